"""Draw the pictures of README and docs from a demo's results: `make pictures` (runs the demo first)."""

from __future__ import annotations

import sys
from pathlib import Path

from invid.diagnosis.diagnose import diagnose
from invid.model.document import load_model
from invid.recording import read_recording
from invid.report import data, figures

SHOWN = ("forces",)


def main(demo: Path, out: Path) -> None:
    """Write the figures that README and docs show of the demo in ``demo`` as SVG into ``out``."""
    recording = read_recording(demo / "recording.h5")
    model = load_model(demo / "model.json")
    out.mkdir(parents=True, exist_ok=True)
    drawn = figures.draw(data.figure_data(recording, model, diagnose(recording, model=model)))
    for name in SHOWN:
        svg = drawn[name]
        (out / f"{name}.svg").write_text(svg, encoding="utf-8")
        print(out / f"{name}.svg")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
