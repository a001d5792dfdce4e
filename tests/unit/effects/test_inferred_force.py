"""The force that a missing torque would take at a place, read where it is felt and no further."""

from types import SimpleNamespace

import numpy as np

from invid.effects.motion import View
from invid.model.place import Pattern
from invid.numerics.arrays import Complex128

PATTERN: Pattern = ((1, 1.0), (2, -1.0))


def seen(push: Complex128, noise: float) -> View:
    """One record of one motor that feels a force by ``push`` (F,), with ``noise`` power of its torque."""
    view = View.__new__(View)
    view.record = SimpleNamespace(omega=np.arange(push.size) + 1.0)  # type: ignore[assignment]
    view._condensed_forces = {PATTERN: push[:, None]}
    view.certainty = np.full((push.size, 1, 1), 1.0 / noise, dtype=complex)
    return view


def test_a_force_is_read_from_the_torque_that_it_causes() -> None:
    rng = np.random.default_rng(1)
    push = (0.5 + rng.uniform(size=40)).astype(complex)
    force = np.exp(2j * np.pi * rng.uniform(size=40))
    found = seen(push, 1e-6).estimated_force(PATTERN, -(push * force)[:, None])
    np.testing.assert_allclose(found, force, rtol=2e-2)


def test_noise_alone_is_read_as_no_force_in_all_but_few_records() -> None:
    rng = np.random.default_rng(2)
    push = np.geomspace(1e-4, 1.0, 250).astype(complex)
    view = seen(push, 1.0)
    draws = rng.normal(size=(400, 250, 2)) @ np.array([1.0, 1.0j]) * np.sqrt(0.5)
    wrong = sum(bool(np.any(view.estimated_force(PATTERN, r[:, None]))) for r in draws)
    assert wrong <= 5  # expected: one


def test_an_error_where_the_force_is_hardly_felt_reads_as_no_more_than_the_force_elsewhere() -> None:
    push = np.geomspace(1e-3, 1.0, 40).astype(complex)
    missing = -push.copy()  # a force of one everywhere
    missing[0] += 0.05  # a twentieth of what the other end feels: a force of fifty
    found = seen(push, 1e-8).estimated_force(PATTERN, missing[:, None])
    assert np.abs(found).max() < 1.01
    np.testing.assert_allclose(found[1:], 1.0, rtol=2e-2)
