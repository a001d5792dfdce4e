"""An axis that stands still beside others that move: they are identified, and it is said to be unknown."""

from dataclasses import replace

import numpy as np
import pytest
from hidden.generator import make

import invid
from invid.recording.still_axes import moving_part
from invid.report.page import render_report


def beside_a_still_axis(torque: float = 0.0, count: float | None = None) -> invid.Recording:
    """An elastic axis with dry friction, and before it one that stands; ``count``: its encoder flickers."""
    recording, _ = make("coulomb_friction", (0, 1), seed=5, masses=(2,), target_db=30.0, moves=False)
    rng = np.random.default_rng(1)

    def wider(values: np.ndarray, level: float) -> np.ndarray:
        return np.concatenate((np.full_like(values, level), values), axis=1)

    experiments = []
    for e in recording.experiments:
        position = wider(e.position, 0.7)
        if count is not None:
            position[:, 0] += count * rng.integers(0, 2, e.samples)
        columns = {
            name: wider(values, 0.0)
            for name in ("torque_demand", "status", "position_reference", "torque_feedforward")
            if (values := getattr(e, name)) is not None
        }
        experiments.append(
            replace(
                e,
                position=position,
                torque=wider(e.torque, torque),
                hold_gain=np.array([0.0, *e.hold_gain]),
                excited_axis=1 if e.excited_axis == 0 else -1,
                **columns,
            )
        )
    resolution = recording.encoder_resolution
    return replace(
        recording,
        axes=("still", *recording.axes),
        experiments=tuple(experiments),
        masses_per_axis=None,
        rated_torque=None if recording.rated_torque is None else np.array([5.0, *recording.rated_torque]),
        encoder_resolution=None
        if resolution is None
        else np.array([resolution[0] if count is None else count, *resolution]),
    )


@pytest.mark.campaign
@pytest.mark.parametrize(("torque", "count"), [(0.0, None), (3.0, 1e-5)])
def test_axes_that_move_are_diagnosed_as_if_the_still_one_were_not_there(
    torque: float, count: float | None
) -> None:
    alone, _ = make("coulomb_friction", (0, 1), seed=5, masses=(2,), target_db=30.0, moves=False)
    expected, both = invid.diagnose(alone), beside_a_still_axis(torque, count)
    found = invid.diagnose(both)
    assert [r.axis for r in found.residual] == list(alone.axes)
    assert [f.cause for f in found.findings] == [f.cause for f in expected.findings] == ["coulomb_friction"]
    assert found.findings[0].parameters["torque"].value == pytest.approx(
        expected.findings[0].parameters["torque"].value, rel=1e-6
    )
    assert any(
        w.startswith("still stands still in every experiment: nothing is known") for w in found.warnings
    )
    answer = invid.simulate(found.model, both)
    assert answer.axes == alone.axes
    assert "stands still" in render_report(both, found.model, found)


def test_where_nothing_moves_or_a_model_has_the_axis_it_stays() -> None:
    both = beside_a_still_axis()
    assert moving_part(both, both.axes)[0] is both
    rest = replace(
        both,
        experiments=tuple(replace(e, position=0 * e.position, excited_axis=-1) for e in both.experiments),
    )
    assert moving_part(rest)[0] is rest


@pytest.mark.parametrize("hunting", ["counts", "noise", "limit cycle"])
def test_axes_that_hunt_about_their_place_beside_one_that_moves_far_stand(hunting: str) -> None:
    time = np.arange(4000) * 1e-3
    rng = np.random.default_rng(2)
    count = 2 * np.pi / 2**17
    held = {
        "counts": count * rng.integers(-2, 3, time.size),
        "noise": rng.normal(0, 1e-5, time.size),
        "limit cycle": count * np.round(3 * np.sin(2 * np.pi * 4 * time)),
    }[hunting]
    position = np.column_stack([0.5 + held, np.sin(3 * time), -1.0 + held[::-1]])
    e = invid.recording.model.Experiment(
        "000", invid.recording.model.Kind.OTHER, invid.recording.model.Role.IDENTIFY, -1, np.zeros(3), 0,
        np.zeros(0), 1000.0, time, position, np.column_stack([held * 0 + 4, np.cos(3 * time), held * 0]),
    )  # fmt: skip
    recording = invid.Recording("r", ("A1", "A2", "A3"), "rad", "N·m", "2026-11-27T00:00:00Z", (e,))
    part, said = moving_part(recording)
    assert part.axes == ("A2",)
    assert len(said) == 2
    slow = np.column_stack([0.5 + 0.02 * np.sin(time), np.sin(3 * time), -1.0 + held])
    part, _ = moving_part(replace(recording, experiments=(replace(e, position=slow),)))
    assert part.axes == ("A1", "A2")
