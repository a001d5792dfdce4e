"""What the words of a command claim of an axis: the only place that knows how the product speaks."""

from __future__ import annotations

import re
from typing import Any

HELD_BY_DRIVE, HELD_BY_BRAKE, NOT_HELD, ENERGISED, LATE_COMPUTER = (
    "held by its drive", "held by its brake", "not held", "energised", "the computer was late",
)  # fmt: skip

PHRASES = (
    (NOT_HELD, r"not held|nothing holds|without torque|support|falls|let it fall|not seen to|does not hold"
               r"|cannot hold|free to|may move|make sure|gives less|not to hold|too late|sink|is in danger"),
    (HELD_BY_DRIVE, r"held by its drive|its drive holds it\b"),
    (HELD_BY_BRAKE, r"its brake holds it\b|held by its brake"),
    (ENERGISED, r"energised|under power|still enabled|is not off"),
)  # fmt: skip
"""A sentence with the first of these that fits is a claim of the axes that it names."""
GENERAL = re.compile(
    r"after (?:a )?|next time|before|so that|as long as|to have it off|where it carries", re.I
)
LATE = re.compile(r"computer was late", re.I)


def sentences(words: str) -> list[str]:
    """One a line, or between full stops."""
    return [
        s for line in words.splitlines() for s in re.split(r"(?<=[a-z)\]])[.;](?:\s|$)", line) if s.strip()
    ]


def claims(words: str, document: dict[str, Any], axes: list[str]) -> dict[str, dict[str, str]]:
    """Axis to claim to the sentence that makes it; the document's list of the energised too."""
    found: dict[str, dict[str, str]] = {name: {} for name in axes}
    for name in document.get("energised") or ():
        found[name][ENERGISED] = "energised"
    last: list[str] = []
    for line in words.splitlines():
        last = []
        for sentence in sentences(line):
            named = [n for n in axes if re.search(rf"\b{re.escape(n)}\b", sentence)] or last
            last = named
            for claim, pattern in PHRASES:
                if re.search(pattern, sentence, re.I):
                    for name in named:
                        found[name].setdefault(claim, sentence.strip())
    return found
