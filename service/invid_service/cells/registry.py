"""Load the cells that this service serves: one config each."""

from __future__ import annotations

import copy
import logging
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from invid.config import CellConfig, load_config
from invid.errors import ConfigError, InputError
from invid.model.document import dump_json, load_json, save_text
from invid_drivers.simulated import CASE_STUDY, truth

log = logging.getLogger(__name__)


class Cell:
    """A cell: its config and, where it is simulated, how its simulation was changed since."""

    def __init__(self, identity: str, config: CellConfig, folder: Path) -> None:
        self.id, self._config = identity, config
        self._override = folder / "simulation" / f"{identity}.json"
        self._simulation = config.simulation
        if config.simulated and self._override.exists():
            try:
                stored = load_json(self._override)
                self._checked(stored)
                self._simulation = stored
            except InputError as error:
                log.error("cell %s: its changed simulation is ignored: %s", identity, error)

    @property
    def simulated(self) -> bool:
        """True where no hardware is behind it."""
        return self._config.simulated

    @property
    def config(self) -> CellConfig:
        """Return the config with the simulation as it is now."""
        if self._simulation is None:
            return self._config
        return self._config.model_copy(update={"simulation": self._simulation})

    @property
    def axes(self) -> tuple[str, ...]:
        """Return the names of the axes."""
        return tuple(a.name for a in self._config.axes)

    @property
    def simulation(self) -> dict[str, Any]:
        """Return the simulation section as it is now."""
        return copy.deepcopy(self._simulation or {})

    def _checked(self, simulation: Any) -> None:
        truth(self._config.model_copy(update={"simulation": simulation}))

    def set_simulation(self, simulation: dict[str, Any] | None) -> None:
        """Replace the simulation (``None``: as in the config); ConfigError where it is none."""
        if simulation is None:
            self._simulation = self._config.simulation
            self._override.unlink(missing_ok=True)
            return
        self._checked(simulation)
        save_text(self._override, dump_json(simulation))
        self._simulation = simulation

    def with_payload(self, axis: str, mass: float) -> dict[str, Any]:
        """Return the simulation with ``mass`` more on the final mass of one axis, as another tool has."""
        chains = truth(self.config)
        if axis not in self.axes:
            raise ConfigError(f"payload.axis: no axis {axis!r}; the cell has {list(self.axes)}")
        simulation = self.simulation
        old = simulation["plant"]
        branches = [
            {"axis": name, "masses": m.tolist(), "springs": k.tolist(), "dampers": d.tolist()}
            for name, m, k, d in zip(chains.axes, chains.masses, chains.springs, chains.dampers, strict=True)
        ]
        branches[self.axes.index(axis)]["masses"][-1] += mass
        couplings = [
            {"between": [a, b], "value": float(chains.couplings[i, j])}
            for i, a in enumerate(self.axes)
            for j, b in enumerate(self.axes)
            if i < j and chains.couplings[i, j] != 0
        ]
        kept = {k: v for k, v in old.items() if k in ("substep_s", "damping_ratio")}
        simulation["plant"] = {**kept, "branches": branches, "couplings": couplings}
        return simulation

    def job_config(self, run_number: int) -> dict[str, Any]:
        """Return the config for a runner; a simulated cell draws other noise in every run, as a real one
        does.
        """
        document = self.config.model_dump(mode="json")
        if document.get("simulation"):
            document["simulation"]["seed"] = int(document["simulation"].get("seed", 0)) + run_number
        return document


def slug(text: str) -> str:
    """Return a name that can stand in an address."""
    return re.sub(r"[^a-z0-9_]+", "-", text.lower()).strip("-")[:64] or "cell"


def load_cells(configs: Sequence[Path], folder: Path) -> dict[str, Cell]:
    """Return cells by id, the file's stem; ConfigError says what is wrong with a config."""
    paths = list(configs)
    if not paths:
        paths = [CASE_STUDY]
    cells: dict[str, Cell] = {}
    for path in paths:
        identity = slug(path.stem)
        if identity in cells:
            raise ConfigError(f"{path}: another cell is already called {identity!r}; rename the file")
        cells[identity] = Cell(identity, load_config(path), folder)
    return cells
