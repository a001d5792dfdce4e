"""Excitation: spectra, crest factor, orthogonality and boundary values, computed independently."""

import numpy as np
import pytest

from invid.errors import InputError
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


def test_detection_lines_stay_free_but_never_the_ends_of_the_band() -> None:
    everything = lines(detection=0.0)
    for seed in range(20):
        kept = lines(seed=seed)
        assert {everything[0], everything[-1]} <= set(kept)
        assert 0.1 < 1 - kept.size / everything.size < 0.3


def crest_factor(wave: np.ndarray) -> float:
    return float(np.abs(wave).max() / np.sqrt(np.mean(wave**2)))


def test_the_crest_factor_beats_random_phases_and_the_peak_is_one() -> None:
    signal = excitation.multisine(lines(), PERIOD, RATE, rng=np.random.default_rng(2))
    rng = np.random.default_rng(3)
    shape = signal.lines**-0.5
    t = np.arange(PERIOD) / PERIOD
    random = [
        crest_factor(
            shape @ np.cos(2 * np.pi * np.outer(signal.lines, t) + rng.uniform(0, 6.3, (shape.size, 1)))
        )
        for _ in range(20)
    ]
    assert crest_factor(signal.period()) < min(random)
    assert np.abs(signal.period()).max() == pytest.approx(1.0)


@pytest.mark.parametrize("axes", [2, 3, 4, 6])
def test_orthogonal_phases_make_a_unitary_excitation_at_every_line(axes: int) -> None:
    turns = np.array([[excitation.orthogonal_rotation(i, e, axes) for e in range(axes)] for i in range(axes)])
    signal = excitation.multisine(
        lines(), PERIOD, RATE, rng=np.random.default_rng(4), rotations=turns.ravel()
    )
    spectra = np.array(
        [[np.fft.rfft(signal.period(turns[i, e]))[signal.lines] for e in range(axes)] for i in range(axes)]
    )
    for f in range(signal.lines.size):
        matrix = spectra[:, :, f]
        assert np.linalg.cond(matrix) == pytest.approx(1.0, abs=1e-6)
    assert np.abs([signal.period(t) for t in turns.ravel()]).max() <= 1.0 + 1e-12


def test_the_same_seed_gives_the_same_signal_and_another_seed_another() -> None:
    a, b, c = (
        excitation.multisine(lines(), PERIOD, RATE, rng=np.random.default_rng(s)).period() for s in (5, 5, 6)
    )
    assert np.array_equal(a, b)
    assert not np.allclose(a, c)


def test_a_band_without_a_line_is_refused() -> None:
    with pytest.raises(InputError, match="lengthen the period"):
        excitation.line_numbers(0.5, (3.1, 3.9), "odd", detection_fraction=0, rng=np.random.default_rng(0))


def test_ramps_start_and_end_at_rest() -> None:
    wave = excitation.apply_ramps(np.ones(1000), 100, 200)
    assert wave[0] < 1e-3
    assert wave[-1] < 1e-3
    assert wave[100:800].min() == 1.0
    assert np.abs(np.diff(wave)).max() < 0.02


def test_a_doublet_brings_a_rigid_mass_back_to_rest_where_it_began() -> None:
    wave = excitation.doublet(400)
    velocity = np.cumsum(wave)
    position = np.cumsum(velocity) - velocity / 2  # trapezoid: the torque is constant over each sample
    assert velocity[-1] == 0
    assert abs(position[-1]) < 1e-9
    # A·T²/(16·m) with A = m = 1 and T in samples
    assert np.abs(position).max() == pytest.approx(400**2 / 16, rel=0.02)


@pytest.mark.parametrize(("velocity", "travel"), [(0.1, 0.05), (0.02, 0.2), (1.0, 0.01)])
def test_a_constant_velocity_path_is_centred_closes_and_keeps_its_speed(
    velocity: float, travel: float
) -> None:
    path = excitation.constant_velocity_path(velocity, travel, RATE)
    speed = np.diff(path) * RATE
    assert path.max() == pytest.approx(travel / 2, rel=1e-9)
    assert path.min() == pytest.approx(-travel / 2, rel=1e-9)
    assert abs(path[-1]) < 1e-9
    assert np.abs(speed).max() <= velocity * 1.01


def test_a_creep_keeps_its_speed_and_its_window() -> None:
    path = excitation.triangle_path(0.01, 30_000, RATE, 0.05)
    assert path[0] == 0
    assert np.abs(path).max() <= 0.025 + 1e-12
    assert np.median(np.abs(np.diff(path))) * RATE == pytest.approx(0.01)


def test_a_chirp_begins_as_a_cosine_and_sweeps_its_band() -> None:
    wave = excitation.chirp((2.0, 20.0), 20_000, RATE)
    assert wave[0] == 1.0
    spectrum = np.abs(np.fft.rfft(wave)) ** 2
    f = np.fft.rfftfreq(wave.size, 1 / RATE)
    inside = (f > 1.9) & (f < 20.5)
    assert spectrum[inside].sum() > 0.97 * spectrum.sum()
