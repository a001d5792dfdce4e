"""Scales agree or nothing moves: what the config states against what the drive's objects say."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from invid.errors import DriveError
from invid_drivers.cia402 import objects as od
from invid_drivers.cia402.access import Access
from invid_drivers.cia402.objects import Object
from invid_drivers.cia402.stated.units import Scaling, position_per_count

AGREEMENT = 0.05
"""Two statements of one scale agree to 5 %: plates and catalogues give two figures (0.13 N·m for 0.128 is
1.6 %), and the watch over the torque leaves 10 %. What goes wrong is larger: another unit, quadrature counted
or not (4), a gear, another motor of the same series (1.3 and more)."""

MOST_OF_RATED, MUCH_OF_RATED = 32.767, 5.0
"""A torque limit beyond the first multiple of the rated torque cannot even be commanded (0x6071 is INTEGER16
in thousandths). Beyond the second it is asked whether it is meant: servo motors peak at three to five times
(a guess at what is usual)."""


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


def agreed(
    who: str, scale: Statement, overrides: Mapping[str, str], *, drives: bool
) -> tuple[float | None, str]:
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
    names = " and ".join(scale.objects)
    both = (
        f"{who}: {scale.key} is {stated:.6g} {scale.unit}, but {names} of the drive "
        f"{'say' if len(scale.objects) > 1 else 'says'} {found:.6g} ({stated / found:.3g} times)"
    )
    reasons = [f"{name}: {overrides[name]}" for name in scale.objects if name in overrides]
    if reasons:
        return (
            stated,
            f"{both}; the config's {scale.what} is used, as its overrides say ({'; '.join(reasons)})",
        )
    raise DriveError(
        f"{both}; nothing moves before they agree. Correct {scale.key} (or leave it out: the drive's is "
        f"used), or {scale.objects[0]} in the drive; where the config is right, say why: "
        f'overrides: {{"{scale.objects[0]}": "reason"}}'
    )


def read_scaling(drive: Access, warnings: list[str]) -> Scaling:
    """Scales of a drive, compared with the config's; what is worth saying is added to ``warnings``.

    Raises
    ------
    DriveError
        A scale is missing, two contradict each other, or the torque limit cannot be meant.
    """
    scaling = Scaling(_position(drive, warnings), _rated(drive, warnings), drive.config.direction)
    _compare_limit(drive, scaling.rated_torque, warnings)
    return scaling


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
    _, note = agreed(drive.who, scale, drive.config.overrides, drives=False)
    return [note] * bool(note)


def _position(drive: Access, warnings: list[str]) -> float:
    length = "m" if drive.linear else "rad"
    key, stated = f"position_{length}_per_count", drive.config.position_per_count
    candidates = _position_candidates(drive)
    if not candidates and stated is None:
        raise DriveError(
            f"{drive.who}: 0x608F encoder resolution is missing or 0, so position has no scale; give "
            f"{key} in the config. {drive.vendor.advice}".rstrip()
        )
    values = [value for value, _ in candidates]
    if stated is None and max(values) - min(values) > AGREEMENT * min(values):
        said = " and ".join(f"{' and '.join(objects)} say {value:.6g}" for value, objects in candidates)
        raise DriveError(
            f"{drive.who}: the drive contradicts itself in what a count of 0x6064 is [{length}]: {said}. "
            f"Give {key} in the config: one of them, or correct them with the drive's tool",
            axis=drive.name,
        )
    found, objects = (None, ("0x608F",)) if not candidates else candidates[0]
    if stated is not None and candidates:
        found, objects = min(candidates, key=lambda c: abs(math.log(c[0] / stated)))
    scale = Statement("position per count", key, length, stated, found, objects)
    value, note = agreed(drive.who, scale, drive.config.overrides, drives=False)
    warnings += [note] * bool(note)
    return value if value is not None else values[0]


def _position_candidates(drive: Access) -> list[tuple[float, tuple[str, ...]]]:
    """What the drive says of a count, with the objects that say it: by the user's units, by the encoder.

    0x6064 counts in the units of 0x6092 where the drive has them, but not every drive that has the object
    follows it.
    """
    increments = drive.find(od.ENCODER_INCREMENTS) or 0
    turns = (drive.find(od.ENCODER_REVOLUTIONS) or 0) if increments else 0
    feed = drive.find(od.FEED) or 0
    feed_turns = (drive.find(od.FEED_REVOLUTIONS) or 0) if feed else 0
    found = []
    if feed_turns:
        # 0x6092 is per shaft revolution; the motor turns 0x6091 times as often
        motor, shaft = drive.find(od.GEAR_MOTOR) or 1, drive.find(od.GEAR_SHAFT) or 1
        by_feed = position_per_count(feed * shaft, feed_turns * motor, linear=drive.linear)
        found.append((by_feed, ("0x6092", *["0x6091"] * (motor != shaft))))
    found.append((position_per_count(increments, turns, linear=drive.linear), ("0x608F",)))
    return [(value, objects) for value, objects in found if value is not None]


def _rated(drive: Access, warnings: list[str]) -> float:
    from_drive = (drive.find(od.RATED_TORQUE) or 0) / 1000.0
    key, unit = ("rated_force_N", "N") if drive.linear else ("rated_torque_Nm", "N·m")
    scale = Statement(
        "rated torque", key, unit, drive.config.rated_torque, from_drive or None, (od.RATED_TORQUE.address,)
    )
    value, note = agreed(drive.who, scale, drive.config.overrides, drives=True)
    if value is None:
        raise DriveError(
            f"{drive.who}: 0x6076 motor rated torque is missing or 0, so torque has no scale; give "
            f"{key} in the config. {drive.vendor.advice}".rstrip()
        )
    warnings += [note] * bool(note)
    return value


def _compare_limit(drive: Access, rated: float, warnings: list[str]) -> None:
    """Refuse a torque limit that cannot be commanded, question one far above the rated torque."""
    limit = drive.config.limits.torque
    said = f"{drive.who}: {limit_over_rated(limit, rated, linear=drive.linear)}"
    if limit > MOST_OF_RATED * rated:
        raise DriveError(
            f"{said}; 0x6071 cannot command more than {MOST_OF_RATED:g} times. Correct the limit, its "
            "unit or the rated value"
        )
    if limit > MUCH_OF_RATED * rated:
        warnings.append(f"{said}: is that limit meant?")


def limit_over_rated(limit: float, rated: float, *, linear: bool) -> str:
    """How a torque limit of the config stands to the rated torque, in words."""
    key, unit = ("force_N", "N") if linear else ("torque_Nm", "N·m")
    return f"limits.{key} is {limit:g}, {limit / rated:.3g} times the rated {rated:g} {unit}"
