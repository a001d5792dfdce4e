"""Counts and thousandths to radians (metres) and newton metres (newtons): scales agree or nothing moves.

What the config states stands against what the drive's objects say.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from invid.config import AxisConfig
from invid.errors import DriveError
from invid.wording.sentence import listed, sentence
from invid_drivers.cia402 import objects as od
from invid_drivers.cia402.access import Access
from invid_drivers.cia402.objects import Object
from invid_drivers.cia402.stated.vendors import Vendor

TURNS_POSITION, TURNS_TORQUE = 0x80, 0x20
"""Bits of 0x607E: what the drive counts the other way round. The profile has none for torque, drives have."""

AGREEMENT = 0.05
"""Two statements of one scale agree to 5 %: plates and catalogues give two figures (0.13 N·m for 0.128 is
1.6 %), and the watch over the torque leaves 10 %. What goes wrong is larger: another unit, quadrature counted
or not (4), a gear, another motor of the same series (1.3 and more)."""

MOST_OF_RATED, MUCH_OF_RATED = 32.767, 5.0
"""A torque limit beyond the first multiple of the rated torque cannot even be commanded (0x6071 is INTEGER16
in thousandths). Beyond the second it is asked whether it is meant: servo motors peak at three to five times
(a guess at what is usual)."""


WHOLE = 1 << 32
"""Counts of the circle of INTEGER32."""
LEAST_COUNTS = 6
"""Counts of a turn that the coarsest feedback has: the six states of three Hall sensors."""


@dataclass(frozen=True)
class Scaling:
    """Factors of one axis.

    Attributes
    ----------
    position_per_count
        Motor position of one count of 0x6064 [rad or m], > 0.
    rated_torque
        0x6076 or the config's [N·m or N], > 0.
    direction
        +1 or −1: the sign of both position and torque in the recording.
    """

    position_per_count: float
    rated_torque: float
    direction: int = 1

    def torque(self, permille: int) -> float:
        """0x6077 to torque."""
        return self.direction * self.rated_torque * permille / 1000.0

    def most_permille(self, torque: float) -> int:
        """Whole thousandths that are not more than a torque limit, at least one."""
        return max(1, min(32767, math.floor(torque / self.rated_torque * 1000.0 + 1e-9)))


def position_per_count(increments: int, revolutions: int, *, linear: bool = False) -> float | None:
    """Motor position of one count [rad or m] where ``increments`` of them are so many turns of the motor.

    ``None`` where the objects say nothing: zero, or fewer than ``LEAST_COUNTS`` a turn, as in drives that
    come with 1 and 1. For a linear axis a revolution stands for a metre, as the encoder's increments do.
    """
    if revolutions <= 0 or increments < LEAST_COUNTS * revolutions:
        return None
    per_turn = 1.0 if linear else 2.0 * math.pi
    return per_turn * revolutions / increments


def wrapped_difference(counts: int, since: int, span: int = WHOLE) -> int:
    """``counts − since`` on a circle of so many counts: 0x6064 may wrap around, at 0x607B or at 32 bits."""
    return (counts - since + span // 2) % span - span // 2


@dataclass(frozen=True)
class Statement:
    """A scale as the config and the drive state it."""

    what: str
    """"rated torque"."""
    key: str
    """Key of the config."""
    unit: str
    stated: float | None
    """By the config."""
    found: float | None
    """By the drive; ``None`` where it says nothing."""
    objects: tuple[str, ...]
    """Objects that say it, as "0x6076"."""


def agreed(axis: AxisConfig, scale: Statement, *, drives: bool) -> tuple[float | None, str]:
    """The value to use, and what to say of it (empty where nothing).

    ``drives``: where both agree, the drive's figure is used, else the config's.

    Raises
    ------
    DriveError
        They contradict each other and the config does not say why.
    """
    stated, found = scale.stated, scale.found
    if stated is None or found is None:
        return (found if stated is None else stated), ""
    if abs(stated - found) <= AGREEMENT * found:
        return (found if drives else stated), ""
    names = listed(scale.objects)
    both = sentence(
        "{who}: {key} is {stated:.6g} {unit}, but {names} of the drive {say} {found:.6g} ({times:.3g} times)",
        who=_who(axis),
        key=scale.key,
        stated=stated,
        unit=scale.unit,
        names=names,
        say="say" if len(scale.objects) > 1 else "says",
        found=found,
        times=stated / found,
    )
    reasons = [f"{name}: {axis.overrides[name]}" for name in scale.objects if name in axis.overrides]
    if reasons:
        return (
            stated,
            f"{both}; the config's {scale.what} is used, as its overrides say ({'; '.join(reasons)})",
        )
    raise DriveError(
        sentence(
            "{both}; nothing moves before they agree. Correct {key} (or leave it out: the "
            "drive's is used), or {objects} in the drive; where the config is right, say why: "
            'overrides: {{"{objects}": "reason"}}',
            both=both,
            key=scale.key,
            objects=scale.objects[0],
        ),
        axis=axis.name,
        code="scales_contradict",
    )


def _who(axis: AxisConfig) -> str:
    return sentence("axis {axis} (node {node})", axis=axis.name, node=axis.node_id)


Read = Callable[[Object], int | None]
"""Value of an object of the axis, ``None`` where the drive lacks it."""


def read_factors(read: Read, axis: AxisConfig, *, linear: bool, vendor: Vendor) -> Factors:
    """Scales of an axis by its objects, compared with the config's and with each other.

    Position by 0x608F, 0x6091, 0x6092 and 0x6093, torque by 0x6076, velocity (0x607F) by 0x6096, signs by
    0x607E. Reads and nothing else.

    Raises
    ------
    DriveError
        With the code ``scale_missing``, ``scales_contradict`` (config and drive, or the drive itself),
        ``polarity_contradicts`` or ``limit_beyond_command``.
    """
    asked = _Asked(read, axis, linear, vendor)
    position, said = asked.position()
    rated, noted = asked.rated()
    notes = [n for n in (said, noted, asked.polarity(), *asked.velocity(position), asked.limit(rated)) if n]
    return Factors(Scaling(position, rated, axis.direction), tuple(notes))


@dataclass(frozen=True)
class Factors:
    """What the objects of an axis say of its units, agreed with the config, and what is to be said of it."""

    scaling: Scaling
    notes: tuple[str, ...]


def require_nominal_current(drive: Access, nominal: Object, whole: int) -> list[str]:
    """The vendor's current at rated torque [mA] against 0x6075; DriveError where they contradict."""
    rated = drive.find(od.RATED_CURRENT)
    scale = Statement(
        "nominal current",
        f"{nominal.address} {nominal.name}",
        "mA",
        whole,
        rated or None,
        (od.RATED_CURRENT.address,),
    )
    _, note = agreed(drive.config, scale, drives=False)
    return [note] * bool(note)


@dataclass(frozen=True)
class _Asked:
    """One axis, while its objects are read."""

    read: Read
    config: AxisConfig
    linear: bool
    vendor: Vendor

    @property
    def who(self) -> str:
        return _who(self.config)

    def refuse(self, code: str, said: str) -> DriveError:
        return DriveError(f"{self.who}: {said}".rstrip(), axis=self.config.name, code=code)

    def position(self) -> tuple[float, str]:
        length = "m" if self.linear else "rad"
        key, stated = f"position_{length}_per_count", self.config.position_per_count
        counts = position_counts(self.read, linear=self.linear)
        if not counts and stated is None:
            raise self.refuse(
                "scale_missing",
                f"0x608F encoder resolution is missing or 0, so position has no scale; give {key} in the "
                f"config. {self.vendor.advice}",
            )
        if stated is None and not agree(counts):
            raise self.refuse(
                "scales_contradict",
                f"the drive contradicts itself in what a count of 0x6064 is [{length}]: {in_words(counts)}. "
                f"Give {key} in the config: one of them, or correct them with the drive's tool",
            )
        used = [c for c in counts if not c.is_converted]
        if stated is not None:
            used.sort(key=lambda c: abs(math.log(c.value / stated)))
        best = used[0] if used else None
        scale = Statement(
            "position per count",
            key,
            length,
            stated,
            None if best is None else best.value,
            ("0x608F",) if best is None else best.objects,
        )
        value, note = agreed(self.config, scale, drives=False)
        return (counts[0].value if value is None else value), note

    def rated(self) -> tuple[float, str]:
        from_drive = (self.read(od.RATED_TORQUE) or 0) / 1000.0
        key, unit = ("rated_force_N", "N") if self.linear else ("rated_torque_Nm", "N·m")
        scale = Statement(
            "rated torque",
            key,
            unit,
            self.config.rated_torque,
            from_drive or None,
            (od.RATED_TORQUE.address,),
        )
        value, note = agreed(self.config, scale, drives=True)
        if value is None:
            raise self.refuse(
                "scale_missing",
                f"0x6076 motor rated torque is missing or 0, so torque has no scale; give {key} in the "
                f"config. {self.vendor.advice}",
            )
        return value, note

    def polarity(self) -> str:
        """Refuse a position that the drive turns round without its torque, which would then drive it away."""
        found = self.read(od.POLARITY) or 0
        if bool(found & TURNS_POSITION) == bool(found & TURNS_TORQUE):
            return ""
        position, torque = (-1 if found & bit else 1 for bit in (TURNS_POSITION, TURNS_TORQUE))
        said = f"0x607E polarity is 0x{found:02X}: position counts times {position}, torque times {torque}"
        reason = self.config.overrides.get(od.POLARITY.address)
        if reason is not None:
            return f"{self.who}: {said}; used all the same, as overrides says ({reason})"
        raise self.refuse(
            "polarity_contradicts",
            f"{said}, so that torque drives the axis against its count; set 0x607E to 0 with the drive's "
            "tool and direction: -1 in the config, or, where this drive turns its torque with it, say so: "
            'overrides: {"0x607E": "reason"}',
        )

    def velocity(self, position: float) -> tuple[str, ...]:
        """Refuse a speed limit whose unit the drive converts: by which way round is not known."""
        factor = _factor(self.read, od.VELOCITY_NUMERATOR, od.VELOCITY_DIVISOR)
        limit = self.read(od.MAX_VELOCITY)
        if factor == 1.0 or not limit:
            return ()
        unit = f"{'m' if self.linear else 'rad'}/s"
        plain = limit * velocity_per_unit(position, self.vendor, linear=self.linear)
        said = (
            f"0x607F max profile velocity is {limit}, which is {plain:.6g} {unit} in the drive's plain unit, "
            f"but {plain * factor:.6g} or {plain / factor:.6g} {unit} by its 0x6096 velocity factor "
            f"({factor:.6g})"
        )
        reason = self.config.overrides.get("0x6096")
        if reason is not None:
            return (f"{self.who}: {said}; the plain unit is used, as overrides says ({reason})",)
        raise self.refuse(
            "scales_contradict",
            f"{said}; set 0x6096 to 1 and 1 with the drive's tool, or, where the drive does not convert "
            '0x607F, say so: overrides: {"0x6096": "reason"}',
        )

    def limit(self, rated: float) -> str:
        """Refuse a torque limit that cannot be commanded, question one far above the rated torque."""
        limit = self.config.limits.torque
        said = limit_over_rated(limit, rated, linear=self.linear)
        if limit > MOST_OF_RATED * rated:
            raise self.refuse(
                "limit_beyond_command",
                f"{said}; 0x6071 cannot command more than {MOST_OF_RATED:g} times. Correct the limit, its "
                "unit or the rated value",
            )
        return f"{self.who}: {said}: is that limit meant?" if limit > MUCH_OF_RATED * rated else ""


@dataclass(frozen=True)
class Count:
    """What a count of 0x6064 is [rad or m at the motor], and the objects that say so."""

    value: float
    objects: tuple[str, ...]
    is_converted: bool = False
    """0x6093 says that the drive converts it: a count of the encoder is not one of 0x6064."""


def position_counts(read: Read, *, linear: bool) -> tuple[Count, ...]:
    """What the drive says of a count, each with its objects; the user's units come first.

    0x6064 counts in the units of 0x6092 where the drive has them, but not every drive that has the object
    follows it. Of 0x6093 the older profile says (DSP 402, 12.3.3): increments are units times the factor.
    """
    increments = read(od.ENCODER_INCREMENTS) or 0
    turns = (read(od.ENCODER_REVOLUTIONS) or 0) if increments else 0
    feed = read(od.FEED) or 0
    feed_turns = (read(od.FEED_REVOLUTIONS) or 0) if feed else 0
    found = []
    if feed_turns:
        # 0x6092 is per shaft revolution; the motor turns 0x6091 times as often
        motor, shaft = read(od.GEAR_MOTOR) or 1, read(od.GEAR_SHAFT) or 1
        by_feed = position_per_count(feed * shaft, feed_turns * motor, linear=linear)
        found.append((by_feed, ("0x6092", *["0x6091"] * (motor != shaft)), False))
    encoder = position_per_count(increments, turns, linear=linear)
    factor = _factor(read, od.POSITION_NUMERATOR, od.POSITION_DIVISOR)
    if factor != 1.0:
        found.append((encoder and encoder * factor, ("0x6093", "0x608F"), False))
    if factor == 1.0 or not feed_turns:
        found.append((encoder, ("0x608F",), factor != 1.0))
    return tuple(Count(value, objects, converted) for value, objects, converted in found if value)


def agree(counts: Sequence[Count]) -> bool:
    """Whether the objects say the same of a count."""
    values = [c.value for c in counts]
    return max(values) - min(values) <= AGREEMENT * min(values)


def in_words(counts: Sequence[Count]) -> str:
    """What the objects say of a count, side by side."""
    return " and ".join(f"{' and '.join(c.objects)} say {c.value:.6g}" for c in counts)


def velocity_per_unit(position_per_count: float, vendor: Vendor, *, linear: bool) -> float:
    """Velocity [rad/s or m/s] of one unit of 0x607F without a factor."""
    return (1.0 if linear else 2 * math.pi) / 60 if vendor.velocity_in_rpm else position_per_count


def _factor(read: Read, numerator: Object, divisor: Object) -> float:
    """A factor of the drive; 1 where it says none."""
    over, under = read(numerator) or 0, read(divisor) or 0
    return over / under if over and under else 1.0


def limit_over_rated(limit: float, rated: float, *, linear: bool) -> str:
    """How a torque limit of the config stands to the rated torque, in words."""
    key, unit = ("force_N", "N") if linear else ("torque_Nm", "N·m")
    return f"limits.{key} is {limit:g}, {limit / rated:.3g} times the rated {rated:g} {unit}"
