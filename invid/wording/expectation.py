"""Statements that answer what a person said was changed. Their words: ``en.json`` and ``de.json``."""

from __future__ import annotations

import math

from invid.model.expectation import Agreement, Answer, Expectation
from invid.wording.clauses import change_clause
from invid.wording.statement import Figure, Statement, Value


def answer_clause(answer: Answer) -> Statement:
    """Return whether the change found is what was said: "as you said, new load on A2: …"."""
    said = answer.expectation
    values: dict[str, Value] = {"said": said_phrase(said), "axis": said.axis or ""}
    if answer.change is not None:
        values["found"] = change_clause(answer.change)
        values |= _lever(said, answer)
    elif answer.visible is not None:
        values["visible"] = Figure(f"±{answer.visible:.2g} {answer.unit or ''}".rstrip())
    code = f"said.{answer.agreement}"
    if answer.agreement is Agreement.NOT_VISIBLE and answer.visible is not None:
        code += ".beyond"
    return Statement(code, values)


def said_phrase(said: Expectation) -> Statement:
    """Return what was said in a few words: "another tool on A2, about +1.3 kg·m²"."""
    subject = Statement(f"said.{said.subject}")
    where = subject if said.axis is None else Statement("said.on", {"what": subject, "axis": said.axis})
    amount = said.size if said.size is not None else said.mass
    if amount is None:
        return where
    unit = "kg" if said.size is None or said.linear else "kg·m²"
    return Statement("said.about", {"what": where, "size": Figure(f"{amount:+.3g} {unit}".replace("-", "−"))})


def _lever(said: Expectation, answer: Answer) -> dict[str, Value]:
    """Return the mass that was said and the distance from the axis at which it makes what was found."""
    found = None if answer.change is None else answer.change.difference
    if answer.agreement is not Agreement.SIZE_OPEN or not said.mass or found is None:
        return {}
    return {
        "mass": Figure(f"{abs(said.mass):.3g} kg"),
        "arm": Figure(f"{math.sqrt(found / said.mass):.2g} m"),
    }
