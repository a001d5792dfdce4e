"""Recordings of what no machine does are refused in words, before anything is fitted."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hidden.generator import make
from invid.diagnosis.diagnose import diagnose
from invid.errors import InputError
from invid.identification.identify import identify
from invid.recording.model import Experiment, Recording
from invid.signals.plausibility import check_shaken


def _changed(recording: Recording, change: Callable[[Experiment], Experiment]) -> Recording:
    return replace(recording, experiments=tuple(change(e) for e in recording.experiments))


@pytest.mark.parametrize(("seed", "motors"), [(1, 1), (4, 2)])
def test_torque_of_the_wrong_sign_is_called_that(seed: int, motors: int) -> None:
    recording, truth = make("coulomb_friction", seed=seed, target_db=20.0, motors=motors)
    check_shaken(recording)
    turned = _changed(recording, lambda e: replace(e, torque=-e.torque, torque_demand=None))
    with pytest.raises(InputError, match=f"axis {truth.chains.axes[0]} have opposite signs"):
        identify(turned)


def test_an_axis_that_never_moves_is_named() -> None:
    recording, truth = make("coulomb_friction", seed=1, target_db=20.0, motors=1)
    still = _changed(recording, lambda e: replace(e, position=np.zeros_like(e.position)))
    with pytest.raises(InputError, match=f"position of axis {truth.chains.axes[0]} never changes"):
        identify(still)


def test_a_torque_that_nobody_mapped_is_named() -> None:
    """All zeros: LAPACK complained, and the command line called it an internal error."""
    recording, truth = make("coulomb_friction", seed=1, target_db=20.0, motors=1)
    none = _changed(recording, lambda e: replace(e, torque=np.zeros_like(e.torque), torque_demand=None))
    for ask in (identify, diagnose):
        with pytest.raises(InputError, match=f"torque of axis {truth.chains.axes[0]} never changes"):
            ask(none)


def test_a_torque_read_without_its_sign_is_called_that() -> None:
    recording, truth = make("coulomb_friction", seed=1, target_db=20.0, motors=1)
    unit = float(max(np.abs(e.torque).max() for e in recording.experiments)) / 300
    lost = _changed(
        recording,
        lambda e: replace(e, torque=np.mod(np.round(e.torque / unit), 2.0**16) * unit, torque_demand=None),
    )
    for ask in (identify, diagnose):
        with pytest.raises(InputError, match=f"torque of axis {truth.chains.axes[0]} has lost its sign"):
            ask(lost)


def test_a_model_of_a_linear_machine_is_refused_for_a_rotary_one() -> None:
    recording, _ = make("coulomb_friction", seed=1, target_db=20.0, motors=1)
    other = replace(identify(recording), linear=True)
    with pytest.raises(InputError, match="one is rotary, the other linear"):
        diagnose(recording, model=other)


def _with_spring_holds(recording: Recording) -> Recording:
    """Torque of the axes that are not shaken as a stiff hold records it, spread over the lines."""

    def held(e: Experiment) -> Experiment:
        torque = e.torque.copy()
        others = [i for i in range(recording.axis_count) if i != e.excited_axis]
        torque[:, others] = -1e3 * e.position[:, others]
        return replace(e, torque=torque, torque_demand=None)

    return _changed(recording, held)


def test_experiments_that_name_the_wrong_axis_are_told_from_torque_of_the_wrong_sign() -> None:
    recording, truth = make(None, seed=4, motors=2, masses=(2, 2), from_rest=False, moves=False, noise=1e-3)
    alone = _with_spring_holds(
        replace(recording, experiments=tuple(e for e in recording.experiments if e.excited_axis >= 0))
    )
    assert alone.experiments
    swapped = _changed(alone, lambda e: replace(e, excited_axis=1 - e.excited_axis))
    second = truth.chains.axes[1]
    with pytest.raises(InputError, match=f"name it as excited_axis shake {second} more"):
        check_shaken(swapped)
