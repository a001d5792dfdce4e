"""A gap as wide as its spring deflects leads the linear fit astray: its force is read from the torque."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from invid.diagnosis.evidence import Trial
from invid.diagnosis.rules.wide_gap import rattles
from invid.diagnosis.search_pass import _begun
from invid.diagnosis.validation import PLAIN
from invid.likelihood.joint_fit import held_out
from invid.model.document import ChainStd, Model
from invid.recording.model import Recording

sys.path.insert(0, str(Path(__file__).parents[1]))
from hidden.generator import Truth, make

RMS = 0.0049
"""Deflection of the spring [rad], rms of the strongest record without a gap, of the plant below."""


def _plant(cause: str, size: dict[str, float]) -> tuple[Recording, Truth]:
    """Two masses, periodic records of two amplitudes."""
    return make(
        cause,
        (0, 1),
        size,
        seed=4711,
        masses=(2,),
        noise=1e-3,
        bits=20,
        periods=2,
        drive="smooth",
        from_rest=False,
    )


def _astray(truth: Truth, recording: Recording) -> Model:
    """What a linear fit makes of such a gap: another total mass and a spring far too soft."""
    chains = truth.chains
    masses = tuple(m * np.array([0.6, 0.7]) for m in chains.masses)
    wrong = replace(chains, masses=masses, springs=tuple(0.4 * k for k in chains.springs))
    return Model(robot=recording.robot, method="by hand", chains=wrong, std=ChainStd.unknown(wrong))


@pytest.mark.parametrize("gaps", [1.0, 2.0])
def test_a_gap_as_wide_as_the_deflection_is_found_from_a_linear_fit_that_it_led_astray(gaps: float) -> None:
    recording, truth = _plant("backlash", {"gap": gaps * RMS})
    _, _, (base, _, train, held) = _begun(recording, _astray(truth, recording), PLAIN)
    step = rattles(Trial(base, held_out(base, held)), train, held)
    assert step is not None
    found = step.chosen.fit
    assert abs(np.exp(found.candidate.x[0][0]) / (gaps * RMS) - 1.0) < 0.02
    chains = found.layout.structure.chains(found.p[: found.layout.structure.count])
    np.testing.assert_allclose(chains.masses[0], truth.chains.masses[0], rtol=0.02)
    np.testing.assert_allclose(chains.springs[0], truth.chains.springs[0], rtol=0.02)
    assert step.chosen.cost < 0.02 * step.before.cost
