"""What the words of a command claim of an axis: the only place that knows how the product speaks.

A document may say it as data instead: ``axes``, a list of objects with ``name`` and ``state``, the state one
of the values of ``SAID_STATES``; then the words count no more.
"""

import re
from typing import Any

HELD_BY_DRIVE, HELD_BY_BRAKE, NOT_HELD, ENERGISED, NO_TORQUE = (
    "held by its drive", "held by its brake", "not held", "energised", "without torque",
)  # fmt: skip
SAID_STATES = {
    "held by drive": HELD_BY_DRIVE, "held by brake": HELD_BY_BRAKE, "not held": NOT_HELD,
    "energised": ENERGISED,
}  # fmt: skip

UNHELD = (
    r"not held|nothing (?:holds|was seen)|falls|let it fall|not seen to|does not hold|cannot hold|may move"
    r"|make sure|gives (?:less|too little)|not to hold|too late|sink|is in danger|support"
)
PHRASES = (
    (NO_TORQUE, r"is without torque"),
    (NOT_HELD, UNHELD),
    (HELD_BY_DRIVE, r"held by its drive|its drive holds it\b"),
    (HELD_BY_BRAKE, r"its brake holds it\b|held by its brake"),
    (ENERGISED, r"energised|under power|still enabled|is not off"),
)
"""A sentence claims what the first of these that fits says, of the axes that it names or that the one before
named."""
CONDITIONAL = re.compile(
    r"to have it off|after a fault of|where it carries|was not seen yet|it is not known that|"
    r"so that it cannot fall|will move:",
    re.I,
)
"""What would be, or what to do: claims nothing of how an axis is left."""
LATE = re.compile(r"computer was late", re.I)


def sentences(line: str) -> list[str]:
    """What stands between full stops."""
    return [s.strip() for s in re.split(r"(?<=[a-z)\]`])\.(?:\s|$)", line) if s.strip()]


def claims(words: str, document: dict[str, Any], axes: list[str]) -> dict[str, dict[str, str]]:
    """Axis to claim to the sentence that makes it; the document's list of the energised too."""
    found: dict[str, dict[str, str]] = {name: {} for name in axes}
    for name in document.get("energised") or ():
        found[name][ENERGISED] = "energised"
    said = [a for a in document.get("axes") or () if isinstance(a, dict) and a.get("state") in SAID_STATES]
    for axis in said:
        found[axis["name"]][SAID_STATES[axis["state"]]] = axis["state"]
    if said:
        return found
    for line in words.splitlines():
        last: list[str] = []
        for sentence in sentences(line):
            last = [n for n in axes if re.search(rf"\b{re.escape(n)}\b", sentence)] or last
            if CONDITIONAL.search(sentence):
                continue
            for claim, pattern in PHRASES:
                if re.search(pattern, sentence, re.I):
                    for name in last:
                        found[name].setdefault(claim, sentence)
                    break
    return found
