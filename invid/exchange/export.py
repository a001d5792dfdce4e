"""A model written for another tool, with its covariance and what the format cannot hold beside it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from invid.errors import InputError
from invid.exchange.linear_plant import LinearPlant, ParameterSpread, linear_plant, parameter_spread
from invid.extensions import extension_names, load_extension
from invid.model.document import Model, dump_json, model_to_json, save_bytes, save_text
from invid.numerics.arrays import Float64

BESIDE = ".json"
"""Added to the file's name for what travels beside it."""


@dataclass(frozen=True)
class Export:
    """What was written: ``path``, ``beside`` (covariance and losses, JSON), and the losses in sentences."""

    to: str
    path: str
    beside: str
    losses: tuple[str, ...]
    warnings: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """The document of ``invid export --json``."""
        return {
            "to": self.to,
            "output": self.path,
            "beside": self.beside,
            "losses": list(self.losses),
            "warnings": list(self.warnings),
        }


FORMATS = {"statespace": "scipy", "mjcf": "mujoco", "urdf": "", "fmu": "pythonfmu3"}
"""Formats, each a module of this folder with ``losses`` and ``content``, and the package it needs."""
EXPORTS = "invid.exports"
"""Entry point group of further such modules, by the names of their formats."""


def export_model(model: Model, to: str, path: str | Path) -> Export:
    """Write ``model`` to ``path`` in another tool's format; see ``invid.export``."""
    target = Path(path)
    if target.is_dir():
        raise InputError(f"{target}: is a folder; name a file in it")
    module = _module(to)
    plant, spread = linear_plant(model), parameter_spread(model)
    lost: list[str] = module.losses(plant)
    content: bytes = module.content(plant, spread, robot=model.robot, losses=lost)
    warnings = [] if spread.joint else [_no_covariance(spread)]
    if not model.fit.get("trustworthy", True):
        warnings.append("the model is not to be trusted, its own warnings say why")
    beside = target.with_name(target.name + BESIDE)
    export = Export(to, str(target), str(beside), tuple(lost), tuple(warnings))
    document = _beside(export, model, plant, spread)
    save_bytes(target, content)
    save_text(beside, dump_json(document))
    return export


def format_names() -> tuple[str, ...]:
    """The formats that there are, of installed packages too."""
    return *FORMATS, *extension_names(EXPORTS)


def _module(to: str) -> Any:
    if to not in FORMATS:
        further = load_extension(EXPORTS, to)
        if further is None:
            raise InputError(f"--to {to}: there are {', '.join(format_names())}")
        return further
    try:
        return import_module(f"invid.exchange.{to}")
    except ModuleNotFoundError as error:
        if error.name != FORMATS[to]:
            raise
        raise InputError(
            f"--to {to} needs the package {error.name}, which is not installed: pip install 'invid[export]'"
        ) from None


def _no_covariance(spread: ParameterSpread) -> str:
    unknown = [n for n, v in zip(spread.names, spread.covariance.diagonal(), strict=True) if math.isnan(v)]
    text = "the model has no joint covariance: its standard deviations alone stand on the diagonal"
    return text + (f"; not known, NaN: {', '.join(unknown)}" if unknown else "")


def _beside(export: Export, model: Model, plant: LinearPlant, spread: ParameterSpread) -> dict[str, Any]:
    def known(row: Float64) -> list[float | None]:
        return [None if math.isnan(v) else float(v) for v in row]

    return {
        "format": "invid-export",
        "format_version": 1,
        "to": export.to,
        "file": Path(export.path).name,
        "losses": list(export.losses),
        "warnings": list(export.warnings),
        "coordinates": list(plant.coordinates),
        "modes_hz": [float(w) / (2 * math.pi) for w in plant.modes],
        "parameters": {
            "names": list(spread.names),
            "values": spread.values.tolist(),
            "covariance": [known(row) for row in spread.covariance],
        },
        "model": model_to_json(model),
    }
