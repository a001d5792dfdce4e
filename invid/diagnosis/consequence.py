"""Consequences of findings: grade with reason, order of the findings, headline.

One place for what the words of a diagnosis promise, for elastic and rigid machines alike
(``grade_consequences``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from invid.config import CellConfig, parse_config
from invid.diagnosis.headline import with_headline
from invid.diagnosis.loop_signs import loop_signs
from invid.effects.registry import effect_of
from invid.effects.sizes import Machine, Size, measured_sizes
from invid.errors import ConfigError
from invid.model.diagnosis_document import Consequence, Diagnosis, Finding, Grade
from invid.model.document import EffectTerm
from invid.recording.model import Recording
from invid.wording.sentence import capital, joined, marked, sentence

SPEED_SAMPLES = 10
"""Samples over which a speed is taken; over one sample it would be that of one encoder count."""


def machine_of(diagnosis: Diagnosis, recording: Recording) -> tuple[Machine, list[str]]:
    """What sizes are compared with, from the recording and the config in it; and warnings."""
    config, warnings = None, []
    if recording.config:
        try:
            config = parse_config(recording.config, source=f"{recording.source}: config")
        except ConfigError as error:
            # Foreign files may carry anything there; only limits that somebody meant are missed.
            if "acceptable" in recording.config:
                warnings.append(
                    sentence("its limits for findings (acceptable) are not used: {error}", error=error)
                )
    axes = {} if config is None else {a.name: a for a in config.axes}
    rated = (
        {}
        if recording.rated_torque is None
        else dict(zip(recording.axes, recording.rated_torque, strict=True))
    )
    rated = {name: float(size) for name, size in rated.items() if np.isfinite(size) and size > 0}
    for name, axis in axes.items():
        if axis.rated_torque is not None:
            rated.setdefault(name, axis.rated_torque)
    speed = {name: _top_speed(recording, i) for i, name in enumerate(recording.axes)}
    speed |= {name: axis.limits.velocity for name, axis in axes.items()}
    return Machine(
        chains=diagnosis.model.chains,
        linear=recording.linear,
        rated=rated,
        speed=speed,
        duration=sum(e.duration for e in recording.experiments),
        acceptable=_accepted_limits(config),
    ), warnings


def _accepted_limits(config: CellConfig | None) -> dict[str, dict[str, float]]:
    axes = () if config is None else config.axes
    return {a.name: a.acceptable.model_dump(exclude_none=True) for a in axes}


def _top_speed(recording: Recording, axis: int) -> float:
    """Largest speed of an axis in the recording [rad/s or m/s]."""
    speeds = [0.0]
    for e in recording.experiments:
        if e.samples > SPEED_SAMPLES:
            travel = e.position[SPEED_SAMPLES:, axis] - e.position[:-SPEED_SAMPLES, axis]
            speeds.append(float(np.nanmax(np.abs(travel))) * e.sample_rate_hz / SPEED_SAMPLES)
    return max(speeds)


def consequence_of(term: EffectTerm, machine: Machine) -> Consequence:
    """Grade, sizes and reason of one effect: by the limits of the config first, then by published figures."""
    effect = effect_of(term.cause)
    declared = () if effect is None else effect.sizes
    found = measured_sizes(declared, term, machine)
    sizes = {size.quantity.name: value for size, value in found}
    text = joined([size.phrase(value, machine.linear) for size, value in found])
    share = max((value for size, value in found if size.quantity.torque), default=None)
    own = machine.acceptable.get(term.axis, {})
    judged: list[tuple[Grade, str, str]] = []
    for size, value in found:
        limit = own.get(size.quantity.limit or size.quantity.name)
        if limit is not None:
            grade = Grade.AS_EXPECTED if abs(value) <= limit else Grade.ACT
            accepted = sentence("the config accepts up to {size}", size=size.number(limit, machine.linear))
            judged.append((grade, accepted, "config"))
        elif size.expected is not None and size.serious is not None and (size.linear or not machine.linear):
            grade = Grade.ACT if value > size.serious else Grade.WATCH
            grade = Grade.AS_EXPECTED if value <= size.expected else grade
            judged.append((grade, _usual_text(size, size.expected, machine.linear), size.source))
    if not judged:
        return Consequence(
            Grade.WATCH, text, _no_figure_reason(term, machine, declared, sizes), share, None, sizes
        )
    grade, reason, source = min(judged, key=lambda j: j[0].rank)
    return Consequence(grade, text, reason, share, source, sizes)


def _usual_text(size: Size, expected: float, linear: bool) -> str:
    """Text of the largest usual size; "none is expected" where physics allows none."""
    if expected == 0:
        return sentence("none is expected")
    return sentence("up to {number} is usual for such drives", number=size.number(expected, linear))


def _no_figure_reason(
    term: EffectTerm, machine: Machine, declared: Sequence[Size], sizes: Mapping[str, float]
) -> str:
    wanted = {s.quantity.name for s in declared if s.expected is not None}
    if wanted and not wanted & sizes.keys() and term.axis not in machine.rated:
        return sentence("no figure to judge by: the rated torque is not in the recording")
    return sentence("no figure to judge by; a limit of this axis can stand in its config (acceptable)")


def grade_consequences(diagnosis: Diagnosis, recording: Recording) -> Diagnosis:
    """The diagnosis with its findings graded and sorted by consequence, and with a headline."""
    machine, warnings = machine_of(diagnosis, recording)
    graded = [_grade_finding(f, machine) for f in diagnosis.findings]
    rank = {id(f): _rank(f) for f in graded}
    findings = tuple(sorted(graded, key=lambda f: rank[id(f)]))
    result = replace(
        diagnosis,
        findings=findings,
        sentences=_reorder_sentences(diagnosis, graded, findings),
        warnings=tuple(dict.fromkeys([*diagnosis.warnings, *warnings])),
    )
    # A later comparison asks whether a cause that is not in the model was looked for.
    searched = {"verdict": str(result.verdict), "search_cut_short": bool(result.details.get("cut_short"))}
    model = replace(result.model, fit={**result.model.fit, **searched})
    signs = loop_signs(recording)
    details = {**result.details, **({"loop": list(signs)} if signs else {})}
    result = replace(result, model=model, details=details)
    return with_headline(result)


def _grade_finding(finding: Finding, machine: Machine) -> Finding:
    consequence = consequence_of(finding.effect, machine)
    return replace(
        finding,
        consequence=consequence,
        sentence=graded_sentence(finding, consequence),
    )


def _rank(finding: Finding) -> tuple[int, float]:
    """Sort key of a finding: most serious first, within a grade by what it explains."""
    grade = Grade.WATCH if finding.consequence is None else finding.consequence.grade
    return grade.rank, -finding.fraction


_HOW = {
    Grade.AS_EXPECTED: marked("{size}: as expected ({reason})."),
    Grade.WATCH: marked("{size}: more than usual ({reason})."),
    Grade.ACT: marked("{size}: too much ({reason})."),
}


def graded_sentence(finding: Finding, consequence: Consequence) -> str:
    """The finding's sentence with what to check, where its cause is sure and not as expected, and with its
    consequence."""
    effect, parts = effect_of(finding.effect.cause), [finding.sentence]
    if not finding.sentence:
        return ""
    if effect is not None and not finding.is_doubtful and consequence.grade is not Grade.AS_EXPECTED:
        parts.append(sentence(effect.check))
    size = capital(consequence.text)
    if size and consequence.source is None:
        parts.append(sentence("{size}.", size=size))
    elif size:
        parts.append(sentence(_HOW[consequence.grade], size=size, reason=consequence.reason))
    return joined(parts, " ")


def _reorder_sentences(
    diagnosis: Diagnosis, graded: Sequence[Finding], findings: Sequence[Finding]
) -> tuple[str, ...]:
    """The diagnosis' sentences with those of the findings in the new order, at the same positions."""
    own = [f.sentence for f in diagnosis.findings]
    ordered = iter([f.sentence for f in findings if f.sentence])
    if sum(s in own for s in diagnosis.sentences) != sum(bool(f.sentence) for f in graded):
        return diagnosis.sentences
    return tuple(next(ordered) if s in own else s for s in diagnosis.sentences)
