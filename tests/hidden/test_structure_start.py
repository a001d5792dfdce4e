"""The chain is found anew beside a motor's friction, wherever the fit stands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hidden.generator import make
from invid.diagnosis.known_effects import fitted_friction
from invid.diagnosis.linear_fit import start_vector
from invid.diagnosis.rules.structure_start import starts_beside_friction
from invid.diagnosis.rules.whole_search import LAW
from invid.diagnosis.search_pass import _fit_and_split
from invid.diagnosis.validation import ValidationRequest
from invid.effects.motion import Equivalent, along
from invid.identification.identify import identify
from invid.likelihood.evaluation import record_views
from invid.likelihood.joint_fit import JointFit, fit
from invid.likelihood.nuisance.corner_motion import complete_motion
from invid.likelihood.placed_effect import Candidate, PlacedEffect
from invid.model.place import Place
from invid.signals.spectra import LineSpectra
from invid.signals.spectral_record import SpectralRecord


def _beside_friction(seed: int) -> tuple[JointFit, list[SpectralRecord], tuple[LineSpectra, ...], np.ndarray]:
    """A fit of one axis of three masses with its motor's friction, its records, and the true masses."""
    recording, truth = make("coulomb_friction", seed=seed, motors=1, masses=(3,), target_db=40)
    model = identify(recording, masses=[3])
    request = ValidationRequest(beside_friction=True)
    spectra, _, (base, _, train, _) = _fit_and_split(recording, model, request)
    place = Place("mass", 0, 1)
    (shape,) = LAW.grid(base.evaluation.views, place)
    known = fitted_friction(model, base.layout.structure)
    dry = sum(float(x[0]) for t, x in zip(known.terms, known.x, strict=True) if t.place == place)
    candidate = Candidate().plus(PlacedEffect(LAW, place), np.array([dry, 0.0, 0.0, 0.0, 0.0, 0.0, *shape]))
    fitted = fit(base.layout, train, start_vector(model, base.layout), candidate, iterations=40)
    return fitted, train, spectra, np.asarray(truth.chains.masses[0])


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_from_a_wrong_chain_the_friction_found_leads_to_the_right_one(seed: int) -> None:
    fitted, train, spectra, masses = _beside_friction(seed)
    wrong = fitted.p.copy()
    wrong[:5] += np.random.default_rng(seed).normal(0.0, 1.0, 5)  # logarithms: off by a factor of e
    found = starts_beside_friction(replace(fitted, p=wrong), train, spectra, linear_axes=False)
    assert found
    nearest = min(found, key=lambda p: np.abs(p[:3] - np.log(masses)).max())
    assert np.exp(nearest[:3]) == pytest.approx(masses, rel=0.1)


def test_what_a_spring_and_a_damper_answer_is_taken_out_exactly() -> None:
    fitted, train, _, _ = _beside_friction(3)
    (view, *_) = record_views(fitted.layout, train, fitted.p)
    rng = np.random.default_rng(1)
    places = [Place("spring", 0, 1), Place("mass", 0, 3)]
    laws = [Equivalent(p.pattern(view.structure), p, *rng.uniform(1.0, 1e3, 2)) for p in places]
    view.set_equivalents(tuple(laws))
    gap = rng.normal(size=view.base.shape) + 1j * rng.normal(size=view.base.shape)
    moved = view.without_response(gap)
    answered = sum(
        view.inner_receptance(e.pattern)
        * ((e.stiffness + 1j * view.omega * e.damping) * along(e.pattern, moved))[:, None]
        for e in laws
    )
    assert np.abs(moved + answered - gap).max() < 1e-9 * np.abs(gap).max()


def test_a_completed_record_keeps_what_was_found_of_it_since_it_was_prepared() -> None:
    fitted, train, _, _ = _beside_friction(3)
    marked = [replace(r, scatter=r.scatter + 1.0, weight=np.ones(r.omega.size), differs=True) for r in train]
    for before, after in zip(marked, complete_motion(marked, fitted), strict=True):
        assert np.array_equal(after.scatter, before.scatter)
        assert np.array_equal(after.weight, before.weight)
        assert after.differs
        assert after.fine is not None
        assert after.fine.samples == before.fine.samples
