"""A law given by a table: resistance over one quantity of the motion, with its covariance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from invid.errors import ModelError


@dataclass(frozen=True)
class LawTable:
    """Resistance [N·m or N] at knots of one quantity, a natural cubic spline between them.

    Attributes
    ----------
    over
        The quantity: "velocity", "position", "deflection" or "deflection rate".
    at, at_unit
        (k,) knots, ascending, and their unit.
    value, unit
        (k,) resistance at the knots, and its unit.
    covariance
        (k, k) of the resistances. What the model fits beside the law (an offset, a stiffness) is not in it.
    """

    over: str
    at: tuple[float, ...]
    at_unit: str
    value: tuple[float, ...]
    unit: str
    covariance: tuple[tuple[float, ...], ...]

    @property
    def std(self) -> tuple[float, ...]:
        """(k,) standard deviations of the resistances."""
        return tuple(float(np.sqrt(max(row[k], 0.0))) for k, row in enumerate(self.covariance))

    @property
    def is_known(self) -> bool:
        """Whether its largest is above three standard deviations, of any knot: the rest of the model may undo
        it else."""
        return 3.0 * max(self.std) < max(abs(v) for v in self.value)


def table_to_json(table: LawTable) -> dict[str, Any]:
    """Return the parameters ``over`` and ``table`` of the contract."""
    return {
        "over": {"value": table.over, "std": 0.0, "unit": table.at_unit},
        "table": {
            "at": list(table.at),
            "value": list(table.value),
            "std": list(table.std),
            "unit": table.unit,
            "covariance": [list(row) for row in table.covariance],
        },
    }


def table_from_json(parameters: Mapping[str, Any], where: str) -> LawTable:
    """Return the table of the parameters ``over`` and ``table``; ModelError where they are none."""
    over, given = parameters.get("over"), parameters["table"]
    try:
        found = LawTable(
            str(over["value"] if isinstance(over, Mapping) else over),
            tuple(float(v) for v in given["at"]),
            str(over.get("unit", "") if isinstance(over, Mapping) else ""),
            tuple(float(v) for v in given["value"]),
            str(given.get("unit", "")),
            tuple(tuple(float(v) for v in row) for row in given["covariance"]),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ModelError(
            f"{where}: table: {type(error).__name__}: {error}; it needs over and table with at, value and "
            "covariance"
        ) from None
    count = len(found.at)
    sizes = {len(found.value), len(found.covariance), *map(len, found.covariance)}
    if count < 2 or sizes != {count}:
        raise ModelError(
            f"{where}: table: {count} knots and {len(found.value)} values; it needs as many of both, at "
            "least 2, and a covariance of that many rows and columns"
        )
    if not np.isfinite([*found.at, *found.value, *sum(found.covariance, ())]).all():
        raise ModelError(f"{where}: table: its numbers must be finite")
    if not (np.diff(found.at) > 0).all():
        raise ModelError(f"{where}: table: its knots must ascend; found {list(found.at)}")
    return found
