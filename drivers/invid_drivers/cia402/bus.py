"""The cell: every drive on one bus, exchanged with once per SYNC. Implements ``invid.sweep.ports.Cell``.

Raw ``struct`` in the cycle; SDO, maps and states before and after it. Whoever energises also stops:
``stop`` works from any state, any number of times, and never raises.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence
from functools import partial

import can

from invid.config import CellConfig
from invid.errors import BusError, ConfigError, DriveError, InvidError, SafetyStop
from invid.sweep.bounds import Bounds, bounds_of
from invid.sweep.motion import FADE_S
from invid.sweep.ports import Clock, Mode, Sample
from invid_drivers.cia402 import objects as od
from invid_drivers.cia402 import states
from invid_drivers.cia402.axis import Drive, DriveReport, ModeSet
from invid_drivers.cia402.cycle import Cycle
from invid_drivers.cia402.cycle_time import tell_cycle
from invid_drivers.cia402.disk import PATIENCE_S
from invid_drivers.cia402.journal import Journal
from invid_drivers.cia402.limits import tighten
from invid_drivers.cia402.link import HEARD_S, NMT_PRE_OPERATIONAL, NMT_START, Link, never
from invid_drivers.cia402.mode_change import CHANGE_S
from invid_drivers.cia402.standing.held_axes import HeldAxes
from invid_drivers.cia402.standing.holding import (
    AxisHolding,
    Reason,
)
from invid_drivers.cia402.standing.moving_cell import MovingCell
from invid_drivers.cia402.standing.stop_test import StopTest
from invid_drivers.cia402.standing.takeover import find_powered, require_mode, require_ours
from invid_drivers.cia402.standing.way_out import WAY_OUT_S, Loads, WayOut
from invid_drivers.cia402.states import DriveState, OperationMode, is_energised, state_of

RESTORE_S = 30.0
"""Longest restoring of all drives together: tenths of a second for each, ten for one that takes 0.2 s for an
answer. The rest is left to the next start, which finds it in the journal."""
LEAVING_S = 0.1
"""Longest wait on the way out for a setting that a loaded axis is better held with."""
LOOK_S = 0.35
"""At rest, before power: longer than the longest window in which a fall is seen (0.32 s), and than a drive
takes from showing a mode to being in it (0.1 s, one report)."""
LOOK_CYCLES = 600
"""Where the adapter is in doubt: 99 % are then bounded by the second worst."""
ENABLE_S = 3.0
"""Longest way to operation enabled: brakes take a few hundred milliseconds to open."""


STOPPED_S = FADE_S + HEARD_S + LEAVING_S + WAY_OUT_S + 2 * PATIENCE_S + RESTORE_S
"""From a request to stop to drives that are off or held, restored, and a bus that is free: longest, whatever
drives, disk and bus do."""


class Cia402Cell:
    """Drives of a cell on a python-can bus, which it owns from here on."""

    def __init__(self, bus: can.BusABC, config: CellConfig, *, journal: Journal | None = None) -> None:
        self._config = config
        self.link = self._link = Link(bus, heartbeat_s=config.safety.heartbeat_s)
        self.clock: Clock = self.link.clock
        self.journal = journal if journal is not None else Journal(None)
        self._drives = [Drive(self._link, a, self.journal, config) for a in config.axes]
        self.held = HeldAxes(self._drives, self.journal)
        """How each axis is held when nobody commands it."""
        self.axes = tuple(d.name for d in self._drives)
        """Names, in the order of every list."""
        self.reports: tuple[DriveReport, ...] = ()
        """What each drive said at ``check``, and what follows from that."""
        self.can_hold: tuple[bool, ...] = ()
        self.by_offset: tuple[bool, ...] = ()
        """Whether each axis is shaken by its torque offset while its drive goes on holding it."""
        self.resolution: tuple[float, ...] = ()
        """Position of one encoder count of each axis [rad or m]."""
        self.rated_torque: tuple[float, ...] = ()
        """[N·m or N]"""
        self._cycle = Cycle(self._link, config)
        self.jitter = self._cycle.jitter
        self.asked: Sequence[float] = self._cycle.asked
        """Torque that each axis in a torque mode was sent with the last SYNC [N·m or N]; the list stays."""
        self.touched = False
        """Whether the drives were prepared to be enabled."""
        self._late_share: tuple[float, float] | None = None
        self._stopped = True
        self.bounds: Bounds | None = None
        """What no cycle may pass, from before the first axis is enabled to the last one off."""
        self._torque_off: dict[int, float] = {}
        """What each drive showed as torque without voltage [N·m or N]."""
        self.held_at_end: tuple[str, ...] = ()
        """Axes that their drives hold in quick stop active."""
        self.complaints: list[str] = []
        """What could not be restored, in words."""
        self._closed = False
        self.not_off: tuple[str, ...] = ()
        """Axes that were not seen to switch off."""
        self.not_held: tuple[str, ...] = ()
        """Loaded axes that were not seen to stand after the stop, or whose brake was seen not to hold
        them."""
        self.cancelled: Callable[[], bool] = never
        """Asked in every wait until the way out: brakes and drives take their time, a stop must not."""
        self.tell: Callable[[str], None] = lambda phase: None
        """Hears what is being done on the way out, while it lasts."""

    # --- before motion -------------------------------------------------------------------------
    def check(self) -> tuple[DriveReport, ...]:
        """Restore what an earlier run left behind, then ask every drive what it can do. Moves nothing."""
        self._hear_stops()
        self._link.require_bus()
        for drive in self._drives:
            drive.refuse_declared()
        if not self._link.gate.listened:
            self._link.listen()
        self._link.refuse_others()
        powered, silent = find_powered(self._drives, self.held.memory)
        self._pre_operational()
        powered |= {d.name: s for d in silent if (s := d.quiet_state()) and is_energised(s)}
        left = [() if drive.left_alone else drive.restore() for drive in self._drives]
        try:
            self.reports = tuple(d.check(found) for d, found in zip(self._drives, left, strict=True))
        except DriveError as error:  # what was left as somebody set it is said once
            raise DriveError(". ".join([str(error), *(s for found in left for s in found)])) from None
        for drive in self._drives:
            self._refuse_owned(drive)
        self.held.find(self.reports, powered)
        self._link.refuse_others()
        self.can_hold = tuple(r.can_hold for r in self.reports)
        self.by_offset = tuple(r.by_offset for r in self.reports)
        self.resolution = tuple(r.scaling.position_per_count for r in self.reports)
        self.rated_torque = tuple(r.scaling.rated_torque for r in self.reports)
        for i, r in enumerate(self.reports):
            position = r.scaling.direction * r.scaling.position_per_count
            most = r.scaling.most_permille(r.limits.torque.value)
            self._cycle.scale(i, position=position, torque=r.scaling.torque(1), most=most)
        self.bounds = bounds_of(tighten(self._config, self.reports), self.resolution, self.rated_torque)
        return self.reports

    def _hear_stops(self) -> None:
        self._link.cancelled = lambda: self.cancelled()

    def _pre_operational(self) -> None:
        """But for drives under power: leaving operational may make one of them let go."""
        for drive in self._drives:
            if self._link.gate.may_let_go(drive.node_id):
                self._link.nmt(NMT_PRE_OPERATIONAL, drive.node_id)
        self._link.wait(0.02)

    @property
    def holdings(self) -> list[AxisHolding]:
        """How each axis is held when nobody commands it, from ``check`` on."""
        return self.held.holdings

    @property
    def not_ready(self) -> tuple[Reason, ...]:
        """Axes that are energised though nobody measures, or at which the last run ended; empty: none."""
        return self.held.not_ready

    @property
    def endings(self) -> tuple[str, ...]:
        """Axes energised after the stop, by what, and what to do; and loaded ones without torque."""
        return self.held.endings(self.held_at_end, self.not_off, self.not_held, self._cycle.sample)

    def clear(self, names: Sequence[str]) -> None:
        """A person has found the cause: these axes may be enabled again. Before ``check``."""
        self.held.clear(names)

    def suspect(self, error: BaseException) -> None:
        """The run ended at the axes of an error: remembered where any axis carries a load."""
        if self.touched and isinstance(error, InvidError):
            self.held.suspect(error.axes, error.reason)

    def _refuse_owned(self, drive: Drive) -> None:
        """BusError where a drive watches the heartbeat of a node that is there: it belongs to that master."""
        watched = drive.find(od.CONSUMER_HEARTBEAT) or 0
        producer = watched >> 16 & 0x7F
        if watched & 0xFFFF and any(f.node == producer for f in self._link.others.values()):
            raise BusError(
                f"axis {drive.name} (node {drive.node_id}): it watches the heartbeat of node {producer} "
                "(0x1016), which is on this bus: it belongs to that master. Switch that off, or clear 0x1016 "
                "if it is none",
                axis=drive.name,
            )

    @property
    def notes(self) -> tuple[str, ...]:
        """Who else is on the bus, and is left alone; what turned out when protection was written."""
        slaves = sorted({f.node for f in self._link.others.values() if f.node is not None})
        others = [f.text for f in self._link.others.values() if not f.master and f.node is None]
        said = [f"node {n} is on the bus too, is not in the config, and is left alone" for n in slaves]
        protection = (note for d in self._drives for note in d.protection.notes)
        holds = (s for h in self.holdings if (s := h.said(f"axis {h.config.name}")))
        return (
            *said,
            *(f"{text} are on the bus too" for text in others),
            *protection,
            *holds,
        )

    def energise(self, modes: Sequence[Mode]) -> None:
        """Protect, map, start and enable every drive at rest where it stands."""
        if not self.reports:
            self.check()
        self._hear_stops()
        for reason in self.not_ready:
            if reason.code == "axis_suspect":
                raise DriveError(f"{reason.text}; {reason.fix}")
        for drive, holding in zip(self._drives, self.holdings, strict=True):
            if is_energised(holding.state):
                require_ours(drive, holding)
        for drive in self._drives:
            self._link.gate.take(drive.node_id)
            self._link.peers[drive.node_id].booted = False
        self._stopped = False
        self.touched = True
        self._link.beating = True
        self._pre_operational()
        for drive, report, holding in zip(self._drives, self.reports, self.holdings, strict=True):
            drive.protection.quick_stop_option = holding.first_option
            drive.protect(report)
            if not holding.taken_over:
                drive.map_pdos()
                tell_cycle(drive, self._config.bus.cycle_s)
        self.held.foresee_options()
        unset: list[ModeSet] = []
        for i, mode in enumerate(modes):
            self._now_in(i, mode)
        for i, (drive, report, mode) in enumerate(zip(self._drives, self.reports, modes, strict=True)):
            drive.command(od.TORQUE_OFFSET if drive.by_offset else od.TARGET_TORQUE, 0)
            if mode is Mode.HOLD or drive.by_offset:
                drive.command(od.TARGET_POSITION, drive.read(od.POSITION))
            operation = self._operation_mode(report, mode)
            set_by_now = drive.set_mode(operation, CHANGE_S)
            if set_by_now is ModeSet.LATER and self.holdings[i].taken_over:
                set_by_now = require_mode(drive, operation)
            unset.append(set_by_now)
        self._refuse_disturbed()
        self.held.note_begin()
        self._link.events.clear()
        self._link.refuse_others()
        for peer in self._link.peers.values():
            peer.last_heartbeat = None
        for drive in self._drives:
            self._link.nmt(NMT_START, drive.node_id)
        self._link.wait(0.005)
        self._cycle.restart_slots()
        self._cycle.support[:] = [0.0] * len(self._drives)
        self.held.memory.defer()  # from here on no cycle waits for a disk
        self._watch.resting = {i for i, mode in enumerate(modes) if mode is Mode.HOLD}
        self._look_first()
        self._enable(modes, unset)

    def _look_first(self) -> None:
        """See every axis at rest before the first is enabled; a mode that is shown has begun to act by
        then."""
        self._cycle.control[:] = [
            states.QUICK_STOP if h.taken_over else states.DISABLE_VOLTAGE for h in self.holdings
        ]
        cycle = self._config.bus.cycle_s
        asked = self._late_share is not None
        late, count = [0] * len(self._drives), 0
        end = self.clock.now() + (max(LOOK_S, LOOK_CYCLES * cycle) if asked else LOOK_S)
        self._cycle.apart = asked
        try:
            while self.clock.now() < end and not self.cancelled():
                sample = self._watched([0.0] * len(self._drives))
                count += 1
                late = [n + (not came) for n, came in zip(late, sample.fresh, strict=True)]
                if self._watch.origin is None and all(sample.fresh):
                    self._watch.start(sample.position)
        finally:
            self._cycle.apart = False  # on the way out no SYNC waits
        if self._late_share is not None and max(late) > self._late_share[0] * count:
            names = ", ".join(name for name, n in zip(self.axes, late, strict=True) if n == max(late))
            raise ConfigError(
                f"bus: cycle_s is {cycle:g}, and of {count} answers to SYNC without power {max(late)} "
                f"of axis {names} "
                f"came too late or not at all; set bus.cycle_s to {self._late_share[1]:g} or longer"
            )

    def expect_answers(self, share: float, cycle_s: float) -> None:
        """Refuse to enable drives of whose answers to SYNC more than a share comes too late; the cycle that
        would do."""
        self._late_share = share, cycle_s

    def _refuse_disturbed(self) -> None:
        """Raise DriveError where a drive restarted or reported an error while it was prepared."""
        restarted = [p.name for p in self._link.peers.values() if p.booted]
        if restarted:
            raise DriveError(
                f"axis {', '.join(restarted)} has restarted while its protection was written, and may have "
                "lost it; look at its supply, then start again",
                axes=restarted,
            )
        for peer in self._link.peers.values():
            for code in peer.own_errors(since=peer.recovered):
                raise DriveError(
                    f"axis {peer.name} reported error 0x{code:04X} before it was enabled; find out why, then "
                    "start again",
                    axis=peer.name,
                )

    def _operation_mode(self, report: DriveReport, mode: Mode) -> OperationMode:
        return report.torque_mode if mode is Mode.TORQUE else OperationMode.CYCLIC_POSITION

    def _now_in(self, axis: int, mode: Mode) -> None:
        self._cycle.modes[axis] = mode
        self._cycle.operation[axis] = self._operation_mode(self.reports[axis], mode)

    def _enable(self, modes: Sequence[Mode], unset: list[ModeSet]) -> None:
        """To operation enabled; ``unset``: what came of each mode, which is set and seen on the way."""
        zero = [0.0] * len(self._drives)
        end = self.clock.now() + ENABLE_S
        self._cycle.control[:] = [
            states.QUICK_STOP if h.taken_over else states.DISABLE_VOLTAGE for h in self.holdings
        ]
        while True:
            sample = self._watched(zero)
            found = [state_of(s) for s in sample.status]
            if self._watch.origin is None and all(sample.fresh):
                self._watch.start(sample.position)  # nothing was enabled before that
            for i, state in enumerate(found):
                if sample.fresh[i] and not is_energised(state):
                    self._torque_off[i] = sample.torque[i]
            enabled = all(sample.fresh) and all(s is DriveState.OPERATION_ENABLED for s in found)
            if enabled and not self.changing and all(m is ModeSet.SHOWN for m in unset):
                return
            for i, state in enumerate(found):
                if sample.fresh[i] and self._watch.origin is not None:
                    if not self._mode_follows(i, state, modes[i], unset):
                        continue
                    resumes = self.holdings[i].taken_over and state is DriveState.QUICK_STOP_ACTIVE
                    self._cycle.control[i] = (
                        states.ENABLE_OPERATION if resumes else states.towards_enabled(state)
                    )
            if self.cancelled():
                raise SafetyStop(
                    "stopped on request while the drives were being enabled; nothing was recorded yet"
                )
            late = self.clock.now() - end
            if late >= (CHANGE_S if enabled else 0.0):  # a mode that is asked for in the cycle takes its time
                missing = [
                    i
                    for i, state in enumerate(found)
                    if not sample.fresh[i] or state is not DriveState.OPERATION_ENABLED
                ]
                raise self._not_enabled(missing, sample, unset)

    def _not_enabled(self, missing: Sequence[int], sample: Sample, unset: Sequence[ModeSet]) -> DriveError:
        """The error of the first axis that is not enabled, or else has no mode yet."""
        i = next(iter(missing), next((k for k, m in enumerate(unset) if m is not ModeSet.SHOWN), 0))
        seen = state_of(sample.status[i]).words if sample.fresh[i] else "silence (no TPDO comes)"
        what = f"not enabled after {ENABLE_S:g} s, the drive shows {seen}"
        if not missing:
            what = f"enabled, but without its mode (0x6060) after {ENABLE_S + CHANGE_S:g} s"
        return DriveError(
            f"axis {self.axes[i]} (node {self._drives[i].node_id}): {what}; check its supply, its enable "
            "input, safe torque off and the brake",
            axis=self.axes[i],
        )

    def _mode_follows(self, axis: int, state: DriveState, mode: Mode, unset: list[ModeSet]) -> bool:
        """Ask for a mode that was not set without power, where the drive takes it; whether to go on."""
        late = unset[axis]
        due = {ModeSet.LATER: DriveState.SWITCHED_ON, ModeSet.TAKEN: DriveState.OPERATION_ENABLED}.get(late)
        if state is due:
            operation = self._operation_mode(self.reports[axis], mode)
            self._cycle.change(axis, mode, operation, taken=late is ModeSet.TAKEN)
            unset[axis] = ModeSet.SHOWN  # or the change ends the run
        return self._cycle.has_taken(axis)

    def secure(self, loaded: Sequence[bool]) -> bool:
        """Axes that carry nothing may switch off after a stop, others are tested: whether any was."""
        self._watch.pause()  # whoever made the cycles before may have watched them otherwise
        self._watch.resting = set()  # the tests let axes go
        self.held.settle(loaded, self._cycle.permille)
        self.held.refuse_dead_displays(self._cycle.sample, self._torque_off, self.reports)
        self.held.set_options(self._cycle, self.clock, self._watched)
        permitted = [limit.velocity for limit in self._watch.limits]
        for i in range(len(self._drives)):
            self._watch.permit(i, math.inf)  # a fall in the tests is none of what was planned
        try:
            test = StopTest(self._moving(self._watched), self.holdings, self.held.memory, self.cancelled)
            return test.run()
        finally:
            self._cycle.rest_s[:] = [h.rest_s for h in self.holdings]
            for i, velocity in enumerate(permitted):
                self._watch.permit(i, velocity)

    def _moving(self, exchange: Callable[[Sequence[float]], Sample]) -> MovingCell:
        return MovingCell(
            self._config,
            self._link,
            self._drives,
            self._cycle,
            exchange,
            self.resolution,
            self.rated_torque,
            [r.torque_mode for r in self.reports],
            self.tell,
        )

    @property
    def _watch(self) -> Bounds:
        if self.bounds is None:
            raise DriveError("the cell was not checked: nothing is known of its drives")
        return self.bounds

    def set_modes(self, modes: Sequence[Mode]) -> None:
        """Ask for other modes while energised; the change goes on in the cycles to come (``changing``).

        An axis that is to be held keeps the place at which it is asked; torque for every axis that changes is
        taken from ``exchange`` meanwhile.
        """
        for i, (report, mode) in enumerate(zip(self.reports, modes, strict=True)):
            operation = self._operation_mode(report, mode)
            if operation is not self._cycle.operation[i]:
                self._cycle.change(i, mode, operation)
            elif report.by_offset:
                self._cycle.modes[i] = mode  # its mode stays; what changes is whether it is sent torque

    @property
    def changing(self) -> bool:
        """Whether a drive does not show yet the mode that it was asked for."""
        return self._cycle.changing

    # --- the cycle -----------------------------------------------------------------------------
    def exchange(self, torque: Sequence[float]) -> Sample:
        """Targets out, SYNC at its slot, samples in."""
        return self._cycle.exchange(torque)

    def _watched(self, torque: Sequence[float]) -> Sample:
        """A cycle that the cell makes by itself: checked as the sweep checks those that it makes."""
        sample = self.exchange(torque)
        if self._cycle.paused:
            self._watch.pause()
            self._cycle.paused = False
        self._watch.check(sample, self.asked)
        return sample

    # --- the way out ---------------------------------------------------------------------------
    def stop(self) -> None:
        """Quick stop, disable voltage, NMT stop; idempotent, from any state, never raises.

        Where it is interrupted itself (a second Ctrl-C), the next call begins again.
        """
        self._link.cancelled = never
        if self._stopped:
            return
        falls = {} if self.bounds is None else self.bounds.falls
        with contextlib.suppress(Exception):
            if self.held.weigh_at_once(self._cycle.sample, self.rated_torque, self._cycle.modes, falls):
                self.held.set_options(self._cycle, self.clock, self.exchange, LEAVING_S)
        weigh = partial(self.held.weigh_in_quick_stop, self._config, self.rated_torque)
        loads = Loads(
            [h.stays for h in self.holdings],
            {
                i
                for i, h in enumerate(self.holdings)
                if h.loaded is not False and h.config.brake == "drive" and not h.stays
            },
            self.held.doubted,
            {i for i, h in enumerate(self.holdings) if h.has_position_mode},
            falls,
            set() if self.bounds is None else self.bounds.blind,
            {i: h.seen.brake_s for i, h in enumerate(self.holdings) if h.seen.brake_s is not None},
            {i: h.seen.brake_drop for i, h in enumerate(self.holdings) if h.seen.brake_drop is not None},
            {} if self.bounds is None else self.bounds.weights,
        )
        way = WayOut(self._moving(self.exchange), loads, self._ramp_s, weigh)
        self.not_off = way.take()
        for i in way.too_heavy:
            self.held.too_heavy(i, self.holdings[i].limit + 1)
        self.held_at_end = tuple(
            h.config.name
            for i, h in enumerate(self.holdings)
            if (h.stays or i in way.caught)
            and h.config.name not in self.not_off
            and not self._is_surely_off(i)
        )
        self.not_held = tuple(self.axes[i] for i in sorted(way.unheld | way.failed_brakes))
        for i in way.failed_brakes:
            self.holdings[i].note(self.held.memory, brake_drop=self.holdings[i].config.limits.position)
            self.holdings[i].brake_failed = i in way.caught and i not in way.unheld
        self.held.note_end(self.held_at_end, self.not_off)
        self._link.until = math.inf
        self._stopped = True

    def _is_surely_off(self, axis: int) -> bool:
        """By its last TPDO; where that did not come, it is asked."""
        sample = self._cycle.sample
        state = state_of(sample.status[axis]) if sample.fresh[axis] else self._drives[axis].quiet_state()
        return state is not None and not is_energised(state)

    @property
    def _ramp_s(self) -> float:
        """Longest quick stop from a velocity limit, by what the drives say of their ramps."""
        return max(
            (
                a.limits.velocity / r.stopping.deceleration
                for a, r in zip(self._config.axes, self.reports, strict=False)
                if r.stopping.deceleration
            ),
            default=0.0,
        )

    def states(self) -> dict[str, DriveState]:
        """The last state heard of each drive."""
        return {d.name: state_of(s) for d, s in zip(self._drives, self._cycle.sample.status, strict=True)}

    def close(self) -> list[str]:
        """Stop, restore every object that was written, close the bus; what could not be restored.

        Once closed, or where it is interrupted, ``complaints`` has what was found by then.
        """
        complaints = self.complaints
        self.stop()
        if self._closed:
            return complaints
        try:
            for disk in (self.journal, self.held.memory):
                try:
                    disk.settle()
                except BusError as error:
                    complaints.append(str(error))
                    disk.defer()
            self._link.until = self.clock.now() + RESTORE_S
            if self.touched or self.journal.entries:
                self._restore(complaints)
        except InvidError as error:
            complaints.append(str(error))
        finally:
            self._closed = True
            self._link.beating = False
            self._link.close()
            self.journal.release()
        return complaints

    @property
    def left(self) -> tuple[str, ...]:
        """What is known of the axes after the stop, and what could not be restored, as sentences."""
        not_off = [
            f"axis {', '.join(self.not_off)} was not seen to switch off (its heartbeat watch should stop "
            "it): make sure of it, with the emergency stop if need be"
        ]
        return tuple(dict.fromkeys((*(not_off if self.not_off else ()), *self.endings, *self.complaints)))

    def _restore(self, complaints: list[str]) -> None:
        on = self._perhaps_on(complaints)
        on |= {d.name for d in self._drives if not self._link.gate.may_let_go(d.node_id)}
        for drive in self._drives:
            if drive.name not in on:
                self._link.nmt(NMT_PRE_OPERATIONAL, drive.node_id)
        self._link.wait(0.02)
        suspects = {h.config.name for h in self.holdings if h.seen.suspect}
        for drive in self._drives:
            if drive.name in on | suspects:
                continue
            said: tuple[str, ...] = ()
            if not self._is_late:
                try:
                    said = drive.restore()
                except InvidError as error:
                    said = (str(error),)
            if self._is_late:
                said = (
                    f"axis {drive.name}: its settings were not restored within {RESTORE_S:g} s; the next "
                    "start restores them",
                )
            complaints += said

    @property
    def _is_late(self) -> bool:
        return self.clock.now() >= self._link.until

    def _perhaps_on(self, complaints: list[str]) -> set[str]:
        """Axes that keep their heartbeat watch and limits until the next start, because they may be on."""
        complaints += self.endings
        for name in self.not_off:
            complaints.append(
                f"axis {name} was not seen to switch off; its objects, its heartbeat watch among them, stay "
                "as they are until the next start"
            )
        return {*self.held_at_end, *self.not_off}
