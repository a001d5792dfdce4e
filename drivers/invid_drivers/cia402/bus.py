"""The cell: every drive on one bus. Implements ``invid.sweep.ports.Cell``.

SDO, maps and states before power; from then on every cycle is the supervisor's. Whoever energises also
stops: ``stop`` works from any state, any number of times, and never raises.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence

import can

from invid.config import CellConfig
from invid.errors import BusError, ConfigError, DriveError, InvidError, SafetyStop
from invid.sweep.bounds import Bounds, bounds_of
from invid.sweep.motion import FADE_S
from invid.sweep.ports import Clock, Loop, Mode, Procedure, Sample, T, Want, Wish
from invid.wording.sentence import joined, sentence
from invid_drivers.cia402 import objects as od
from invid_drivers.cia402 import procedures
from invid_drivers.cia402.axis import Drive, DriveReport, ModeSet
from invid_drivers.cia402.axis_state import LONGEST_RAMP_S, QUICK_STOP_S, AxisState, longest_way_out
from invid_drivers.cia402.cycle import Cycle
from invid_drivers.cia402.cycle_requests import CHANGE_S
from invid_drivers.cia402.cycle_time import tell_cycle
from invid_drivers.cia402.journal import Journal
from invid_drivers.cia402.limits import tighten
from invid_drivers.cia402.link import HEARD_S, NMT_PRE_OPERATIONAL, NMT_START, NMT_STOP, Link, never
from invid_drivers.cia402.standing.held_axes import HeldAxes
from invid_drivers.cia402.standing.takeover import find_powered, require_mapped, require_mode, require_ours
from invid_drivers.cia402.state_folder import PATIENCE_S
from invid_drivers.cia402.states import OperationMode, is_energised
from invid_drivers.cia402.supervised_axis import SupervisedAxis
from invid_drivers.cia402.supervisor import STOPPING, Supervisor

ENABLING = sentence("stopped on request while the drives were being enabled")
RAMP_MARGIN = 1.25
"""On the time of a ramp from the speed limit: the axis may be faster, the drive settles at its end."""
RESTORE_S = 30.0
"""Longest restoring of all drives together: tenths of a second for each, ten for one that takes 0.2 s for an
answer. The rest is left to the next start, which finds it in the journal."""
LEAVING_S = 0.1
"""Longest wait on the way out for a setting that a loaded axis is better held with."""
STOPPED_S = FADE_S + HEARD_S + LEAVING_S + longest_way_out() + 2 * PATIENCE_S + RESTORE_S + procedures.AFTER_S
"""From a request to stop to drives that are off or held, restored, and a bus that is free: longest, whatever
drives, disk and bus do."""


class Cia402Cell:
    """Drives of a cell on a python-can bus, which it owns from here on."""

    def __init__(self, bus: can.BusABC, config: CellConfig, *, journal: Journal | None = None) -> None:
        self._config = config
        self.link = self._link = Link(bus, heartbeat_s=config.safety.heartbeat_s)
        self.clock: Clock = self.link.clock
        self.journal = journal if journal is not None else Journal(None)
        self.drives = [Drive(self._link, a, self.journal, config) for a in config.axes]
        self.held = HeldAxes(self.drives, self.journal)
        """How each axis is held when nobody commands it."""
        self.axes = tuple(d.name for d in self.drives)
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
        self._supervisor: Supervisor | None = None
        self._stopped = True
        self.bounds: Bounds | None = None
        """What no cycle may pass, from before the first axis is enabled to the last one off."""
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
        self.seen: Callable[[dict[str, str]], None] = lambda states: None
        """Hears the states of all axes, in words, whenever one changes."""
        self.tell: Callable[[str], None] = lambda phase: None
        """Hears what is being done on the way out, while it lasts."""

    # --- before motion -------------------------------------------------------------------------
    def check(self) -> tuple[DriveReport, ...]:
        """Restore what an earlier run left behind, then ask every drive what it can do. Moves nothing."""
        self._link.cancelled = lambda: self.cancelled()
        self._link.require_bus()
        for drive in self.drives:
            drive.refuse_declared()
        self.listen()
        powered, silent = find_powered(self.drives, self.held.memory)
        self._pre_operational()
        powered |= {d.name: s for d in silent if (s := d.quiet_state()) and is_energised(s)}
        left = [() if drive.left_alone else drive.restore() for drive in self.drives]
        try:
            self.reports = tuple(d.check(found) for d, found in zip(self.drives, left, strict=True))
        except DriveError as error:  # what was left as somebody set it is said once
            raise DriveError(joined([str(error), *(s for found in left for s in found)], ". ")) from None
        for drive in self.drives:
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
            span = self.drives[i].counts_of_circle()
            self._cycle.scale(i, position=position, torque=r.scaling.torque(1), most=most, span=span)
        self.bounds = bounds_of(tighten(self._config, self.reports), self.resolution, self.rated_torque)
        return self.reports

    def listen(self) -> None:
        """Hear who else is on the bus, once; BusError where another master is."""
        if not self._link.gate.listened:
            self._link.listen()
        self._link.refuse_others()

    def _pre_operational(self) -> None:
        """But for drives under power: leaving operational may make one of them let go."""
        for drive in self.drives:
            if self._link.gate.may_let_go(drive.node_id):
                self._link.nmt(NMT_PRE_OPERATIONAL, drive.node_id)
        self._link.wait(0.02)

    @property
    def endings(self) -> tuple[str, ...]:
        """Axes energised after the stop, by what, and what to do; and loaded ones without torque."""
        axes = () if self._supervisor is None else self._supervisor.axes
        unseen = [a.name for a in axes if a.is_unseen()]
        return self.held.endings(self.held_at_end, unseen, self.not_held, self._cycle.sample)

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
                sentence(
                    "axis {axis} (node {node_id}): it watches the heartbeat of node {producer} "
                    "(0x1016), which is on this bus: it belongs to that master. Switch that off, or "
                    "clear 0x1016 if it is none",
                    axis=drive.name,
                    node_id=drive.node_id,
                    producer=producer,
                ),
                axis=drive.name,
            )

    @property
    def notes(self) -> tuple[str, ...]:
        """Who else is on the bus, and is left alone; what turned out when protection was written."""
        others = self._link.others.values()
        slaves = sorted({f.node for f in others if f.node is not None})
        return (
            *(f"node {n} is on the bus too, is not in the config, and is left alone" for n in slaves),
            *(f"{f.text} are on the bus too" for f in others if not f.master and f.node is None),
            *(note for d in self.drives for note in d.protection.notes),
            *(s for h in self.held.holdings if (s := h.said(f"axis {h.config.name}"))),
        )

    def energise(self, modes: Sequence[Mode]) -> Procedure[None]:
        """Protect, map, start and enable every drive at rest where it stands."""
        if not self.reports:
            self.check()
        self._link.cancelled = lambda: self.cancelled()
        if any(reason.code == "axis_suspect" for reason in self.held.not_ready):
            raise DriveError(joined([s for r in self.held.not_ready for s in r.sentences], ". "))
        for drive, holding in zip(self.drives, self.held.holdings, strict=True):
            if is_energised(holding.state):
                require_ours(drive, holding)
            elif drive.node_id in {h.config.node_id for h in self.held.holdings if h.taken_over}:
                require_mapped(drive)
        for drive in self.drives:
            self._link.gate.take(drive.node_id)
            self._link.peers[drive.node_id].booted = False
        self._stopped = False
        self.touched = True
        self._supervisor = self._supervise()
        self._link.beating = True
        self._pre_operational()
        rows = zip(self.drives, self.reports, self.held.holdings, strict=True)
        under_power = {h.config.node_id for h in self.held.holdings if h.taken_over}
        for drive, report, holding in sorted(rows, key=lambda row: row[0].of_node.number):
            drive.protection.quick_stop_option = holding.first_option
            drive.protect(report)
            if drive.node_id not in under_power:
                drive.map_pdos()
                tell_cycle(drive, self._config.bus.cycle_s)
        for axis, mode in zip(self._supervisor.axes, modes, strict=True):
            self._set_first_mode(axis, mode)
        self._refuse_disturbed()
        self.held.note_begin()
        self._link.events.clear()
        self._link.refuse_others()
        for peer in self._link.peers.values():
            peer.last_heartbeat = None
        for drive in self.drives:
            self._link.nmt(NMT_START, drive.node_id)
        self._link.wait(0.005)
        self._cycle.restart_slots()
        self.held.memory.file.defer()  # from here on no cycle waits for a disk
        self._watch.resting = {i for i, mode in enumerate(modes) if mode is Mode.HOLD}
        yield from self._look_first()
        yield from self._unless_asked(procedures.enable(self._stage), ENABLING)
        self._watch.resting = set()

    def _supervise(self) -> Supervisor:
        cycle = self._config.bus.cycle_s
        ramps_s = [
            RAMP_MARGIN * a.limits.velocity / r.stopping.deceleration
            for a, r in zip(self._config.axes, self.reports, strict=False)
            if r.stopping.deceleration
        ]
        quick_stop = min(max([QUICK_STOP_S, *ramps_s]), LONGEST_RAMP_S)
        axes = [
            SupervisedAxis(i, holding, self._watch.estimators[i], report.torque_mode, cycle, quick_stop)
            for i, (holding, report) in enumerate(zip(self.held.holdings, self.reports, strict=True))
        ]
        for axis in axes:
            if axis.holding.taken_over:
                axis.state = AxisState.STANDS
        supervisor = Supervisor(self._cycle, self._link, self._watch, axes)
        supervisor.changed = lambda: self.seen(self.axis_states)
        supervisor.tell = lambda phase: self.tell(phase)
        supervisor.note = lambda axis, **seen: axis.holding.note(self.held.memory, **seen)
        return supervisor

    def _set_first_mode(self, axis: SupervisedAxis, mode: Mode) -> None:
        """Set the mode of an axis without power, and its targets to where it stands."""
        drive, report = self.drives[axis.index], self.reports[axis.index]
        drive.command(od.TORQUE_OFFSET if drive.by_offset else od.TARGET_TORQUE, 0)
        if mode is Mode.HOLD or drive.by_offset:
            drive.command(od.TARGET_POSITION, drive.read(od.POSITION))
        operation = report.torque_mode if mode is Mode.TORQUE else OperationMode.CYCLIC_POSITION
        axis.target = AxisState.LED if mode is Mode.TORQUE else AxisState.HELD
        axis.takes_mode = drive.set_mode(operation, CHANGE_S)
        if axis.takes_mode is ModeSet.LATER and axis.holding.taken_over:
            axis.takes_mode = require_mode(drive, operation)
        if axis.takes_mode is ModeSet.SHOWN:
            self._cycle.operation[axis.index] = operation

    @property
    def _stage(self) -> procedures.Stage:
        supervisor = self._supervised
        return procedures.Stage(
            supervisor.axes,
            self.clock.now,
            supervisor.mute,
            supervisor.speak,
            lambda: supervisor.is_mute,
            supervisor.note,
        )

    def _unless_asked(self, procedure: Procedure[None], asked: str) -> Procedure[None]:
        """The same, ended by a request to stop, which is heard in every cycle."""
        for wish in procedure:
            yield wish
            if self.cancelled():
                raise SafetyStop(sentence("{asked}; nothing was recorded yet", asked=asked), code="asked")

    @property
    def _supervised(self) -> Supervisor:
        if self._supervisor is None:
            raise DriveError(sentence("the cell was not energised: no axis is supervised"))
        return self._supervisor

    def _look_first(self) -> Procedure[None]:
        """See every axis at rest before the first is enabled; a mode that is shown has begun to act by
        then."""
        cycle = self._config.bus.cycle_s
        asked = self._late_share is not None
        seconds = max(procedures.LOOK_S, procedures.LOOK_CYCLES * cycle) if asked else procedures.LOOK_S
        answers = procedures.Answers([0] * len(self.drives))
        self._cycle.apart = asked
        try:
            yield from self._unless_asked(procedures.look(self._stage, seconds, answers), ENABLING)
        finally:
            self._cycle.apart = False  # on the way out no SYNC waits
        sample = self._cycle.sample
        count = answers.cycles
        late = [count - n for n in answers.came]
        if self._late_share is not None and max(late) > self._late_share[0] * count:
            names = ", ".join(name for name, n in zip(self.axes, late, strict=True) if n == max(late))
            raise ConfigError(
                sentence(
                    "bus: cycle_s is {cycle:g}, and of {count} answers to SYNC without power {most} of "
                    "axis {axis} came too late or not at all; set bus.cycle_s to {late_share:g} or "
                    "longer",
                    cycle=cycle,
                    count=count,
                    most=max(late),
                    axis=names,
                    late_share=self._late_share[1],
                )
            )
        silent = [d.name for d, n in zip(self.drives, answers.came, strict=True) if not n]
        if silent:
            raise DriveError(
                sentence(
                    "axis {axis}: silence (no TPDO comes) after {seconds:.2g} s of SYNC; check its "
                    "supply and its PDOs",
                    axis=", ".join(silent),
                    seconds=seconds,
                ),
                axes=silent,
            )
        self._watch.start(sample.position)

    def expect_answers(self, share: float, cycle_s: float) -> None:
        """Refuse to enable drives of whose answers to SYNC more than a share comes too late; the cycle that
        would do."""
        self._late_share = share, cycle_s

    def _refuse_disturbed(self) -> None:
        """Raise DriveError where a drive restarted or reported an error while it was prepared."""
        restarted = [p.name for p in self._link.peers.values() if p.booted]
        if restarted:
            raise DriveError(
                sentence(
                    "axis {axis} has restarted while its protection was written, and may have lost it; "
                    "look at its supply, then start again",
                    axis=", ".join(restarted),
                ),
                axes=restarted,
            )
        for peer in self._link.peers.values():
            for code in peer.own_errors(since=peer.recovered):
                raise DriveError(
                    sentence(
                        "axis {axis} reported error 0x{code:04X} before it was enabled; find out why, then "
                        "start again",
                        axis=peer.name,
                        code=code,
                    ),
                    axis=peer.name,
                )

    def secure(self, loaded: Sequence[bool]) -> Procedure[bool]:
        """Take over what carries a load, and see how each axis is held when nobody commands it.

        Whether axes were let go or stopped for it: they are held again, perhaps in another place.
        """
        supervisor = self._supervised
        self._watch.pause()  # whoever made the cycles before may have watched them otherwise
        self._watch.resting = set()  # the tests let axes go
        self.held.settle(loaded, self._cycle.permille)
        off = {a.index: a.torque_off for a in supervisor.axes if a.torque_off is not None}
        self.held.refuse_dead_displays(self._cycle.sample, off, self.reports)
        yield from self._set_options(CHANGE_S)
        permitted = [limit.velocity for limit in self._watch.limits]
        for i in range(len(self.drives)):
            self._watch.permit(i, math.inf)  # a fall in the tests is none of what was planned
        before = [len(a.story) for a in supervisor.axes]
        try:
            test = procedures.test_stops(self._stage, 3 * self._config.safety.heartbeat_s)
            yield from self._unless_asked(test, sentence("stopped on request in the stop test"))
        finally:
            for i, velocity in enumerate(permitted):
                self._watch.permit(i, velocity)
        return before != [len(a.story) for a in supervisor.axes]

    def _set_options(self, longest_s: float) -> Procedure[None]:
        """Write 0x605A of drives that turned out to have to hold a load, between two SYNCs."""
        if not self.held.set_options(self._cycle):
            return
        end = self.clock.now() + longest_s
        while self._cycle.is_changing and self.clock.now() < end:
            yield self._stage.everyone(Want.STAY)

    @property
    def _watch(self) -> Bounds:
        if self.bounds is None:
            raise DriveError(sentence("the cell was not checked: nothing is known of its drives"))
        return self.bounds

    def set_loops(self, loops: Sequence[Loop | None]) -> None:
        """Loops by which led axes are brought to rest when the run ends."""
        self._supervised.loops = list(loops)

    @property
    def changing(self) -> bool:
        """Whether a drive does not show yet the mode that was wished for; its torque acts meanwhile."""
        return self._supervisor is not None and self._supervisor.is_changing

    # --- the cycle -----------------------------------------------------------------------------
    def run(self, procedure: Procedure[T]) -> T:
        """What a procedure returns: the one loop, a cycle for each of its wishes. What must stop the motion
        ends the procedure, too."""
        with contextlib.closing(procedure):
            try:
                wish = next(procedure)
                while True:
                    wish = procedure.send(self.tick(wish))
            except StopIteration as end:
                result: T = end.value
                return result

    def tick(self, wish: Wish) -> Sample:
        """One cycle of the supervisor."""
        return self._supervised.tick(wish)

    # --- the way out ---------------------------------------------------------------------------
    def stop(self) -> None:
        """Every axis to rest, held or off; idempotent, from any state, never raises.

        Where it is interrupted itself (a second Ctrl-C), the next call begins again.
        """
        self._link.cancelled = never
        supervisor = self._supervisor
        if self._stopped or supervisor is None:
            return
        supervisor.is_leaving = True
        with contextlib.suppress(Exception):
            supervisor.speak()  # it may have been silent on purpose
        with contextlib.suppress(Exception):  # whoever listens may have gone
            self.tell(STOPPING)
        self._weigh_at_once(supervisor)
        way_out = procedures.leave(self._stage, longest_way_out(), self.held.doubted)
        self._leave_by(way_out)
        self._note_ends(supervisor)
        off = (AxisState.OFF, AxisState.BRAKED, AxisState.FAULT, AxisState.UNHEARD)
        kept = {a.holding.config.node_id for a in supervisor.axes if a.state not in off}
        for a in supervisor.axes:
            if a.holding.config.node_id not in kept:
                with contextlib.suppress(BusError):
                    self._link.nmt(NMT_STOP, a.holding.config.node_id)
        self._link.until = math.inf
        self._stopped = True

    def _leave_by(self, procedure: Procedure[None]) -> None:
        """Run a part of the way out, whatever fails in a cycle of it."""
        for wish in procedure:
            try:
                self.tick(wish)
            except (
                Exception
            ):  # a queue that is full has room again; a fault of this program ends nothing here
                with contextlib.suppress(Exception):
                    self._link.wait(self._config.bus.cycle_s)

    @property
    def axis_states(self) -> dict[str, str]:
        """The state of every axis that was supervised, in words."""
        return {} if self._supervisor is None else {a.name: a.state.value for a in self._supervisor.axes}

    def _weigh_at_once(self, supervisor: Supervisor) -> None:
        held = [a.state in (AxisState.ENABLING, AxisState.HELD) for a in supervisor.axes]
        falls = {} if self.bounds is None else self.bounds.falls
        with contextlib.suppress(Exception):
            self.held.weigh_at_once(self._cycle.sample, self.rated_torque, held, falls)
            self._leave_by(self._set_options(LEAVING_S))

    def _note_ends(self, supervisor: Supervisor) -> None:
        """What is said at the end is read from the states."""
        axes = supervisor.axes
        for a in axes:
            if a.too_heavy:
                self.held.too_heavy(a.index, a.holding.limit + 1)
            if a.brake_failed:
                a.holding.note(self.held.memory, brake_drop=a.holding.config.limits.position)
                a.holding.brake_failed = a.state is AxisState.STANDS
        self.not_off = tuple(a.name for a in axes if a.deaf or not a.is_final or a.may_be_on)
        on = [a for a in axes if a.is_energised and a.name not in self.not_off]
        self.held_at_end = tuple(a.name for a in on)
        self.not_held = tuple(a.name for a in axes if a.was_let_go)
        self.held.note_end(self.held_at_end, self.not_off)

    def close(self) -> list[str]:
        """Stop, restore every object that was written, look at what is left held, close the bus; what could
        not be restored.

        Once closed, or where it is interrupted, ``complaints`` has what was found by then.
        """
        complaints = self.complaints
        self.stop()
        if self._closed:
            return complaints
        try:
            if self.held_at_end:
                self._link.attend = lambda: self.tick(self._stage.everyone(Want.END))
            for file in (self.journal.file, self.held.memory.file):
                try:
                    file.settle()
                except BusError as error:
                    complaints.append(str(error))
                    file.defer()
            self._link.until = self.clock.now() + RESTORE_S
            if self.touched or self.journal.entries:
                self._restore(complaints)
            self._look_after()
        except InvidError as error:
            complaints.append(str(error))
        finally:
            self._closed = True
            self._link.attend = None
            self._link.beating = False
            self._link.close()
            self.journal.release()
        complaints += [said for said in self.endings if said not in complaints]
        return complaints

    def _look_after(self) -> None:
        """See what is left held without its master, and say what was seen."""
        self._link.attend = None
        supervisor = self._supervisor
        if supervisor is None:
            return
        self._link.until = math.inf
        self._leave_by(procedures.look_after(self._stage))
        if not all(a.is_final for a in supervisor.axes):
            supervisor.speak()
            self._leave_by(procedures.leave(self._stage, longest_way_out(), ()))
        self._note_ends(supervisor)

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
        on |= {d.name for d in self.drives if not self._link.gate.may_let_go(d.node_id)}
        for drive in self.drives:
            if drive.name not in on:
                self._link.nmt(NMT_PRE_OPERATIONAL, drive.node_id)
        self._link.wait(0.02)
        suspects = {h.config.name for h in self.held.holdings if h.seen.suspect}
        for drive in self.drives:
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
        for name in self.not_off:
            complaints.append(
                f"axis {name} was not seen to switch off; its objects, its heartbeat watch among them, stay "
                "as they are until the next start"
            )
        on = {*self.held_at_end, *self.not_off}
        nodes = {d.node_id for d in self.drives if d.name in on}  # restored as a whole, or not
        return {d.name for d in self.drives if d.node_id in nodes}
