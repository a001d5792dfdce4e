"""A driven motor that friction holds for most of a record has no say in it."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))

from hidden.generator import make

from invid.diagnosis.validation import split_records
from invid.identification.identify import identify
from invid.likelihood.prepare_records import leave_out_sticking_axes, split_into_periods
from invid.signals.spectra import all_spectra


@pytest.mark.parametrize(("noisier", "said"), [(1.0, False), (1e4, True)])
def test_its_torque_is_left_out_where_the_sign_of_its_velocity_is_lost(noisier: float, said: bool) -> None:
    recording, _ = make("coulomb_friction", target_db=20, seed=11, motors=1)
    spectra = all_spectra(recording)
    train, _, _ = split_records(recording, spectra)
    model = identify(recording)
    entry = {"value": 2.0, "std": 0.1}
    model = replace(model, fit={**model.fit, "friction": {f"{recording.axes[0]}.coulomb": entry}})
    first = train[0]
    still = replace(first, velocity_noise=noisier * first.velocity_noise)
    out, warnings = leave_out_sticking_axes([still, *train[1:]], spectra, model, recording)
    assert bool(out[0].set_aside.any()) is said
    assert not any(r.set_aside.any() for r in out[1:])
    assert any("hardly moves for its friction" in w for w in warnings) is said
    if said:
        assert (out[0].noise[:, 1] >= (1e3 * 2.0) ** 2).all()
        assert np.array_equal(out[0].noise[:, 0], first.noise[:, 0])


def test_without_friction_every_record_counts() -> None:
    recording, _ = make(None, seed=11, motors=1)
    spectra = all_spectra(recording)
    train, _, _ = split_records(recording, spectra)
    model = identify(recording)
    model = replace(model, fit={**model.fit, "friction": {}})
    out, warnings = leave_out_sticking_axes(
        [replace(r, velocity_noise=1e4 * r.velocity_noise) for r in train], spectra, model, recording
    )
    assert not any(r.set_aside.any() for r in out)
    assert warnings == []


@pytest.mark.parametrize(("noisier", "stands"), [(1.0, False), (1e4, True)])
def test_a_held_axis_stands_only_where_it_does_not_move(noisier: float, stands: bool) -> None:
    """The chain behind a motor moves it against its friction, whatever the torque that holds it."""
    recording, _ = make(None, seed=11, motors=2)
    spectra = all_spectra(recording)
    train, _, _ = split_records(recording, spectra)
    axis = 1
    held = [SimpleNamespace(key=train[0].key, driven=np.array([True, False]))]
    record = replace(train[0], velocity_noise=noisier * train[0].velocity_noise)
    entry = {"value": 10.0 * float(np.ptp(record.torque_wave[:, axis])), "std": 1e-3}
    friction = {f"{recording.axes[axis]}.coulomb": entry}
    model = identify(recording)
    model = replace(model, fit={**model.fit, "friction": friction})
    (out,), _ = leave_out_sticking_axes([record], held, model, recording)  # type: ignore[arg-type]
    assert (bool(out.set_aside.size) and bool(out.set_aside[axis])) is stands


def test_the_periods_of_a_record_leave_out_what_it_leaves_out() -> None:
    recording, _ = make("coulomb_friction", target_db=20, seed=11, motors=1, periods=3)
    spectra = all_spectra(recording)
    (first, *_), _, _ = split_records(recording, spectra)
    aside = replace(first, set_aside=np.array([True]), noise=first.noise + np.array([0.0, 1e6]))
    periods = split_into_periods(recording, [aside], [aside.key])
    assert len(periods) > 1
    assert all(r.set_aside.all() and (r.noise[:, 1] >= 1e6).all() for r in periods)
    assert all((r.noise[:, 0] < 1.0).all() for r in periods)
