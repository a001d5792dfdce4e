"""The report: one HTML file, its pictures as SVG strings and their data as plain lists.

Loaded when first used: the drawing of the branches does without the plot library.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from invid.report.data import figure_data
    from invid.report.page import render_report

_HOMES = {"figure_data": "data", "render_report": "page"}
__all__ = ["figure_data", "render_report"]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
