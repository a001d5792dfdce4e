"""Draws the README's pictures from a demo's results: `make pictures` (runs the demo first)."""

from __future__ import annotations

import sys
from pathlib import Path

from invid.discrepancy import diagnose
from invid.model import load_model
from invid.recording import read_recording
from invid.report.figures import figures


def main(demo: Path, out: Path) -> None:
    """Write every figure of the report of the demo in ``demo`` as SVG into ``out``."""
    recording = read_recording(demo / "recording.h5")
    model = load_model(demo / "model.json")
    out.mkdir(parents=True, exist_ok=True)
    for name, svg in figures(recording, model, diagnose(recording, model=model)).items():
        (out / f"{name}.svg").write_text(svg, encoding="utf-8")
        print(out / f"{name}.svg")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
