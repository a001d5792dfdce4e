"""What was ruled out: for every cause at every place the smallest size that these records would have shown.

Of a law of the size a, y(a) is the torque that no parameter of the fit takes up. λ = |y|² is its gain in χ²
without noise, on the training records and, with the parameters as the training leaves them, on those kept
out; a gain passes its threshold N in 95 of 100 records where √λ ≥ √N + 1.64 (noncentral χ² of one number).
Laws that are linear in their size ask for one projection. Of free play and other laws with a knee the torque
at several sizes is put into the rows of the fit, and the size is found between them. A law of unknown shape
(cycles, a knee, a frequency in the band) counts at the shape that shows least, of those that show at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from invid.diagnosis.acceptance import needed_gain
from invid.diagnosis.score_test import Screen, terms_to_test
from invid.diagnosis.selection import Selection
from invid.diagnosis.sentences import ruled_out_sentence
from invid.diagnosis.thresholds import HELD_OUT, LARGER, REMAINDER
from invid.effects.catalogue.extra_mode import excited_band
from invid.effects.effect import Effect
from invid.effects.motion import View
from invid.effects.registry import BY_CAUSE
from invid.effects.units import unit_of
from invid.likelihood.evaluation import Evaluation, evaluate
from invid.likelihood.null_test import FALSE_ALARM, null_test
from invid.likelihood.placed_effect import PlacedEffect
from invid.model.diagnosis_document import RuledOut
from invid.numerics import budget
from invid.numerics.arrays import Complex128, Float64
from invid.numerics.distributions import f_isf, normal_isf
from invid.numerics.whitening import stack
from invid.recording.model import Recording
from invid.signals.spectral_record import SpectralRecord

SURE = normal_isf(0.05)
"""Standard deviations by which the root of a gain has to pass its threshold (statistical: 95 of 100)."""
WHAT = "what was ruled out"
"""What a spent budget leaves out, in the words of the warning."""
UNSEEN = 1e-4
"""Share of a law's torque that the fit has to leave for it to be told from the model's parameters. Empirical:
linearised parameters and reconstructed motion are right to about a hundredth of what they take up."""
BISECTIONS = 6
"""Halvings between two sizes of a law with a knee (1 % of their distance)."""
UNCHECKED = {"viscous_friction": "a limit of it has not been confirmed by trial"}
"""Causes of which none is said: injected at 1.3 times the limit by this reckoning they were not found."""
TIMING = ("torque_delay", "torque_lag")
"""Causes of which the search takes up to a sample for a convention of sampling."""
BEYOND_DRY = {
    "stribeck_friction": ("static", (0.0, 1.0), ((1.0, 0.0),)),
    "asymmetric_friction": (
        "coulomb_positive",
        (0.5, -0.5, 0.0, 0.0),
        ((1.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 1.0)),
    ),
}
"""Of laws that contain plain friction the parameter, and the coefficients of what they have beyond it and of
what they have in common; the limit is that of what is beyond it."""


def ruled_out(
    selection: Selection,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
    recording: Recording,
) -> tuple[RuledOut, ...]:
    """The limit of every cause that was not found, by place; those that could not be seen with the reason.

    Of as many as the budget allows.
    """
    if budget.is_left_out(WHAT):
        return ()
    rows = _Rows.of(selection, train, held)
    structure = selection.final.fit.layout.structure
    chosen = selection.final.fit.candidate.terms
    terms = terms_to_test(structure, linear_axes=recording.linear, chosen=chosen)
    out = []
    for term in terms:
        if budget.is_left_out(WHAT):
            break
        limit = _limit_of(term, rows, len(terms), recording)
        out.append(replace(limit, sentence=ruled_out_sentence(limit, structure.sizes, recording.axes)))
    rows.screen.restore_views()
    return tuple(out)


@dataclass(frozen=True, eq=False)
class _Rows:
    """The final fit with its rows: what a torque put into them would gain."""

    selection: Selection
    screen: Screen
    held: Evaluation
    beyond_noise: float
    """χ² by which the null test has to be passed before a further cause is sought; 0 without a cause."""

    @classmethod
    def of(
        cls, selection: Selection, train: Sequence[SpectralRecord], held: Sequence[SpectralRecord]
    ) -> _Rows:
        final = selection.final
        fit = final.fit
        part = evaluate(fit.layout, held, fit.p, fit.candidate, near=final.held.views)
        excess = 0.0
        if selection.steps and not final.rejects([*train, *held]):
            test = null_test(final.cost, final.dof, [*train, *held])
            limit = f_isf(FALSE_ALARM, max(test.dof, 1), max(test.noise_dof, 2.0)) * test.dof
            excess = limit - test.dof + SURE * float(np.sqrt(2.0 * test.dof))
        return cls(selection, Screen(fit), part, excess)

    def project(
        self, trained: Sequence[Complex128], kept_out: Sequence[Complex128]
    ) -> tuple[Float64, Float64, Float64]:
        """(rows, L) columns that the fit leaves of lines (F, M, L) on the training and on the held-out
        records, and (L,) squared norm before."""
        screen, here = self.screen, self.selection.final.fit.evaluation
        left = screen.project(trained)
        parts = [_without(stack(r @ c), b) for c, r, b in zip(trained, here.roots, here.bases, strict=True)]
        whole = np.concatenate([*parts, np.zeros((screen.tail, left.shape[1]))])
        moved = screen.parameters_taking_up(whole)
        held = [
            _without(stack(r @ c), b)
            for c, r, b in zip(kept_out, self.held.roots, self.held.bases, strict=True)
        ]
        own = np.concatenate(held)
        kept = own - self.held.jacobian[: own.shape[0]] @ moved
        return left, kept, (whole**2).sum(axis=0) + (own**2).sum(axis=0)

    def size_seen(self, gains: tuple[float, float], needed: float) -> float:
        """How many times larger a law with these gains at size one has to be (linear in its size)."""
        trained, kept_out = gains
        final = self.selection.final
        disp = max(final.fit.dispersion, 1.0), final.held_dispersion
        whole = max(float(np.sqrt(needed * disp[0])) + SURE * float(np.sqrt(disp[0])), self._least_excess())
        held = (float(np.sqrt(HELD_OUT)) + SURE) * float(np.sqrt(disp[1]))
        with np.errstate(divide="ignore"):
            return float(max(whole / np.sqrt(trained + kept_out), held / np.sqrt(kept_out)))

    def _least_excess(self) -> float:
        """Root of the χ² that a further cause has to add or to take."""
        final = self.selection.final
        left = max(final.excess, 0.0) * REMAINDER if self.selection.steps else 0.0
        return float(np.sqrt(max(self.beyond_noise, left)))


def _without(rows: Float64, basis: Float64) -> Float64:
    out: Float64 = rows - basis @ (basis.T @ rows) if basis.size else rows
    return out


def _limit_of(term: PlacedEffect, rows: _Rows, count: int, recording: Recording) -> RuledOut:
    """The limit of one cause at one place, or why it could not have been seen."""
    effect, place, views = term.effect, term.place, rows.screen.views
    parameter = {"base_compliance": "mass", **{k: v[0] for k, v in BEYOND_DRY.items()}}.get(
        effect.cause, effect.main
    )
    made = RuledOut(
        cause=effect.cause,
        axis=recording.axes[place.axis],
        element=place.element,
        other_axis=recording.axes[place.other] if place.other >= 0 else None,
        parameter=parameter,
        limit=None,
        unit=unit_of(effect.parameters[parameter], recording.linear),
        why=None,
    )
    why = UNCHECKED.get(effect.cause) or _why_never(term, views, recording)
    if why is None:
        needed = needed_gain(rows.selection.final, _Sized(term), count, rejects=bool(rows.selection.steps))
        knee = not effect.coefficients
        found = _size_of_knee(term, rows, needed) if knee else _size_of_linear(term, rows, needed)
        if found is None:
            why = "nothing in these records tells it from the parameters of the model"
        else:
            limit = _parameter_value(effect, found, term, rows, parameter)
            if effect.cause in TIMING:
                limit = max(limit, views[0].record.step)
            if limit > _largest(effect, parameter, term, views):
                why = "even as large as all that acts there it would not have stood out of the noise"
            else:
                return replace(made, limit=limit)
    return replace(made, why=why)


@dataclass(frozen=True)
class _Sized:
    """What the acceptance asks of a trial: its term and initial states."""

    term: PlacedEffect
    starts: int = 0


def _size_of_linear(term: PlacedEffect, rows: _Rows, needed: float) -> list[float] | None:
    """Parameters of the smallest law that is seen at the shape that shows least; ``None`` where none is."""
    effect, place, screen = term.effect, term.place, rows.screen
    worst: tuple[float, list[float]] | None = None
    for shape in _shapes(effect, screen.views, term):
        screen.reconstruct(term)
        trained = [effect.basis(v, place, shape) for v in screen.views]
        kept_out = [effect.basis(v, place, shape) for v in rows.held.views]
        if effect.cause == "presliding_friction":
            dry = BY_CAUSE["coulomb_friction"]
            both = (trained, screen.views), (kept_out, rows.held.views)
            trained, kept_out = (
                [np.concatenate((own, dry.basis(v, place, ())), axis=2) for own, v in zip(c, vs, strict=True)]
                for c, vs in both
            )
        left, kept, whole = rows.project(trained, kept_out)
        direction, common = _directions(effect, left, kept)
        both_left = np.concatenate((left, kept))
        if not np.isfinite(both_left).all():
            continue
        y, size = both_left @ direction, float(whole @ direction**2)
        if common is not None:
            shared = both_left @ common
            y = y - shared @ np.linalg.lstsq(shared, y, rcond=1e-9)[0]
        gains = float(y[: left.shape[0]] @ y[: left.shape[0]]), float(y[left.shape[0] :] @ y[left.shape[0] :])
        if not sum(gains) > UNSEEN**2 * size or min(gains) <= 0.0:
            continue
        seen = rows.size_seen(gains, LARGER if common is not None else needed)
        count = len(effect.coefficients)
        if np.isfinite(seen) and (worst is None or seen > worst[0]):
            worst = seen, [*(seen * direction[:count]).tolist(), *shape]
    return None if worst is None else worst[1]


def _directions(effect: Effect, left: Float64, kept: Float64) -> tuple[Float64, Float64 | None]:
    """(L,) coefficients of a law of size one, and (L, k) those of what a smaller law has in common."""
    if effect.cause in BEYOND_DRY:
        _, own, common = BEYOND_DRY[effect.cause]
        return np.array(own), np.array(common).T
    if effect.cause == "presliding_friction":
        return np.array([1.0, 0.0]), np.array([[0.0], [1.0]])
    information = left.T @ left + kept.T @ kept
    if effect.coefficients == ("sine", "cosine") and np.isfinite(information).all():
        return np.linalg.eigh(information)[1][:, 0], None  # the phase that shows least
    out = np.zeros(left.shape[1])
    out[0] = 1.0
    return out, None


def _shapes(effect: Effect, views: Sequence[View], term: PlacedEffect) -> list[tuple[float, ...]]:
    """Shapes at which a law of unknown shape is asked for: those that the search starts from, in the band."""
    grid = effect.grid(views, term.place)
    if effect.shapes[:1] == ("frequency",):
        low, high = (float(np.log(w)) for w in excited_band(views))
        grid = [shape for shape in grid if low <= shape[0] <= high]
    return grid


def _size_of_knee(term: PlacedEffect, rows: _Rows, needed: float) -> list[float] | None:
    """Shape of the smallest law that is seen, found by trial between the sizes that the search starts from;
    ``None`` where the largest is not."""
    effect, place, screen = term.effect, term.place, rows.screen
    falls = effect.cause == "torque_saturation"
    shapes = sorted((s[0] for s in effect.grid(screen.views, place) if len(s) == 1), reverse=falls)
    if effect.cause == "torque_delay":
        shapes = [s for s in shapes if s > 0.0]

    def is_seen(shape: float) -> bool:
        screen.reconstruct(term)
        trained = [effect.contribution(v, place, (shape,))[0][..., None] for v in screen.views]
        kept_out = [effect.contribution(v, place, (shape,))[0][..., None] for v in rows.held.views]
        left, kept, whole = rows.project(trained, kept_out)
        gains = float((left**2).sum()), float((kept**2).sum())
        if not np.isfinite(sum(gains)) or not sum(gains) > UNSEEN**2 * float(whole[0]) or min(gains) <= 0:
            return False
        return rows.size_seen(gains, needed) <= 1.0

    seen = next((k for k, shape in enumerate(shapes) if is_seen(shape)), None)
    if seen is None:
        return None
    high, low = shapes[seen], shapes[max(seen - 1, 0)]
    for _ in range(BISECTIONS if seen else 0):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if is_seen(middle) else (middle, high)
    return [high]


def _parameter_value(
    effect: Effect, x: list[float], term: PlacedEffect, rows: _Rows, parameter: str
) -> float:
    """The limit in the unit of its parameter."""
    if effect.cause in BEYOND_DRY:
        return float(max(np.abs(x[: len(effect.coefficients)]))) * (2.0 if x[0] else 1.0)
    fit = rows.selection.final.fit
    count = fit.layout.structure.count
    value = effect.of_machine(fit.layout.structure.chains(fit.p[:count])).values(x, term.place)[parameter]
    return abs(value - 1.0) if effect.cause == "torque_gain" else abs(value)


def _largest(effect: Effect, parameter: str, term: PlacedEffect, views: Sequence[View]) -> float:
    """The largest size that makes sense of a law's torque or free play; infinite where nothing bounds it."""
    if effect.parameters[parameter] == "torque" and effect.cause != "torque_saturation":
        return max(float(np.abs(v.record.torque_wave[:, term.place.axis]).max()) for v in views)
    if effect.cause == "backlash":
        return max(2.0 * float(np.abs(v.wave(term.place.pattern(v.structure))).max()) for v in views)
    return np.inf


def _why_never(term: PlacedEffect, views: Sequence[View], recording: Recording) -> str | None:
    """Why these records could not show a cause there, whatever its size; ``None`` where they could."""
    place, axis = term.place, term.place.axis
    resolution = None if recording.encoder_resolution is None else float(recording.encoder_resolution[axis])
    noise = max(float(v.record.velocity_noise[axis]) for v in views)
    moved = any(float(np.abs(v.velocity(_motor(v, axis))).max()) > 3.0 * noise for v in views)
    span = max(float(np.ptp(v.wave(_motor(v, axis)))) for v in views)
    if not moved or (resolution is not None and span < 2.0 * resolution):
        return "the axis never moved"
    if place.kind == "spring":
        pattern = place.pattern(views[0].structure)
        at = views[0].structure.spring_pairs.index((pattern[0][0], pattern[1][0]))
        bent = max(float(np.abs(v.wave(pattern)).max()) for v in views) * float(views[0].springs[at])
        if bent == 0.0:
            return "the spring was never loaded"
        carried = min(abs(float(e.torque[:, axis].mean())) for e in recording.experiments)
        if term.effect.cause == "backlash" and carried > bent:
            return "it was never unloaded"
    if term.effect.family == "friction" and "dry" in (term.effect.parts or ()):
        pattern = place.pattern(views[0].structure)
        speeds = [v.velocity(pattern) for v in views]
        if all(float(s.min()) >= 0.0 or float(s.max()) <= 0.0 for s in speeds):
            return "the motion never reversed"
    if not term.effect.grid(views, place):
        return "one record alone shows no change; repeat the first experiment at the end"
    return None


def _motor(view: View, axis: int) -> tuple[tuple[int, float], ...]:
    return ((int(view.structure.motor_dofs[axis]), 1.0),)
