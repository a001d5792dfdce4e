"""The model of a large motion: inertias, couplings, springs to ground, and the effects the data ask for."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from invid.errors import ModelError, NotIdentifiableError
from invid.model.chains import CoupledChains
from invid.model.document import ChainStd, Model
from invid.model.doubts import Doubt, DoubtCode, doubt_facts
from invid.numerics.arrays import frozen_float
from invid.recording.model import Recording
from invid.rigid_motion.analysis import Analysis, analyse
from invid.rigid_motion.effect_terms import effect_of_cause
from invid.rigid_motion.fit import fit_terms
from invid.rigid_motion.search import causes_of
from invid.rigid_motion.terms import Base, Term
from invid.wording.sentence import sentence

TRAJECTORY = "trajectory"
"""Method name of models of rigid axes."""


def identify_trajectory(recording: Recording, *, analysis: Analysis | None = None) -> Model:
    """Rigid (or grounded) model with the effects that the data need, fitted together.

    ``analysis``: that of this recording, where it exists already.
    """
    return model_of(analyse(recording) if analysis is None else analysis)


def model_of(a: Analysis, given: Model | None = None) -> Model:
    """The model of an analysis; ``given`` provides the inertia where the record cannot show it."""
    recording, final = a.recording, a.final
    count = recording.axis_count
    mass, mass_std = np.ones(count), np.full(count, np.nan)
    coupling, coupling_std = np.zeros((count, count)), np.full((count, count), np.nan)
    spring, spring_std = np.zeros(count), np.full(count, np.nan)
    warnings = list(_warnings(a))
    if a.reach.steady:
        if given is not None and given.chains.branches == count:
            mass = np.array([m.sum() for m in given.chains.masses])
        warnings.append(
            sentence(
                "constant velocity shows no inertia: the masses in this model are placeholders; "
                "record moves that accelerate to identify them"
            )
        )
    facts: dict[str, Any] = {}
    for term in final.terms:
        value, std = final.of(term)
        if term.law is Base.INERTIA and final.free[final.span(term)].all():
            mass[term.axis], mass_std[term.axis] = value[0], std[0]
        elif term.law is Base.COUPLING and term.other is not None:
            for i, j in ((term.axis, term.other), (term.other, term.axis)):
                coupling[i, j], coupling_std[i, j] = value[0], std[0]
        elif term.law is Base.TIME_OFFSET:
            offsets = facts.setdefault("time_offset_s", {})
            offsets[f"{recording.axes[term.axis]}.time_offset"] = {
                "value": float(value[0]),
                "std": float(std[0]),
            }
        elif term.law is Base.GROUND_SPRING:
            spring[term.axis], spring_std[term.axis] = value[0], std[0]
        elif term.law is Base.CONFIGURATION:
            facts["inertia_with_angle"] = {
                "axes": [recording.axes[term.axis], recording.axes[term.other or 0]],
                "cosine": {"value": float(value[0]), "std": float(std[0])},
                "sine": {"value": float(value[1]), "std": float(std[1])},
                "meaning": "M11 += 2 b cos q2, M12 += b cos q2, with the Coriolis terms that belong to it",
            }
    unseen = [] if a.reach.steady else [i for i in range(count) if not np.isfinite(mass_std[i])]
    doubts = []
    for i in unseen:
        mass[i] = _hidden_inertia_std(a, i)
        said = sentence(
            "the inertia of {axes} does not show: the mass in this model, {mass:.2g}, is what "
            "the rest could hide; record faster moves, or see that the torque is the motor's",
            axes=recording.axes[i],
            mass=mass[i],
        )
        doubts.append(Doubt(DoubtCode.UNSEEN, said))
    warnings += [d.text for d in doubts]
    if doubts:
        facts |= doubt_facts(doubts)
    try:
        chains = CoupledChains.build(
            [[m] for m in mass],
            [[] for _ in mass],
            None,
            coupling,
            ground_springs=spring,
            axes=recording.axes,
        )
    except ModelError as error:
        warnings.append(sentence("inertia couplings left out: {error}", error=error))
        chains = CoupledChains.build([[m] for m in mass], [[] for _ in mass], axes=recording.axes)
    std_of = replace(
        ChainStd.unknown(chains),
        masses=tuple(frozen_float([s]) for s in mass_std),
        couplings=frozen_float(coupling_std),
        ground_springs=frozen_float(spring_std),
    )
    return Model(
        robot=recording.robot,
        method=TRAJECTORY,
        chains=chains,
        std=std_of,
        linear=recording.linear,
        effects=tuple(
            effect_of_cause(a.rows, final, c, recording.axes, linear=recording.linear)
            for c in causes_of(final.terms)
        ),
        warnings=tuple(warnings),
        fit={
            **facts,
            "rows": int(a.rows.torque.size),
            "independent_rows": round(float(a.rows.independent.sum()), 1),
        },
        provenance={"recording": recording.source, "model_of": "rigid body with gravity and friction"},
    )


def _hidden_inertia_std(a: Analysis, axis: int) -> float:
    """Standard deviation of an inertia given the rest of the model: how much could be there unseen."""
    own = Term(Base.INERTIA, axis)
    rest = [t for t in a.final.terms if t.label != own.label]
    _, std = fit_terms(a.rows, [*rest, own]).of(own)
    if not std[0] > 0:
        raise NotIdentifiableError(
            f"{a.recording.source}: {a.recording.axes[axis]} does not accelerate",
            way_out="record faster moves",
            code="no_acceleration",
            axis=a.recording.axes[axis],
        )
    return float(std[0])


def _warnings(a: Analysis) -> list[str]:
    cutoffs = ", ".join(f"{f:.3g}" for f in a.band.rows_hz)
    sources = [e.attributes.get("position_source") for e in a.recording.experiments]
    said = (
        (
            not a.rows.has_validation,
            sentence(
                "the recording names no validation data: whole pieces (or constant-speed records) "
                "were kept out in turn"
            ),
        ),
        (
            "integrated_velocity" in sources,
            sentence(
                "position is the integral of a measured velocity: causes that depend on position were weak"
            ),
        ),
        (
            not a.reach.steady,
            f"residuals are those of every row kept out, below {cutoffs} Hz; what dry friction may take up "
            "while an axis stands or turns is not missing; the noise floor is read from the upper quarter of "
            "the spectra and taken as white",
        ),
    )
    return [sentence for is_so, sentence in said if is_so]
