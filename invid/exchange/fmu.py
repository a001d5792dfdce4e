"""FMI 3 co-simulation and model exchange, built by pythonfmu3.

The FMU runs in the Python of the tool that loads it, with numpy.
"""

from __future__ import annotations

import importlib.util
import json
import shutil
import tempfile
from pathlib import Path
from typing import Any

from pythonfmu3.builder import FmuBuilder

from invid.exchange.linear_plant import LinearPlant, ParameterSpread, derivatives, effect_losses
from invid.numerics.arrays import Float64

SLAVE = "fmu_slave"


def content(plant: LinearPlant, spread: ParameterSpread, *, robot: str, losses: list[str]) -> bytes:
    """The FMU file; the losses stand in its description."""
    source = importlib.util.find_spec(f"invid.exchange.{SLAVE}")
    if source is None or source.origin is None:
        raise RuntimeError(f"invid.exchange.{SLAVE} is not installed as a file")
    with tempfile.TemporaryDirectory(prefix="invid-fmu-") as folder:
        work = Path(folder)
        shutil.copy(source.origin, work / f"{SLAVE}.py")
        document = json.dumps(plant_document(plant, spread, robot=robot, losses=losses), allow_nan=False)
        (work / "plant.json").write_text(document, encoding="utf-8")
        made = FmuBuilder.build_FMU(
            work / f"{SLAVE}.py", dest=work / "made", project_files=[work / "plant.json"]
        )
        return Path(made).read_bytes()


def plant_document(
    plant: LinearPlant, spread: ParameterSpread, *, robot: str, losses: list[str]
) -> dict[str, Any]:
    """What the slave reads: matrices, and their derivatives as (row, column, value) by parameter."""
    made = zip(("mass", "damping", "stiffness"), derivatives(plant, spread.names), strict=True)
    sparse: dict[str, Any] = {
        f"{kind}_derivative": {n: _entries(m) for n, m in zip(spread.names, d, strict=True) if m.any()}
        for kind, d in made
    }
    torque, position = ("N", "m") if plant.linear_axes else ("N.m", "rad")
    return {
        "description": "; ".join([f"{robot}: linear elastic model identified by invid", *losses]),
        "axes": list(plant.axes),
        "coordinates": list(plant.coordinates),
        "motors": list(plant.motors),
        "gain": plant.gain.tolist(),
        "lag": plant.lag.tolist(),
        "units": {"torque": torque, "position": position, "velocity": f"{position}/s"},
        "parameters": list(spread.names),
        "values": spread.values.tolist(),
        "mass_matrix": plant.mass.tolist(),
        "damping_matrix": plant.damping.tolist(),
        "stiffness_matrix": plant.stiffness.tolist(),
        **sparse,
    }


def _entries(matrix: Float64) -> list[tuple[int, int, float]]:
    return [(int(r), int(c), float(matrix[r, c])) for r, c in zip(*matrix.nonzero(), strict=True)]


losses = effect_losses
"""What is not linear is not held."""
