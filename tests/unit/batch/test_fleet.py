"""A fleet beside its baseline: what changed comes first, and an unchanged fleet is left in peace."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from stated_models import model_of

from invid.batch.fleet import compare_fleet, find_baselines, write_changes
from invid.errors import InputError
from invid.model.chains import case_study
from invid.model.document import Model, parameter_vector, save_model

STD = 0.01
NAMES, VALUES = parameter_vector(case_study(damping_ratio=0.01))


def measured(rng: np.random.Generator, **factors: float) -> Model:
    """A model of the case study as a measurement with independent errors gives it; ``A2_mass_3=1.1`` is a
    change of the machine."""
    truth = VALUES * np.array([factors.get(n.replace(".", "_"), 1.0) for n in NAMES])
    found = truth + STD * np.abs(VALUES) * rng.standard_normal(VALUES.size)
    std = STD * np.abs(VALUES)
    return model_of(case_study(damping_ratio=0.01), found, std, covariance=np.diag(std**2))


def saved(folder: Path, model: Model) -> None:
    folder.mkdir(parents=True)
    save_model(model, folder / "model.json")


def test_an_unchanged_fleet_is_called_changed_as_rarely_as_stated(tmp_path: Path) -> None:
    rng, alarms, fleets, cells, alpha = np.random.default_rng(5), 0, 40, 10, 0.05
    for k in range(cells):
        saved(tmp_path / f"cell {k}" / "first", measured(rng))
    now = {f"cell {k}/second.h5": measured(rng) for k in range(cells)}
    for _ in range(fleets):
        for k in range(cells):
            save_model(measured(rng), tmp_path / f"cell {k}" / "first" / "model.json")
        now = {name: measured(rng) for name in now}
        rows = compare_fleet(now, find_baselines(tmp_path, now), alpha)
        alarms += any(r.comparison is None or r.comparison.named for r in rows)
    assert alarms <= 6  # of 40 at 5 %: more in 1.4 % of cases


def test_a_heavier_load_and_a_softer_spring_come_first_in_their_order(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    for k in range(20):
        saved(tmp_path / f"cell {k:02}" / "first", measured(rng))
    changed = {7: {"A2_mass_3": 1.10}, 11: {"A1_spring_1": 0.93}}
    now: dict[str, Model | str] = {
        f"cell {k:02}/second.h5": measured(rng, **changed.get(k, {})) for k in range(20)
    }
    now["cell 03/broken.h5"] = "not a recording"
    rows = compare_fleet(now, find_baselines(tmp_path, now))
    assert [r.recording for r in rows[:2]] == ["cell 07/second.h5", "cell 11/second.h5"]
    assert all(r.comparison is None or not r.comparison.named for r in rows[2:])
    assert next(r for r in rows if "broken" in r.recording).headline == "not a recording"
    with write_changes(tmp_path, rows).open(newline="") as file:
        table = list(csv.DictReader(file))
    assert [(t["rank"], t["parameter"]) for t in table[:2]] == [("1", "A2.mass.3"), ("2", "A1.spring.1")]
    assert float(table[0]["difference"]) == pytest.approx(0.1 * 6.0, abs=0.25)
    assert {t["changed"] for t in table[2:]} == {"no", "cannot tell"}


def test_a_list_of_cells_names_the_models_and_another_file_is_refused(tmp_path: Path) -> None:
    save_model(measured(np.random.default_rng(7)), tmp_path / "seven.json")
    (tmp_path / "cells.yaml").write_text("cell 7/*: seven.json\n")
    names = ["cell 7/a.h5", "cell 8/a.h5"]
    found = find_baselines(tmp_path / "cells.yaml", names)
    assert [len(found[n]) for n in names] == [1, 0]
    (tmp_path / "cells.yaml").write_text("just words\n")
    with pytest.raises(InputError, match="a line each machine"):
        find_baselines(tmp_path / "cells.yaml", names)
