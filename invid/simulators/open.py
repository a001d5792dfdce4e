"""The simulator in a file, by what the file is."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from invid.errors import InputError
from invid.simulators.guided import Simulator

KINDS = {".xml": "mujoco_engine", ".mjcf": "mujoco_engine", ".json": "invid_engine", ".fmu": "fmu_engine"}
"""Modules of this folder by a file's ending; each has ``opened(path, axes)``."""


def open_simulator(path: Path, axes: Sequence[str]) -> Simulator:
    """The simulator; InputError where there is none or nobody reads it."""
    if not path.is_file():
        raise InputError(f"{path}: no such file; --against takes a MuJoCo XML, an invid model or an FMU")
    if path.suffix.lower() not in KINDS:
        raise InputError(
            f"{path}: --against takes a MuJoCo XML (.xml), an invid model (.json) or an FMU (.fmu)"
        )
    try:
        module = import_module(f"invid.simulators.{KINDS[path.suffix.lower()]}")
    except ModuleNotFoundError as error:
        raise InputError(
            f"{path}: needs the package {error.name}, which is not installed: pip install 'invid[against]'"
        ) from None
    simulator: Simulator = module.opened(path, tuple(axes))
    return simulator
