"""Excitation: spectra, crest factor, orthogonality and boundary values, computed independently."""

import numpy as np
import pytest

from invid.signals import excitation

RATE, PERIOD = 1000.0, 4096


def lines(**settings: float) -> np.ndarray:
    return excitation.line_numbers(
        PERIOD / RATE,
        (0.5, 12.0),
        "odd",
        detection_fraction=settings.get("detection", 0.2),
        rng=np.random.default_rng(int(settings.get("seed", 0))),
    )


def test_a_multisine_has_its_power_on_its_odd_lines_only_and_falls_with_the_root_of_frequency() -> None:
    signal = excitation.multisine(lines(), PERIOD, RATE, rng=np.random.default_rng(1))
    spectrum = np.abs(np.fft.rfft(signal.period())) * 2 / PERIOD
    on = np.zeros(spectrum.size, dtype=bool)
    on[signal.lines] = True
    assert np.all(signal.lines % 2 == 1)
    assert spectrum[~on].max() < 1e-12
    np.testing.assert_allclose(
        spectrum[on] / spectrum[on][0], np.sqrt(signal.lines[0] / signal.lines), rtol=1e-9
    )


def test_a_doublet_brings_a_rigid_mass_back_to_rest_where_it_began() -> None:
    wave = excitation.doublet(400)
    velocity = np.cumsum(wave)
    position = np.cumsum(velocity) - velocity / 2  # trapezoid: the torque is constant over each sample
    assert velocity[-1] == 0
    assert abs(position[-1]) < 1e-9
    # A·T²/(16·m) with A = m = 1 and T in samples
    assert np.abs(position).max() == pytest.approx(400**2 / 16, rel=0.02)


def test_a_creep_keeps_its_speed_and_its_window() -> None:
    path = excitation.triangle_path(0.01, 30_000, RATE, 0.05)
    assert path[0] == 0
    assert np.abs(path).max() <= 0.025 + 1e-12
    assert np.median(np.abs(np.diff(path))) * RATE == pytest.approx(0.01)
