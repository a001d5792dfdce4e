"""Units of parameters, from what kind of quantity they are, on rotary and on linear axes."""

from __future__ import annotations

import re

from invid.errors import InputError

_DIMENSIONS = {
    # (torque, length, second, mass)
    "torque": (1, 0, 0, 0),
    "position": (0, 1, 0, 0),
    "velocity": (0, 1, -1, 0),
    "time": (0, 0, 1, 0),
    "mass": (0, 0, 0, 1),
    "stiffness": (1, -1, 0, 0),
    "damping": (1, -1, 1, 0),
    "cubic": (1, -3, 0, 0),
    "stiffness_rate": (1, -1, -1, 0),
}
_PURE = {"angle": "rad", "count": "1", "ratio": "1"}
_POWERS = {1: "", 2: "²", 3: "³", 4: "⁴", 5: "⁵", 6: "⁶"}


_MADE = "'torque/velocity^2' or 'torque*time'"


def _known() -> str:
    """ "angle (rad), count (1), …": every kind with its unit on a rotary axis."""
    return ", ".join(f"{kind} ({unit_of(kind, False)})" for kind in sorted((*_DIMENSIONS, *_PURE)))


def unit_of(kind: str, linear: bool) -> str:
    """Unit of a kind of quantity: "torque", "damping", "torque/velocity^2", "torque*time", "ratio", …

    Raises
    ------
    InputError
        An unknown kind; the message lists the known ones.
    """
    if kind in _PURE:
        return _PURE[kind]
    if not re.fullmatch(r"[a-z_]+(\^[1-6])?([*/][a-z_]+(\^[1-6])?)*", kind):
        raise InputError(f"unit {kind!r}: it is one of {_known()}, or made of them as {_MADE}")
    total = [0, 0, 0, 0]
    for sign, name, power in re.findall(r"(^|[*/])([a-z_]+)(?:\^([1-6]))?", kind):
        if name not in _DIMENSIONS:
            raise InputError(
                f"unit {kind!r}: no kind of quantity is called {name!r}; known: {_known()}, or made of them "
                f"as {_MADE}"
            )
        for k, own in enumerate(_DIMENSIONS[name]):
            total[k] += own * int(power or 1) * (-1 if sign == "/" else 1)
    names = ("N", "m", "s", "kg") if linear else ("N·m", "rad", "s", "kg·m²")
    above = [f"{n}{_POWERS[p]}" for n, p in zip(names, total, strict=True) if p > 0]
    below = [f"{n}{_POWERS[-p]}" for n, p in zip(names, total, strict=True) if p < 0]
    if not below:
        return "·".join(above) or "1"
    under = "·".join(below)
    return f"{'·'.join(above) or '1'}/{under if len(below) == 1 else f'({under})'}"
