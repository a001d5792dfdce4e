"""What was ruled out: for every cause at every place the smallest size that these records would have shown.

Of a law of the size a, y(a) is the torque that no parameter of the fit takes up. λ = |y|² is its gain in χ²
without noise, on the training records and, with the parameters as the training leaves them, on those kept
out; a gain passes its threshold N in 95 of 100 records where √λ ≥ √N + 1.64 (noncentral χ² of one number).
Laws that are linear in their size ask for one projection. Of free play and other laws with a knee the torque
at several sizes is put into the rows of the fit, and the size is found between them. A law of unknown shape
(cycles, a knee, a frequency in the band) counts at the shape that shows least, of those that show at all: not
where masses and springs take it up so far that their second order outweighs what is left.

Time offsets, shares held over the sample and the places of holds take a law up within their bounds alone, and
the holds are those that a recording with some friction would leave open, not this one: viscous friction at a
motor shows above what its hold makes of it by acting half a sample earlier.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import lsq_linear

from invid.diagnosis.acceptance import needed_gain
from invid.diagnosis.score_test import Screen, terms_to_test
from invid.diagnosis.selection import Selection
from invid.diagnosis.sentences import ruled_out_sentence
from invid.diagnosis.thresholds import HELD_OUT, LARGER, REMAINDER, SIGNIFICANCE
from invid.effects.catalogue.extra_mode import excited_band
from invid.effects.catalogue.torque_delay import ActuatorEffect
from invid.effects.effect import Effect
from invid.effects.motion import View
from invid.effects.registry import BY_CAUSE
from invid.effects.units import unit_of
from invid.likelihood.evaluation import Evaluation, evaluate
from invid.likelihood.joint_fit import JointFit, fit, parameter_bounds
from invid.likelihood.nuisance.hold_share import InsideHold
from invid.likelihood.null_test import FALSE_ALARM, null_test
from invid.likelihood.placed_effect import PlacedEffect
from invid.model.diagnosis_document import RuledOut
from invid.model.place import Place
from invid.numerics import budget
from invid.numerics.arrays import Complex128, Float64
from invid.numerics.distributions import chi2_isf, f_isf, normal_isf
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
    holds: Sequence[InsideHold] = (),
) -> tuple[RuledOut, ...]:
    """The limit of every cause that was not found, by place; those that could not be seen with the reason.

    Of as many as the budget allows. ``holds``: those whose place the identification leaves open where a
    recording shows friction that they may make (``holds_left_open``).
    """
    if budget.is_left_out(WHAT):
        return ()
    rows = _Rows.of(selection, train, held, holds)
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


@dataclass(frozen=True)
class Needed:
    """What the acceptance asks of a cause, in χ² gained."""

    gain: float
    """On all records."""
    trained: float
    """On the training records alone: beside causes all of it, else a significant size (0 without sizes)."""
    held: float = HELD_OUT
    """On the held-out records alone."""


@dataclass(frozen=True, eq=False)
class _Rows:
    """The final fit with its rows: what a torque put into them would gain."""

    selection: Selection
    screen: Screen
    held: Evaluation
    timing: tuple[Float64, Float64]
    """(rows, k) what the time offsets, shares and holds, each within its bounds, may take up of a law on the
    training and on the held-out records."""
    inverse: Float64
    """(k, rows) pseudo-inverse of the first."""
    bounds: tuple[Float64, Float64]
    """(k,) how far each of them is from its bounds."""
    beyond_noise: float
    """χ² by which the null test has to be passed before a further cause is sought; 0 without a cause."""

    @classmethod
    def of(
        cls,
        selection: Selection,
        train: Sequence[SpectralRecord],
        held: Sequence[SpectralRecord],
        holds: Sequence[InsideHold],
    ) -> _Rows:
        final = selection.final
        here = _with_holds(final.fit, train, holds)
        part = evaluate(here.layout, held, here.p, here.candidate, near=final.held.views)
        excess = 0.0
        if selection.steps and not final.rejects([*train, *held]):
            test = null_test(final.cost, final.dof, [*train, *held])
            limit = f_isf(FALSE_ALARM, max(test.dof, 1), max(test.noise_dof, 2.0)) * test.dof
            excess = limit - test.dof + SURE * float(np.sqrt(2.0 * test.dof))
        timing = slice(here.layout.structure.count, here.layout.hold_slice.stop)
        low, high = parameter_bounds(here.layout, here.candidate, here.evaluation, strict=True)
        now = here.p[timing]
        screen = Screen(here, timing)
        trained = here.evaluation.jacobian[:, timing]
        taken = trained - screen.basis @ (screen.basis.T @ trained)
        own = part.jacobian[:, timing] - part.jacobian @ screen.parameters_taking_up(trained)
        kept = own[: sum(2 * v.record.omega.size * v.record.torque.shape[1] for v in part.views)]
        scale = np.maximum(np.linalg.norm(taken, axis=0), 1e-300)
        inverse = np.linalg.pinv(taken / scale, rcond=1e-9) / scale[:, None]
        bounds = low[timing] - now, high[timing] - now
        return cls(selection, screen, part, (taken, kept), inverse, bounds, excess)

    def project(
        self, trained: Sequence[Complex128], kept_out: Sequence[Complex128]
    ) -> tuple[Float64, Float64, Float64, Float64]:
        """(rows, L) columns that the model's parameters leave of lines (F, M, L) on the training and on the
        held-out records, (L,) squared norm before, and (k, L) relative changes of masses and springs."""
        screen, here = self.screen, self.screen.fit.evaluation
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
        structure = screen.fit.layout.structure
        changes = moved[: structure.count][structure.logarithmic]
        return left, kept, (whole**2).sum(axis=0) + (own**2).sum(axis=0), changes

    def beyond_timing(self, left: Float64, kept: Float64) -> tuple[Float64, Float64, Float64]:
        """Of columns as ``project`` leaves them what unbounded timing leaves, and its (k, L) change."""
        trained, held = self.timing
        moved = self.inverse @ left
        return left - trained @ moved, kept - held @ moved, moved

    def smallest_seen(self, left: Float64, kept: Float64, needed: Needed) -> float:
        """How many times larger a law that leaves this at size one has to be (linear in its size)."""
        beyond = self.beyond_timing(left, kept)
        low, high = self.bounds
        size = self._size_seen(_gains(*beyond[:2]), needed)
        if np.isfinite(size) and ((low <= size * beyond[2]) & (size * beyond[2] <= high)).all():
            return size
        # The timing reaches a bound first, and the rest of the law stands alone.
        small, large = 0.0, self._size_seen(_gains(left, kept), needed)
        while large < size and not self.is_seen(large * left, large * kept, needed):
            small, large = large, 2.0 * large
        for _ in range(BISECTIONS if small else 0):
            middle = 0.5 * (small + large)
            small, large = (
                (small, middle) if self.is_seen(middle * left, middle * kept, needed) else (middle, large)
            )
        return min(large, size)

    def is_seen(self, left: Float64, kept: Float64, needed: Needed) -> bool:
        """Whether a law that leaves this is seen, with the timing within its bounds."""
        trained, held = self.timing
        if not trained.size:
            return self._size_seen(_gains(left, kept), needed) <= 1.0
        q, r = np.linalg.qr(trained)
        scale = np.maximum(np.linalg.norm(r, axis=0), 1e-300)
        low, high = (scale * b for b in self.bounds)
        moved = lsq_linear(r / scale, q.T @ left, (low, high), method="bvls").x / scale
        return self._size_seen(_gains(left - trained @ moved, kept - held @ moved), needed) <= 1.0

    def _size_seen(self, gains: tuple[float, float], needed: Needed) -> float:
        """How many times larger a law with these gains at size one has to be."""
        trained, kept_out = gains
        final = self.selection.final
        disp = max(final.fit.dispersion, 1.0), final.held_dispersion
        whole, train, held = (float(np.sqrt(n)) + SURE for n in (needed.gain, needed.trained, needed.held))
        whole = max(whole * float(np.sqrt(disp[0])), self._least_excess())
        with np.errstate(divide="ignore"):
            return float(
                max(
                    whole / np.sqrt(trained + kept_out),
                    train * np.sqrt(disp[0] / trained) if needed.trained else 0.0,
                    held * np.sqrt(disp[1] / kept_out) if needed.held else 0.0,
                )
            )

    def _least_excess(self) -> float:
        """Root of the χ² that a further cause has to add or to take."""
        final = self.selection.final
        left = max(final.excess, 0.0) * REMAINDER if self.selection.steps else 0.0
        return float(np.sqrt(max(self.beyond_noise, left)))


def _with_holds(found: JointFit, train: Sequence[SpectralRecord], holds: Sequence[InsideHold]) -> JointFit:
    """The fit with further holds in its layout, all of them held over the sample."""
    known = {h.axis for h in found.layout.holds}
    further = tuple(h for h in holds if h.axis not in known)
    if not further:
        return found
    layout = replace(found.layout, holds=(*found.layout.holds, *further))
    p = np.insert(found.p, found.layout.hold_slice.stop, np.zeros(len(further)))
    return fit(layout, train, p, found.candidate, iterations=0)


def _gains(left: Float64, kept: Float64) -> tuple[float, float]:
    """Gain of χ² on the training and on the held-out records."""
    return float((left**2).sum()), float((kept**2).sum())


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
    why = _why_never(term, views, recording)
    if why is None:
        knee = not effect.coefficients
        beside = bool(rows.selection.steps)
        gain = needed_gain(rows.selection.final, _Sized(term), count, rejects=beside)
        significant = 0.0 if knee else chi2_isf(SIGNIFICANCE / count, len(effect.coefficients))
        needed = Needed(gain, gain if beside else significant)
        found = _size_of_knee(term, rows, needed) if knee else _size_of_linear(term, rows, needed)
        if found is None:
            why = "nothing in these records tells it from the parameters of the model"
        else:
            limit, at = _values(effect, found, term, rows, parameter)
            if limit > _largest(effect, parameter, term, views):
                why = "even as large as all that acts there it would not have stood out of the noise"
            else:
                return replace(made, limit=limit, at=at)
    return replace(made, why=why)


@dataclass(frozen=True)
class _Sized:
    """What the acceptance asks of a trial: its term and initial states."""

    term: PlacedEffect
    starts: int = 0


def _size_of_linear(term: PlacedEffect, rows: _Rows, needed: Needed) -> list[float] | None:
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
        left, kept, whole, changes = rows.project(trained, kept_out)
        if not (np.isfinite(left).all() and np.isfinite(kept).all()):
            continue
        directions, common = _directions(effect, *rows.beyond_timing(left, kept)[:2])
        if common is not None:
            # Ranked before plain friction (Schwarz), and asked for by the training records.
            rank = (term.size - 1) * float(np.log(rows.selection.final.fit.dof))
            needed = Needed(rank, LARGER, 0.0)
        both_left, count = np.concatenate((left, kept)), len(effect.coefficients)
        for direction in directions:
            y, size = both_left @ direction, float(whole @ direction**2)
            if common is not None:
                shared = both_left @ common
                y = y - shared @ np.linalg.lstsq(shared, y, rcond=1e-9)[0]
            here, there = y[: left.shape[0]], y[left.shape[0] :]
            gains = _gains(here, there)
            if not sum(gains) > UNSEEN**2 * size or min(gains) <= 0.0:
                continue
            seen = rows.smallest_seen(here, there, needed)
            second = seen * float(np.abs(changes @ direction).max(initial=0.0))
            if not np.isfinite(seen) or second**2 * size > sum(gains):
                continue  # the second order of what masses and springs take up is more than the first leaves
            if worst is None or seen > worst[0]:
                worst = seen, [*(seen * direction[:count]).tolist(), *shape]
            break
    return None if worst is None else worst[1]


def _directions(effect: Effect, left: Float64, kept: Float64) -> tuple[list[Float64], Float64 | None]:
    """(L,) coefficients of a law of size one, those that show least first, and (L, k) those of what a smaller
    law has in common."""
    if effect.cause in BEYOND_DRY:
        _, own, common = BEYOND_DRY[effect.cause]
        return [np.array(own)], np.array(common).T
    if effect.cause == "presliding_friction":
        return [np.array([1.0, 0.0])], np.array([[0.0], [1.0]])
    information = left.T @ left + kept.T @ kept
    if effect.coefficients == ("sine", "cosine") and np.isfinite(information).all():
        return list(np.linalg.eigh(information)[1].T), None  # phases
    return [np.eye(left.shape[1])[0]], None


def _shapes(effect: Effect, views: Sequence[View], term: PlacedEffect) -> list[tuple[float, ...]]:
    """Shapes at which a law of unknown shape is asked for: those that the search starts from, in the band."""
    grid = effect.grid(views, term.place)
    if effect.shapes[:1] == ("frequency",):
        low, high = (float(np.log(w)) for w in excited_band(views))
        grid = [shape for shape in grid if low <= shape[0] <= high]
    return grid


def _size_of_knee(term: PlacedEffect, rows: _Rows, needed: Needed) -> list[float] | None:
    """Shape of the smallest law that is seen, found by trial between the sizes that the search starts from;
    ``None`` where the largest is not."""
    effect, place, screen = term.effect, term.place, rows.screen
    falls = effect.cause == "torque_saturation"
    shapes = sorted((s[0] for s in effect.grid(screen.views, place) if len(s) == 1), reverse=falls)
    if effect.cause == "torque_delay":
        shapes = [s for s in shapes if s > 0.0]

    def is_seen(shape: float) -> bool:
        screen.reconstruct(term)
        trained = [_lines(effect, v, place, shape)[..., None] for v in screen.views]
        kept_out = [_lines(effect, v, place, shape)[..., None] for v in rows.held.views]
        left, kept, whole, _ = rows.project(trained, kept_out)
        gains = _gains(left, kept)
        if not np.isfinite(sum(gains)) or not sum(gains) > UNSEEN**2 * float(whole[0]) or min(gains) <= 0:
            return False
        return rows.is_seen(left[:, 0], kept[:, 0], needed)

    seen = next((k for k, shape in enumerate(shapes) if is_seen(shape)), None)
    if seen is None:
        return None
    high, low = shapes[seen], shapes[seen - 1]
    if seen == 0:
        low = (
            0.0
            if effect.cause == "torque_delay"
            else effect.limits(screen.views, place)[0][1 if falls else 0]
        )
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if is_seen(middle) else (middle, high)
    return [high]


def _lines(effect: Effect, view: View, place: Place, shape: float) -> Complex128:
    """(F, M) resistance of a law with a knee. Timing adds up in the logarithm: what a time offset leaves of a
    lag is half of what it leaves to first order."""
    if not isinstance(effect, ActuatorEffect) or effect.cause == "torque_saturation":
        return effect.contribution(view, place, (shape,))[0]
    response, out = effect.response(view, place, (shape,)), np.zeros_like(view.acting)
    late = np.log(np.abs(response)) + 1j * np.unwrap(np.angle(response))
    out[:, place.axis] = -late * view.acting[:, place.axis]
    return out


def _values(
    effect: Effect, x: list[float], term: PlacedEffect, rows: _Rows, parameter: str
) -> tuple[float, dict[str, float]]:
    """The limit in the unit of its parameter, and the law's other parameters there."""
    fit = rows.selection.final.fit
    chains = fit.layout.structure.chains(fit.p[: fit.layout.structure.count])
    at = effect.of_machine(chains).values(x, term.place)
    value = at.pop(parameter)
    if effect.cause in BEYOND_DRY:
        size = float(max(np.abs(x[: len(effect.coefficients)]))) * (2.0 if x[0] else 1.0)
        return size, {name: at[name] for name in effect.shapes}
    return abs(value - 1.0) if effect.cause == "torque_gain" else abs(value), at


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
