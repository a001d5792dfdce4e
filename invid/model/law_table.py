"""A law given by a table: resistance over one or two quantities of the motion, with its covariance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import chain
from math import prod
from typing import Any

import numpy as np

from invid.errors import ModelError


@dataclass(frozen=True)
class LawTable:
    """Resistance [N·m or N] at knots of one quantity, or of two, natural cubic splines between them.

    Attributes
    ----------
    over
        The quantity: "velocity", "position", "deflection" or "deflection rate".
    at, at_unit
        (k,) knots, ascending, and their unit.
    value, unit
        (k,) resistance at the knots, and its unit; of two quantities (k·l,), all knots of the second at the
        first of the first, and so on.
    covariance
        Of the resistances. What the model fits beside the law (an offset, a stiffness) is not in it.
    across, across_at, across_unit
        The second quantity, its (l,) knots and their unit; "" and none for a law over one.
    """

    over: str
    at: tuple[float, ...]
    at_unit: str
    value: tuple[float, ...]
    unit: str
    covariance: tuple[tuple[float, ...], ...]
    across: str = ""
    across_at: tuple[float, ...] = ()
    across_unit: str = ""

    @property
    def quantities(self) -> tuple[str, ...]:
        """One quantity or two."""
        return (self.over, self.across) if self.across else (self.over,)

    @property
    def std(self) -> tuple[float, ...]:
        """(k,) standard deviations of the resistances."""
        return tuple(float(np.sqrt(max(row[k], 0.0))) for k, row in enumerate(self.covariance))


def table_to_json(table: LawTable) -> dict[str, Any]:
    """Return the parameters ``over``, ``across`` where there is one, and ``table`` of the contract."""
    two = bool(table.across)
    across = {"across": {"value": table.across, "std": 0.0, "unit": table.across_unit}} if two else {}
    return {
        "over": {"value": table.over, "std": 0.0, "unit": table.at_unit},
        **across,
        "table": {
            "at": list(table.at),
            **({"across_at": list(table.across_at)} if two else {}),
            "value": list(table.value),
            "std": list(table.std),
            "unit": table.unit,
            "covariance": [list(row) for row in table.covariance],
        },
    }


def table_from_json(parameters: Mapping[str, Any], where: str) -> LawTable:
    """Return the table that ``over``, ``across`` and ``table`` state; ModelError where they state none."""
    given = parameters["table"]
    (over, unit), (across, across_unit) = (_quantity(parameters.get(key)) for key in ("over", "across"))
    try:
        found = LawTable(
            over,
            tuple(float(v) for v in given["at"]),
            unit,
            tuple(float(v) for v in given["value"]),
            str(given.get("unit", "")),
            tuple(tuple(float(v) for v in row) for row in given["covariance"]),
            across,
            tuple(float(v) for v in given["across_at"]) if across else (),
            across_unit,
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ModelError(
            f"{where}: table: {type(error).__name__}: {error}; it needs over and table with at, value and "
            "covariance"
        ) from None
    axes = (found.at, found.across_at) if across else (found.at,)
    count = prod(map(len, axes))
    sizes = {len(found.value), len(found.covariance), *map(len, found.covariance)}
    if min(map(len, axes)) < 2 or sizes != {count}:
        raise ModelError(
            f"{where}: table: {count} knots and {len(found.value)} values; it needs as many of both, at "
            "least 2, and a covariance of that many rows and columns"
        )
    if not np.isfinite([*found.at, *found.across_at, *found.value, *chain(*found.covariance)]).all():
        raise ModelError(f"{where}: table: its numbers must be finite")
    for knots in axes:
        if not (np.diff(knots) > 0).all():
            raise ModelError(f"{where}: table: its knots must ascend; found {list(knots)}")
    return found


def _quantity(given: object) -> tuple[str, str]:
    """Name and unit of a quantity as the contract states it; "" where it does not."""
    if isinstance(given, Mapping):
        return str(given.get("value", "")), str(given.get("unit") or "")
    return "" if given is None else str(given), ""
