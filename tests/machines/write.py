"""The machine's log as some tool might have written it: CSV in varied dress, and the map that reads it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from machines.draw import Machine

_UNITS = {
    False: {
        "position": {"rad": 1.0, "deg": 180 / np.pi, "mrad": 1e3},
        "velocity": {"rad/s": 1.0, "rpm": 30 / np.pi},
        "torque": {"N·m": 1.0, "mN·m": 1e3},
    },
    True: {
        "position": {"m": 1.0, "mm": 1e3},
        "velocity": {"m/s": 1.0, "mm/s": 1e3},
        "torque": {"N": 1.0, "kN": 1e-3},
    },
}


def write(machine: Machine, folder: Path, seed: int) -> tuple[Path, Path]:
    """CSV and map in ``folder``."""
    rng = np.random.default_rng([seed, 5])
    units = _UNITS[machine.linear]
    delimiter, decimal = [(",", "."), (";", ","), (";", "."), ("\t", "."), (" ", ".")][int(rng.integers(5))]
    clock, ticks = [("s", 1.0), ("ms", 1e3)][int(rng.integers(2))]
    names, data = ["clock"], [machine.time * ticks]
    axes: list[dict[str, Any]] = []
    for i in range(machine.torque.shape[1]):
        axis: dict[str, Any] = {"name": f"J{i + 1}"}
        quantity = "velocity" if machine.velocity_only else "position"
        for what, signal in ((quantity, getattr(machine, quantity)[:, i]), ("torque", machine.torque[:, i])):
            unit = str(rng.choice(list(units[what])))
            sign, name = int(rng.choice([-1, 1])), f"{what[0]}{i + 1}"
            factor, entry = units[what][unit], {"column": name, "unit": unit, "sign": sign}
            if what == "torque" and rng.random() < 0.4:
                rated = float(2.0 * np.abs(signal).max())
                factor, entry["unit"], axis["rated_torque"] = 100 / rated, "%", rated
            names.append(name)
            data.append(sign * factor * signal)
            axis[what] = entry
        axes.append(axis)
    experiments: list[dict[str, Any]] = [{"kind": "other", "role": "identify"}]
    if "period" in machine.facts:
        experiments = [
            {"kind": "multisine", "role": "identify", "excited_axis": 0,
             "period_samples": machine.facts["period"], "frequencies_hz": machine.facts["lines"]}
        ]  # fmt: skip
    elif machine.split:
        cut = 2 * machine.time.size // 3
        experiments = [
            {"kind": "other", "role": "identify", "rows": [0, cut]},
            {"kind": "other", "role": "validate", "rows": [cut, None]},
        ]
    chart = {
        "format": "invid-import-map", "robot": machine.family, "time": {"column": "clock", "unit": clock},
        "motion": "linear" if machine.linear else "rotary", "axes": axes, "experiments": experiments,
    }  # fmt: skip
    source, place = folder / "log.csv", folder / "map.yaml"
    lines = [delimiter.join(names)]
    if rng.random() < 0.4:
        lines = ["logger 3.1", f"date{delimiter}2026-01-02", *lines]
        chart["source"] = {"header_lines": 3, "names": names}
    for row in np.stack(data, 1):
        text = delimiter.join(f"{v:.12g}" for v in row)
        lines.append(text.replace(".", ",") if decimal == "," else text)
    source.write_text("\n".join(lines) + "\n", encoding="utf-8")
    place.write_text(yaml.safe_dump(chart, allow_unicode=True), encoding="utf-8")
    return source, place
