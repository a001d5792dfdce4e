"""The simulator in a file, by what the file is."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from xml.etree.ElementTree import ParseError, iterparse

from invid.errors import InputError
from invid.simulators.guided import Simulator

KINDS = {
    ".xml": "mujoco_engine",
    ".mjcf": "mujoco_engine",
    ".urdf": "urdf_engine",
    ".json": "invid_engine",
    ".fmu": "fmu_engine",
}
"""Modules of this folder by a file's ending; each has ``opened(path, axes)``."""
WAYS = {
    ".xacro": "expand it first: xacro {0} > {1}.expanded.urdf",
    ".sdf": "give the URDF that it was made of",
    ".usd": "export the robot as URDF or MJCF there (Isaac Sim: File, Export, URDF)",
}
"""The way to a file that is taken, by the ending of one that is not."""
TAKEN = "a MuJoCo XML (.xml), a URDF (.urdf), an invid model (.json) or an FMU (.fmu)"


def open_simulator(path: Path, axes: Sequence[str]) -> Simulator:
    """The simulator; InputError where there is none or nobody reads it."""
    if not path.is_file():
        raise InputError(f"{path}: no such file; --against takes {TAKEN}")
    ending = path.suffix.lower()
    if ending not in KINDS:
        way = next((w for e, w in WAYS.items() if ending.startswith(e)), "").format(
            path.name, path.name.split(".")[0]
        )
        raise InputError(f"{path}: --against takes {TAKEN}", way_out=way, code="simulator_not_read")
    if ending == ".xml" and _root(path) == "robot":
        ending = ".urdf"
    try:
        module = import_module(f"invid.simulators.{KINDS[ending]}")
    except ImportError as error:
        package = (error.name or "mujoco").split(".")[0]
        if package == "invid":
            raise
        # An upgrade in place may leave a package that is there and does not load.
        is_missing = isinstance(error, ModuleNotFoundError)
        state = "is not installed" if is_missing else f"does not load ({str(error).splitlines()[0][:160]})"
        way = "pip install 'invid[against]'" if is_missing else f"pip install --force-reinstall {package}"
        raise InputError(
            f"{path}: needs the package {package}, which {state}",
            way_out=way,
            code="package_missing" if is_missing else "package_broken",
        ) from None
    simulator: Simulator = module.opened(path, tuple(axes))
    return simulator


def _root(path: Path) -> str:
    """Name of an XML's root; nothing where it is none, which its reader says better."""
    try:
        return next((str(element.tag) for _, element in iterparse(path, events=("start",))), "")
    except (ParseError, OSError):
        return ""
