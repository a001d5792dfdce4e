"""Changes of parameters and causes as data that a headline is made of (``NamedChange``)."""

from __future__ import annotations

from invid.comparison.changes import CauseChange, CauseStatus, Change
from invid.model.named_change import ChangeKind, NamedChange

_KINDS = {
    "inertia": ChangeKind.INERTIA,
    "spring": ChangeKind.SPRING,
    "ground_spring": ChangeKind.GROUND_SPRING,
    "damper": ChangeKind.DAMPER,
    "coupling": ChangeKind.COUPLING,
    "effect": ChangeKind.EFFECT,
}
_CAUSES = {
    CauseStatus.APPEARED: ChangeKind.APPEARED,
    CauseStatus.GREW: ChangeKind.GREW,
    CauseStatus.SHRANK: ChangeKind.SHRANK,
    CauseStatus.GONE: ChangeKind.GONE,
}


def named_change(c: Change, *, matters: bool = True) -> NamedChange:
    """Return a parameter with its change."""
    tail = c.name.rpartition(".")[2]
    number = int(tail) if tail.isdigit() and c.kind in ("mass", "spring", "damper") else None
    if c.kind == "mass":
        kind = ChangeKind.LOAD if c.final else ChangeKind.MOTOR_MASS if number == 1 else ChangeKind.MASS
    else:
        kind = _KINDS[c.kind]
    other = c.other_axis
    if kind is ChangeKind.COUPLING:
        other = c.name.removesuffix(".coupling").removeprefix(f"{c.axis}-")
    known = c.difference is not None and c.scale > 0
    return NamedChange(
        kind,
        c.axis,
        c.name,
        number,
        other,
        c.cause,
        c.element,
        tail if kind is ChangeKind.EFFECT else None,
        c.old,
        c.new,
        c.difference,
        c.std,
        c.unit,
        (c.difference or 0.0) / c.scale if known else None,
        matters,
    )


def named_cause(c: CauseChange, *, matters: bool = True) -> NamedChange:
    """Return a cause with what became of it."""
    scale = 0.0 if c.old is None else abs(c.old.value)
    return NamedChange(
        _CAUSES.get(c.status, ChangeKind.EFFECT),
        c.axis,
        c.name,
        None,
        c.other_axis,
        c.cause,
        c.element,
        c.parameter if c.status in _CAUSES else None,
        c.old,
        c.new,
        c.difference,
        c.std,
        c.unit,
        c.difference / scale if c.difference is not None and scale > 0 else None,
        matters,
    )
