"""The pictures as SVG strings, by name."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from invid.report.labels import label
from invid.report.style import AFTER, BEFORE, INK, MEASURED, NOISE, over_frequency, powers_of_ten, svg


def draw(data: dict[str, Any]) -> dict[str, str]:
    """SVG of what ``figure_data`` returned, by name: ``residual``, ``forces``, ``cause-1`` …, ``frf-1`` …
    (one an axis), ``missing-torque``.
    """
    out: dict[str, str] = {}
    if data["residual"]:
        out["residual"] = residual(data["residual"])
    if data["forces"]:
        out["forces"] = forces(data["forces"])
    for number, view in enumerate(data["views"], 1):
        if view["own"] or not view["cause"]:  # a cause without a law of motion has no such picture
            out[f"cause-{number}"] = dependence(view, f"cause-{number}")
    if data["missing_torque"]:
        out["missing-torque"] = missing(data["missing_torque"])
    for number, axis in enumerate(data["frf"], 1):
        out[f"frf-{number}"] = response(axis, f"frf-{number}")
    return out


def forces(rows: list[dict[str, Any]]) -> str:
    """Force in no law at each place, without and with the named causes, on a logarithmic scale."""
    strongest = max(max(r["before"], r["after"]) for r in rows)
    least = NOTHING * strongest

    def fill(figure: Figure) -> None:
        ax = figure.add_subplot()
        at = np.arange(len(rows))
        for number, (key, words, style) in enumerate(SERIES[:2]):
            sizes = [max(r[key], least) for r in rows]
            ax.barh(
                at + (number - 0.5) * 0.4, sizes, 0.38, label=words, edgecolor=INK, linewidth=0.5, **style
            )
        # A stub where nothing is left.
        ax.set(xscale="log", xlim=(0.6 * least, 2.0 * strongest), yticks=at, yticklabels=map(_place, rows))
        ax.set_xlabel(f"force in no law, rms [{label(rows[0]['unit'])}]")
        powers_of_ten(ax.xaxis)
        ax.invert_yaxis()
        ax.grid(False, axis="y")
        figure.legend(loc="upper right", ncols=2)

    height = 1.4 + 0.32 * len(rows)
    return svg("forces", fill, size=(7.2, height), title="Force in no law at each place, before and after")


def _place(row: dict[str, Any]) -> str:
    between = f"–{row['other_axis']}" if row["other_axis"] else ""
    return f"{label(row['axis'], 16)}{between} {row['element']}"


NOTHING = 1e-3
"""Force over the strongest below which nothing is drawn."""
SERIES: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("before", "without causes", {"facecolor": BEFORE, "hatch": "//"}),
    ("after", "with the causes named", {"facecolor": AFTER, "hatch": ""}),
    ("noise_floor", "noise floor", {"facecolor": NOISE, "hatch": ".."}),
)
"""What bars stand for."""


def residual(rows: list[dict[str, Any]]) -> str:
    """Missing torque before and after, and what noise alone would leave where it is known; one scale for all
    axes."""
    sizes = {key: [r[key] or 0.0 for r in rows] for key, *_ in SERIES}

    def fill(figure: Figure) -> None:
        ax = figure.add_subplot()
        at = np.arange(len(rows))
        for number, (key, words, style) in enumerate(SERIES):
            place = at + (number - 1) * 0.27
            bars = ax.bar(place, sizes[key], 0.25, label=words, edgecolor=INK, linewidth=0.5, **style)
            ax.bar_label(bars, [f"{v:.2g}" for v in sizes[key]], padding=1.5, fontsize=8)
        # An axis may be hundreds of times another: a logarithmic scale shows all of them.
        seen = [v for own in sizes.values() for v in own if v > 0]
        if seen and max(seen) > 30 * min(seen):
            ax.set_yscale("log")
            powers_of_ten(ax.yaxis)
        ax.margins(y=0.15)
        ax.set(xticks=at, xticklabels=[label(r["axis"], 16) for r in rows])
        ax.set_ylabel(f"missing torque, rms [{label(rows[0]['unit'])}]")
        ax.grid(False, axis="x")
        figure.legend(loc="upper right", ncols=3)

    return svg(
        "residual", fill, size=(7.2, 2.9), title="Missing torque of each axis before, after, noise floor"
    )


def dependence(view: dict[str, Any], name: str) -> str:
    """Missing torque over what it depends on, with the fitted cause drawn over it."""
    side = view["sides"][0]

    def fill(figure: Figure) -> None:
        ax = figure.add_subplot()
        words = str(view["cause"]).replace("_", " ")
        if side["fit"]:
            low, high = view["band_hz"]
            ax.plot(
                side["fit"]["x"], side["fit"]["y"], "s", ms=3.6, alpha=0.45, color=BEFORE, mec="none",
                label=f"{words}, in the same band",
            )  # fmt: skip
            said = f"dots and squares hold {low:.2g} to {high:.2g} Hz only: a step looks round"
            ax.set_title(said, loc="right", fontsize=8, fontweight="normal")
        ax.plot(side["x"], side["y"], ".", ms=3.2, color=MEASURED, mec="none", label="missing (measured)")
        if side["law"]:
            ax.plot(side["law"]["x"], side["law"]["y"], color=BEFORE, lw=1.6, label=f"{words}, fitted")
        ax.axhline(0.0, color=INK, lw=0.6)
        ax.set(xlabel=label(side["x_label"]), ylabel=label(view["y_label"]))
        place = f", {view['element']}" if view["element"] else ""
        ax.set_title(label(f"{view['axis']}{place}", 60), loc="left")
        figure.legend(loc="upper right", ncols=3)

    title = f"Missing torque of {view['axis']} over {side['x_label']}"
    return svg(name, fill, size=(7.2, 3.3), title=title)


def missing(rows: list[dict[str, Any]]) -> str:
    """Missing torque of each axis over frequency against the noise floor; one scale for all."""

    def fill(figure: Figure) -> None:
        plots = figure.subplots(len(rows), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
        values = [
            v for r in rows for v in (*r["excited"]["before"], *r["silent"]["before"], *r["noise_floor"])
        ]
        for ax, row in zip(plots, rows, strict=True):
            over_frequency(ax, row["frequency_hz"], _positive(row["noise_floor"]), values)
            for key, marker, size, words in (
                ("excited", "o", 3.0, "missing, excited lines"),
                ("silent", "x", 2.6, "missing, lines not excited"),
            ):
                hz, rms = row[key]["frequency_hz"], _positive(row[key]["before"])
                ax.plot(hz, rms, marker, ms=size, color=BEFORE, mew=0.7, label=words)
            ax.set_title(label(row["axis"]), loc="left")
            ax.set_ylabel(f"[{label(row['unit'])}]")
        plain_hz(plots[-1])
        handles, words = plots[0].get_legend_handles_labels()
        figure.legend(handles, words, loc="upper right", ncols=3)

    return svg(
        "missing-torque",
        fill,
        size=(7.2, 0.7 + 1.5 * len(rows)),
        title="Missing torque of each axis over frequency",
    )


def response(row: dict[str, Any], name: str) -> str:
    """Frequency response of one axis, measured and simulated, before and after on one scale."""

    def fill(figure: Figure) -> None:
        top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[2.2, 1])
        hz, measured = row["frequency_hz"], row["measured"]
        if measured is not None:
            f, magnitude = np.array(measured["frequency_hz"]), np.array(measured["magnitude"])
            std = np.array(measured["std"])
            top.fill_between(
                f,
                np.maximum(magnitude - 2 * std, magnitude * 0.05),
                magnitude + 2 * std,
                color=MEASURED,
                alpha=0.25,
                lw=0,
                label="measured ± 2 std",
            )
            top.plot(f, magnitude, "o", ms=2.6, color=MEASURED, mec="none", label="measured")
            bottom.errorbar(
                f,
                measured["phase_deg"],
                2 * np.minimum(measured["phase_std_deg"], 90.0),
                fmt="o",
                ms=2.2,
                color=MEASURED,
                mec="none",
                elinewidth=0.6,
            )
        styles = (
            ("before", "linear model", BEFORE, "-"),
            ("after", "extended model, linear part", AFTER, "--"),
        )
        for key, words, colour, line in styles:
            if key in row["simulated"]:
                curve = row["simulated"][key]
                top.plot(hz, _positive(curve["magnitude"]), line, color=colour, lw=1.1, label=words)
                bottom.plot(hz, curve["phase_deg"], line, color=colour, lw=1.1)
        top.set(xscale="log", yscale="log", ylabel=f"magnitude [{label(row['unit'])}]")
        powers_of_ten(top.yaxis)
        simulated = np.array(row["simulated"]["before"]["magnitude"])
        for peak, height in _apart(row["peaks_hz"], hz, simulated):
            top.annotate(
                f"{peak:.3g} Hz", (peak, height), (0, 4), textcoords="offset points", ha="center", fontsize=8
            )
        top.margins(y=0.12)
        top.set_title(label(row["axis"]), loc="left")
        bottom.set(ylabel="phase [°]", yticks=[-270, -180, -90, 0, 90], ylim=(-290, 110))
        plain_hz(bottom)
        figure.legend(loc="upper right", ncols=4)

    return svg(
        name, fill, size=(7.2, 4.3), title=f"Frequency response of {row['axis']}, measured and simulated"
    )


def _apart(peaks: list[float], hz: list[float], magnitude: Any) -> list[tuple[float, float]]:
    """The highest peaks whose labels do not overlap (22 % apart at this size), with their heights."""
    kept: list[tuple[float, float]] = []
    for height, peak in sorted(((float(np.interp(p, hz, magnitude)), p) for p in peaks), reverse=True):
        if all(abs(np.log(peak / other)) > 0.22 for other, _ in kept):
            kept.append((peak, height))
    return kept


def _positive(values: list[float]) -> Any:
    """Return the values for a logarithmic scale: what is not positive is left out of the line."""
    array = np.array(values, dtype=float)
    return np.where(array > 0, array, np.nan)


def plain_hz(ax: Axes) -> None:
    """A logarithmic frequency axis with ticks at 1, 2, 5 in plain figures."""
    ax.set_xlabel("frequency [Hz]")
    ax.xaxis.set_major_locator(LogLocator(10, subs=(1.0, 2.0, 5.0)))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.xaxis.set_minor_formatter(NullFormatter())
