"""The documentation site: `make docs`. The pages are plain Markdown and read as well on a forge."""

import sys
from importlib.metadata import version as installed
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.util import logging

sys.path.insert(0, str(Path(__file__).parents[1] / "scripts"))
from check_docs import marker_lines

project = "invid"
author = "the invid project"
copyright = "MIT licence"
version = release = installed("invid")

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
source_suffix = {".md": "markdown"}
myst_heading_anchors = 3
myst_enable_extensions = ["fieldlist"]
suppress_warnings = ["misc.highlighting_failure"]  # blocks that show an ellipsis are no valid YAML or JSON

html_theme = "furo"
html_title = "invid"
html_copy_source = False

autodoc_typehints = "description"
autodoc_typehints_format = "short"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
napoleon_google_docstring = False


def refuse_markers(app: Sphinx, page: str, source: list[str]) -> None:
    """Warn of what a merge left behind, so that ``-W`` ends the build."""
    for line in marker_lines(source[0]):
        logging.getLogger(__name__).warning("conflict marker", location=(page, line))


def setup(app: Sphinx) -> None:
    """Read every page for conflict markers before it is built."""
    app.connect("source-read", refuse_markers)
