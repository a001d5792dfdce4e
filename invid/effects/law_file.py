"""A law without a name as an effect file: its shape is kept, its size is fitted."""

from __future__ import annotations

import keyword

import numpy as np

from invid.effects.laws.empirical_law import IN_SPRING, NAMELESS
from invid.effects.motion_effect import OF_RATE
from invid.effects.registry import effect_of
from invid.errors import InputError
from invid.model.document import EffectTerm

_TEMPLATE = '''"""{title}: found as a law without a name{where}.

{said} Say in title, check and looks_like what it is.
"""

import numpy as np

from invid.effects import Experiment, MotionEffect, Parameter, {places}, {spline}

AT = {at}  # {at_unit}
{across_at}SHAPE = {shape}  # resistance over its largest
LAW = {spline}({knots}, SHAPE)


class {kind}(MotionEffect):
    """Resistance torque·s({letters}), s a spline through the shape."""

    cause, family, over = "{name}", "other", "{over}"
{across}    numbers = (Parameter("torque", "torque"),)
    title = "{title}"
    check = "Look for what acts there."
    separating = Experiment("amplitudes", "the same excitation at another amplitude: its curve stays")
    home = "{home}"

    def places(self, structure):
        return {places}(structure)

    def resistance(self, motion, shape):
        return LAW({quantities})


EFFECT = {kind}()
'''


def law_file(name: str, term: EffectTerm) -> str:
    """Return the text of the effect file of a law without a name; InputError where that is none, or the name
    cannot be used."""
    if not name.isidentifier() or keyword.iskeyword(name) or name != name.lower():
        raise InputError(f"{name!r} is no name of a cause: small letters, digits and _, as churned_oil")
    if effect_of(name) is not None:
        raise InputError(f"{name!r}: there is a cause of that name; choose another")
    table = term.table
    if term.cause != NAMELESS or table is None:
        raise InputError(f"{term.cause} on {term.axis} has a name already; only {NAMELESS} becomes a file")
    size = max(float(np.abs(table.value).max()), 1e-300)
    in_spring, two = table.over in IN_SPRING, bool(table.across)
    said = f"u is the {table.over} [{table.at_unit}]" + (
        f", w the {table.across} [{table.across_unit}]." if two else "."
    )
    return _TEMPLATE.format(
        name=name,
        kind="".join(part.capitalize() for part in name.split("_")) or "Law",
        title=name.replace("_", " ").strip() or name,
        where=f" on {term.axis}" + (f", {term.element}" if term.element else ""),
        said=said,
        letters="u, w" if two else "u",
        spline="surface_law" if two else "spline_law",
        knots="AT, ACROSS" if two else "AT",
        over=table.over,
        across=f'    across = "{table.across}"\n' if two else "",
        across_at=f"ACROSS = {_listed(list(table.across_at))}  # {table.across_unit}\n" if two else "",
        at_unit=table.at_unit,
        at=_listed(list(table.at)),
        shape="np.array(" + _listed([[v / size] for v in table.value]) + ")",
        places="pair_places" if term.other_axis else "spring_places" if in_spring else "mass_places",
        home="spring" if in_spring else "motor",
        quantities=", ".join(
            f"motion.{'velocity' if q in OF_RATE else 'position'}" for q in table.quantities
        ),
    )


def _listed(values: list[float] | list[list[float]]) -> str:
    """Return numbers as Python writes them, six digits, a line for each six."""
    said = [f"[{v[0]:.6g}]" if isinstance(v, list) else f"{v:.6g}" for v in values]
    rows = [", ".join(said[k : k + 6]) for k in range(0, len(said), 6)]
    return "[\n" + "".join(f"    {row},\n" for row in rows) + "]"
