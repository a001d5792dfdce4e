"""The cells that the project itself hands out, on the virtual bus: demo, service, examples, ``init``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from invid.config import CellConfig, load_config, parse_config
from invid_drivers.cia402.link import Link
from invid_drivers.cli.init import ask_all
from invid_drivers.connect import VIRTUAL, open_bus
from invid_drivers.first_config import Adapter, first_config
from invid_drivers.simulated import CASE_STUDY
from machines.ordinary import ordinary

CONFIGS = Path(__file__).parents[2] / "configs"
BEHIND: dict[str, dict[str, Any]] = {
    "socketcan-elmo-gold": {
        "masses": [[0.04, 0.06], [0.06, 0.04], [0.02, 0.02]], "profile": "elmo_gold", "load": {"A2": 0.6},
    },
    "socketcan-epos4": {"masses": [[0.004, 0.004], [0.005, 0.003]], "profile": "epos4", "load": {}},
    "socketcan-linear-nanotec": {"masses": [[6.0, 6.0]], "profile": "nanotec_c5e", "load": {}},
}  # fmt: skip
"""A machine that fits what each example says of its drives."""
RESONANCE = 1500.0
"""Square of the antiresonance of the second mass [rad²/s²]: 6 Hz."""


def named_cells() -> Iterator[tuple[str, CellConfig]]:
    """Name and cell."""
    yield "demo and service", load_config(CASE_STUDY)
    for path in sorted(CONFIGS.glob("*.yaml")):
        yield path.stem[-20:], on_virtual_bus(load_config(path), path.stem)
    for seed in range(1, 9):
        yield f"init of seed {seed}", written_by_init(ordinary(seed))


def on_virtual_bus(config: CellConfig, name: str) -> CellConfig:
    """An example in virtual time, with a machine behind it where it has none."""
    document = config.model_dump(mode="json", exclude_none=True)
    document["bus"] |= {"interface": VIRTUAL, "channel": name}
    if config.simulation is None:
        behind = BEHIND[name]
        axes = [a.name for a in config.axes]
        document["simulation"] = {
            "plant": {
                "branches": [
                    {"axis": a, "masses": m, "springs": [RESONANCE * m[1]], "dampers": [m[1]]}
                    for a, m in zip(axes, behind["masses"], strict=True)
                ]
            },
            "axes": {
                a.name: {
                    "rated_torque": a.rated_torque,
                    "encoder_counts": _counts(a.position_per_count, linear=config.linear),
                    "torque_noise": 0.005,
                    "quick_stop_deceleration": 10.0,
                    "ramp_unit": "rpm_per_s" if behind["profile"] == "epos4" else "counts_per_s2",
                    "load": {"torque": behind["load"].get(a.name, 0.0)},
                    "objects": {"profile": behind["profile"]},
                }
                for a in config.axes
            },
        }
    return CellConfig.model_validate(document)


def _counts(position_per_count: float | None, *, linear: bool) -> float:
    turn = 1.0 if linear else 6.283185307179586
    return 524288.0 if position_per_count is None else turn / position_per_count


def written_by_init(config: CellConfig) -> CellConfig:
    """What ``invid init`` writes for the drives of a simulated cell, in front of the same machine."""
    bus = open_bus(config)
    try:
        link = Link(bus, heartbeat_s=0.1)
        drives = [n for n in ask_all(link, last=len(config.axes)) if n.is_drive]
    finally:
        bus.shutdown()
    adapter = Adapter(VIRTUAL, config.bus.channel, config.bus.bitrate_bit_per_s)
    document = yaml.safe_load(first_config(adapter, drives).text)
    document["simulation"] = config.simulation
    for axis, old in zip(document["axes"], config.axes, strict=True):
        if old.allow_missing_heartbeat:  # a person's decision, asked for by `invid check`
            axis["allow_missing_heartbeat"] = True
    return parse_config(yaml.safe_dump(document))
