"""Starts of a machine whose torque acts late are drawn with that taken out."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from invid.identification.identify import identify_chains
from invid.identification.starts import fit_sizes, measured_frf
from invid.identification.torque_timing import refit_with_late_torque
from invid.model.chains import CoupledChains
from invid.recording import Role
from invid.signals.spectra import LineSpectra, all_spectra

sys.path.insert(0, str(Path(__file__).parents[1]))
from hidden.causes import CATALOGUE
from hidden.generator import make
from hidden.measurement import Active, record
from hidden.plants import random_plant
from hidden.setup import draw_setup


def test_a_fit_in_a_wrong_minimum_starts_again_with_the_lateness_that_it_found_taken_out() -> None:
    recording, truth = make(
        "torque_delay",
        (0, 0),
        {"delay": 0.0096},
        seed=5,
        masses=(2,),
        noise=0.003,
        drive="smooth",
        periods=2,
        moves=False,
        from_rest=False,
    )
    spectra = all_spectra(recording, Role.IDENTIFY)
    right = fit_sizes(spectra, (2,), recording.axes, measured_frf(spectra), thorough=False)
    # Another minimum: as late, but off by far.
    late = {"time_offset_s": {f"{recording.axes[0]}.time_offset": {"value": 0.0096, "std": 1e-5}}}
    wrong = replace(right, noise_cost=1e3 * right.noise_cost, facts=late)

    def starts_for(turned: Sequence[LineSpectra]) -> Iterator[CoupledChains]:
        yield truth.chains.__class__.build(
            [1.5 * m for m in truth.chains.masses],
            [1.6 * k for k in truth.chains.springs],
            truth.chains.dampers,
            axes=truth.chains.axes,
        )

    found = refit_with_late_torque(spectra, wrong, starts_for)
    assert found is not wrong
    assert found.chains.springs[0] == pytest.approx(truth.chains.springs[0], rel=0.01)
    # Within a sample nothing is late, and nothing is tried.
    punctual = replace(wrong, facts={"time_offset_s": {}})
    assert refit_with_late_torque(spectra, punctual, starts_for) is punctual


def test_masses_that_are_declared_are_found_behind_a_late_torque_as_those_that_are_not() -> None:
    rng = np.random.default_rng([2, 39])
    rng.integers(2, 4, 1)
    plant = random_plant(rng, ("A1",), (3,))
    setup = draw_setup(rng, plant, moves=False, periods=2, from_rest=False)
    late = Active(CATALOGUE["torque_delay"], 0, 0, -1, {"delay": 1.3 / setup.rate})
    recording = record(np.random.default_rng([2, 40]), setup, (late,), [3])[0]
    for masses in ([3], "auto"):
        found = identify_chains(recording, masses)
        np.testing.assert_allclose(found.chains.masses[0], plant.chains.masses[0], rtol=0.01)
