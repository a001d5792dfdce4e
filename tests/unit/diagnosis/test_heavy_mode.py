"""A mode that is a resonance of its own, sought with the chains from the first."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))

from hidden.generator import make

from invid.diagnosis.linear_fit import linear_fit
from invid.diagnosis.rules.heavy_mode import strong_modes
from invid.diagnosis.validation import split
from invid.identification.identify import identify
from invid.signals.spectra import all_spectra


@pytest.mark.slow
def test_a_mode_as_heavy_as_the_mass_it_sits_on_is_found_with_the_chains() -> None:
    size = {"mass": 20.0, "stiffness": 17600.0}
    recording, truth = make("extra_mode", (1, 2), size, seed=8, masses=(2, 2))
    (true,) = truth.effects
    spectra = all_spectra(recording)
    train, held, _ = split(recording, spectra)
    base, _, train, held = linear_fit(identify(recording), recording, spectra, train, held)
    found = min(strong_modes(base, train, held), key=lambda t: t.cost)
    axis = base.layout.structure.axes[found.term.place.axis]
    assert (axis, found.term.place.element) == (true.axis, true.element)
    values = found.term.effect.values(found.x.tolist(), found.term.place)
    assert values["mass"] == pytest.approx(true.parameters["mass"], rel=0.03)
    assert values["stiffness"] == pytest.approx(true.parameters["stiffness"], rel=0.03)
    assert found.cost < 1.2 * found.dof
    assert np.isfinite(found.fit.covariance_of(-1)).all()
