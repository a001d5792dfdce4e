"""The one loop: in every cycle every axis is seen, judged, moved on by the table and sent its command.

A procedure wishes; the supervisor grants. No wish leads to a state without a hold: the way to power off is
the table's. Whatever raises in a cycle does so after every axis has been attended to, and what a run has left
by then is brought to its end by the way out, which nothing ends.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence

from invid.errors import DriveError, InvidError, SafetyStop
from invid.sweep.bounds import Bounds
from invid.sweep.ports import Event, Loop, Mode, Sample, Severity, Want, Wish
from invid.wording.sentence import marked, sentence
from invid_drivers.cia402 import objects as od
from invid_drivers.cia402 import states
from invid_drivers.cia402.axis import ModeSet
from invid_drivers.cia402.axis_state import (
    CHANGING_S,
    NEXT,
    RULES,
    SUPPORT_S,
    UNHEARD_S,
    AxisState,
    Command,
    Fact,
)
from invid_drivers.cia402.cycle import Cycle
from invid_drivers.cia402.cycle_requests import Change
from invid_drivers.cia402.link import NMT_PRE_OPERATIONAL, NMT_START, NMT_STOP, Link
from invid_drivers.cia402.states import DriveState, OperationMode
from invid_drivers.cia402.supervised_axis import DEAF_S, DRIVEN_LOOK_S, SupervisedAxis, Trouble

CYCLIC = OperationMode.CYCLIC_POSITION
STOPPING = "stopping"
MOVES = "moved by itself"
UNSEEN = marked("support the load of {axes}: it is not seen to stand")
"""Phases that are told."""
SWITCHABLE = (AxisState.LED, AxisState.STOPPING, AxisState.SWITCHING)
"""States in which an axis may be switched off for a mode that its drive takes without power only."""
SAME_CAUSE_S = 1.0
"""An axis that lets go so soon after another was cut off from outside was cut off, too: relays of one
emergency stop open within tenths of a second."""
MISSED_S = 0.3
"""After a silence drives go on saying that their master was gone."""
CUT_LOOK_S = 0.4
"""How an axis moves on that was cut off: longer than the longest window in which a fall is seen."""
EDGE_CYCLES = 2.5
"""Cycles in which a drive is told to stop before it goes on from quick stop: two, should one be lost."""
STAND_BY_S = 0.3
"""A drive that is still enabled so long after *switch on* knows no way back to it: the voltage goes."""


class Supervisor:
    """All axes of a cell, from before power until they are off or held."""

    def __init__(self, cycle: Cycle, link: Link, bounds: Bounds, axes: Sequence[SupervisedAxis]) -> None:
        self._cycle, self._link, self.bounds, self.axes = cycle, link, bounds, list(axes)
        self._cycle_s, self._watch_s = axes[0].cycle_s, 3 * link.heartbeat_s
        self._ticked = math.inf
        self.is_leaving = False
        """On the way out nothing ends what holds an axis."""
        self.tell: Callable[[str], None] = lambda phase: None
        self.changed: Callable[[], None] = lambda: None
        """Called when an axis has come into another state."""
        self.note: Callable[..., None] = lambda axis, **seen: None
        """Remembers what was seen of an axis."""
        self.loops: list[Loop | None] = [None] * len(self.axes)
        self.is_mute = False
        """Whether the master says nothing on purpose."""
        self._silent_since = self._missed_until = -math.inf
        self._cut_from_outside = -math.inf
        self._told: set[str] = set()

    # --- the loop ---------------------------------------------------------------------------------
    def tick(self, wish: Wish) -> Sample:
        """One cycle: grant, command, see, judge, move on."""
        self._notice_pause()
        for axis, want in zip(self.axes, wish.wants, strict=True):
            self.grant(axis, want)
        if wish.torque:
            for axis, torque in zip(self.axes, wish.torque, strict=True):
                axis.torque = torque
        sample, error = self._exchange()
        error = error or self._judge_bounds(sample)
        for axis in self.axes:
            axis.see(sample)
        unseen = [a for a in self.axes if self.is_leaving and a.state is not AxisState.OFF and a.is_unseen()]
        self._cycle.asking = {a.index for a in (self.axes if self.is_mute else unseen)}
        for axis in self.axes:
            try:
                self._attend(axis)
            except InvidError as found:  # what a drive did explains what its axis does
                error = found if isinstance(error, SafetyStop) and error.axis == axis.name else error or found
            except Exception as fault:  # a fault of this program at one axis: the others are attended to
                error = error or DriveError(
                    sentence("axis {axis}: a fault of this program: {fault!r}", axis=axis.name, fault=fault)
                )
        if error is not None and not self.is_leaving:
            raise error
        return sample

    def _notice_pause(self) -> None:
        """After a pause beyond their watch drives have stopped by themselves: no command takes that back."""
        now = self._link.clock.now()
        paused = now - self._ticked > self._watch_s and not (self.is_mute or self._cycle.paused)
        self._ticked = now
        for axis in self.axes:
            if paused and RULES[axis.state].command is Command.ENABLE:
                self.enter(axis, AxisState.PARKING)

    def _exchange(self) -> tuple[Sample, InvidError | None]:
        """One cycle on the bus; where that fails nothing has come of any axis, and time goes on."""
        try:
            if self.is_mute:
                return self._cycle.silent_cycle(), None
            sample = self._cycle.exchange([self._command(a) for a in self.axes])
            if self._cycle.paused:
                self.bounds.pause()
                self._cycle.paused = False
            return sample, None
        except InvidError as error:
            sample, clock = self._cycle.sample, self._link.clock
            clock.sleep_until(clock.now() + self._cycle_s)  # a queue that is full has room again
            sample.time, sample.fresh[:] = clock.now(), [False] * len(self.axes)
            return sample, error

    def _judge_bounds(self, sample: Sample) -> InvidError | None:
        """What leaves its bounds, and which axes are to blame."""
        bounds = self.bounds
        led = (AxisState.LED, AxisState.STOPPING, AxisState.SLOWING)
        bounds.led = {a.index for a in self.axes if a.state in led}
        if self._link.clock.now() < self._missed_until:
            self._hear_who_missed_us(sample)
        if self.is_leaving or self.is_mute:
            bounds.observe(sample)
            held = {a.index for a in self.axes if RULES[a.state].command is Command.ENABLE}
            bounds.blind.update(bounds.uncarried(sample, held - bounds.led))
            bounds.falls = {}
            return None
        try:
            bounds.check(sample, self._cycle.asked)
        except InvidError as error:
            tried = next((a for a in self.axes if a.on_trial and a.name == error.axis), None)
            if tried is None or not isinstance(error, SafetyStop):
                return error
            tried.verdict = tried.verdict or error.reason  # what a test was made to see
        return None

    def _hear_who_missed_us(self, sample: Sample) -> None:
        """What drives say of a silence that was on purpose ends nothing; what they say besides does."""
        sample.events = [e for e in sample.events if e.severity is not Severity.DRIVE]
        for peer in self._link.peers.values():
            for code in peer.own_errors(since=self._silent_since):
                text = f"axis {peer.name} reports error 0x{code:04X} in the stop test"
                sample.events.append(Event(Severity.DRIVE, text, peer.name))

    # --- silence of the master ----------------------------------------------------------------------
    def mute(self) -> None:
        """Say nothing from here on, as if the master had died; drives are only asked where they are."""
        self.is_mute, self._link.beating = True, False
        self._silent_since = self._link.clock.now()

    def speak(self) -> None:
        """Go on after a silence."""
        if not self.is_mute:
            return
        self.is_mute, self._link.beating = False, True
        self._missed_until = self._link.clock.now() + MISSED_S
        for peer in self._link.peers.values():
            peer.last_heartbeat = None
        for axis in self.axes:  # a drive may leave operational when its master is gone
            if not (self.is_leaving and axis.state in (AxisState.OFF, AxisState.BRAKED, AxisState.FAULT)):
                self._link.nmt(NMT_START, axis.holding.config.node_id)
        self._cycle.restart_slots()

    # --- wishes -------------------------------------------------------------------------------------
    def grant(self, a: SupervisedAxis, want: Want) -> None:
        """What an axis gets of what is wished: the only way into a state by will."""
        match want:
            case Want.END:
                self._grant_end(a)
            case Want.LEAD if a.state is AxisState.HELD:
                self.enter(a, AxisState.LED)
            case Want.HOLD if a.state is AxisState.LED and a.has_turned and a.takes_torque:
                self._react_to_driven(a, is_sure=True)  # no loop of its drive's would hold it
            case Want.HOLD if a.state is AxisState.LED and a.holding.has_position_mode:
                self.enter(a, AxisState.STOPPING)
            case Want.HOLD if a.state in (AxisState.OFF, AxisState.STANDS, AxisState.BRAKED):
                self.enter(a, AxisState.ENABLING)
            case Want.HOLD if a.state is AxisState.CAUGHT and a.on_trial:
                self.enter(a, AxisState.HELD)
            case Want.PARK if a.state in (AxisState.HELD, AxisState.LED):
                self.enter(a, AxisState.PARKING)
            case Want.BRAKE if a.state is AxisState.HELD and a.has_brake:
                self.enter(a, AxisState.BRAKING)

    def _grant_end(self, a: SupervisedAxis) -> None:
        match a.state:
            case AxisState.LED if a.has_turned and a.takes_torque and not a.is_unseen():
                self._react_to_driven(a, is_sure=True)
            case AxisState.LED if a.carries and a.holding.has_position_mode and not a.is_unseen():
                self.enter(a, AxisState.STOPPING)
            case AxisState.STOPPING if a.is_unseen():  # no loop of this master's closes, its drive's may
                self.enter(a, AxisState.PARKING)
            case AxisState.LED | AxisState.ENABLING | AxisState.SWITCHING if a.is_energised or not a.fresh:
                self.enter(a, AxisState.PARKING)
            case AxisState.ENABLING | AxisState.SWITCHING:
                self.enter(a, AxisState.LETTING_GO)
            case AxisState.HELD if a.carries and a.has_brake:
                self.enter(a, AxisState.BRAKING)
            case AxisState.HELD | AxisState.LED:
                self.enter(a, AxisState.PARKING)
            case AxisState.STANDS if not a.carries:
                self.enter(a, AxisState.LETTING_GO)
            case AxisState.CAUGHT if a.parks is not False:
                self.enter(a, AxisState.PARKING)

    def enter(self, a: SupervisedAxis, state: AxisState) -> None:
        """Bring an axis into a state."""
        if state is AxisState.CATCHING:
            self.speak()
        self._cycle.drop_change(a.index)
        a.enter(state)
        if state in (AxisState.ENABLING, AxisState.CATCHING) and self._cycle.is_in(a.index, CYCLIC):
            self._cycle.change(a.index, CYCLIC, taken=True)  # held where it is by now
        a.mode_is_there = False
        with contextlib.suppress(Exception):  # whoever listens may have gone
            self.changed()
        if state in (
            AxisState.CATCHING,
            AxisState.CAUGHT,
            AxisState.SLOWING,
            AxisState.LOST,
            AxisState.FAULT,
        ):
            self._tell_support(a)

    def _tell_support(self, a: SupervisedAxis) -> None:
        """Say at once which loads a person must support: it may last a minute."""
        if a.name not in self._told and a.carries:
            self._told.add(a.name)
            with contextlib.suppress(Exception):  # whoever listens may have gone
                names = ", ".join(x.name for x in self.axes if x.name in self._told)
                self.tell(sentence(UNSEEN, axes=names))

    # --- one axis -----------------------------------------------------------------------------------
    def _attend(self, a: SupervisedAxis) -> None:
        """See what is wrong with an axis and move it on."""
        if a.state is AxisState.SLOWING and not self.is_leaving:
            raise SafetyStop(
                sentence("axis {axis}: its torque moved it the opposite way", axis=a.name),
                way_out=sentence(
                    "a sign has turned in motor or encoder: find out before anything moves again"
                ),
                code="disobeys",
                axis=a.name,
            )
        a.blind |= a.index in self.bounds.blind
        self._tell_by_nmt(a)
        trouble = self._restarted(a) or self._given_away(a) or a.trouble()
        if trouble is not None:
            self._react(a, trouble)
        self._see_cut(a)
        self._advance(a)

    def _restarted(self, a: SupervisedAxis) -> Trouble | None:
        """A drive that has started anew gives no torque, whatever it showed before."""
        powered = RULES[a.state].command in (Command.ENABLE, Command.QUICK_STOP)
        booted = self._link.peers[a.holding.config.node_id].booted
        return Trouble.RESTARTED if powered and booted else None

    def _given_away(self, a: SupervisedAxis) -> Trouble | None:
        """What the bounds found of an axis that is led: a torque that turned, or that is missing."""
        fall = self.bounds.falls.get(a.index)
        if fall is None or a.state is not AxisState.LED:
            return None
        return Trouble.DRIVEN if a.is_driven(fall) else Trouble.FALLS

    def _react(self, a: SupervisedAxis, trouble: Trouble) -> None:
        """The next state by the table; SafetyStop or DriveError where that ends the run."""
        before, rule = a.state, RULES[a.state]
        match trouble:
            case Trouble.FAULT | Trouble.RESTARTED:
                self.enter(a, AxisState.FAULT)
            case Trouble.LEFT:
                self._react_to_left(a)
            case Trouble.LET_GO if a.now - self._cut_from_outside < SAME_CAUSE_S:
                self.enter(a, AxisState.FAULT)
            case Trouble.LET_GO:
                self._note_does_not_park(a)
                self.enter(a, a.next_means())
            case Trouble.DRIVEN:
                self._react_to_driven(a, is_sure=before is AxisState.LED or not a.carries)
            case Trouble.BLIND:
                means = AxisState.BRAKING if a.has_brake else AxisState.PARKING
                self.enter(a, means if a.carries or before is AxisState.LED else AxisState.LETTING_GO)
            case Trouble.DEAF:
                self._react_to_deaf(a)
            case Trouble.FALLS:
                self._react_to_fall(a, rule.falls)
        if self._was_silent(a) and trouble is Trouble.LEFT and a.state is not AxisState.CATCHING:
            return  # it stopped by itself when its master fell silent, as it should
        if a.on_trial and before is not a.state:
            a.verdict = a.verdict or trouble.value
            return
        if before is a.state or self.is_leaving or trouble is Trouble.DEAF:
            return
        if trouble in (Trouble.FAULT, Trouble.LEFT):
            raise DriveError(
                sentence(
                    "axis {axis}: the drive left operation enabled (statusword 0x{status:04X}{fault})",
                    axis=a.name,
                    status=a.status,
                    fault=sentence(", fault") if a.status & 0x08 else "",
                ),
                way_out=sentence("read its error memory, find the cause, reset it there"),
                code="drive_left",
                axis=a.name,
            )

    def _react_to_left(self, a: SupervisedAxis) -> None:
        """Its drive stopped by itself: what this master did not switch off it does not enable again."""
        if a.drive is DriveState.QUICK_STOP_ACTIVE:
            self.enter(a, AxisState.PARKING)
        elif self._was_silent(a) and not a.carries:
            self.enter(a, AxisState.LETTING_GO)
        elif self._was_silent(a):
            self.note(a, holds=False)
            self.enter(a, a.next_means())
        else:
            self._cut_from_outside = a.now
            self.enter(a, AxisState.FAULT)

    def _was_silent(self, a: SupervisedAxis) -> bool:
        """Whether an axis may have been left because its master was silent on purpose; the catch of another
        one ends the silence."""
        return self.is_mute or (a.on_trial and a.now < self._missed_until)

    def _react_to_driven(self, a: SupervisedAxis, *, is_sure: bool) -> None:
        """A quick stop first: a load that falls looks the same for a moment; then cut off. Of a led axis it
        is known by what was asked of it, and what carries nothing does not fall.

        One that goes against this master's torque is slowed by its opposite, whether motor or encoder has
        turned: no other torque is left, and where that is wrong it gets faster and is cut off, too."""
        turned = a.state is AxisState.LED and a.takes_torque
        if a.driven_since is None:
            a.driven_since, a.entry_speed = a.now, abs(a.estimator.speed)
            if a.state is not AxisState.PARKING:
                self.enter(a, AxisState.PARKING)
        looked = a.now - a.driven_since >= DRIVEN_LOOK_S and abs(a.estimator.speed) >= a.entry_speed
        if is_sure or looked:
            a.is_cut = True
            self.enter(
                a,
                AxisState.BRAKING
                if a.has_brake and a.carries
                else (AxisState.SLOWING if turned else AxisState.LETTING_GO),
            )

    def _react_to_deaf(self, a: SupervisedAxis) -> None:
        """It may hear NMT though its PDOs are lost; its abort option (0x6007) is a quick stop. A drive that
        holds a load in position mode holds it."""
        a.deaf = True
        if not self._holds_by_itself(a):
            self.enter(a, AxisState.UNHEARD)
            self._stop_by_nmt(a)

    def _holds_by_itself(self, a: SupervisedAxis) -> bool:
        return a.carries and self._cycle.is_in(a.index, CYCLIC)

    def _stop_by_nmt(self, a: SupervisedAxis) -> None:
        """NMT stops all axes of a node: none where another one holds a load."""
        node = a.holding.config.node_id
        others = [x for x in self.axes if x is not a and x.holding.config.node_id == node]
        if not any(x.carries and x.is_energised for x in others):
            self._link.nmt(NMT_STOP, node)

    def _tell_by_nmt(self, a: SupervisedAxis) -> None:
        """A drive whose process data are lost may hear NMT: then it does what it does without a master."""
        ending = a.state in (AxisState.PARKING, AxisState.LETTING_GO) and not self._holds_by_itself(a)
        unheard = a.now - a.heard > DEAF_S  # not by SDO either
        if self.is_leaving and ending and unheard and not a.is_stopped_by_nmt:
            a.is_stopped_by_nmt = True
            self._stop_by_nmt(a)

    def _react_to_fall(self, a: SupervisedAxis, falls: AxisState | None) -> None:
        if a.state is AxisState.CATCHING:
            self.enter(a, a.use_last_means())
        if falls is None or (a.is_cut and a.state is not AxisState.BRAKING):
            return
        if a.state is AxisState.BRAKING and a.is_energised and not a.power_is_useless:
            a.power_is_useless = True
            self.enter(a, AxisState.BRAKING)
            return
        if a.state is AxisState.ENABLING and not a.mode_is_there:
            error = self._late_error(a)
            self.enter(a, AxisState.PARKING)  # a quick stop needs no mode
            a.estimator.begin()  # how it fell until now says nothing of that
            raise error
        a.power_is_useless |= a.is_energised
        a.in_vain |= RULES[a.state].command is Command.ENABLE and a.state is not AxisState.CATCHING
        if a.state in (AxisState.BRAKING, AxisState.BRAKED):
            a.brake_failed = True
        if a.state in (AxisState.PARKING, AxisState.STANDS):
            self._note_does_not_park(a)
        if a.state in (AxisState.OFF, AxisState.LETTING_GO):
            a.holding.loaded = True
        if a.state is AxisState.LED and a.on_trial:
            drifts = f"its drive is in {a.drive.words}"  # and nobody notices
            a.verdict = a.verdict or (drifts if a.carries else MOVES)
            a.holding.loaded = True
            self.enter(a, AxisState.STOPPING)
            return
        if a.state is AxisState.LED or a.full is not None:
            a.weak = True
        if a.full is not None and a.holding.config.brake != "drive":
            a.too_heavy = True
            return  # it gives all it may, and it falls faster without
        means = a.next_means() if falls is NEXT else falls
        if a.state is AxisState.STOPPING and a.has_brake:
            means = AxisState.BRAKING
        if means is AxisState.LOST and a.state is AxisState.PARKING:
            return  # nothing better is left
        self.enter(a, means)

    def _note_does_not_park(self, a: SupervisedAxis) -> None:
        if self._cycle.is_in(a.index, CYCLIC):
            a.parks = False
        self.note(a, holds=False)

    def _see_cut(self, a: SupervisedAxis) -> None:
        """Tell a load beyond the limit from a wrong sign, once the torque is gone: the load gets faster."""
        if a.full is not None and a.estimator.fall is not None and not a.is_energised:
            a.too_heavy |= a.estimator.fall.acceleration > a.full.acceleration

    def _advance(self, a: SupervisedAxis) -> None:
        """Transitions by what is seen, and by deadline."""
        rule = RULES[a.state]
        a.mode_is_there = self._mode_is_there(a, rule.mode)
        change = self._cycle.change_of(a.index)
        if change is not None and a.is_energised:
            a.changing_s = a.seconds
        if a.state in SWITCHABLE and change is not None and change.without_power:
            self._switch_mode(a, change)
            rule = RULES[a.state]
        if a.state is AxisState.PARKING and not a.carries and a.shows(Fact.UNPOWERED):
            self.enter(a, AxisState.LETTING_GO)  # it switches itself off when its ramp has ended
        elif a.state is AxisState.SLOWING and a.runs_away():
            self.enter(a, AxisState.LETTING_GO)
        elif a.state is AxisState.LETTING_GO and a.is_cut and a.shows(Fact.UNPOWERED):
            if a.seconds > CUT_LOOK_S:
                self.enter(a, AxisState.FAULT)
        elif a.state is AxisState.STANDS and self.is_leaving and a.now - a.heard > UNHEARD_S:
            self.enter(a, AxisState.LOST)
        elif rule.done and all(a.shows(f) for f in rule.done) and rule.then is not None:
            self._finish(a, rule.then)
        elif a.seconds > self._within(a, rule.within_s):
            self._be_late(a, rule.late)

    def _switch_mode(self, a: SupervisedAxis, change: Change) -> None:
        """Off, where it stands then, until its drive has taken the mode."""
        rest_s = a.holding.rest_s
        if rest_s is None:
            return
        if a.state is not AxisState.SWITCHING:
            a.target = AxisState.LED if change.operation is a.torque_mode else AxisState.HELD
            a.enter(AxisState.SWITCHING)
            self.changed()
        elif a.fresh and not a.is_energised and a.seconds > rest_s:
            change.ask_again(a.now)

    @staticmethod
    def _within(a: SupervisedAxis, within_s: float) -> float:
        own = {AxisState.PARKING: a.quick_stop_s, AxisState.SLOWING: SUPPORT_S if a.carries else within_s}
        return own.get(a.state, within_s + min(a.changing_s, CHANGING_S))

    def _finish(self, a: SupervisedAxis, then: AxisState) -> None:
        match a.state:
            case AxisState.ENABLING:
                then = a.target if a.holding.has_position_mode else AxisState.LED
                a.target = AxisState.HELD
            case AxisState.PARKING:
                a.parks = True
        self.enter(a, then)

    def _be_late(self, a: SupervisedAxis, late: AxisState | None) -> None:
        """A deadline has passed."""
        before, error = a.state, self._late_error(a)
        match before:
            case AxisState.PARKING if not a.carries or a.is_cut:
                self.enter(a, AxisState.LETTING_GO)
            case AxisState.PARKING:
                self.enter(a, AxisState.LOST)
            case AxisState.LETTING_GO if a.fresh and not a.is_energised:
                self.enter(a, AxisState.FAULT if a.is_cut else AxisState.OFF)
            case AxisState.ENABLING if not a.is_energised:
                self.enter(a, AxisState.LETTING_GO)
            case AxisState.BRAKING:
                a.brake_failed = True
                self.enter(a, a.next_means())
            case AxisState.UNHEARD:
                return
            case AxisState.CAUGHT:
                a.support_was_awaited = True
                self.enter(a, AxisState.PARKING)
            case _:
                self.enter(a, a.next_means() if late in (NEXT, None) else late)
        if a.on_trial:
            a.verdict = a.verdict or f"it was still {before.value}"
        elif not self.is_leaving and before in (AxisState.ENABLING, AxisState.SWITCHING, AxisState.STOPPING):
            raise error

    @staticmethod
    def _late_error(a: SupervisedAxis) -> DriveError:
        node, seconds = a.holding.config.node_id, f"{a.seconds:.2g}"
        seen = a.drive.words if a.fresh else "silence (no TPDO comes)"
        what = f"not enabled after {seconds} s, the drive shows {seen}"
        way_out = sentence("check its supply, its enable input, safe torque off and the brake")
        if a.shows(Fact.ENABLED):
            what = f"enabled, but without its mode (0x6060) after {seconds} s, and it went {a.drop:.2g} away"
            way_out = sentence("see in its manual when it takes a mode, and in 0x6502 whether it has that")
        return DriveError(
            sentence(
                "axis {axis} (node {node}): {what}; {way_out}",
                axis=a.name,
                node=node,
                what=what,
                way_out=way_out,
            ),
            axis=a.name,
        )

    # --- modes --------------------------------------------------------------------------------------
    def _operation(self, a: SupervisedAxis, mode: Mode | None) -> OperationMode | None:
        if mode is None:
            return None
        if a.state is AxisState.ENABLING and a.target is AxisState.LED:
            return a.torque_mode
        return a.torque_mode if mode is Mode.TORQUE or not a.holding.has_position_mode else CYCLIC

    def _mode_is_there(self, a: SupervisedAxis, mode: Mode | None) -> bool:
        if a.state is AxisState.SWITCHING:
            return self._cycle.change_of(a.index) is None
        operation = self._operation(a, mode)
        return operation is None or self._cycle.is_in(a.index, operation)

    def _takes_mode_now(self, a: SupervisedAxis) -> bool:
        """Some drives take a mode from switched on, some show it when they are enabled."""
        match a.takes_mode:
            case ModeSet.SHOWN:
                return True
            case ModeSet.LATER:
                return a.drive in (DriveState.SWITCHED_ON, DriveState.OPERATION_ENABLED)
            case ModeSet.TAKEN:
                return a.drive is DriveState.OPERATION_ENABLED

    def _ask_for_mode(self, a: SupervisedAxis, mode: Mode | None) -> None:
        operation = self._operation(a, mode)
        if operation is None or self._cycle.operation[a.index] is operation:
            return
        if self._cycle.change_of(a.index) is None:
            self._cycle.change(a.index, operation, taken=a.takes_mode is ModeSet.TAKEN)
            a.takes_mode = ModeSet.SHOWN if a.takes_mode is ModeSet.TAKEN else a.takes_mode

    @property
    def is_changing(self) -> bool:
        """Whether an axis is on its way to being led or held."""
        on_the_way = (AxisState.STOPPING, AxisState.SWITCHING, AxisState.ENABLING)
        return any(
            a.state in on_the_way or (a.state is AxisState.LED and not self._mode_is_there(a, Mode.TORQUE))
            for a in self.axes
        )

    # --- commands -----------------------------------------------------------------------------------
    def _command(self, a: SupervisedAxis) -> float:
        """Set the controlword and the mode of an axis in the coming cycle; its torque."""
        rule, cycle = RULES[a.state], self._cycle
        cycle.waits_for_power_off[a.index] = a.state in SWITCHABLE and a.holding.rest_s is not None
        cycle.control[a.index] = self._controlword(a, rule.command)
        if a.state is not AxisState.ENABLING or self._takes_mode_now(a):
            self._ask_for_mode(a, rule.mode)
        if a.state is AxisState.UNHEARD:
            self._tell_by_sdo(a)
        if a.state is AxisState.LED:
            return a.torque
        if a.state is AxisState.STOPPING:
            return self._rest_torque(a)
        if a.state is AxisState.SLOWING:
            return a.within_limit(a.damping * a.speed)
        if a.state is AxisState.CATCHING and a.takes_torque:
            return a.catching_torque
        return a.support if a.holding.has_position_mode else 0.0

    def _controlword(self, a: SupervisedAxis, command: Command) -> int:
        match command:
            case Command.DISABLE:
                return states.DISABLE_VOLTAGE
            case Command.QUICK_STOP:
                return states.QUICK_STOP
            case Command.STAND_BY:
                late = a.seconds > STAND_BY_S and a.is_energised
                useless = a.is_cut or a.blind or a.brake_is_last or a.power_is_useless
                return states.DISABLE_VOLTAGE if late or useless else states.SWITCH_ON
            case Command.ENABLE:
                waits = not a.fresh or (a.state is AxisState.ENABLING and self._waits_for_mode(a))
                if a.fresh and a.drive is DriveState.QUICK_STOP_ACTIVE:
                    # one that stopped by itself goes on only from a command to stop
                    waits |= a.seconds < EDGE_CYCLES * a.cycle_s
                    return states.QUICK_STOP if waits else states.ENABLE_OPERATION
                word = self._cycle.control[a.index] if waits else states.towards_enabled(a.drive)
                a.asked += word == states.SHUTDOWN
                return word

    def _waits_for_mode(self, a: SupervisedAxis) -> bool:
        """Whether an axis goes no further before its drive has taken the mode it is to hold it in."""
        if not self._takes_mode_now(a):
            return False
        operation = self._operation(a, RULES[a.state].mode)
        return (
            operation is not None
            and not self._cycle.is_in(a.index, operation)
            and not (
                a.takes_mode is ModeSet.LATER
                and self._cycle.change_of(a.index) is not None
                and self._cycle.has_taken(a.index)
            )
        )

    def _rest_torque(self, a: SupervisedAxis) -> float:
        """Torque by which a led axis is brought to rest until its drive holds it."""
        loop = self.loops[a.index]
        if a.on_trial:
            return a.catching_torque
        a.is_damped = self.is_leaving and loop is not None
        if not self.is_leaving:
            return a.torque
        if loop is None:
            return a.support
        return a.within_limit(loop.torque - loop.damping * a.speed)

    def _tell_by_sdo(self, a: SupervisedAxis) -> None:
        if a.is_energised and self._cycle.is_free_for_sdo(a.index):
            self._link.nmt(NMT_PRE_OPERATIONAL, a.holding.config.node_id)  # NMT stopped, it would not answer
            self._cycle.set_object(a.index, od.CONTROLWORD, states.DISABLE_VOLTAGE)
