"""The parts of a joint's friction are means over the samples, where it reverses within one as well."""

from __future__ import annotations

import numpy as np

from invid.effects.laws.joint import _mean_parts
from invid.effects.laws.sign import even_law, excess_law


def test_the_parts_are_what_a_hundredth_of_the_step_makes_of_them() -> None:
    width, slow = 4e-3, 0.12
    time = np.arange(256)
    v = 0.3 * np.sin(2 * np.pi * 5 * time / 256 + 0.1)
    fine = np.interp(np.arange(256 * 100) / 100, np.arange(257), np.append(v, v[0]))
    sign, near = np.tanh(fine / width), np.exp(-((fine / slow) ** 2))
    parts = [sign, fine, sign * near, sign**2, np.abs(fine), sign**2 * near]
    found = _mean_parts(v, width, slow)
    for k, part in enumerate(parts):
        after = np.array([np.mean(part[100 * n : 100 * (n + 1)]) for n in range(256)])
        expected = 0.5 * (after + np.roll(after, 1))
        assert np.abs(found[:, k] - expected).max() < 0.02 * np.abs(part).max(), k


def test_the_catalogues_laws_have_the_same_parts() -> None:
    width, slow = 4e-3, 0.12
    v = 0.3 * np.sin(2 * np.pi * 5 * np.arange(256) / 256 + 0.1)
    found = _mean_parts(v, width, slow)
    assert np.allclose(found[:, 2], excess_law(v, width, slow), atol=0.01)
    assert np.allclose(found[:, 3], even_law(v, width), atol=1e-9)
