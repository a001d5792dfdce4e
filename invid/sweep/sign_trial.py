"""Play small doublets before anything else: do the signs agree, does it move, do the scales fit its
inertia?
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from invid.config import AxisConfig
from invid.errors import SafetyStop
from invid.numerics.arrays import Float64
from invid.planning.hold_laws import Gains
from invid.planning.phases import (
    CATCH_HZ,
    SIGN_CATCH_S,
    SIGN_COUNTS,
    SIGN_FAR,
    SIGN_FIRST_S,
    SIGN_LAST_S,
    SIGN_MOST,
    SLOW_SHARE,
    SLOW_WINDOW,
    sign_amplitude,
    sign_wanted,
)
from invid.signals.excitation import doublet
from invid.sweep import trials
from invid.sweep.inertia import AGREES, ELASTIC, ELASTIC_S, Branch, compare, rigid_branch
from invid.sweep.loads import LOAD_SHARE
from invid.sweep.motion import Feedback, Log, Motion
from invid.sweep.ports import Mode, Procedure
from invid.wording.sentence import sentence

TRIAL_CLIMB, TRIAL_AGAIN_S = 2.0, 0.08
"""Where the longest doublet does not move an axis, its torque is doubled, up to what is planned, and it
begins again at this length."""
FIRST_SHARES = (0.1, 0.3, 1.0)
"""Shares of the trial's amplitude at the shortest doublet. The last is a tenth of the shaking: with a scale
of torque ten times wrong it is the shaking itself, which is within the torque limit."""
LEAST_GROWTH = 1.2
"""A doublet that may not be longer by more than this says nothing new."""
MORE_THAN_FRICTION = 2.0
"""Torque of a slow doublet over the friction that a stronger one showed: half of it is then left."""
SLOW_TRIALS = 5
"""The slow doublet that moves the whole branch is longer again where outer masses turn out to follow."""
PROBE_S = 1.1
"""Of a doublet in which masses behind springs follow: longer than ``ELASTIC_S`` by more than a cycle."""
PROBES, PROBE_CLIMB, PROBE_WAYS = 3, 1.5, 2.5
"""So often, each with as much more torque, as long as none moves the axis by a tenth of its window."""
SLEEP_COUNTS = 20
"""An encoder that dies shows so many counts first; fewer are what ringing leaves of a coarse one."""
LATE_TRIALS = 20
"""Trials that say nothing because somebody was late, before the measurement gives up: seven seconds at least,
so that a few in which a computer is busy with something else do not end it; each trial is as small as the
others and the axis is caught after it. Empirical: a machine on which one SYNC in twenty comes late spoils one
doublet in three."""
DRIFTS = 8
"""Doublets of which drifting took an axis further than one may, before that is taken for their motion."""
LEAST_COUNTS = 5
"""Less than this after the longest doublet, and the axis did not move."""
LEAST_STEPS = 2.0
"""Thousandths of rated torque below which a doublet is not commanded at all: 0x6071 has no smaller steps."""
SEEN_SHARE = 0.01
"""Share of rated torque from which 0x6077 must show a doublet: ten of its steps."""
FIT_MOST = 2.0
"""Friction that may hold an axis, over the one that its doublet showed where it slid."""
ONE_COUNT = 1.5
"""Counts that an encoder which is stuck shows at most."""
REACTION = 5.0
"""A held axis whose torque swings by this many times what it did before the first doublet, and by
``SEEN_SHARE`` of its rated torque, is shaken by the axis on trial, which therefore moves."""


@dataclass(frozen=True)
class Trial:
    """One doublet and what it did."""

    response: trials.Response
    log: Log
    drifted: float
    """Way in the quiet before it."""


class SignTrial:
    """The trial of one axis; the others are held."""

    def __init__(
        self, motion: Motion, axis: int, stated: tuple[float, str] | None, warnings: list[str]
    ) -> None:
        self._motion, self._axis, self._stated = motion, axis, stated
        self._warnings = warnings
        self._settings: AxisConfig = motion.config.axes[axis]
        self._count = motion.cell.resolution[axis]
        self._rated = motion.cell.rated_torque[axis]
        self._amplitude, self._most = sign_amplitude(motion.config, motion.plan.experiments, axis)
        self._unit, self._torque_unit = ("m", "N") if motion.config.linear else ("rad", "N·m")
        self._modes = motion.resting_modes()
        self._modes[axis] = Mode.TORQUE
        self._others = [
            Feedback(i, Gains(0.0, 0.0), motion.bias[i], a.limits.torque)
            for i, a in enumerate(motion.config.axes)
            if self._modes[i] is Mode.TORQUE
        ]
        self._foretold = None if motion.by_offset(axis) else motion.plan.doublets[axis]
        self._spoilt: list[trials.Response] = []
        self._seen: list[trials.Response] = []
        self._still: list[bool] = []
        self._home = 0.0
        self._calm: Float64 | None = None

    def run(self) -> Procedure[bool]:
        """Try one axis, and return whether it moves as a model foretells; SafetyStop where signs or scales
        are wrong, or nothing moves."""
        motion, axis = self._motion, self._axis
        motion.phase = sentence("trying the signs of {axis}", axis=self._settings.name)
        motion.experiment = None
        self._home = motion.place[axis]
        motion.watching.bounds.near = motion.announced({axis})
        yield from motion.change(self._modes, self._others)
        motion.watching.held = set(range(motion.count)) - {axis}
        amplitude, length, last = yield from self._grow()
        self._require_torque(last.response, amplitude)
        self._require_motion(last.response, amplitude, length)
        self._require_signs(last.response, amplitude)
        if not motion.by_offset(axis):
            name, rated, unit = self._settings.name, self._rated, self._torque_unit
            trials.judge_scale(name, self._seen, rated=rated, torque_unit=unit)
        shown = self._shown_over_foretold(last.response, length)
        branch = None if motion.by_offset(axis) else self._branch(last.log)
        if shown is None:
            branch = yield from self._weigh(last, amplitude, length)
        self._compare(branch, last.response)
        # what swings behind it moves an axis as well: no axis is lighter than its first mass
        known = max(last.response.inertia, last.response.first_mass)
        known = self._stated[0] if self._stated is not None else known
        known *= max(1.0, shown or 1.0)  # a heavier load than the model's takes longer to stop
        friction = amplitude
        if branch is not None:  # as the fit shows it, but no less than a drive's friction at rest may be
            friction = min(amplitude, max(FIT_MOST * branch.friction, LOAD_SHARE * self._rated))
        ways, bounds = self._ways(last.log), motion.watching.bounds
        bounds.unmoved.moved_by(axis, friction, ways)
        grip = amplitude if branch is None else branch.friction
        bounds.held_torque.grips[axis] = grip if all(ways) else math.inf
        yield from self._catch(branch.inertia if branch is not None and branch.rigid else known)
        if motion.cell.can_hold[axis]:
            yield from motion.change(motion.resting_modes(), [f for f in self._others if f.axis != axis])
        motion.watching.bounds.near = {}
        return shown is not None

    # --- doublets ------------------------------------------------------------------------------
    def _play(self, amplitude: float, length: float) -> Procedure[Trial]:
        """Play a doublet until one is punctual. A pause in it leaves the axis drifting: catch it."""
        while (trial := (yield from self._play_once(amplitude, length))).response.late:
            self._spoilt.append(trial.response)
            if len(self._spoilt) > LATE_TRIALS:
                raise trials.too_late(self._settings.name, [*self._seen, *self._spoilt])
            yield from self._catch_again(self._stated[0] if self._stated else trial.response.inertia)
        return trial

    def _play_once(self, amplitude: float, length: float) -> Procedure[Trial]:
        """Play one doublet with quiet before and after it."""
        motion, axis, cycle = self._motion, self._axis, self._motion.plan.cycle_s
        wave = amplitude * doublet(round(length / cycle))
        quiet = max(8, round(trials.EDGE_S / cycle) + max(trials.LAGS))
        rows = np.zeros((wave.size + 2 * quiet, motion.count))
        rows[quiet:-quiet, axis] = wave
        motion.watching.words.begin()
        kept = yield from motion.play(rows, len(rows))
        motion.watching.words.require_no_limit([axis], f"{amplitude:.3g} {self._torque_unit}")
        if self._calm is None:
            self._calm = _swing(kept.torque[:quiet], kept.fresh[:quiet])
        torque, came = kept.torque[:, axis], kept.fresh[:, axis]
        own = torque - motion.bias[axis]
        if motion.by_offset(axis):
            own = trials.without_loop(kept.time, self._demand(kept), own, kept.position[:, axis], came)
        found = trials.response(
            kept.time,
            self._demand(kept),
            own,
            kept.position[:, axis] - kept.position[0, axis],
            count=self._count,
            rated=self._rated,
            fresh=came,
            acting=torque - motion.bias[axis] if motion.by_offset(axis) else None,
        )
        still = came.sum() >= trials.SIDE_ROWS and bool(np.ptp(torque[came]) == 0)
        if amplitude >= SEEN_SHARE * self._rated:
            self._still.append(still)
        before = kept.position[: quiet + 1, axis]
        return Trial(found, kept, float(abs(before[-1] - before[0])))

    def _passed_on(self, kept: Log) -> bool:
        """Return whether held axes answer: an axis that stands passes nothing on, so its encoder is stuck.

        More torque would only make the axes behind it swing further.
        """
        if self._calm is None:
            return False
        now, rated = _swing(kept.torque, kept.fresh), np.array(self._motion.cell.rated_torque)
        answers = now > np.maximum(REACTION * self._calm, SEEN_SHARE * rated)
        answers[self._axis] = False
        return bool(answers.any())

    def _ways(self, kept: Log) -> tuple[bool, bool]:
        """Whether the axis went down, and up."""
        x = kept.position[kept.fresh[:, self._axis], self._axis]
        down, up = (np.maximum.accumulate(x) - x).max(), (x - np.minimum.accumulate(x)).max()
        least = LEAST_COUNTS * self._count
        return bool(down >= least), bool(up >= least)

    def _demand(self, kept: Log) -> Float64:
        demand: Float64 = kept.demand[:, self._axis] - self._motion.bias[self._axis]
        return demand

    def _catch_again(self, inertia: float) -> Procedure[None]:
        """Bring the axis back, and let it go for the next doublet."""
        yield from self._catch(inertia)
        yield from self._motion.change(self._modes, self._others)

    def _catch(self, inertia: float) -> Procedure[None]:
        """Bring the axis gently back to where it stood."""
        self._motion.inertia[self._axis] = inertia
        yield from self._motion.centre({self._axis}, lowest=CATCH_HZ)
        yield from self._motion.until_still({self._axis}, SIGN_CATCH_S)

    def _hold_again(self) -> Procedure[None]:
        """Let an axis of which nobody knows how heavy it is be held for a while: what swung behind it when it
        was let go moves it.
        """
        motion, done = self._motion, self._motion.done_s
        if motion.cell.can_hold[self._axis]:
            others = [f for f in self._others if f.axis != self._axis]
            yield from motion.change(motion.resting_modes(), others)
            yield from motion.play(None, round(SIGN_CATCH_S / motion.plan.cycle_s))
            yield from motion.change(self._modes, self._others)
        motion.done_s = done  # no part of the plan

    def _grow(self) -> Procedure[tuple[float, float, Trial]]:
        """Play stronger, then longer, then again stronger doublets until the axis has moved; return the
        last amplitude, length and trial.
        """
        limits = self._settings.limits
        # The slope is of the sampled position, so the axis must move many counts.
        wanted, suffices = sign_wanted(limits, self._count), 0.0
        if self._foretold is not None:
            wanted, suffices = SIGN_COUNTS * self._count, self._foretold.length_s - self._motion.plan.cycle_s
        far = SIGN_MOST * limits.position
        least = LEAST_STEPS / 1000 * self._rated
        shares = [s for s in FIRST_SHARES if s == 1.0 or s * self._amplitude >= least]
        amplitude, length = shares.pop(0) * self._amplitude, SIGN_FIRST_S
        doubted = asleep = answered = False
        drifts = 0
        while True:
            trial = yield from self._play(amplitude, length)
            found = trial.response
            drifting = self._stated is None and trial.drifted >= LEAST_COUNTS * self._count
            if drifting and length == SIGN_FIRST_S and found.displacement > far and drifts < DRIFTS:
                drifts += 1
                yield from self._hold_again()
                continue
            if shares and found.displacement <= far:
                amplitude = shares.pop(0) * self._amplitude
                continue
            shares.clear()
            if asleep and found.displacement < LEAST_COUNTS * self._count:
                break
            if found.stood and not asleep and found.displacement >= SLEEP_COUNTS * self._count:
                # It moved and then stood under a torque that moves it: once more before that is believed.
                asleep = True
                continue
            self._seen.append(found)
            sign = trials.sign_score(self._seen)
            if (sign < -trials.DECISIVE or found.opposed) and not doubted:
                # A wrong sign is wrong twice; a computer that was late in the first trial is not.
                doubted = True
                self._seen.clear()
                continue
            shown = found.displacement >= wanted and length >= suffices
            if sign < -trials.DECISIVE or (shown and sign > trials.DECISIVE):
                break
            if found.displacement > far:
                break
            if found.displacement < ONE_COUNT * self._count and self._passed_on(trial.log):
                # light axes feel a heavy one that moves by less than a count: twice as long it shows
                if answered:
                    break
                answered = True
            longer = self._next_length(length, found.displacement)
            unseen = found.displacement < LEAST_COUNTS * self._count
            way = self._free_way(amplitude, longer) if unseen else 0.0
            if length * 2 <= SIGN_LAST_S and way <= SIGN_FAR * limits.position:
                length = longer
                continue
            if amplitude * TRIAL_CLIMB > self._most or found.displacement >= wanted:
                break
            # What holds it against a small torque is most often friction; a stronger doublet starts short.
            amplitude, length = TRIAL_CLIMB * amplitude, TRIAL_AGAIN_S
        return amplitude, length, trial

    def _free_way(self, amplitude: float, length: float) -> float:
        """Return how far a doublet takes a free mass of the stated inertia; 0 where nobody stated one.

        An axis that nobody sees move may do so all the same: more torque tells as well as a longer way.
        """
        return amplitude * length**2 / (4 * self._stated[0]) if self._stated is not None else 0.0

    def _next_length(self, length: float, moved: float) -> float:
        """Twice as long; where a model says which length suffices that one, if what has moved so far does not
        go too far in it by itself."""
        if self._foretold is None or moved < LEAST_COUNTS * self._count:
            return 2 * length
        far = length * float(np.sqrt(SIGN_FAR * self._settings.limits.position / moved))
        return max(2 * length, min(self._foretold.length_s, far))

    # --- verdicts ------------------------------------------------------------------------------
    def _require_torque(self, found: trials.Response, amplitude: float) -> None:
        """Require that 0x6077 shows what is commanded well above its steps."""
        if not self._still or not all(self._still):
            return
        moved = found.displacement >= LEAST_COUNTS * self._count
        raise SafetyStop(
            f"axis {self._settings.name}: the measured torque (0x6077) did not change while {amplitude:.3g} "
            f"{self._torque_unit} ({amplitude / self._rated:.1%} of rated) were commanded, and the axis "
            + (
                "moved: the drive does not show its torque"
                if moved
                else "did not move: the drive gives no torque"
            ),
            way_out=(
                "let it update 0x6077, or nothing can be identified"
                if moved
                else "look at its torque and current limits, safe torque off and its torque mode"
            )
            + self._ignored(),
            code="torque_hidden" if moved else "no_torque",
            axis=self._settings.name,
        )

    def _require_motion(self, found: trials.Response, amplitude: float, length: float) -> None:
        if found.displacement >= LEAST_COUNTS * self._count:
            return
        self._motion.watching.bounds.blind.add(self._axis)
        raise SafetyStop(
            sentence(
                "axis {axis}: {amplitude:.3g} {torque_unit} for {length:.2g} s moved the encoder "
                "by {displacement:.0f} counts: the brake is closed, the encoder is stuck, or "
                "friction takes all of the planned torque",
                axis=self._settings.name,
                amplitude=amplitude,
                torque_unit=self._torque_unit,
                length=length,
                displacement=found.displacement / self._count,
            ),
            way_out="see that the brake opens and turn the axis by hand" + self._ignored(),
            code="stands",
            axis=self._settings.name,
        )

    def _ignored(self) -> str:
        """Return what the drive says of a target that did nothing."""
        if not self._motion.watching.words.ignores(self._axis):
            return ""
        return ". The drive does not say that it follows its target (statusword bit 12 is 0)"

    def _require_signs(self, found: trials.Response, amplitude: float) -> None:
        name, seen = self._settings.name, self._seen
        sign = trials.sign_score(seen)
        if abs(sign) <= trials.DECISIVE:
            if sum(r.late_edges for r in seen) > sum(r.edges for r in seen):
                raise trials.too_late(name, [*seen, *self._spoilt])
            self._warnings.append(
                sentence(
                    "axis {axis}: the trial could hardly tell the encoder's sign ({sign:+.1f} standard "
                    "deviations); the encoder is coarse or the torque small",
                    axis=name,
                    sign=sign,
                )
            )
        self._judge(found, sign, amplitude)

    def _judge(self, found: trials.Response, sign: float, amplitude: float) -> None:
        name, unit, torque_unit = self._settings.name, self._unit, self._torque_unit
        trials.judge(name, found, sign, amplitude=amplitude, unit=unit, torque_unit=torque_unit)

    # --- inertia -------------------------------------------------------------------------------
    def _weigh(self, last: Trial, amplitude: float, length: float) -> Procedure[Branch | None]:
        """Weigh the whole branch as a rigid mass by slower doublets; ``None`` where it does not move so.

        Where nobody has stated an inertia there is nothing to compare with; where the drive's own loop stays
        closed, no axis moves so.
        """
        if self._stated is None or self._motion.by_offset(self._axis):
            return None
        window = self._settings.limits.position
        slow = max(self._amplitude * SLOW_SHARE, LEAST_STEPS / 1000 * self._rated)
        slow = min(amplitude, slow)
        moved = length
        branch = self._branch(last.log)
        for _ in range(SLOW_TRIALS):
            inertia = branch.inertia if branch is not None else last.response.inertia
            if branch is not None:  # what friction takes of it says nothing of the mass
                slow = min(amplitude, max(slow, MORE_THAN_FRICTION * branch.friction))
            next_length = min(SIGN_LAST_S, float(np.sqrt(16 * inertia * SLOW_WINDOW * window / slow)))
            if not next_length > LEAST_GROWTH * length:
                break
            trial = yield from self._play_near(last, slow, next_length)
            if trial.response.displacement < LEAST_COUNTS * self._count:
                # friction may hold it under less torque: what moved it moves it again
                again = yield from self._play(amplitude, moved)
                self._require_motion(again.response, amplitude, moved)
                break
            last, length = trial, next_length
            branch = self._branch(last.log)
        seen = branch.inertia if branch is not None else last.response.inertia
        if length < ELASTIC_S and seen < self._stated[0] / ELASTIC:
            done = self._motion.done_s
            branch = (yield from self._probe(last)) or branch
            self._motion.done_s = done  # no part of the plan
        return branch

    def _shown_over_foretold(self, found: trials.Response, length: float) -> float | None:
        """Return the inertia that this doublet showed over that which a model foretells of it.

        ``None`` where nothing is foretold of it, or they differ so much that slower doublets must weigh it.
        """
        told = self._foretold
        if told is None or abs(length - told.length_s) > self._motion.plan.cycle_s:
            return None
        ratio = found.inertia / told.inertia
        return ratio if 1.0 / AGREES <= ratio <= AGREES else None

    def _play_near(self, last: Trial, amplitude: float, length: float) -> Procedure[Trial]:
        """Play a doublet, from where the axis stood where the last one left it further than one may take it.

        Masses that swung behind the motor while it was held leave the whole branch drifting when it lets go.
        """
        away = last.log.position[-1, self._axis] - self._home
        if self._stated is not None and abs(away) > SIGN_FAR * self._settings.limits.position:
            yield from self._catch_again(self._stated[0])
        return (yield from self._play(amplitude, length))

    def _probe(self, last: Trial) -> Procedure[Branch | None]:
        """Play a doublet slow enough for the whole branch of an axis that moved too easily for one so far.

        Its torque is by the stated inertia: it moves an axis as light as ``ELASTIC`` permits by the way of
        the other slow doublets, and one whose scale is ten times wrong by less than twice of that. More
        follows where friction took too much of it.
        """
        stated, cycle = self._stated[0] if self._stated is not None else 0.0, self._motion.plan.cycle_s
        length = round(PROBE_S / cycle) * cycle
        way = SLOW_WINDOW * self._settings.limits.position
        torque = max(16 * stated / ELASTIC * way / length**2, LEAST_STEPS / 1000 * self._rated)
        for _ in range(PROBES):
            if torque > self._amplitude:
                break
            last = trial = yield from self._play_near(last, torque, length)
            found = self._branch(trial.log)
            if found is not None:
                return found if found.inertia < stated / ELASTIC else None  # a spring may hold it back
            if trial.response.displacement > PROBE_WAYS * way:
                break
            torque *= PROBE_CLIMB
        return None

    def _branch(self, kept: Log) -> Branch | None:
        position = kept.position[:, self._axis] - kept.position[0, self._axis]
        if np.ptp(position) < SIGN_COUNTS * self._count:
            return None
        fresh = kept.fresh[:, self._axis]
        found = rigid_branch(kept.time, self._demand(kept), position, fresh, count=self._count)
        if found.is_opposed:  # steps of a coarse encoder may leave that open
            self._judge(self._seen[-1], -math.inf, found.torque)
        return found if found.fits else None

    def _compare(self, branch: Branch | None, found: trials.Response) -> None:
        if self._stated is None:
            return
        stated, source = self._stated
        said = compare(
            self._settings.name,
            stated,
            source,
            first_mass=found.first_mass,
            branch=branch,
            unit="kg" if self._motion.config.linear else "kg·m²",
        )
        self._warnings += [said] * bool(said)


def _swing(torque: Float64, fresh: np.ndarray) -> Float64:
    """Standard deviation of each axis' torque over the samples that came [torque units], (M,)."""
    return np.array([np.std(t[f]) if f.any() else np.inf for t, f in zip(torque.T, fresh.T, strict=True)])
