"""The case study at 250 Hz with one short experiment, as a document that a test changes further."""

from pathlib import Path
from typing import Any

import yaml

CONFIGS = Path(__file__).parents[2] / "configs"
CYCLE_S = 0.004
"""The machine that runs the tests is busy with other tests."""


def short_case_study(name: str = "case-study.yaml") -> dict[str, Any]:
    """One of the case study's configs with that cycle and experiment."""
    data: dict[str, Any] = yaml.safe_load((CONFIGS / name).read_text(encoding="utf-8"))
    data["bus"]["cycle_s"] = CYCLE_S
    data["experiments"] = [
        {"kind": "multisine", "band_Hz": [1, 12], "period_s": 2.048, "periods": 2, "settle_periods": 0,
         "experiments": 1}
    ]  # fmt: skip
    return data
