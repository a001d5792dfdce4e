"""Where vendors differ from the profile, as rows of a table.

From 16 vendor EDS/DCF files and from manuals. A row says what the master does instead, and what a manual
says about stopping and limits (``Manual``); whether a drive has an object is still asked of the drive,
because firmware versions differ. ``python scripts/drive-tables.py`` prints the tables of the docs.
"""

from __future__ import annotations

from dataclasses import dataclass

from invid_drivers.cia402.objects import Object
from invid_drivers.cia402.stated.manuals import NO, UNKNOWN, YES, Manual


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


def vendor(name: str) -> Vendor | None:
    """The row of that name; ``None`` where there is none."""
    return VENDORS.get(name)
