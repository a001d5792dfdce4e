"""Records side by side in a file under names of their own: ``u_est``, ``y_est`` and ``u_val``, ``y_val``."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from invid.numerics.arrays import Float64
from invid.recording.model import Role

_IDENTIFY = "estimation|est|identify|ident|id|training|train"
_VALIDATE = "validation|validate|valid|val|testing|test"
_ENDING = re.compile(rf"^(.+?)[_. ]?({_IDENTIFY}|{_VALIDATE}|\d+)?$", re.IGNORECASE)


@dataclass(frozen=True)
class NamedRecord:
    """The columns of one record by what their names have in common with those of the others."""

    role: Role
    columns: Mapping[str, str]


def records_by_name(columns: Mapping[str, Float64]) -> list[NamedRecord]:
    """The records that the names of a file's columns tell apart, those to identify first; empty for one.

    Each has the same two columns or more, of one length. Numbers at the end may as well be axes: they are
    records only where the lengths differ.
    """
    by_ending: dict[str, dict[str, str]] = {}
    for name in columns:
        matched = _ENDING.match(name)
        stem, ending = matched.groups(default="") if matched else (name, "")
        by_ending.setdefault(ending.lower(), {})[stem.lower()] = name
    plain = by_ending.pop("", {})
    stems = set.intersection(*(set(group) for group in by_ending.values())) if by_ending else set()
    if stems <= set(plain) and not any(e.isdigit() for e in by_ending):
        by_ending[""] = plain
    records, lengths = [], set()
    for ending, group in by_ending.items():
        own = {stem: group[stem] for stem in group if stem in stems}
        sizes = {columns[name].size for name in own.values()}
        if len(own) < 2 or len(sizes) != 1:
            return []
        lengths |= sizes
        role = Role.VALIDATE if re.fullmatch(_VALIDATE, ending) else Role.IDENTIFY
        records.append(NamedRecord(role, own))
    if len(records) < 2 or (len(lengths) == 1 and any(e.isdigit() for e in by_ending)):
        return []
    return sorted(records, key=lambda record: record.role is Role.VALIDATE)


def only_first(columns: Mapping[str, Float64], records: Sequence[NamedRecord]) -> dict[str, Float64]:
    """The columns without those of all records but the first."""
    beside = {name for record in records[1:] for name in record.columns.values()}
    return {name: column for name, column in columns.items() if name not in beside}


def further_experiments(
    records: Sequence[NamedRecord], is_used: Callable[[str], bool]
) -> list[dict[str, Any]]:
    """Entries of a map for all records but the first, whose columns the map uses."""
    return [
        {
            "rows": [0, None],
            "role": str(record.role),
            "kind": "other",
            "columns": {n: record.columns[stem] for stem, n in records[0].columns.items() if is_used(n)},
        }
        for record in records[1:]
    ]
