"""The report: one HTML file, its pictures as SVG strings and their data as plain lists."""

from __future__ import annotations

from invid.report.data import figure_data
from invid.report.figures import figures
from invid.report.page import render_report

__all__ = ["figure_data", "figures", "render_report"]
