"""Where vendors differ from the profile, as rows of a table.

From 16 vendor EDS/DCF files and from manuals. A row says what the master does instead, and what a manual
says about stopping and limits (``Manual``); whether a drive has an object is still asked of the drive,
because firmware versions differ. ``python scripts/drive-tables.py`` prints the tables of the docs.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from invid_drivers.cia402.objects import Object


class Answer(enum.Enum):
    """An answer from a manual. Nothing is assumed of ``UNKNOWN`` but the worst.

    Ask ``certain`` of what protects (does the drive enforce its limit?) and ``possible`` of what endangers
    (may the torque limit lengthen the ramp?): both then count an unknown as the worst.
    """

    YES = "yes"
    NO = "no"
    UNKNOWN = "unknown"

    @property
    def certain(self) -> bool:
        """Yes, and a source says so."""
        return self is Answer.YES

    @property
    def possible(self) -> bool:
        """Not excluded by a source."""
        return self is not Answer.NO


YES, NO, UNKNOWN = Answer.YES, Answer.NO, Answer.UNKNOWN

RampUnit = Literal["rpm/s", "position units/s²", "unknown"]
"""Unit of 0x6085. Unknown: its value says nothing about how the axis stops."""

Reaction = Literal["quick stop", "voltage off", "nothing", "unknown"]
"""What a drive does by itself. Unknown: nothing, then voltage off, whichever is worse for the axis."""

BrakeClosing = Literal["at standstill", "when disabled", "unknown"]
"""When the drive closes its brake. Unknown: too late to hold a loaded axis."""


@dataclass(frozen=True, kw_only=True)
class Manual:
    """What was read of one drive. ``sources`` names document and revision for each field that is known.

    Attributes
    ----------
    cyclic_torque
        Cyclic synchronous torque (mode 10).
    torque_offset
        0x60B2 adds to the torque in cyclic synchronous position.
    enforces_torque_limit
        0x6072 (or the vendor's own torque limit) acts in a torque mode.
    quick_stop_default
        0x605A as delivered; ``None`` where the object is missing or its value is unknown.
    quick_stop_values
        What 0x605A takes; empty where unknown.
    quick_stop_ramp_unit
        Unit of 0x6085.
    ramp_capped_by_torque_limit
        0x6072 bounds the torque of the quick stop, so that the ramp of 0x6085 may not be reached.
    heartbeat_lost
        What the drive does where the heartbeat it watches is missing, with 0x6007 as delivered.
    rpdo_event_timer
        0x1400:5 watches for a missing RPDO.
    sync_supervision
        The drive notices missing SYNC (0x1006).
    brake_closes, torque_until_brake_closed
        When the brake is closed, and whether the motor holds until it has closed.
    position_before_gear
        0x6064 counts at the motor, before the gear.
    """

    cyclic_torque: Answer = UNKNOWN
    torque_offset: Answer = UNKNOWN
    enforces_torque_limit: Answer = UNKNOWN
    quick_stop_default: int | None = None
    quick_stop_values: tuple[int, ...] = ()
    quick_stop_ramp_unit: RampUnit = "unknown"
    ramp_capped_by_torque_limit: Answer = UNKNOWN
    heartbeat_lost: Reaction = "unknown"
    rpdo_event_timer: Answer = UNKNOWN
    sync_supervision: Answer = UNKNOWN
    brake_closes: BrakeClosing = "unknown"
    torque_until_brake_closed: Answer = UNKNOWN
    position_before_gear: Answer = UNKNOWN
    sources: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Vendor(Manual):
    """One vendor's departures.

    Attributes
    ----------
    torque_limit
        Current limit in mA, where 0x6072 is missing.
    nominal_current
        Current in mA at rated torque, to scale ``torque_limit``.
    velocity_in_rpm
        0x607F is in rpm, not in counts per second. Assumed where it is unknown: of the two it is the tighter.
    zero_as_shipped
        Limits that are 0 until somebody sets them: 0 is then no commissioned value.
    advice
        For the technician, where something of the above is missing.
    """

    name: str
    torque_limit: Object | None = None
    nominal_current: Object | None = None
    velocity_in_rpm: bool = False
    zero_as_shipped: tuple[str, ...] = ()
    advice: str = ""

    @property
    def takes_offset(self) -> bool:
        """Whether 0x60B2 may be tried in cyclic position: a source says so, or nothing was read at all and
        the drive itself is asked."""
        return self.torque_offset.certain or not self.sources


def _read(source: str, *names: str) -> dict[str, str]:
    return dict.fromkeys(names, source)


_EPOS4 = (
    "EPOS4 Firmware Specification, ed. 2026-07 (rel13740), and the EDS of EPOS4 Module 50/15, both as cited "
    "object by object in github.com/Imcab/EposLib 42fe757 and EposLibDocs 60d9028"
)
_GOLD = (
    "github.com/nasa-jpl/jsd e486622, src/jsd_egd.c and jsd_egd_types.h, after MAN-G-DS402 "
    "(Gold over EtherCAT, the same object dictionary)"
)
_NANOTEC_CST = (
    "Nanotec PD4-E CANopen online manual, Cyclic Synchronous Torque, and N5 EtherCAT manual, 6072h "
    "(FIR-v1426 and later, one firmware family)"
)
_SCHUNK = "Schunk_0_63.dcf of 2013-05-23 (PRL120; github.com/ipa320/schunk_robots f879329)"
_PILZ = "prbt_0_1.dcf of 2018-09-07 (github.com/PilzDE/pilz_robots c8c310c)"
_EROB = (
    "ZeroErrDriver.eds of 2022-09-05, revision 0x00020111 (github.com/ZeroErrControl/eRob_CANopen_Linux "
    "30826ed)"
)
_SOMANET = (
    "Synapticon documentation, software 4.0 to 4.2 and 4.19 (Circulo 7), 0x60B2, 0x2004 and brake pages"
)
_FILES = "one of the 16 vendor EDS files"

VENDORS: dict[str, Vendor] = {
    "generic": Vendor("generic"),
    "epos4": Vendor(
        "EPOS4",
        torque_limit=Object(0x3001, 2, "I", "output current limit"),
        nominal_current=Object(0x3001, 1, "I", "nominal current"),
        velocity_in_rpm=True,
        advice="give position_rad_per_count and rated_torque_Nm from the motor's data sheet",
        cyclic_torque=YES,
        torque_offset=YES,
        quick_stop_default=6,
        quick_stop_values=(6,),
        quick_stop_ramp_unit="rpm/s",
        heartbeat_lost="quick stop",
        rpdo_event_timer=NO,
        sync_supervision=NO,
        brake_closes="at standstill",
        torque_until_brake_closed=NO,
        position_before_gear=YES,
        sources=_read(
            _EPOS4, "cyclic_torque", "torque_offset", "quick_stop_default", "quick_stop_values",
            "quick_stop_ramp_unit", "heartbeat_lost", "rpdo_event_timer", "sync_supervision", "brake_closes",
            "torque_until_brake_closed", "position_before_gear",
        ),
    ),
    "elmo_gold": Vendor(
        "Elmo Gold",
        advice="give rated_torque_Nm: 0x6076 is 0 until it is set",
        cyclic_torque=YES,
        torque_offset=YES,
        enforces_torque_limit=YES,
        quick_stop_default=2,
        brake_closes="when disabled",
        torque_until_brake_closed=NO,
        sources=_read(
            _GOLD, "cyclic_torque", "torque_offset", "enforces_torque_limit", "brake_closes",
            "torque_until_brake_closed",
        ) | _read(_FILES, "quick_stop_default"),
    ),
    "nanotec_c5e": Vendor(
        "Nanotec C5-E",
        velocity_in_rpm=True,
        zero_as_shipped=("0x6072",),
        advice="0x6072 starts at 0; 0x1016 is missing",
        cyclic_torque=YES,
        enforces_torque_limit=YES,
        quick_stop_default=1,
        sources=_read(_NANOTEC_CST, "cyclic_torque", "enforces_torque_limit")
        | _read(_FILES, "quick_stop_default"),
    ),
    "nanotec_pd4e": Vendor(
        "Nanotec PD4-E",
        velocity_in_rpm=True,
        advice="0x6072 starts at 0 and is raised to the torque limit",
        cyclic_torque=YES,
        enforces_torque_limit=YES,
        brake_closes="when disabled",
        sources=_read(_NANOTEC_CST, "cyclic_torque", "enforces_torque_limit")
        | _read(
            "Nanotec PD6-E manual, Automatic brake control, and PD4-E manual, 2038h (times of the brake)",
            "brake_closes",
        ),
    ),
    "zeroerr_erob": Vendor(
        "ZeroErr eRob",
        advice="give position_rad_per_count of the motor encoder",
        cyclic_torque=YES,
        torque_offset=YES,
        enforces_torque_limit=NO,
        rpdo_event_timer=YES,
        sources=_read(_EROB, "cyclic_torque", "torque_offset", "enforces_torque_limit", "rpdo_event_timer"),
    ),
    "schunk": Vendor(
        "Schunk",
        advice="has no 0x6071: torque cannot be commanded",
        cyclic_torque=NO,
        torque_offset=NO,
        enforces_torque_limit=NO,
        rpdo_event_timer=NO,
        sync_supervision=NO,
        sources=_read(
            _SCHUNK, "cyclic_torque", "torque_offset", "enforces_torque_limit", "rpdo_event_timer",
            "sync_supervision",
        ),
    ),
    "pilz": Vendor(
        "Pilz",
        advice="has no 0x6071: torque cannot be commanded",
        cyclic_torque=NO,
        torque_offset=NO,
        enforces_torque_limit=NO,
        rpdo_event_timer=NO,
        sync_supervision=NO,
        sources=_read(
            _PILZ, "cyclic_torque", "torque_offset", "enforces_torque_limit", "rpdo_event_timer",
            "sync_supervision",
        ),
    ),
    "faulhaber_3150": Vendor(
        "Faulhaber 3150",
        advice="has neither 0x6071 nor 0x6077",
        cyclic_torque=NO,
        torque_offset=UNKNOWN,
        sources=_read(_FILES, "cyclic_torque"),
    ),
    "somanet_circulo": Vendor(
        "Synapticon SOMANET Circulo",
        velocity_in_rpm=True,
        advice="is on EtherCAT: record with its own tool and use `invid import`",
        cyclic_torque=YES,
        torque_offset=YES,
        brake_closes="when disabled",
        torque_until_brake_closed=YES,
        sources=_read(
            _SOMANET, "cyclic_torque", "torque_offset", "brake_closes", "torque_until_brake_closed"
        ),
    ),
}  # fmt: skip
