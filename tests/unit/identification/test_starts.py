"""Where a fit starts: branches alike, and a fit that stands in a wrong minimum beside the paper's inverse."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.identification.bench_identify import estimate, measure, truth
from benchmarks.shared import plant_oracle as oracle
from invid.identification.identify import identify, restart_from_second_route
from invid.identification.separate_branches import start_separate_branches
from invid.inverse import PaperResult
from invid.likelihood.fit import fit_structure
from invid.model.chains import CoupledChains
from invid.model.parameters import ChainStructure
from invid.recording.model import Recording
from invid.signals.spectra import all_spectra


def recorded(plant: oracle.OraclePlant, top_hz: float) -> Recording:
    peak = 10.0 * np.array([sum(m) for m in plant.masses])
    return measure(
        plant, np.random.default_rng(77), period=5000, periods=2, settle=3, band=(0.3, top_hz), peak=peak,
        bits=20,
    )  # fmt: skip


@pytest.mark.campaign
def test_a_fit_in_a_wrong_minimum_is_led_out_by_the_papers_inverse_that_contradicts_it() -> None:
    plant = oracle.OraclePlant(
        [[0.889, 1.176, 0.511, 1.096], [0.885, 0.948, 1.536, 1.188]],
        [[2285.0, 5506.0, 5383.0], [5017.0, 3990.0, 1602.0]],
        [[0.6, 0.6, 0.6], [0.6, 0.6, 0.6]],
        couplings={(0, 1): 0.52},
    )
    spectra = all_spectra(recorded(plant, 32.0))
    # Another chain with nearly the same modes at its motor: inner masses and springs change places.
    wrong = CoupledChains.build(
        [[0.889, 1.28, 1.119, 0.384], [0.885, 0.947, 1.532, 1.192]],
        [[2269.0, 3532.0, 3432.0], [5016.0, 3988.0, 1727.0]],
        plant.dampers,
        np.array([[0.0, 0.52], [0.52, 0.0]]),
        axes=("A1", "A2"),
    )
    true = CoupledChains.build(
        plant.masses, plant.springs, plant.dampers, np.array([[0.0, 0.52], [0.52, 0.0]]), axes=("A1", "A2")
    )
    right = fit_structure(spectra, ChainStructure((4, 4), ("A1", "A2")), [true])
    stuck = right.solution.p.copy()
    stuck[: right.structure.count] = right.structure.vector(wrong)
    fit = replace(
        right,
        solution=replace(right.solution, p=stuck, result="limit"),
        chains=wrong,
        noise_chi2=2.5,
        noise_cost=2.5 * right.noise_cost,
    )
    found, paper = restart_from_second_route(spectra, fit)
    assert found.noise_chi2 < 1.2
    assert found.chains.masses[0] == pytest.approx(plant.masses[0], rel=0.01)
    assert isinstance(paper, PaperResult)
    assert paper.chains.masses[0] == pytest.approx(plant.masses[0], rel=0.05)


def test_two_branches_alike_that_do_not_move_one_another_are_each_found_on_their_own() -> None:
    # The fourth mode is barely visible at the motor, and there are two of it.
    branch = ([1.15, 1.47, 1.35, 1.78, 1.65], [1512.0, 4744.0, 5863.0, 4451.0], [0.6, 1.1, 1.3, 1.2])
    plant = oracle.OraclePlant([branch[0]] * 2, [branch[1]] * 2, [branch[2]] * 2)
    spectra = all_spectra(recorded(plant, 21.0))
    start = start_separate_branches(spectra, (5, 5), ("A1", "A2"))
    assert start is not None
    assert not start.couplings.any()
    for masses, springs in zip(start.masses, start.springs, strict=True):
        assert masses == pytest.approx(branch[0], rel=0.1)
        assert springs == pytest.approx(branch[1], rel=0.1)


def test_periods_that_still_settle_need_no_chain_grown_first(monkeypatch: pytest.MonkeyPatch) -> None:
    grown = []
    monkeypatch.setattr("invid.identification.starts.grow_chains", lambda *given: grown.append(given))
    plant = oracle.OraclePlant(
        [[0.8, 1.6], [1.1, 2.0]], [[1800.0], [2500.0]], [[0.3], [0.4]], couplings={(0, 1): 0.3}
    )
    peak = 10.0 * np.array([sum(m) for m in plant.masses])
    recording = measure(
        plant, np.random.default_rng(78), period=5000, periods=2, settle=0, band=(0.3, 12.0), peak=peak,
        bits=20,
    )  # fmt: skip
    assert all(s.transient and s.periods == 2 for s in all_spectra(recording))
    values, std = estimate(identify(recording, masses=(2, 2)))
    assert np.abs((values - truth(plant)) / std).max() < 6
    assert not grown
