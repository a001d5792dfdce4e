"""The documentation site: `make docs`. The pages are plain Markdown and read as well on a forge."""

from importlib.metadata import version as installed

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
