"""A driven motor that friction holds for most of a record has no say in it."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))

from hidden.generator import make

from invid.diagnosis.validation import split_records
from invid.identification.identify import identify
from invid.likelihood.prepare_records import leave_out_sticking_axes
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
