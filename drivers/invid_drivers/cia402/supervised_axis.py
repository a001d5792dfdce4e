"""One axis as it is supervised: its state, what is seen of it, and what is wrong with it."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from enum import Enum

from invid.sweep.axis_estimator import SEEN, AxisEstimator, Fall, Kind
from invid.sweep.loads import LOAD_SHARE
from invid.sweep.ports import Sample
from invid_drivers.cia402.axis import ModeSet
from invid_drivers.cia402.axis_state import RULES, AxisState, Command, Fact
from invid_drivers.cia402.standing.holding import BRAKE_MARGIN, CLOSES_S, AxisHolding
from invid_drivers.cia402.states import DriveState, OperationMode, is_energised, state_of

DEAF_S = 0.2
"""A drive that is still enabled so long after quick stop does not hear its controlword."""
UNSEEN_CYCLES = 3
"""Without process data for so many cycles a drive is asked by SDO."""
SUPPORTED_S = 0.5
"""How long a load must rest on its support."""
RUNAWAY_GROWTH, RUNAWAY_SHARE = 1.2, 0.02
"""What brings an axis to rest only slows it down. Above 1.2 times the speed at its start, and 2 % of the
permitted speed, it does the opposite (empirical)."""
NOISE_COUNTS, NOISE_DEVIATIONS = 4, 3
"""And beyond so many counts a cycle, and deviations of the speed."""
DRIVEN_SHARE = 0.8
"""Of the torque against its motion: a load that all its torque does not hold, and that is faster, weighs
1.8 times it."""
DRIVEN_LOOK_S = 0.04
"""A drive that seems to drive its axis away is sent a quick stop for so long before it is cut off: what is
slower by then was none."""
CREEPS = 2.0
"""Of the tolerance within which an axis stands: one that is further from its place in quick stop within the
look is not held, however slowly it goes."""
READY_S, READY_SPARE_S = 0.25, 0.03
"""Ready to switch on needs no power: a drive that is not there within the time that it took when it was
enabled, and this to spare, is inhibited from outside, by an emergency stop or safe torque off, and is not
enabled again. The first counts where it was not enabled in this run."""
CATCH_TIME_S = 0.02
"""Ten cycles of 2 ms: slower than a torque loop and its dead time (empirical: foreign drives with 0.8 ms)."""
TURNED, LED_CYCLES, LAG_CYCLES = 0.3, 30, 6
"""Of the impulse of its torque over so many cycles: within that its momentum has changed by the opposite
where a sign has turned. Its speed is that of half of ``SPEED_SAMPLES`` ago, and torque acts two cycles
later."""
MOST_CATCHES = 3
"""From quick stop out of torque mode, from quick stop out of position mode, and until it is supported."""


class Trouble(Enum):
    """What is wrong with an axis."""

    FAULT = "its drive reports a fault"
    RESTARTED = "its drive has started anew"
    LEFT = "its drive left operation by itself"
    LET_GO = "its drive let it go"
    FALLS = "it does not stand"
    DRIVEN = "its own drive drives it away"
    BLIND = "its encoder is dead"
    DEAF = "its drive does not obey"


@dataclass
class SupervisedAxis:
    """One axis. Units: rad, N·m (m, N where linear), seconds."""

    index: int
    holding: AxisHolding
    estimator: AxisEstimator
    torque_mode: OperationMode
    cycle_s: float
    quick_stop_s: float
    """Longest that its drive's ramp takes."""

    # --- supervised ---------------------------------------------------------------------------
    state: AxisState = AxisState.OFF
    since: float = 0.0
    place: float = 0.0
    """Where it was when it came into its state, or was seen to stand in it."""
    entry_speed: float = 0.0
    target: AxisState = AxisState.HELD
    """Where it goes after ``SWITCHING``."""
    support: float = 0.0
    """Torque that carries its load, sent while its drive is to hold it: a drive may show its mode before it
    acts."""
    damping: float = 0.0
    """By which a fall is braked until its drive holds it [N·m·s/rad or N·s/m]."""
    is_damped: bool = False
    """This master brings it to rest by damping alone: it only slows down."""
    torque: float = 0.0
    """Wished for, where it is led."""
    on_trial: bool = False
    """What it does now is a test: that it lets go is a finding, and ends no run by itself."""
    verdict: str = ""
    catches: int = 0
    blind: bool = False
    too_heavy: bool = False
    """All its torque does not hold it."""
    full: Fall | None = None
    driven_since: float | None = None
    brake_failed: bool = False
    power_is_useless: bool = False
    """It fell while its drive was still to hold it: its brake closes the sooner without."""
    in_vain: bool = False
    """It fell while its drive held it: given it again its drive would open the brake."""
    brake_is_last: bool = False
    """Nothing better than its brake is left, however late it closes."""
    weak: bool = False
    """Its drive gives less than it is asked for."""
    is_cut: bool = False
    """Nothing that its drive could do is wanted any more."""
    deaf: bool = False
    """It obeyed late, or not: if it is off by now, that was its own watch."""
    parks: bool | None = None
    """Whether its drive was seen to hold it in quick stop active, out of position mode."""
    support_was_awaited: bool = False
    asked: int = 0
    """Cycles in its state in which its drive was asked to be ready to switch on."""
    ready_s: float | None = None
    """Longest that its drive took for it on its way to being enabled."""
    is_stopped_by_nmt: bool = False
    silence_was_tried: bool = False
    takes_mode: ModeSet = ModeSet.SHOWN
    """When its drive takes a mode."""

    # --- seen -----------------------------------------------------------------------------------
    fresh: bool = False
    heard: float = 0.0
    status: int = 0
    shown_torque: float = 0.0
    now: float = 0.0
    was_enabled: bool = False
    """In this state, or in the one before where that sends the same."""
    was_powered: bool = False
    samples: int = 0
    """That came since its command changed."""
    was_ready: bool = False
    """It has gone a step towards operation enabled in this state."""
    mode_is_there: bool = False
    changing_s: float = 0.0
    """Of its state, until its drive had taken another mode under power."""
    supported_since: float | None = None
    moved_at: float = 0.0
    """When it was last seen to move, in its state."""
    moved_from: float = 0.0
    drop: float = 0.0
    """How far it went in its state."""
    torque_off: float | None = None
    """What its drive shows without voltage."""
    led: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=LED_CYCLES + LAG_CYCLES))
    """Speed, and impulse of the torque that it was asked for in its state, in each cycle [N·m·s or N·s]."""
    story: list[tuple[float, AxisState]] = field(default_factory=list)

    @property
    def name(self) -> str:
        """Its name in the config."""
        return self.holding.config.name

    @property
    def drive(self) -> DriveState:
        """The state of its drive."""
        return state_of(self.status)

    @property
    def is_energised(self) -> bool:
        """Whether its drive may give torque."""
        return is_energised(self.drive)

    @property
    def carries(self) -> bool:
        """Whether it must not be left without a hold: loaded, or not known to be free."""
        return self.holding.loaded is not False or self.holding.taken_over

    @property
    def takes_torque(self) -> bool:
        """Whether it is led in a torque mode; another is shaken by an offset to its drive's own loop."""
        return self.torque_mode is not OperationMode.CYCLIC_POSITION

    @property
    def is_final(self) -> bool:
        """Whether the way out may end here."""
        late = self.state is AxisState.UNHEARD and self.seconds > RULES[AxisState.UNHEARD].within_s
        waits = (self.state is AxisState.STANDS and (self.is_unseen() or not self.carries)) or (
            self.state is AxisState.FAULT and self.is_energised and self.seconds < self.quick_stop_s
        )
        return (RULES[self.state].is_final and not waits) or late

    @property
    def may_be_on(self) -> bool:
        """Whether it does not obey, or its drive still reacts to a fault."""
        return self.state is AxisState.UNHEARD or (self.state is AxisState.FAULT and self.is_energised)

    @property
    def was_let_go(self) -> bool:
        """Whether it carries a load, may have had power, and was not seen to be held in the end."""
        doubted = self.is_energised and (self.parks is False or self.driven_since is not None)
        held = self.state in (AxisState.STANDS, AxisState.BRAKED) and not (
            doubted or self.blind or self.brake_failed
        )
        return self.carries and not held and (self.was_powered or (bool(self.story) and self.is_unseen()))

    @property
    def has_brake(self) -> bool:
        """Whether a brake is left that was not seen to fail."""
        h = self.holding
        return h.config.brake == "drive" and h.brake_in_time is not False and not self.brake_failed

    @property
    def is_catchable(self) -> bool:
        """Whether its drive may be given it again."""
        unable = self.blind or self.is_cut or self.weak or self.support_was_awaited
        return self.holding.has_position_mode and not unable and self.catches < MOST_CATCHES

    @property
    def most_drop(self) -> float:
        """How far it may go where something is to hold it [rad or m]."""
        return max(self.holding.most_drop, self.estimator.tolerance)

    # --- transitions ------------------------------------------------------------------------------
    def enter(self, state: AxisState) -> None:
        """Come into a state: what is seen from here on counts for it."""
        before, rule = RULES[self.state].command, RULES[state]
        if self.state is AxisState.HELD and self.estimator.stands and self.carries and self.takes_torque:
            self.support = self.estimator.torque  # an offset would add to its drive's loop
        if rule.command is not before or state is AxisState.CATCHING:
            self.was_enabled, self.samples = False, 0
        self.was_ready, self.asked, self.changing_s = False, 0, 0.0
        damped = (AxisState.CATCHING, AxisState.SLOWING)
        if state in damped or (state is AxisState.STOPPING and self.on_trial):
            self.damping = self._catching_damping()
        if state is AxisState.CATCHING:
            self.catches += 1
        self.state, self.since = state, self.now
        self.place = self.moved_from = self.estimator.position
        self.moved_at, self.drop = self.now, 0.0
        # a load that damping alone lowers gets as fast as that
        sinks = abs(self.support) / self.damping if state is AxisState.SLOWING and self.damping else 0.0
        self.entry_speed = max(abs(self.estimator.speed), sinks)
        self.supported_since = None
        self.estimator.look_anew()
        self.led.clear()
        self.is_cut |= state is AxisState.SLOWING  # no loop of its drive's holds it
        self.story.append((self.now, state))

    def _catching_damping(self) -> float:
        """Damping that stops a fall in ``CATCH_TIME_S``.

        Its inertia is that of the config, or by the work of its load on the way: load·way = J·v²/2.
        """
        speed, inertia = self.estimator.speed, self.holding.config.inertia
        if inertia is None:
            inertia = 2 * abs(self.support) * self.drop / speed**2 if speed**2 > SEEN * self.drop else 0.0
        return inertia / CATCH_TIME_S

    @property
    def has_turned(self) -> bool:
        """Whether what it was asked for while it is led has moved its mass the opposite way, to a third at
        least of the speed that it has; its weight did the rest."""
        mass, led = self.holding.config.inertia, self.led
        if mass is None or len(led) < LED_CYCLES + LAG_CYCLES:
            return False
        impulse = led[-1 - LAG_CYCLES][1] - led[0][1]
        change = mass * (led[-1][0] - led[LAG_CYCLES][0])
        off = abs(change + impulse + self.support * (LED_CYCLES - 1) * self.cycle_s)
        return off < TURNED * abs(impulse) and 3 * change * led[-1][0] > mass * led[-1][0] ** 2

    def within_limit(self, torque: float) -> float:
        """The torque, or as much of it as its limit permits [N·m or N]."""
        limit = self.estimator.limits.torque
        return max(-limit, min(limit, torque))

    @property
    def catching_torque(self) -> float:
        """Torque that carries its load and brakes its fall [N·m or N]."""
        return self.within_limit(self.support - self.damping * self.speed)

    @property
    def speed(self) -> float:
        """What its motion is damped by: nothing where nobody sees it, or its torque would stand."""
        return 0.0 if self.is_unseen() else self.estimator.speed

    @property
    def seconds(self) -> float:
        """How long it is in its state."""
        return self.now - self.since

    # --- observation ------------------------------------------------------------------------------
    def see(self, sample: Sample) -> None:
        """Take in what one cycle brought of it."""
        i = self.index
        self.now, self.fresh = sample.time, sample.fresh[i]
        if not self.fresh:
            return
        self.heard, self.status, self.shown_torque = sample.time, sample.status[i], sample.torque[i]
        self.samples += 1
        self.led.append(
            (
                self.estimator.speed,
                (self.led[-1][1] if self.led else 0.0) + self.within_limit(self.torque) * self.cycle_s,
            )
        )
        self.was_enabled |= self.drive is DriveState.OPERATION_ENABLED
        self.was_ready |= self.drive in (DriveState.READY_TO_SWITCH_ON, DriveState.SWITCHED_ON)
        if self.was_ready and self.asked and self.state is AxisState.ENABLING:
            self.ready_s = max(self.ready_s or 0.0, self.asked * self.cycle_s)
        self.was_powered |= self.is_energised
        if not self.is_energised:
            self.torque_off = sample.torque[i]
        at = sample.position[i]
        if self.samples == 1 and not self.story:
            self.place = self.moved_from = at  # it may be held since an earlier run, anywhere
        self.drop = max(self.drop, abs(at - self.place))
        if abs(at - self.moved_from) > self.estimator.tolerance:
            self.moved_from, self.moved_at = at, sample.time
        light = abs(sample.torque[i]) < LOAD_SHARE * self.estimator.limits.rated_torque
        if not light or self.state is not AxisState.CAUGHT or not self.estimator.stands:
            self.supported_since = None
        elif self.supported_since is None:
            self.supported_since = sample.time

    def is_unseen(self) -> bool:
        """Whether nothing came from its drive for some cycles."""
        return self.now - self.heard > (UNSEEN_CYCLES - 0.5) * self.cycle_s

    def shows(self, fact: Fact) -> bool:
        """Whether a fact is seen now."""
        if not self.fresh and fact is not Fact.MODE:
            return False
        match fact:
            case Fact.ENABLED:
                return self.drive is DriveState.OPERATION_ENABLED
            case Fact.MODE:
                return self.mode_is_there
            case Fact.STANDING:
                return self.estimator.stands and (not self.blind or self.state is AxisState.BRAKING)
            case Fact.STOPPED:
                return self.drive is DriveState.QUICK_STOP_ACTIVE
            case Fact.UNPOWERED:
                return not self.is_energised
            case Fact.SUPPORTED:
                since = self.supported_since
                return since is not None and self.now - since >= SUPPORTED_S

    def trouble(self) -> Trouble | None:
        """What is wrong with it by this sample."""
        if not self.fresh or self.state in (AxisState.FAULT, AxisState.LOST, AxisState.UNHEARD):
            return None
        return self._trouble_of_drive() or self._trouble_of_motion()

    def _trouble_of_drive(self) -> Trouble | None:
        drive, command = self.drive, RULES[self.state].command
        if drive in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE):
            return Trouble.FAULT
        enabled = drive is DriveState.OPERATION_ENABLED
        went_back = self.was_ready and drive is DriveState.SWITCH_ON_DISABLED
        if command is Command.ENABLE and not enabled and (self.was_enabled or went_back):
            return Trouble.LEFT
        if self.state is AxisState.CATCHING and drive is DriveState.SWITCH_ON_DISABLED:
            most = READY_S if self.ready_s is None else self.ready_s + READY_SPARE_S
            return Trouble.LEFT if self.asked * self.cycle_s > most else None
        if command is not Command.QUICK_STOP:
            return None
        if self.carries and not self.is_energised:
            first = self.samples <= 1  # it does not follow from what was sent with the same SYNC
            return Trouble.LEFT if first else Trouble.LET_GO
        return Trouble.DEAF if enabled and self.seconds > DEAF_S else None

    def _trouble_of_motion(self) -> Trouble | None:
        state, estimator = self.state, self.estimator
        if self.is_cut:
            return None  # nothing that its drive could do is wanted
        if self.blind:
            return Trouble.BLIND if RULES[state].command is Command.ENABLE else None
        if state is AxisState.LED:
            drifts = self.on_trial and self.drop > self.most_drop / 2
            return Trouble.FALLS if drifts and (self.carries or self._speeds_up()) else None
        if state is AxisState.CATCHING:  # what is caught falls, and its torque grows
            return Trouble.FALLS if self.drop > estimator.limits.position else None
        if state in (AxisState.BRAKING, AxisState.BRAKED):
            # where the brake is the last means nothing better is left
            return Trouble.FALLS if not self.brake_is_last and self._has_dropped() else None
        if state in (AxisState.OFF, AxisState.LETTING_GO):
            far = self.drop > self.most_drop and estimator.fall is not None
            return Trouble.FALLS if far and not self.is_energised and len(self.story) > 1 else None
        if state is AxisState.STOPPING and self.is_damped and self.runs_away():
            return Trouble.FALLS
        if state is AxisState.PARKING and not self.carries and self.runs_away():
            return Trouble.DRIVEN
        parked = state in (AxisState.PARKING, AxisState.STANDS)
        if parked and self.on_trial and self.carries and self._has_dropped():
            return Trouble.FALLS
        if state is AxisState.STANDS and self.carries and self.drop > CREEPS * estimator.tolerance:
            return Trouble.FALLS
        fall = estimator.fall
        if fall is None or not self.is_energised or (state is AxisState.PARKING and not self.carries):
            return None
        if fall.at_limit:
            self.full = fall
        return Trouble.DRIVEN if self.is_driven(fall) else Trouble.FALLS

    def _has_dropped(self) -> bool:
        """Whether an axis that was at rest has gone too far, or half of that and is faster than a loop that
        sags."""
        brake_s = self.holding.seen.brake_s if self.state is AxisState.BRAKING else None
        tolerance = self.most_drop if brake_s is None else self.estimator.tolerance
        if self.in_vain or self.entry_speed**2 > 2 * SEEN * tolerance:  # it came in motion
            # a brake that closed under torque in its test was not seen to take its time
            late = brake_s is not None and self.seconds > max(BRAKE_MARGIN * brake_s, CLOSES_S[0])
            return self.drop > self.estimator.limits.position or (
                late and self.runs_away() and not self.in_vain
            )
        return (self.drop > self.most_drop / 2 and self._speeds_up()) or self.drop > self.most_drop

    def _speeds_up(self) -> bool:
        """Whether it got its speed on its way by more than ``SEEN``."""
        return self.estimator.speed**2 > 2 * SEEN * self.drop

    def runs_away(self) -> bool:
        """Whether what brings it to rest does the opposite."""
        limits = self.estimator.limits
        noise = max(NOISE_COUNTS * abs(limits.resolution), NOISE_DEVIATIONS * self.estimator.noise)
        least = max(RUNAWAY_SHARE * limits.velocity, noise / (4 * self.cycle_s))
        return abs(self.estimator.speed) > RUNAWAY_GROWTH * self.entry_speed + least

    def is_driven(self, fall: Fall) -> bool:
        """Whether its own drive does it: seen, or what all its torque does not slow down is no load of that
        mass.

        Of a mass that nobody stated both may be true. What is driven does more harm than what falls.
        """
        if fall.kind is Kind.DRIVEN or not fall.at_limit:
            return fall.kind is Kind.DRIVEN
        mass = self.holding.config.inertia
        return mass is None or mass * fall.acceleration > DRIVEN_SHARE * abs(fall.torque)

    def next_means(self) -> AxisState:
        """What holds it next, where what was to hold it does not: a brake that closes too late is better than
        nothing."""
        if self.has_brake and self.state not in (AxisState.BRAKING, AxisState.BRAKED):
            return AxisState.BRAKING
        in_vain = self.in_vain and self.last_means() is AxisState.BRAKING
        return AxisState.CATCHING if self.is_catchable and not in_vain else self.use_last_means()

    def last_means(self) -> AxisState:
        """What is left where nothing was seen to hold it."""
        has_brake = self.holding.config.brake == "drive" and not self.brake_is_last
        return AxisState.BRAKING if has_brake else AxisState.LOST

    def use_last_means(self) -> AxisState:
        """``last_means``, which is used once."""
        means = self.last_means()
        self.brake_is_last |= means is AxisState.BRAKING
        return means
