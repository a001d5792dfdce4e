"""Where real drives' object dictionaries depart from the generic one, as rows of a table.

From 16 vendor EDS/DCF files (see docs/explanations/simulated-cell.md). ``lacks`` are objects that do
not exist, ``values`` start values that differ, ``rpdos``/``tpdos`` the number of PDOs.
"""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Profile:
    """One vendor's departures."""

    lacks: frozenset[int] = frozenset()
    values: dict[tuple[int, int], int | str] = field(default_factory=dict)
    rpdos: int = 4
    tpdos: int = 4
    velocity_in_rpm: bool = False
    """0x607F is in rpm, not in counts per second."""


_NO_TORQUE = frozenset({0x6071, 0x6072, 0x6076, 0x605A, 0x6007, 0x6087})
_NO_GEAR = frozenset({0x608F, 0x6091, 0x6092})
_DUMMIES = frozenset(range(2, 8))

PROFILES: dict[str, Profile] = {
    "generic": Profile(),
    "epos4": Profile(
        lacks=_NO_GEAR | _DUMMIES | {0x6072},
        values={(0x6076, 0): 0, (0x605A, 0): 6, (0x6007, 0): 3, (0x1008, 0): "EPOS4 (simulated)"},
        velocity_in_rpm=True,
    ),
    "elmo_gold": Profile(
        values={(0x6076, 0): 0, (0x605A, 0): 2, (0x6007, 0): 1, (0x1008, 0): "Gold (simulated)"}
    ),
    "nanotec_c5e": Profile(
        lacks=frozenset({0x6076, 0x6007, 0x1016}),
        values={(0x6072, 0): 0, (0x605A, 0): 1, (0x1008, 0): "C5-E (simulated)"},
        rpdos=8,
        tpdos=8,
        velocity_in_rpm=True,
    ),
    "zeroerr_erob": Profile(
        lacks=frozenset({0x6072, 0x605A, 0x6007}) | _NO_GEAR, values={(0x1008, 0): "eRob (simulated)"}
    ),
    "schunk": Profile(
        lacks=_NO_TORQUE | _NO_GEAR,
        values={(0x6502, 0): 0x43, (0x1008, 0): "Schunk (simulated)"},
        rpdos=2,
    ),
    "pilz": Profile(
        lacks=_NO_TORQUE | _NO_GEAR, values={(0x6502, 0): 0x43, (0x1008, 0): "PRBT (simulated)"}, rpdos=2
    ),
    "faulhaber_3150": Profile(
        lacks=_NO_TORQUE | {0x6077},
        values={(0x6502, 0): 0x00000080, (0x1008, 0): "3150 (simulated)"},
    ),
}
