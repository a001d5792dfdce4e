"""``CoupledChains``: matrices by hand, and every refusal in plain words; the JSON contract."""

from __future__ import annotations

import json

import numpy as np

from invid.model.chains import case_study
from invid.model.document import ChainStd, Model, dump_json, model_from_json, model_to_json


def test_the_case_study_has_the_papers_matrices() -> None:
    chains = case_study()
    mass = np.diag([0.7, 2, 3, 4, 5, 6, 7, 8, 9.0])
    mass[2, 5] = mass[5, 2] = 1
    mass[2, 8] = mass[8, 2] = 2
    mass[5, 8] = mass[8, 5] = 3
    np.testing.assert_array_equal(chains.mass_matrix, mass)
    stiffness = chains.stiffness_matrix
    np.testing.assert_array_equal(
        stiffness[:3, :3], [[1000, -1000, 0], [-1000, 3000, -2000], [0, -2000, 2000]]
    )
    np.testing.assert_array_equal(
        stiffness[6:, 6:], [[5000, -5000, 0], [-5000, 11000, -6000], [0, -6000, 6000]]
    )
    np.testing.assert_array_equal(stiffness[:3, 3:], 0)
    np.testing.assert_array_equal(chains.rigid_mass_matrix, [[5.7, 1, 2], [1, 15, 3], [2, 3, 24]])


def test_json_goes_out_and_comes_back_unchanged() -> None:
    chains = case_study(damping_ratio=0.01)
    model = Model("robot", "refined", chains, ChainStd.unknown(chains))
    document = json.loads(dump_json(model_to_json(model)))
    assert document["format"] == "invid-model"
    assert document["branches"][0]["masses"][0] == {"value": 0.7, "std": None}
    back = model_from_json(document).chains
    for mine, theirs in zip(
        back.masses + back.springs + back.dampers,
        chains.masses + chains.springs + chains.dampers,
        strict=True,
    ):
        np.testing.assert_array_equal(mine, theirs)
    np.testing.assert_array_equal(back.couplings, chains.couplings)
