"""The model of a machine of elastic chains: friction at its motors, drives that are late, doubts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invid.effects.units import unit_of
from invid.identification.contest import NEGLIGIBLE, torque_rms
from invid.identification.fewer_masses import fewer_masses_warnings, with_masses_seen
from invid.identification.fitted_model import model_of
from invid.identification.late_drives import late_drives
from invid.identification.quantities import axis_and_element
from invid.identification.search_start import SearchStart, on_all_records
from invid.identification.terms import TermWriter
from invid.likelihood.unknown_forces.fitted_hypothesis import FittedHypothesis
from invid.likelihood.unknown_forces.motor_laws import Part
from invid.likelihood.unknown_forces.price import pays, price
from invid.likelihood.unknown_forces.shapes import reshape, scan_friction
from invid.likelihood.unknown_forces.worth import (
    Deletion,
    Worth,
    channel_deletions,
    friction_deletions,
    prune,
    role_falls,
    spring_deletions,
    without_loose_springs,
)
from invid.model.document import EffectTerm, Model
from invid.model.doubts import Doubt, DoubtCode, doubt_facts, doubts_of
from invid.numerics import budget
from invid.wording.sentence import sentence

EXPLAINED = 0.9
"""Share of the torque a trustworthy model explains. Empirical: real drives with friction stand above
0.99, a wrong order or a torque that is none below 0.7 (flexible bench, case study)."""
ASTRAY = 0.3
"""Unknown force behind the motors over the torque's rms from which the masses are doubted (empirical: single
axes of another hand from a wrong start leave 1.4 and more, free play of 2 mrad 0.1)."""
NOISY = 2.0
"""Missing power over the sensors' from which something acts that the model does not contain."""


def model_of_chains(begun: SearchStart) -> Model:
    """The model of a first fit: with the friction that pays its price, and what is to be doubted."""
    return model_of_fit(begun, *finished_fit(begun))


def finished_fit(begun: SearchStart) -> tuple[FittedHypothesis, Sequence[Worth]]:
    """The fit of all records with the friction that pays its price, and what each part of it is worth."""
    now = _with_late_drives(reshape(scan_friction(begun.first)))
    now = with_masses_seen(now)
    # Dry friction is expected: what is too small to be said would bend what is beside it. Viscous friction
    # would as well, but a hold's time takes it up.
    dry = [(Part.DRY, m) for m in range(now.hypothesis.structure.motors)]
    worths, end = prune(without_loose_springs(now), _deletions_of, dry)
    if not budget.is_left_out(sentence("the records that judged the model")):
        end = on_all_records(end, begun.recording)
    return end, worths


def model_of_fit(begun: SearchStart, end: FittedHypothesis, worths: Sequence[Worth]) -> Model:
    """The model of a finished fit, and what is to be doubted."""
    recording = begun.recording
    model = model_of(end, _terms(end, worths, begun), recording)
    found = _doubts(begun, end, model)
    fit = dict(model.fit)
    if begun.declared is None:
        fit["order"] = {
            "chosen": list(end.hypothesis.structure.sizes),
            "alike": [list(n) for n in begun.alike],
        }
    doubts = [*doubts_of(model.fit), *found]
    said = [
        *begun.warnings,
        *begun.stopgap,
        *(d.text for d in found),
        *model.warnings,
        *fewer_masses_warnings(begun.declared, end.hypothesis.structure.sizes),
        *_warnings(model),
    ]
    return replace(model, fit={**fit, **doubt_facts(doubts)}, warnings=tuple(dict.fromkeys(said)))


def _with_late_drives(now: FittedHypothesis) -> FittedHypothesis:
    """With the delay or lag of every drive that is late, the better of the two for each."""
    while not budget.is_left_out(sentence("drives that are late")):
        late = [d for d in late_drives(now) if pays(*role_falls(d.without, d.found), price())]
        if not late:
            break
        now = reshape(scan_friction(min(late, key=lambda d: d.found.total).found))
    return now


def _deletions_of(now: FittedHypothesis) -> list[Deletion]:
    return [*spring_deletions(now), *friction_deletions(now), *channel_deletions(now)]


def _terms(end: FittedHypothesis, worths: Sequence[Worth], begun: SearchStart) -> tuple[EffectTerm, ...]:
    """All that the fit holds besides its chains: a simulation without it would be another machine."""
    stays = {w.key for w in worths if w.stays}
    writer = TermWriter(end, begun.recording.axes, linear=begun.recording.linear)
    structure = end.hypothesis.structure
    friction = [
        t
        for m in range(structure.motors)
        for t in writer.friction(m, frozenset(p for p in Part if (p, m) in stays))
    ]
    springs = [writer.load_spring(p) for p in structure.pairs if p in stays]
    return (*friction, *springs, *(writer.channel(*c) for c in writer.late_channels if c in stays))


def _doubts(begun: SearchStart, end: FittedHypothesis, model: Model) -> list[Doubt]:
    """Why the model is not to be relied on."""
    out = []
    share = float(model.fit["explained"])
    inner = end.inner_strength / torque_rms(end.bench)
    if inner > (ASTRAY if share > EXPLAINED else NEGLIGIBLE):
        strongest = next(s for v, s in end.strength if v == end.inner_strength)
        axis, element = axis_and_element(end.hypothesis.structure, strongest)
        unit = unit_of("torque", begun.recording.linear)
        said = sentence(
            "a force of {inner_strength:.2g} {unit} that no mass, spring or friction of a "
            "motor makes acts at {element} of {axes}: free play, friction or a spring that "
            "bends there, another number of masses, or a wrong minimum; invid diagnose names "
            "the cause where it can",
            inner_strength=end.inner_strength,
            unit=unit,
            element=element,
            axes=begun.recording.axes[axis],
        )
        out.append(Doubt(DoubtCode.WRONG_STRUCTURE, said, {"times": inner}))
    elif share < EXPLAINED:
        said = sentence(
            "the model explains {share:.0%} of the torque only: another number of masses, a "
            "torque channel that is not the motor torque, or axes that do not move freely",
            share=share,
        )
        out.append(Doubt(DoubtCode.LITTLE_EXPLAINED, said, {"share": share}))
    if begun.alike:
        sizes = (end.hypothesis.structure.sizes, *begun.alike)
        alike = " and ".join(",".join(map(str, n)) for n in sizes)
        said = sentence(
            "order: {alike} masses explain these data alike: the motors do not show on which "
            "branch the further mass is; say it with --masses",
            alike=alike,
        )
        out.append(Doubt(DoubtCode.ORDER_OPEN, said))
    return out


def _warnings(model: Model) -> list[str]:
    """What is said of a fit beside its doubts."""
    out = []
    times = float(np.sqrt(model.fit["noise_chi2_per_dof"]))
    if times > np.sqrt(NOISY):
        out.append(
            sentence(
                "the torque is missed by {times:.2g} times its noise: something acts that the "
                "model does not contain; standard deviations include it; invid diagnose names it "
                "where it can",
                times=times,
            )
        )
    return out
