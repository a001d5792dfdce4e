"""A wrong torque scale is a doubt; a machine that changed since an earlier model is none."""

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from invid.identification.stated_inertia import against_stated
from invid.model.chains import CoupledChains
from invid.model.document import ChainStd, Model
from invid.model.doubts import DoubtCode, doubts_of
from invid.recording.model import Recording

LIMITS = "limits: {torque_Nm: 40, position_window_rad: 1, velocity_rad_per_s: 5}"
RELATIVE = 0.005


def recording(stated: float, created: str = "now") -> Recording:
    text = (
        "format: invid-config\nrobot: r\nbus: {interface: invid-virtual, channel: c, cycle_s: 0.002}\n"
        f"axes:\n- {{name: A1, node_id: 1, inertia_kgm2: {stated}, {LIMITS}}}\n"
    )
    seen = SimpleNamespace(
        config=text, source="r.h5", axes=("A1",), rated_torque=np.array([80.0]), created=created
    )
    return cast(Recording, seen)


def model(masses: np.ndarray, created: str = "now") -> Model:
    count = masses.size
    chains = CoupledChains.build(
        [masses], [[1000.0] * (count - 1)], [[1.0] * (count - 1)], np.zeros((1, 1)), axes=("A1",)
    )
    std = ChainStd(
        masses=(RELATIVE * masses,),
        springs=(np.full(count - 1, 1.0),),
        dampers=(np.full(count - 1, 0.1),),
        couplings=np.full((1, 1), np.nan),
        ground_springs=np.full(1, np.nan),
    )
    return Model("r", "refined", chains, std, provenance={"recorded": created})


def measured(rng: np.random.Generator, masses: np.ndarray, created: str = "now") -> Model:
    return model(masses * (1.0 + RELATIVE * rng.standard_normal(masses.size)), created)


def doubted(found: Model) -> bool:
    return any(d.code is DoubtCode.STATED_INERTIA for d in doubts_of(found.fit))


def machines(count: int) -> list[tuple[np.random.Generator, np.ndarray]]:
    rng = np.random.default_rng(count)
    return [
        (rng, 10 ** rng.uniform(-1, 1) * rng.dirichlet(np.full(int(rng.integers(2, 4)), 8.0)))
        for _ in range(count)
    ]


@pytest.mark.parametrize("factor", [0.4, 0.8, 1.25, 2.5])
def test_a_scale_that_multiplies_every_mass_is_a_doubt_with_and_without_an_earlier_model(
    factor: float,
) -> None:
    for rng, masses in machines(40):
        run = recording(float(masses.sum()))
        now, before = measured(rng, factor * masses), measured(rng, masses, "before")
        assert doubted(against_stated(now, run))
        found = against_stated(now, run, before)
        assert doubted(found)
        assert not found.fit["trustworthy"]
        assert "0x6076" in found.warnings[0]


@pytest.mark.parametrize("more", [-0.3, 0.3, 1.5])  # of the whole
def test_a_tool_that_an_earlier_model_did_not_have_is_a_changed_machine_and_no_doubt(more: float) -> None:
    for rng, masses in machines(40):
        masses[-1] = masses[:-1].sum()
        run = recording(float(masses.sum()))
        changed = masses.copy()
        changed[-1] += more * masses.sum()
        now, before = measured(rng, changed), measured(rng, masses, "before")
        first = against_stated(now, run)
        assert doubted(first)
        # said at first, and taken back by whoever knows the accepted model
        found = against_stated(first, run, before)
        assert not doubted(found)
        assert found.fit["trustworthy"]
        assert not found.warnings
        # from then on it is the accepted one
        assert not doubted(against_stated(measured(rng, changed), recording(masses.sum(), "later"), found))


def test_an_earlier_model_that_is_in_doubt_itself_or_of_the_same_recording_vouches_for_nothing() -> None:
    masses = np.array([0.4, 0.6])
    run = recording(1.0)
    before = against_stated(model(2.0 * masses, "before"), run)
    assert doubted(before)
    assert doubted(against_stated(model(2.0 * masses), run, before))
    assert doubted(against_stated(model(2.0 * masses), run, model(2.0 * masses)))
    assert not doubted(against_stated(model(2.0 * masses), run, model(2.0 * masses, "before")))


def test_of_a_rigid_axis_nobody_can_tell_and_another_machine_says_nothing() -> None:
    run = recording(1.0)
    rigid = model(np.array([2.0]))
    assert doubted(against_stated(rigid, run, model(np.array([1.0]), "before")))
    assert doubted(against_stated(rigid, run, model(np.array([0.4, 0.6]), "before")))
    other = replace(model(np.array([1.0]), "before"), linear=True)
    assert doubted(against_stated(rigid, run, other))
