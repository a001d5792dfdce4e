"""The case study and its plant, as planned for."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from invid.config import CellConfig, load_config
from invid.planning.belief import Belief
from invid_drivers.simulated import truth

CONFIG = Path(__file__).parents[3] / "configs" / "case-study.yaml"


@pytest.fixture(scope="module")
def cell() -> CellConfig:
    return load_config(CONFIG)


@pytest.fixture(scope="module")
def belief(cell: CellConfig) -> Belief:
    plant = replace(truth(cell), ground_dampers=np.zeros(3))
    return Belief(plant, np.array([0.05, 0.1, 0.2]), np.array([0.1, 0.2, 0.4]), "truth", False)
