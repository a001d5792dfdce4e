"""Where vendors differ from the profile, as rows of a table.

From 16 vendor EDS/DCF files. A row says what the master does instead; whether a drive has an object
is still asked of the drive, because firmware versions differ.
"""

from __future__ import annotations

from dataclasses import dataclass

from invid_drivers.cia402.objects import Object


@dataclass(frozen=True)
class Vendor:
    """One vendor's departures.

    Attributes
    ----------
    torque_limit
        Current limit in mA, where 0x6072 is missing.
    nominal_current
        Current in mA at rated torque, to scale ``torque_limit``.
    velocity_in_rpm
        0x607F is in rpm, not in counts per second.
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


VENDORS: dict[str, Vendor] = {
    "generic": Vendor("generic"),
    "epos4": Vendor(
        "EPOS4",
        torque_limit=Object(0x3001, 2, "I", "output current limit"),
        nominal_current=Object(0x3001, 1, "I", "nominal current"),
        velocity_in_rpm=True,
        advice="give position_rad_per_count and rated_torque_Nm from the motor's data sheet",
    ),
    "elmo_gold": Vendor("Elmo Gold", advice="give rated_torque_Nm: 0x6076 is 0 until it is set"),
    "nanotec_c5e": Vendor(
        "Nanotec C5-E",
        velocity_in_rpm=True,
        zero_as_shipped=("0x6072",),
        advice="0x6072 starts at 0; 0x1016 is missing",
    ),
    "zeroerr_erob": Vendor("ZeroErr eRob", advice="give position_rad_per_count of the motor encoder"),
    "schunk": Vendor("Schunk", advice="has no 0x6071: torque cannot be commanded"),
    "pilz": Vendor("Pilz", advice="has no 0x6071: torque cannot be commanded"),
    "faulhaber_3150": Vendor("Faulhaber 3150", advice="has neither 0x6071 nor 0x6077"),
}


def vendor(name: str) -> Vendor | None:
    """The row of that name; ``None`` where there is none."""
    return VENDORS.get(name)
