"""Chains grown from rigid axes, in records of axes that move together and never repeat."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import invid
from invid.identification.grown_chain import grow_chains
from invid.recording import Role
from invid.signals.spectra import all_spectra

sys.path.insert(0, str(Path(__file__).parents[2]))
from machines.mujoco_cells import Cell, drawn, measured, write


def production(path: Path, seed: int, sizes: tuple[int, ...]) -> tuple[Cell, invid.Recording]:
    cell = drawn(seed, kinds=(), motion="production", sizes=sizes)
    write(cell, measured(cell), path)
    return cell, invid.read_recording(path)


@pytest.mark.campaign
@pytest.mark.parametrize("seed", [14, 16])
def test_axes_that_move_together_without_a_period_are_identified(seed: int, tmp_path: Path) -> None:
    cell, recording = production(tmp_path / "rec.h5", seed, (2, 3))
    found = invid.identify(recording)
    assert found.fit["noise_chi2_per_dof"] < 2.0
    for axis, masses in enumerate(found.chains.masses):
        np.testing.assert_allclose(masses.sum(), cell.load(axis), rtol=0.01)


def test_a_smaller_machine_is_not_grown_at_all(tmp_path: Path) -> None:
    cell, recording = production(tmp_path / "rec.h5", 15, (1, 1))
    grown = grow_chains(all_spectra(recording, Role.IDENTIFY), (1, 1), recording.axes)
    assert grown is not None
    np.testing.assert_allclose(grown.masses[0][0], cell.load(0), rtol=0.1)
