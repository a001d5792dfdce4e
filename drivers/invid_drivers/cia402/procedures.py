"""What is done with the axes, in order: generators that look and wish for every axis, once a cycle.

They command nothing: the supervisor decides in every cycle what an axis gets. The stop test is made at rest,
with loads supported: a brake is tried, a quick stop is watched, then this master says nothing for longer than
the drives wait for it, for that is how a dead master leaves them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np

from invid.errors import BusError, DriveError, SafetyStop
from invid.sweep.loads import CONFIRM_S, LOAD_SHARE
from invid.sweep.ports import Procedure, Want, Wish
from invid.wording.sentence import sentence
from invid_drivers.cia402.axis_state import BRAKE_S, CHANGING_S, ENABLE_S, AxisState
from invid_drivers.cia402.states import DriveState
from invid_drivers.cia402.supervised_axis import SupervisedAxis
from invid_drivers.cia402.supervisor import MOVES

LOOK_S = 0.35
"""At rest, before power: longer than the longest window in which a fall is seen (0.32 s), and than a drive
takes from showing a mode to being in it (0.1 s, one report)."""
LOOK_CYCLES = 600
"""Where the adapter is in doubt: 99 % are then bounded by the second worst."""
SETTLE_S = 2.0
"""What the axis did before has died away by then."""
HOLD_S = 0.4
"""Watched after a quick stop: longer than the ramp from rest, and than a drive takes to switch itself off.
The first time it is looked at as long as at the end."""
TORQUE_S = 0.12
"""In torque mode before this master falls silent: some drives show a mode 0.1 s before it acts."""
DRIFT_S = 0.3
"""Longest heartbeat watch that is waited for in torque mode: with its load's torque alone an axis drifts,
by 1 % of rated torque on 1 kg·m² by 5 mrad until then; else it is waited for in position mode."""
SILENCE_S = 0.2
"""Beyond the drive's heartbeat watch: what it does then takes its time."""
ANSWER_S = 1.0
"""Waited for an answer that does not come, before the bus is called broken."""
SEEN_OFF_S = 0.5
"""What is off or on its brake is looked at so long: a load that falls has gone 1.2 m by then, one that slides
on its brake has left its tolerance."""
WEIGHINGS = 3
"""An axis weighs nothing that showed no load once: those that were just let go swing on for a while."""
AFTER_S = 5.0
"""What is left held is looked at so long without its master: quick stops with a time limit, late faults and
slow loops showed themselves within four seconds."""

CAUGHT = (AxisState.CAUGHT, AxisState.LOST, AxisState.FAULT)


@dataclass(frozen=True)
class Stage:
    """What a procedure is given: the axes to look at, the clock, and the few acts beside wishes."""

    axes: Sequence[SupervisedAxis]
    now: Callable[[], float]
    mute: Callable[[], None]
    """Say nothing from here on."""
    speak: Callable[[], None]
    is_mute: Callable[[], bool]
    note: Callable[..., None]
    """Remembers what was seen of an axis."""

    def everyone(self, want: Want) -> Wish:
        """The same for every axis."""
        return Wish([want] * len(self.axes))

    def only(self, axes: Collection[SupervisedAxis], want: Want) -> Wish:
        """For some axes; the others stay."""
        chosen = {a.index for a in axes}
        return Wish([want if a.index in chosen else Want.STAY for a in self.axes])

    def wait(self, seconds: float, wish: Wish) -> Procedure[None]:
        """Go on wishing the same for a while."""
        return self.until(self.axes, (), wish, seconds)

    def until(
        self, axes: Sequence[SupervisedAxis], states: Collection[AxisState], wish: Wish, longest: float
    ) -> Procedure[None]:
        """Wish the same until these axes are in one of the states, or ``longest`` has passed: every state has
        a deadline of its own, but two could follow each other for ever."""
        end = self.now() + longest
        while self.now() < end and not all(a.state in states for a in axes):
            yield wish


def names_of(axes: Sequence[SupervisedAxis]) -> list[str]:
    """Names of axes, in order."""
    return [a.name for a in axes]


# --- enabling --------------------------------------------------------------------------------------


def enable(stage: Stage) -> Procedure[None]:
    """Bring every axis to operation enabled, held where it stands, or at zero torque where it cannot be."""
    there, longest = (AxisState.HELD, AxisState.LED), 2 * ENABLE_S
    yield from stage.until(stage.axes, there, stage.everyone(Want.HOLD), longest)
    missing = [a for a in stage.axes if a.state not in there]
    if missing:
        names = names_of(missing)
        raise DriveError(
            sentence(
                "axis {axis}: not enabled in its mode (0x6060) after {longest:g} s; check its "
                "supply, its enable input, safe torque off and the brake",
                axis=", ".join(names),
                longest=longest,
            ),
            axes=names,
        )


@dataclass
class Answers:
    """How many cycles were made, and how many answers of each axis came in time."""

    came: list[int]
    cycles: int = 0


def look(stage: Stage, seconds: float, answers: Answers) -> Procedure[None]:
    """See every axis at rest before the first is enabled; what its encoder shows then is its noise."""
    end = stage.now() + seconds
    while stage.now() < end:
        yield stage.everyone(Want.STAY)
        answers.cycles += 1
        for a in stage.axes:
            answers.came[a.index] += a.fresh
            if a.fresh and not a.is_energised:
                a.estimator.learn_noise(a.estimator.position)
    for a in stage.axes:
        a.estimator.use_noise()


# --- stop test ---------------------------------------------------------------------------------------


def test_stops(stage: Stage, silence_s: float) -> Procedure[None]:
    """Try what is to hold each axis, and what drives do when their master has died; all are held afterwards.

    Parameters
    ----------
    silence_s
        The drives' heartbeat watch.

    Raises
    ------
    SafetyStop
        An axis would fall, does not notice that its master is gone, or cannot be taken back into operation.
    """
    brakes = [a for a in stage.axes if a.holding.needs_brake_test]
    if brakes:
        yield from _try_brakes(stage, brakes)
    stops = [a for a in stage.axes if a.holding.needs_stop_test]
    if stops:
        yield from _try_quick_stop(stage, stops)
    watched = [a for a in stage.axes if a.holding.watched and (a in stops or not a.carries)]
    untried = [a for a in watched if not a.silence_was_tried]
    if untried:
        yield from _fall_silent(stage, untried, silence_s)
    for a in stops:
        a.holding.stop_tried = True
        stage.note(a, holds=True, resumes=True)


def _await_rest(stage: Stage, axes: Sequence[SupervisedAxis]) -> Procedure[None]:
    """Wait until axes rest, and begin a test: one that moved before says nothing of its brake or drive."""
    for a in axes:
        a.estimator.look_anew()
    end = stage.now() + SETTLE_S
    while not all(a.estimator.stands for a in axes):
        if stage.now() > end:
            moving = names_of([a for a in axes if not a.estimator.stands])
            raise SafetyStop(
                sentence(
                    "axis {axis}: moves, though its drive is to hold it at rest (before the stop "
                    "test). Somebody moves it, its load is beyond the drive's torque limit, or a sign "
                    "is wrong in it",
                    axis=", ".join(moving),
                ),
                axes=moving,
            )
        yield stage.everyone(Want.STAY)
    for a in axes:
        a.on_trial = True


def _try_brakes(stage: Stage, axes: Sequence[SupervisedAxis]) -> Procedure[None]:
    """Hand axes to their brakes and measure when and how far each moved last."""
    yield from _await_rest(stage, axes)
    began = stage.now()
    seen: dict[int, tuple[float, float, float]] = {}  # way, when it moved last, speeding up
    closed = (AxisState.BRAKED, *CAUGHT)
    end = stage.now() + 2 * BRAKE_S
    while stage.now() < end and not all(a.state in closed for a in axes):
        yield stage.only(axes, Want.BRAKE)
        for a in axes:
            if a.state is AxisState.BRAKING:
                falls = a.estimator.speed**2 / (2 * max(a.drop, a.estimator.tolerance))
                seen[a.index] = a.drop, max(0.0, a.moved_at - began), falls
    silent = [a for a in axes if a.state not in closed]
    if silent:
        names = names_of(silent)
        raise BusError(
            sentence(
                "axis {axis}: no answer for {brake_s:g} s while its brake was tried",
                axis=", ".join(names),
                brake_s=2 * BRAKE_S,
            ),
            axes=names,
        )
    yield from stage.wait(SEEN_OFF_S, stage.everyone(Want.STAY))
    for a in axes:
        a.holding.brake_tried = True
        drop, seconds, falls = seen.get(a.index, (0.0, 0.0, 0.0))
        drop = max(drop, a.drop if a.state is AxisState.BRAKED else 0.0)
        stage.note(
            a,
            brake_s=seconds,
            brake_drop=max(drop, 2 * a.most_drop if a.brake_failed else 0.0),
            falls=falls if a.brake_failed else None,
        )
        a.brake_failed = False  # what was measured is remembered
        if a.holding.stays and not a.holding.can_stay:
            raise SafetyStop(
                sentence(
                    "axis {axis}: it was handed to its brake at rest, it fell by {drop:.2g} and its "
                    "brake did not hold it by then, and its drive cannot (0x605A; stop test). See to "
                    "the brake, or unload it",
                    axis=a.name,
                    drop=drop,
                ),
                axis=a.name,
            )
    yield from _resume(stage, axes)


def _try_quick_stop(stage: Stage, axes: Sequence[SupervisedAxis]) -> Procedure[None]:
    yield from _await_rest(stage, axes)
    parked = (AxisState.STANDS, *CAUGHT)
    yield from stage.until(axes, parked, stage.only(axes, Want.PARK), SETTLE_S)
    end = stage.now() + (HOLD_S if all(a.holding.seen.holds for a in axes) else AFTER_S)
    while stage.now() < end and all(a.state is AxisState.STANDS for a in axes):
        yield stage.everyone(Want.STAY)
    _require_held(stage, axes, "after a quick stop")
    yield from _resume(stage, axes)


def _fall_silent(stage: Stage, axes: Sequence[SupervisedAxis], watch_s: float) -> Procedure[None]:
    """Say nothing for as long as the drives' heartbeat watch is, and more; then look."""
    yield from _await_rest(stage, axes)
    if watch_s <= DRIFT_S:
        led = [a for a in axes if a.takes_torque]
        for a in led:
            a.torque = a.support if a.carries else 0.0
        end = stage.now() + ENABLE_S + CHANGING_S
        while stage.now() < end and not all(a.state is AxisState.LED and a.mode_is_there for a in led):
            yield stage.only(led, Want.LEAD)
        yield from stage.wait(TORQUE_S, stage.only(led, Want.LEAD))
    yield from _keep_silent(stage, axes, 1.5 * watch_s + SILENCE_S)
    loaded = [a for a in axes if a.carries]
    yield from stage.until(loaded, (AxisState.STANDS, *CAUGHT), stage.everyone(Want.STAY), SETTLE_S)
    moved = [a for a in axes if a.verdict == MOVES]
    if moved:
        raise SafetyStop(
            sentence(
                "axis {axis}: it was given no torque and moved by {most_drop:.2g} at least, faster "
                "and faster (stop test at rest): it carries a load that 0x6077 does not show, or "
                "its drive gives torque that nobody asked for. Set gravity_loaded: true, and "
                "support it",
                axis=", ".join(names_of(moved)),
                most_drop=moved[0].most_drop / 2,
            ),
            axes=names_of(moved),
        )
    deaf = [a for a in axes if a.state in (AxisState.LED, AxisState.HELD) and not a.verdict]
    if deaf:
        a = next((x for x in deaf if x.carries), deaf[0])
        if a.carries:
            stage.note(a, holds=False)
            raise _lets_go(a, f"without its master for {watch_s:.2g} s its drive is in {a.drive.words}")
        raise SafetyStop(
            sentence(
                "axis {axis}: its drive went on for {silence_s:.2g} s without its master ({words}; "
                "stop test at rest), though 0x1016 watches it: if this computer dies, the axis "
                "keeps its last torque. See to 0x1016 and 0x6007, or use another drive",
                axis=", ".join(names_of(deaf)),
                silence_s=1.5 * watch_s + SILENCE_S,
                words=a.drive.words,
            ),
            axes=names_of(deaf),
        )
    _require_held(stage, loaded, f"without its master for {watch_s:.2g} s at most")
    for a in axes:
        a.verdict, a.silence_was_tried = "", True
    yield from _resume(stage, axes)


def _keep_silent(stage: Stage, axes: Sequence[SupervisedAxis], seconds: float) -> Procedure[None]:
    """Say nothing for so long, and until every drive has said what it did then; a catch ends it."""
    end = stage.now() + seconds
    answers = dict.fromkeys(names_of(axes), 0)
    stage.mute()
    while stage.is_mute() and (stage.now() < end or min(answers.values()) < 2):
        if stage.now() > end + ANSWER_S:
            silent = [name for name, count in answers.items() if count < 2]
            raise BusError(
                sentence(
                    "axis {axis}: no answer for {answer_s:g} s after its master was silent, in the stop test",
                    axis=", ".join(silent),
                    answer_s=ANSWER_S,
                ),
                axes=silent,
            )
        yield stage.everyone(Want.STAY)
        for a in axes:  # the state of the second answer was asked for after the first
            answers[a.name] += a.fresh and stage.now() > end - SILENCE_S
    stage.speak()


def _require_held(stage: Stage, axes: Sequence[SupervisedAxis], when: str) -> None:
    for a in axes:
        if a.verdict or a.state in CAUGHT:
            stage.note(a, holds=False)
            raise _lets_go(a, f"{when} {a.verdict or a.state.value}")
        if a.fresh and a.state is not AxisState.STANDS:
            still = a.drive is DriveState.QUICK_STOP_ACTIVE
            raise _lets_go(
                a, f"{when} it did not come to rest" if still else f"{when} its drive is in {a.drive.words}"
            )
        if not a.fresh:
            raise BusError(
                sentence("axis {axis}: no answer {when}, in the stop test", axis=a.name, when=when),
                axis=a.name,
            )


def _lets_go(a: SupervisedAxis, what: str) -> SafetyStop:
    return SafetyStop(
        sentence(
            "axis {axis}: it carries a load, and {what} (stop test at rest): its drive would "
            "let it fall. Use a brake that the drive closes (brake: drive), another drive, or "
            "unload the axis",
            axis=a.name,
            what=what,
        ),
        axis=a.name,
    )


def _resume(stage: Stage, axes: Sequence[SupervisedAxis]) -> Procedure[None]:
    """Every axis held again, from quick stop by transition 16, from its brake, or from off."""
    there = (AxisState.HELD, AxisState.LED)
    for a in axes:
        a.verdict = ""
    end = stage.now() + ENABLE_S + CHANGING_S
    missing = list(stage.axes)
    while missing and stage.now() < end and not any(a.verdict for a in axes):
        yield stage.everyone(Want.HOLD)
        missing = [a for a in stage.axes if a.state not in there]
    if not missing:
        for a in axes:
            a.on_trial = False
        return
    held = [a for a in missing if a.drive is DriveState.QUICK_STOP_ACTIVE and a.carries]
    for a in held:
        stage.note(a, holds=True, resumes=False)
    if held:
        raise SafetyStop(
            sentence(
                "axis {axis}: seen to be held after a quick stop, which is remembered, but its "
                "drive does not go back to operation from there (transition 16). With the load "
                "supported, take its enable or supply away and give it back, then start again",
                axis=", ".join(names_of(held)),
            ),
            axes=names_of(held),
        )
    raise SafetyStop(
        sentence(
            "axis {axis}: not enabled again within {enable_s:g} s after the stop test",
            axis=", ".join(names_of(missing)),
            enable_s=ENABLE_S,
        ),
        axes=names_of(missing),
    )


# --- the way out -------------------------------------------------------------------------------------


def leave(stage: Stage, longest_s: float, doubted: Collection[int]) -> Procedure[None]:
    """Every axis to rest, each at its own pace, and off where nothing needs to hold it; then looked at.

    ``doubted`` axes stay held only because nobody knows whether they are loaded: their torque tells.
    """
    end = stage.now() + longest_s
    yield from _until_final(stage, end)
    for _ in range(WEIGHINGS):
        left = [a for a in stage.axes if a.index in doubted and a.state is AxisState.STANDS and a.carries]
        if not left or stage.now() > end:
            break
        yield from _weigh(stage, left)
        yield from _until_final(stage, end)


def _until_final(stage: Stage, end: float) -> Procedure[None]:
    while stage.now() < end:
        yield stage.everyone(Want.END)
        if all(_is_seen_final(a) for a in stage.axes):
            return


def _is_seen_final(a: SupervisedAxis) -> bool:
    looks = a.state in (AxisState.OFF, AxisState.BRAKED) and a.was_powered and a.seconds < SEEN_OFF_S
    return a.is_final and not looks


def _weigh(stage: Stage, axes: Sequence[SupervisedAxis]) -> Procedure[None]:
    """Axes that carry nothing, by the torque that holds them, need not stay under power because a stop came
    before that was known."""
    shown: dict[int, list[float]] = {a.index: [] for a in axes}
    for wants in stage.wait(CONFIRM_S, stage.everyone(Want.END)):
        yield wants
        for a in axes:
            shown[a.index] += [a.shown_torque] * a.fresh
    for a in axes:
        stood = a.state is AxisState.STANDS and a.drop <= a.estimator.tolerance
        least = LOAD_SHARE * a.estimator.limits.rated_torque
        if stood and shown[a.index] and abs(np.mean(shown[a.index])) <= least:
            a.holding.loaded = a.holding.taken_over = False


def look_after(stage: Stage) -> Procedure[None]:
    """See that what is left held stays held without its master."""
    if any(a.state is AxisState.STANDS for a in stage.axes):
        end = stage.now() + AFTER_S
        stage.mute()
        while stage.is_mute() and stage.now() < end:
            yield stage.everyone(Want.END)
