"""A chain with one mass more has the modes of the smaller one and the one that was asked for."""

import numpy as np

from invid.identification.further_mode import LOSS_FACTORS, MissingMode, _frequency_grid, chains_with_mode
from invid.model.chains import CoupledChains


def _modes(masses: np.ndarray, springs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    stiffness = np.zeros((masses.size, masses.size))
    for s, k in enumerate(springs):
        stiffness[s : s + 2, s : s + 2] += k * np.array([[1.0, -1.0], [-1.0, 1.0]])
    squares, shapes = np.linalg.eigh(stiffness / np.sqrt(np.outer(masses, masses)))
    return np.sqrt(np.maximum(squares, 0.0)), shapes[0] ** 2 / masses[0]


def test_the_further_mode_stands_beside_those_of_the_smaller_chain() -> None:
    chains = CoupledChains.build(
        [np.array([4.0, 3.0, 5.0])], [np.array([9e4, 7e4])], [np.array([9.0, 7.0])], axes=["A1"]
    )
    at, share = 2 * np.pi * 31.0, 2e-3
    (found,) = chains_with_mode(chains, MissingMode(at, share, 1.0))
    before, weights = _modes(chains.masses[0], chains.springs[0])
    after, further = _modes(found.masses[0], found.springs[0])
    order = np.argsort(np.append(before, at))
    assert np.allclose(after[1:], np.append(before, at)[order][1:], rtol=1e-6)
    assert np.allclose(further, np.append(weights, share)[order], rtol=1e-6)
    assert np.isclose(found.masses[0].sum(), 12.0)
    assert np.allclose(found.dampers[0] / found.springs[0], 1e-4)


def test_no_mode_of_low_loss_falls_between_two_frequencies_that_are_tried() -> None:
    lines = 2 * np.pi * np.arange(1, 1400) / 10.0
    for loss in LOSS_FACTORS:
        tried = np.sort(_frequency_grid(lines, loss))
        assert tried[0] <= lines[0]
        assert tried[-1] >= lines[-1] * (1 - 1e-9)
        apart = np.diff(tried)
        assert np.all(apart <= 1.01 * np.maximum(loss * tried[1:], lines[1] - lines[0]))
