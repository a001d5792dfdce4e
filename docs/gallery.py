"""Writes build/gallery: a page (gallery.md) with a picture a cause: python docs/gallery.py

One cause at a time is hidden in a simulated axis by the generator of tests/hidden, the recording is
diagnosed, and what the report shows is drawn; the words are those of the effect in the catalogue.
"""

from __future__ import annotations

import sys
from pathlib import Path

DOCS = Path(__file__).resolve().parent
sys.path.insert(0, str(DOCS.parent / "tests"))

from hidden.generator import make

import invid
from invid.effects.effect import Effect
from invid.effects.registry import BY_CAUSE
from invid.model.diagnosis_document import Finding
from invid.report import data, figures

SHOWN = {
    "coulomb_friction": 0, "viscous_friction": 0, "stribeck_friction": 1, "asymmetric_friction": 1,
    "presliding_friction": 0, "cogging": 0, "gravity": 0, "backlash": 1, "cubic_stiffness": 0,
    "spring_hysteresis": 0, "transmission_error": 0, "extra_mode": 0, "torque_saturation": 0,
}  # fmt: skip
"""Cause and the seed of its draw: one of which it is named. Examples, no statistics."""
HEAD = """# Gallery: from picture to cause to repair

Each picture of the report shows the torque that the linear model misses (dots) and the named cause (line).
Simulated: one axis, one hidden cause of 25 dB over the noise. Written by `python docs/gallery.py`. Laws and
look-alikes: `docs/reference/causes.md`.
"""


def main() -> None:
    """Draw all."""
    folder = DOCS.parent / "build" / "gallery"
    folder.mkdir(parents=True, exist_ok=True)
    parts = [HEAD]
    for cause, seed in SHOWN.items():
        recording, _ = make(cause, seed=seed, target_db=25.0, motors=1)
        diagnosis = invid.diagnose(recording)
        found = [f for f in diagnosis.findings if f.cause == cause]
        if not found:
            raise SystemExit(f"{cause}, seed {seed}: not named ({[f.cause for f in diagnosis.findings]})")
        drawn = figures.draw(data.figure_data(recording, diagnosis.model, diagnosis))
        name = f"cause-{diagnosis.findings.index(found[0]) + 1}"
        if name not in drawn:  # no law over one quantity: what is missing over frequency
            name = "missing-torque"
        (folder / f"{cause}.svg").write_text(drawn[name], encoding="utf-8")
        parts.append(entry(BY_CAUSE[cause], found[0]))
        print(f"{cause}: {found[0].confidence:.2f}")
    (folder / "gallery.md").write_text("\n".join(parts), encoding="utf-8")


def entry(effect: Effect, finding: Finding) -> str:
    """One cause: its picture, what was found, what to do."""
    lines = [
        f"## {effect.title[0].upper()}{effect.title[1:]}",
        "",
        f"![Missing torque and fitted cause]({effect.cause}.svg)",
        "",
        f"`{effect.cause}`, {finding.element or finding.axis}. {effect.check}",
        "",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    main()
