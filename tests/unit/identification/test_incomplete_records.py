"""Records as others write them: what they do not say, or say wrongly, must not give a small wrong error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from linear_cell import LinearCell, deviations, record

from invid.diagnosis.diagnose import diagnose
from invid.identification.identify import identify
from invid.likelihood.levenberg_marquardt import gauss_newton
from invid.likelihood.nuisance.hold_timing import INSIDE, common_early_share
from invid.likelihood.nuisance.reversals import fit_sharp_reversals
from invid.likelihood.nuisance.torque_lags import add_coulomb_columns, fit_torque_lags
from invid.likelihood.records import problem_from_spectra, transfer_parameters
from invid.model.parameters import ChainStructure
from invid.recording.model import Experiment, Kind, Role
from invid.signals.smooth_command import find_smooth_hold
from invid.signals.spectra import LineSpectra, all_spectra, spectra_of

ONE = LinearCell([[1.0, 2.0]], [[1500.0]], [[0.8]])
TWO = LinearCell([[1.0, 2.0], [1.5, 2.5]], [[1500.0], [2500.0]], [[0.8], [1.0]], {(0, 1): 0.4})
SUMS = np.array([3.0, 4.0])


def hold(hz: float, ratio: float, sums: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gains P and D of a position hold of so many hertz."""
    w = 2 * np.pi * hz
    return sums * w**2, 2 * ratio * sums * w


def worst(found: dict[str, float]) -> float:
    return max(abs(z) for z in found.values())


@pytest.mark.campaign
def test_a_low_passed_torque_channel_is_recognised_and_costs_no_parameter() -> None:
    recording = record(
        TWO, seed=5, rate=1000.0, gain=20 * SUMS, damping=5 * SUMS, said=20 * SUMS, in_drive=False,
        time_constant=0.002, period=8000,
    )  # fmt: skip
    model = identify(recording)
    assert model.fit["trustworthy"]
    # 4.5 standard deviations: one false alarm in fifteen thousand runs of nine parameters
    assert worst(deviations(model, TWO)) < 4.5
    assert model.fit["torque_lag_s"]["A1"]["value"] == pytest.approx(0.002, rel=0.05)
    assert any("A1: the recorded torque is low-passed" in w for w in model.warnings)


def test_a_stiff_hold_that_the_file_denies_widens_the_motor_mass() -> None:
    gain, damping = hold(5.0, 0.7, SUMS[:1])
    model = identify(record(ONE, seed=7, rate=500.0, gain=gain, damping=damping, said=np.zeros(1)))
    # The sampled hold's damping is 13 % of the motor's mass.
    assert worst(deviations(model, ONE)) < 4.5
    assert any("a hold works" in w for w in model.warnings)


@pytest.mark.parametrize("in_drive", [True, False])
def test_a_demand_with_the_hold_in_it_does_not_tell_when_the_hold_acts(in_drive: bool) -> None:
    """Read at the end of its sample a command acts half a sample early and a hold inside the drive does not:
    D·h/2 was in the motor's mass, 260 deviations."""
    gain, damping = hold(1.5, 0.7, SUMS[:1])
    shown = record(
        ONE, seed=9, rate=1000.0, gain=gain, damping=damping, said=gain, in_drive=in_drive, demand_at_end=True
    )
    model = identify(shown)
    assert worst(deviations(model, ONE)) < 4.5
    assert any("a hold works" in w for w in model.warnings)
    if in_drive:
        return
    by_master = tuple(replace(e, attributes={"hold_by": "master"}) for e in shown.experiments)
    told = identify(replace(shown, experiments=by_master))
    assert worst(deviations(told, ONE)) < 4.5
    assert told.std.masses[0][0] < 0.2 * model.std.masses[0][0]


def test_a_command_that_falls_with_frequency_is_smooth_where_its_lines_are_far_apart() -> None:
    """Between 0.7 and 2 Hz f^−½ bends; taken for roughness it made P 2.6 times too large."""
    gain, damping = hold(1.0, 0.7, SUMS)
    spectra = all_spectra(
        record(TWO, seed=8, rate=1000.0, gain=gain, damping=damping, said=np.zeros(2), period=1500)
    )
    for i in range(2):
        found = find_smooth_hold(spectra, i)
        assert found is not None
        assert found[0] == pytest.approx(gain[i], rel=0.1)
        assert found[1] == pytest.approx(damping[i], rel=0.02)


@pytest.mark.campaign
def test_holds_that_no_record_shows_cost_the_motors_of_uncoupled_axes_nothing_unsaid() -> None:
    """A held axis rests while others are shaken; D·h/2 of its hold was in its motor's mass, 45 deviations."""
    apart = LinearCell(TWO.masses, TWO.springs, TWO.dampers)
    gain, damping = hold(1.0, 0.7, SUMS)
    recording = record(
        apart,
        seed=8,
        rate=500.0,
        gain=gain,
        damping=damping,
        said=np.full(2, np.nan),
        together=False,
        period=3000,
    )
    experiments = tuple(replace(e, excited_axis=i) for i, e in enumerate(recording.experiments))
    recording = replace(recording, experiments=experiments)
    model = identify(recording)
    assert worst(deviations(model, apart)) < 4.5
    assert all(text.startswith(INSIDE) for text in model.fit["holds"].values())
    found = diagnose(recording, model=model)
    assert found.findings == ()
    assert worst(deviations(found.model, apart)) < 4.5
    assert found.model.std.masses[0][0] < 0.005 * apart.masses[0][0]


def test_holds_are_early_together_where_friction_is_one_share_of_what_they_make() -> None:
    share, std = common_early_share(
        [(0.0170, 0.0012, 0.0186), (0.0409, 0.0028, 0.0400), (0.0295, 0.0021, 0.0314)]
    ) or (0, 0)
    assert share == pytest.approx(0.96, abs=0.02)
    assert std == pytest.approx(0.04, abs=0.01)
    for others in (
        [(0.017, 0.0012, 0.0186)],  # one axis may rub as much
        [(0.017, 0.0012, 0.0186), (0.010, 0.0028, 0.040)],  # not alike
        [(0.001, 0.0012, 0.0186), (0.003, 0.0028, 0.040)],  # no more than the errors
        [(0.037, 0.0012, 0.0186), (0.080, 0.0028, 0.040)],  # more than holds make
        [(0.017, 0.0, 0.0186), (0.041, 0.0028, 0.040)],
    ):
        assert common_early_share(others) is None


def test_the_gains_of_a_hold_are_read_off_the_lines_of_the_other_axes() -> None:
    gain, damping = hold(1.0, 0.3, SUMS)
    recording = record(
        TWO, seed=14, rate=500.0, gain=gain, damping=damping, said=gain, interleaved=True, period=8000
    )
    spectra = all_spectra(recording)
    for i in range(2):
        found = find_smooth_hold(spectra, i)
        assert found is not None
        assert found[0] == pytest.approx(gain[i], rel=0.05)
        assert found[1] == pytest.approx(damping[i], rel=0.05)
    assert worst(deviations(identify(recording), TWO)) < 4.5


def test_a_hold_damped_far_more_than_usual_is_known_from_the_command() -> None:
    gain, damping = np.array([3.0]), np.array([30.0])
    model = identify(record(ONE, seed=10, rate=1000.0, gain=gain, damping=damping, said=gain))
    # Half a sample of its damping is 1.5 % of the motor's mass; 2·√(P·S) would say 0.3 %.
    assert worst(deviations(model, ONE)) < 4.5


@pytest.mark.parametrize("rate", [1000.0])
def test_axes_shaken_one_at_a_time_without_being_named_are_told_from_those_held(rate: float) -> None:
    gain, damping = hold(2.0, 0.7, SUMS)
    recording = record(
        TWO, seed=11, rate=rate, gain=gain, damping=damping, said=np.full(2, np.nan), together=False
    )
    assert [s.driven.tolist() for s in all_spectra(recording)] == [[True, False], [False, True]]
    model = identify(recording)
    assert worst(deviations(model, TWO)) < 4.5


def test_the_gradient_of_the_cost_is_exact_with_a_lag_and_a_hold_inside_the_drive() -> None:
    gain, damping = hold(2.0, 0.7, SUMS)
    recording = record(
        TWO, seed=12, rate=500.0, gain=gain, damping=damping, said=np.full(2, np.nan), together=False
    )
    spectra = all_spectra(recording)
    structure = ChainStructure((2, 2), ("A1", "A2"))
    laws = {i: (float(gain[i]), float(damping[i])) for i in range(2)}
    problem = problem_from_spectra(structure, spectra, holds=laws)
    first = len(problem.delay_names)
    problem = replace(
        problem,
        blocks=tuple(replace(b, lag_index=(first, first + 1)) for b in problem.blocks),
        delay_names=(*problem.delay_names, "A1.torque_lag", "A2.torque_lag"),
    )
    log = np.log([1.0, 2.0, 1.5, 2.5, 1500.0, 2500.0])
    p = problem.start(np.concatenate((log, [0.8, 1.0, 0.4, 0.01, 0.02])))
    s = problem.slices
    p[s["delay"]] = [0.001, 0.0011, -0.0009, -0.0012, 1e-6, -2e-6]
    p[s["staircase"]] = [0.9, 0.8]
    residual, jacobian = problem.evaluate(p)
    gradient = 2.0 * jacobian.T @ residual
    for k in (*range(s["delay"].start, s["delay"].stop), s["staircase"].start):
        step = np.zeros(p.size)
        step[k] = 1e-9 if k >= s["delay"].stop - 2 else 1e-6
        up, down = (float(r @ r) for r in (problem.evaluate(p + h)[0] for h in (step, -step)))
        assert gradient[k] == pytest.approx((up - down) / (2 * step[k]), rel=2e-3)


def test_a_lag_that_the_data_do_not_ask_for_stays_out() -> None:
    recording = record(
        ONE, seed=13, rate=500.0, gain=20 * SUMS[:1], damping=5 * SUMS[:1], said=20 * SUMS[:1], in_drive=False
    )
    structure = ChainStructure((2,), ("A1",))
    problem = problem_from_spectra(structure, all_spectra(recording))
    start = problem.start(np.concatenate((np.log([1.0, 2.0, 1500.0]), [0.8, 0.0])))
    solution = gauss_newton(problem, start)
    same, again = fit_torque_lags(problem, solution)
    assert same is problem
    assert np.array_equal(transfer_parameters(problem, solution.p, same), again.p)


def rubbing_mass(friction: float) -> tuple[LineSpectra, np.ndarray]:
    """A mass of 1 kg·m² in steady state under two sines and Coulomb friction, by Euler steps of a 50th
    sample: its noisy spectra, and the friction's spectrum over its size."""
    rate, period, fine = 500.0, 1000, 50
    step = 1.0 / (rate * fine)
    t = np.arange(period * fine) * step
    drive = 4.0 * np.sin(2 * np.pi * 1.5 * t) + 3.0 * np.sin(2 * np.pi * 2.5 * t + 1.0)
    x, v = 0.0, -0.6
    position, rubs = np.empty(period * fine), np.empty(period * fine)
    for _ in range(3):
        for k, force in enumerate(drive):
            stopping = v / step + force  # would stop the mass within the step
            position[k], rubs[k] = x, np.clip(stopping, -friction, friction) / friction
            v += (force - friction * rubs[k]) * step
            x += v * step
    rng = np.random.default_rng(1)
    wave = position[::fine] - np.linspace(position[0], x, period, endpoint=False)
    experiment = Experiment(
        "000", Kind.MULTISINE, Role.IDENTIFY, 0, np.zeros(1), period, np.array([1.5, 2.5]), rate,
        np.arange(2 * period) / rate, np.tile(wave, 2)[:, None] + 3e-5 * rng.standard_normal((2 * period, 1)),
        np.tile(drive[::fine], 2)[:, None] + 0.02 * rng.standard_normal((2 * period, 1)),
    )  # fmt: skip
    s = spectra_of(experiment, band_hz=(0.4, 12.0))
    lines = np.rint(s.frequency_hz * 2.0).astype(int)
    return s, np.fft.rfft(rubs)[lines] * 2.0 / rubs.size


def sharpened(friction: float) -> tuple[float, float, float]:
    """Error of the friction's column and χ², both over what they were before, and its size over the true."""
    s, true = rubbing_mass(friction)
    lines = [replace(s, excited=np.ones(s.frequency_hz.size, dtype=bool))]
    problem = add_coulomb_columns(problem_from_spectra(ChainStructure((1,), ("A1",)), lines), lines)
    solution = gauss_newton(problem, problem.start(np.zeros(problem.structure.count)))
    sharp, found = fit_sharp_reversals(problem, solution, lines)
    before, after = (np.linalg.norm(p.blocks[0].columns[:, 0, 0] - true) for p in (problem, sharp))
    size = dict(zip(sharp.names, found.p, strict=True))["A1.coulomb"]
    return float(after / before), found.chi2 / solution.chi2, size / friction


def test_a_motor_that_stands_for_long_is_described_no_worse_than_by_its_position_alone() -> None:
    error, chi2, _ = sharpened(1.5)
    assert error < 1.0
    assert chi2 < 1.0
