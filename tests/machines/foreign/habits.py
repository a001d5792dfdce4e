"""What single drives do otherwise: small classes, composed; each changes one thing of `Axis`."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from .dictionary import NOT_NOW, PER_RAD, RATED

if TYPE_CHECKING:
    from .axis import Axis

LONG_S = 5.0
"""Nobody waits so long for a drive that does not do what it is told [s]."""


class Habit:
    """One that changes nothing. Instants are seconds of the wire's clock."""

    def start(self, axis: Axis) -> None:
        """Set constants of the axis, before it boots."""

    def tick(self, axis: Axis, now: float) -> None:
        """Every step."""

    def refuses(self, axis: Axis, at: int, value: int) -> int | None:
        """Abort code of a write; 0: acknowledged and forgotten."""
        return None

    def disturbs(self, axis: Axis, at: int, is_write: bool) -> int | None:
        """Abort code of any SDO."""
        return None

    def shows(self, axis: Axis, at: int, value: int) -> int:
        """What is read of an object."""
        return value

    def encoder(self, axis: Axis, q: float) -> float:
        """What its encoder makes of a place [rad]."""
        return q

    def encoder_speed(self, axis: Axis, v: float) -> float:
        """What its encoder makes of a speed [rad/s]."""
        return v

    def limits(self, axis: Axis, up: float, down: float) -> tuple[float, float]:
        """Most torque up and down [N·m]."""
        return up, down

    def gives(self, axis: Axis, torque: float) -> float:
        """Torque that reaches the motor [N·m]."""
        return torque

    def quick_stop_option(self, axis: Axis, option: int) -> int:
        """What it takes 0x605A for."""
        return option

    def abort_option(self, axis: Axis, option: int) -> int:
        """What it takes 0x6007 for."""
        return option

    def entered(self, axis: Axis, before: str) -> None:
        """After every change of state."""

    def left_operational(self, axis: Axis) -> None:
        """When NMT takes it out of operational."""

    def brake_closed(self, axis: Axis) -> None:
        """When its brake has closed."""


@dataclass
class Constants(Habit):
    """Attributes of the axis or its node that are otherwise: times, watches."""

    axis: dict[str, Any] | None = None
    node: dict[str, Any] | None = None

    def start(self, axis: Axis) -> None:
        for name, value in (self.axis or {}).items():
            assert hasattr(axis, name), name
            setattr(axis, name, value)
        for name, value in (self.node or {}).items():
            assert hasattr(axis.node, name), name
            setattr(axis.node, name, value)


# --- quick stop and what follows ---------------------------------------------------------------------
@dataclass
class LetsGo(Habit):
    """Quick stop active without torque: out of these modes, from an instant on."""

    modes: tuple[int, ...] = (10,)
    at: float = 0.0
    limp: bool = False

    def entered(self, axis: Axis, before: str) -> None:
        self.limp = False
        if axis.state == "stopping":
            self.limp = axis.mode in self.modes and axis.node.world.now >= self.at
            if self.limp:
                axis.node.world.mark("lets go")

    def gives(self, axis: Axis, torque: float) -> float:
        return 0.97 * axis.plant.torque if self.limp else torque


@dataclass
class QuickStopEnds(Habit):
    """Holds in quick stop active, and after so long: ``off``, ``fault`` or creeps."""

    seconds: float = 2.0
    how: str = "off"
    creep: float = 0.003
    since: float | None = None

    def entered(self, axis: Axis, before: str) -> None:
        self.since = axis.node.world.now if axis.state == "stopping" else None

    def tick(self, axis: Axis, now: float) -> None:
        if self.since is None or now - self.since < self.seconds:
            return
        if "lets go" not in axis.node.world.marks:
            axis.node.world.mark("lets go")
        if self.how == "creep":
            axis.reference -= self.creep * 5e-4
            return
        self.since = None
        if self.how == "off":
            axis.enter("off", "quick stop took too long")
        else:
            axis.put(0x603F00, 0x2310)
            axis.node.emergency(0x2310)
            axis.enter("fault", "late fault")


@dataclass
class QuickStopTorque(Habit):
    """Its quick stop has a torque of its own, whatever 0x6072 says."""

    permille: int = 400

    def limits(self, axis: Axis, up: float, down: float) -> tuple[float, float]:
        own = self.permille / 1000 * RATED
        return (own, own) if axis.state == "stopping" else (up, down)


class NoLimitInTorqueMode(Habit):
    """Its torque limits count in its own loops only."""

    def limits(self, axis: Axis, up: float, down: float) -> tuple[float, float]:
        return (4 * RATED, 4 * RATED) if axis.state == "enabled" and axis.mode == 10 else (up, down)


@dataclass
class OptionUnderPower(Habit):
    """0x605A written under power: refused, or taken and without effect before it is enabled again."""

    how: str = "refused"
    acts: int | None = None

    def refuses(self, axis: Axis, at: int, value: int) -> int | None:
        if at != 0x605A00 or not axis.is_powered or self.how != "refused":
            return None
        return NOT_NOW if value != axis.number(at) else None

    def entered(self, axis: Axis, before: str) -> None:
        if axis.state == "enabled":
            self.acts = axis.number(0x605A00, 2)

    def quick_stop_option(self, axis: Axis, option: int) -> int:
        return option if self.how == "refused" or self.acts is None else self.acts


class LetsGoAlone(Habit):
    """Without its master it switches off, whatever 0x6007 says."""

    def abort_option(self, axis: Axis, option: int) -> int:
        axis.node.world.mark("lets go")
        return 2


class NeedsOperational(Habit):
    """Its power stage goes off with NMT operational."""

    def left_operational(self, axis: Axis) -> None:
        if axis.is_powered:
            axis.enter("off", "left operational")


# --- commands ----------------------------------------------------------------------------------------
@dataclass
class ModesAtRest(Habit):
    """0x6060 is refused in these states: under power, or in quick stop active."""

    states: tuple[str, ...] = ("enabled", "stopping", "reacting")

    def refuses(self, axis: Axis, at: int, value: int) -> int | None:
        return NOT_NOW if at == 0x606000 and axis.state in self.states and value != axis.mode else None


class ModeNeverComes(Habit):
    """0x6060 is taken, and the mode stays what it was."""

    def start(self, axis: Axis) -> None:
        axis.mode_s = math.inf


@dataclass
class ModeShown(Habit):
    """0x6061 shows a mode before it acts (``early``), or −1 until then (``blank``)."""

    how: str = "early"
    seconds: float = 0.1

    def start(self, axis: Axis) -> None:
        axis.mode_s = self.seconds

    def shows(self, axis: Axis, at: int, value: int) -> int:
        if at != 0x606100 or axis.changes is None:
            return value
        return axis.changes[1] if self.how == "early" else -1


@dataclass
class TransientAbort(Habit):
    """The first so many transfers of an object are aborted with a code that says nothing of the object."""

    index: int = 0x6072
    code: int = 0x08000020
    times: int = 1
    only_writes: bool = False

    def disturbs(self, axis: Axis, at: int, is_write: bool) -> int | None:
        if at >> 8 != self.index or self.times <= 0 or (self.only_writes and not is_write):
            return None
        self.times -= 1
        return self.code


@dataclass
class Forgets(Habit):
    """A write of an object is acknowledged and without effect."""

    index: int

    def refuses(self, axis: Axis, at: int, value: int) -> int | None:
        return 0 if at >> 8 == self.index else None


# --- power -------------------------------------------------------------------------------------------
@dataclass
class EnableInput(Habit):
    """Torque is safely off from an instant on, or from its n-th leaving of operation on; for so long."""

    at: float = math.inf
    seconds: float = 1.0
    into: str = "off"
    leaving: int = 0
    until: float = math.inf

    def entered(self, axis: Axis, before: str) -> None:
        if before == "enabled":
            self.leaving -= 1
            if self.leaving == 0:
                self.at = axis.node.world.now + 0.005

    def tick(self, axis: Axis, now: float) -> None:
        if now >= self.at:
            self.at, self.until = math.inf, now + self.seconds
            axis.locked_out = True
            axis.node.world.mark("torque off")
            if axis.state == "off" and self.seconds < LONG_S:
                axis.node.world.mark("nobody can see it")
            else:
                axis.node.world.note(axis.name, f"{axis.state}, input opened (safe torque off)")
            if axis.state != "off":
                axis.enter(self.into, "safe torque off")
        elif axis.locked_out and now >= self.until:
            axis.locked_out = False
            axis.node.world.note(axis.name, "torque may be had again")


@dataclass
class Faults(Habit):
    """A fault at an instant: by its reaction, or at once off."""

    at: float
    code: int = 0x2310
    at_once: bool = True

    def tick(self, axis: Axis, now: float) -> None:
        if now >= self.at:
            self.at = math.inf
            if self.at_once:
                axis.put(0x603F00, self.code)
                axis.node.emergency(self.code)
                axis.enter("fault", "at once")
            else:
                axis.fault(self.code)


@dataclass
class Reboots(Habit):
    """Its supply fails for a moment."""

    at: float

    def tick(self, axis: Axis, now: float) -> None:
        if now >= self.at:
            self.at = math.inf
            axis.enter("off", "supply")
            axis.node.restart()


@dataclass
class GivesLess(Habit):
    """From an instant on (or so long after it was enabled) no more than this; 0x6077 may echo the demand."""

    at: float = math.inf
    torque: float = 3.0
    echoes: bool = False
    less: bool = False

    def tick(self, axis: Axis, now: float) -> None:
        self.less = self.less or (now >= self.at and axis.is_powered)

    def gives(self, axis: Axis, torque: float) -> float:
        return max(-self.torque, min(self.torque, torque)) if self.less else torque

    def shows(self, axis: Axis, at: int, value: int) -> int:
        if at == 0x607700 and self.echoes and axis.is_powered:
            return round(1000 * axis.wanted / RATED)
        return value


@dataclass
class TorqueGone(Habit):
    """From an instant on there is no torque, and no state says so."""

    at: float
    echoes: bool = True

    def gives(self, axis: Axis, torque: float) -> float:
        return 0.0 if axis.node.world.now >= self.at else torque

    def shows(self, axis: Axis, at: int, value: int) -> int:
        return round(1000 * axis.wanted / RATED) if at == 0x607700 and self.echoes else value


# --- sensors -----------------------------------------------------------------------------------------
@dataclass
class EncoderNoise(Habit):
    """White noise on 0x6064 [counts rms], and steps of several counts (a resolver)."""

    rms: float = 0.0
    step: int = 1
    seed: int = 0

    def start(self, axis: Axis) -> None:
        self.rng = random.Random(self.seed)

    def shows(self, axis: Axis, at: int, value: int) -> int:
        if at != 0x606400:
            return value
        noisy = value + self.rng.gauss(0.0, self.rms) if self.rms else float(value)
        return axis.wrap(math.floor(noisy / self.step) * self.step)


@dataclass
class TorqueShown(Habit):
    """0x6077 with noise [‰ rms], an offset [‰], without sign, an echo of the demand, or a filter [s]."""

    rms: float = 2.0
    offset: float = 0.0
    scale: float = 1.0
    how: str = "true"
    filter_s: float = 0.0
    seed: int = 0
    slow: float = 0.0

    def start(self, axis: Axis) -> None:
        self.rng = random.Random(1000 + self.seed)

    def tick(self, axis: Axis, now: float) -> None:
        if self.filter_s:
            self.slow += 5e-4 / self.filter_s * (1000 * axis.plant.torque / RATED - self.slow)

    def shows(self, axis: Axis, at: int, value: int) -> int:
        if at != 0x607700:
            return value
        true = self.slow if self.filter_s else float(value)
        if self.how == "echo":
            true = 1000 * axis.wanted / RATED
        true = self.scale * true + self.offset + (self.rng.gauss(0.0, self.rms) if self.rms else 0.0)
        return round(abs(true) if self.how == "unsigned" else true)


@dataclass
class EncoderFreezes(Habit):
    """Its encoder stands from an instant on; it may leap first [rad]."""

    at: float
    leap: float = 0.0
    place: float | None = None

    def tick(self, axis: Axis, now: float) -> None:
        if now >= self.at and self.place is None:
            self.place = axis.plant.q + self.leap
            axis.node.world.note(axis.name, f"encoder freezes at {self.place:.4f}")

    def encoder(self, axis: Axis, q: float) -> float:
        return q if self.place is None else self.place

    def encoder_speed(self, axis: Axis, v: float) -> float:
        return v if self.place is None else 0.0


@dataclass
class EncoderLeaps(Habit):
    """Its encoder is off by so much from an instant on [rad]."""

    at: float
    leap: float

    def encoder(self, axis: Axis, q: float) -> float:
        return q + self.leap if axis.node.world.now >= self.at else q


@dataclass
class Signs(Habit):
    """Encoder against the motor, or torque that turns at an instant (0x6077 shows what was asked)."""

    encoder_sign: int = 1
    turns_at: float = math.inf

    def encoder(self, axis: Axis, q: float) -> float:
        return self.encoder_sign * q

    def encoder_speed(self, axis: Axis, v: float) -> float:
        return self.encoder_sign * v

    def gives(self, axis: Axis, torque: float) -> float:
        return -torque if axis.node.world.now >= self.turns_at else torque

    def shows(self, axis: Axis, at: int, value: int) -> int:
        return -value if at == 0x607700 and axis.node.world.now >= self.turns_at else value


# --- brake, prop, bus --------------------------------------------------------------------------------
@dataclass
class BrakeFails(Habit):
    """Its brake holds so many closings, then no more; or from an instant on."""

    closings: int = 1 << 30
    at: float = math.inf

    def tick(self, axis: Axis, now: float) -> None:
        if now >= self.at:
            axis.plant.worn = True

    def brake_closed(self, axis: Axis) -> None:
        self.closings -= 1
        if self.closings < 0:
            axis.plant.worn = True
            axis.node.world.note(axis.name, "its brake does not hold")


@dataclass
class Propped(Habit):
    """Something stands under the axis when it is enabled, and is taken away after a while."""

    seconds: float = 6.0
    goes: float | None = None

    def entered(self, axis: Axis, before: str) -> None:
        if axis.state == "enabled" and self.goes is None:
            self.goes = axis.node.world.now + self.seconds
            axis.plant.prop = axis.plant.q

    def tick(self, axis: Axis, now: float) -> None:
        if self.goes is None:
            return
        if now < self.goes:
            axis.plant.prop = axis.plant.prop if axis.plant.prop is not None else axis.plant.q
        elif self.goes < math.inf:
            self.goes, axis.plant.prop = math.inf, None
            axis.node.world.mark("support taken away")


@dataclass
class Person(Habit):
    """Somebody puts something under a load so long after any drive has let go, once it stands."""

    seconds: float = 6.0

    def tick(self, axis: Axis, now: float) -> None:
        since = axis.node.world.marks.get("lets go")
        plant = axis.plant
        if since is not None and now - since > self.seconds and plant.prop is None and abs(plant.v) < 0.02:
            plant.prop = plant.q


@dataclass
class Silent(Habit):
    """From an instant on the node says nothing (``all``), or answers no SDO (``sdo``), or is late [s]."""

    at: float
    what: str = "all"
    late: float = 0.0

    def tick(self, axis: Axis, now: float) -> None:
        if now < self.at:
            return
        self.at = math.inf
        if self.what == "all":
            axis.node.is_mute = True
        elif self.what == "sdo":
            axis.node.answers_sdo = False
        elif self.what == "slow sdo":
            axis.node.sdo_s = self.late
        else:
            axis.node.pdo_s = self.late


@dataclass
class AddsHome(Habit):
    """0x607C moves what 0x607A means, and 0x6064 not."""

    def tick(self, axis: Axis, now: float) -> None:
        if axis.target is not None and axis.mode == 8:
            counts = axis.number(0x607A00) + axis.number(0x607C00)
            axis.target = (counts + 0.5) / PER_RAD


HABITS = {c.__name__: c for c in tuple(globals().values()) if isinstance(c, type) and issubclass(c, Habit)}
HOOKS = tuple(name for name, what in vars(Habit).items() if callable(what) and not name.startswith("_"))


def overriding(habits: list[Habit]) -> dict[str, list[Habit]]:
    """Those that have something to say at each place."""
    return {n: [h for h in habits if getattr(type(h), n) is not getattr(Habit, n)] for n in HOOKS}
