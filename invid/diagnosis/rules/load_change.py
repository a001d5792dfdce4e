"""Rule: a load that changes during the measurement; the period in which it does fits no plant."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from invid.diagnosis.evidence import Step, evidence_if_finite
from invid.diagnosis.selection import Selection
from invid.likelihood.joint_fit import JointFit, fit
from invid.likelihood.prepare_records import split_into_periods
from invid.recording.model import Recording
from invid.signals.spectral_record import SpectralRecord

NEAR_SHARE = 0.25
"""Share of a period beyond its ends within which a change may belong to that period. Empirical; where there
is a choice the remaining records decide."""


def records_around_change(
    selection: Selection, recording: Recording
) -> tuple[list[SpectralRecord], list[SpectralRecord]] | None:
    """Training and held-out records without the period in which the load changes; ``None`` without a change.

    That period is half of one plant, half of the other, with a transient that the change excites: no model
    here describes it. Where it was the only training record before or after the change, the first held-out
    period of that side joins the training.
    """
    time = load_change_time(selection)
    if time is None:
        return None
    train, held = selection.final.fit.evaluation.records, selection.final.held.records
    within = [r for r in (*train, *held) if _is_inside(r, time)]
    if not within:
        return None
    options = []
    for left_out in (
        *within,
        *(r for r in (*train, *held) if r.alone and _is_near_record(r, time) and r not in within),
    ):
        kept = [[r for r in part if r is not left_out] for part in (train, held)]
        if all(kept):
            options.append(_train_on_both_sides(kept[0], kept[1], time, recording))
    if len(options) < 2:
        return options[0] if options else None
    return min(options, key=lambda parts: _dispersion_without(selection, *parts))


def search_around_change(
    selection: Selection, recording: Recording, base: JointFit, search: Callable[..., Selection]
) -> tuple[JointFit, Selection, list[SpectralRecord], list[SpectralRecord]] | None:
    """Fit, selection and records without the period in which the load changes; ``None`` without a change."""
    parts = records_around_change(selection, recording)
    if parts is None:
        return None
    refit = fit(base.layout, parts[0], base.p, base.candidate, iterations=25)
    found = better_around_change(selection, search(refit, *parts), *parts)
    return None if load_change_time(found) is None else (refit, found, *parts)


def _dispersion_without(
    selection: Selection, train: Sequence[SpectralRecord], held: Sequence[SpectralRecord]
) -> float:
    """χ²/ν of other records with the causes found."""
    final = selection.final.fit
    trial = evidence_if_finite(
        lambda: fit(final.layout, train, final.p, final.candidate, iterations=25), held
    )
    return float("inf") if trial is None else trial.cost / trial.dof


def _is_near_record(record: SpectralRecord, time: float) -> bool:
    """Whether ``time`` is so near the record that the load may have changed in it.

    Fitted with the period in it, a mixture of two plants, the time lies at its edge as often as inside.
    """
    reach = NEAR_SHARE * (record.end_time - record.start_time)
    return record.start_time - reach < time < record.end_time + reach


def _train_on_both_sides(
    train: list[SpectralRecord], held: list[SpectralRecord], time: float, recording: Recording
) -> tuple[list[SpectralRecord], list[SpectralRecord]]:
    """Records of which the training has some before and some after ``time``, where periods allow it."""
    for side in (_is_before, _is_after):
        if any(side(r, time) for r in train):
            continue
        periods = split_into_periods(recording, held, [r.key for r in held if side(r, time)])
        first = next((r for r in periods if side(r, time)), None)
        if first is not None and len(periods) > len(held):
            return [*train, first], [r for r in periods if r is not first]
    return train, held


def _is_before(record: SpectralRecord, time: float) -> bool:
    return record.end_time <= time + record.step


def _is_after(record: SpectralRecord, time: float) -> bool:
    return record.start_time >= time - record.step


def load_change_time(selection: Selection) -> float | None:
    """Time [s] at which the load changes by the selected causes; ``None`` where it does not."""
    candidate = selection.final.fit.candidate
    for term, x in zip(candidate.terms, candidate.x, strict=True):
        if term.effect.cause == "payload_change":
            return float(x[1])
    return None


def better_around_change(
    before: Selection, again: Selection, train: Sequence[SpectralRecord], held: Sequence[SpectralRecord]
) -> Selection:
    """The better of the search ``again`` without the period of the change and the causes of ``before``
    refitted.

    Without that period a change in it looks like one of twice the size in the middle of the next one, and the
    search may end there. The causes found with the period start at the right time.
    """
    final = before.final.fit
    trial = evidence_if_finite(
        lambda: fit(final.layout, train, final.p, final.candidate, iterations=40), held
    )
    if trial is None or trial.cost >= again.final.cost or len(before.steps) != 1:
        return again
    others = [t for s in again.steps[:1] for t, _ in s.ranked if t.term != trial.term]
    dispersion = min(t.dispersion for t in (trial, *others))
    ranked = [(t, t.score(dispersion, trial.fit.dof)) for t in (trial, *others)]
    step = Step(again.base, trial, tuple(sorted(ranked, key=lambda one: one[1])))
    return replace(again, final=trial, steps=(step,))


def _is_inside(record: SpectralRecord, time: float) -> bool:
    """Whether ``time`` is inside the record by more than its sampling."""
    return record.start_time + record.step < time < record.end_time - record.step
