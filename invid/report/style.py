"""Give all pictures one look: Okabe-Ito colours, told apart by line and marker too, light and dark."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable, Sequence
from html import escape
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from invid.report.labels import printable

# Stand-in colours that matplotlib writes; the page's style sheet gives each its light and dark value.
INK, GRID = "#1b1c1d", "#c3c4c5"
MEASURED, BEFORE, AFTER, NOISE = "#0072b2", "#d55e00", "#009e73", "#8a8b8c"
_VARIABLES = {
    INK: "--ink",
    GRID: "--grid",
    MEASURED: "--measured",
    BEFORE: "--before",
    AFTER: "--after",
    NOISE: "--noise",
}


def powers_of_ten(axis: Axis) -> None:
    """Ticks 10⁻³ in plain characters: mathtext is off, because an axis may be called $x_1$."""
    raised = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

    def words(value: float, _: float) -> str:
        return "10" + str(round(math.log10(value))).translate(raised) if value > 0 else ""

    axis.set_major_locator(LogLocator(10, numticks=7))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(words))


def over_frequency(ax: Axes, hz: Any, floor: Any, values: Sequence[float]) -> None:
    """The noise floor over frequency on logarithmic axes, high enough for ``values``."""
    ax.fill_between(hz, floor, 1e-300, color=NOISE, alpha=0.45, lw=0, label="noise floor")
    ax.set_xscale("log")
    ax.set_yscale("log")
    powers_of_ten(ax.yaxis)
    seen = np.array(values)
    seen = seen[np.isfinite(seen) & (seen > 0)]
    if seen.size:
        ax.set_ylim(np.quantile(seen, 0.02) * 0.5, seen.max() * 2)


def svg(name: str, draw: Callable[[Figure], None], *, size: tuple[float, float], title: str) -> str:
    """SVG text of a figure; the same data give the same bytes. ``draw`` fills a matplotlib Figure."""
    settings: Any = {  # older matplotlib types this as a dict of str, newer as one of its names
        "svg.fonttype": "none",
        "svg.hashsalt": f"invid-{name}",
        "text.parse_math": False,  # an axis may be called $x_1$
        "text.usetex": False,
        "font.family": "sans-serif",
        "font.size": 9.0,
        "text.color": INK,
        "axes.edgecolor": INK,
        "axes.labelcolor": INK,
        "axes.titlesize": 9.5,
        "axes.titleweight": "bold",
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "axes.formatter.use_mathtext": False,
        "axes.unicode_minus": True,
        "grid.color": GRID,
        "grid.linewidth": 0.5,
        "xtick.color": INK,
        "ytick.color": INK,
        "legend.frameon": False,
        "legend.fontsize": 8.5,
        "lines.linewidth": 1.4,
        "path.simplify": True,
        "path.simplify_threshold": 0.5,
    }
    with mpl.rc_context(settings):
        figure = Figure(figsize=size)
        # Fixed margins in inches, room for one row of legend: a tenth of a layout engine's time.
        left, right, bottom, top = 0.8 / size[0], 1 - 0.12 / size[0], 0.5 / size[1], 1 - 0.42 / size[1]
        figure.subplots_adjust(left=left, right=right, bottom=bottom, top=top, hspace=0.28)
        figure.patch.set_alpha(0.0)
        FigureCanvasSVG(figure)
        draw(figure)
        for axes in figure.axes:
            axes.patch.set_alpha(0.0)
        stream = io.StringIO()
        figure.savefig(
            stream, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None}
        )
    return _embedded(stream.getvalue(), name, title)


def _embedded(text: str, name: str, title: str) -> str:
    """The svg element alone, its colours as variables, its ids its own, with a title for readers."""
    text = text[text.index("<svg") :].strip()
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.S)
    text = re.sub(r'<g id="[A-Za-z_.]+\d*">', "<g>", text)
    # Hashes of shapes repeat between pictures of one page.
    text = re.sub(r'id="([^"]+)"', rf'id="{name}-\1"', text)
    text = re.sub(r'(xlink:href="#|url\(#)', rf"\g<1>{name}-", text)
    for colour, variable in _VARIABLES.items():
        text = text.replace(colour, f"var({variable}, {colour})")
    text = re.sub(r"font: ([0-9.]+px)[^;\"]*", r"font: \1 system-ui, sans-serif", text)
    text = re.sub(r"\n\s*", "\n", text)
    head, rest = text.split(">", 1)
    head = re.sub(r' (width|height)="[^"]*"', "", head)
    return f'{head} role="img"><title>{escape(printable(title))}</title>{rest}'
