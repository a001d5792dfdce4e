"""What changed since a baseline, over a whole fleet: one rate of false alarms, the weightiest change first.

A recording is compared with the models of its own machine: those at its own path below the baseline folder,
else all in its folder there (the cell), averaged where they agree; or those that a list of cells names. Each
comparison has two families (parameters, causes); with n machines compared each is tested at α/(2n), so that
anything is called changed on an unchanged fleet with a probability of at most α (Bonferroni).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import yaml

from invid.comparison.changes import Comparison
from invid.comparison.compare import compare
from invid.errors import InputError, InvidError
from invid.model.diagnosis_document import load_model, model_of
from invid.model.document import Model, csv_text, save_text
from invid.model.named_change import NamedChange

FALSE_ALARMS = 0.01
"""Probability of calling anything changed in a whole fleet that did not."""
CHANGES = "changes.csv"
_COLUMNS = ("rank", "recording", "changed", "axis", "parameter", "difference", "std", "unit", "headline")
_DOCUMENTS = ("diagnosis.json", "model.json")


@dataclass(frozen=True)
class FleetRow:
    """One recording beside its baseline; ``comparison`` is ``None`` where ``why`` says why there is none."""

    recording: str
    baseline: tuple[str, ...]
    comparison: Comparison | None
    why: str = ""

    @property
    def headline(self) -> str:
        """What changed, for a person."""
        return self.why if self.comparison is None else self.comparison.headline

    @property
    def named(self) -> tuple[NamedChange, ...]:
        """What changed."""
        return () if self.comparison is None or not self.comparison.told else self.comparison.named

    @property
    def weight(self) -> tuple[bool, bool, float]:
        """Order in the fleet: what matters first, then what changed at all, the largest share first."""
        named = self.named
        return (
            not any(c.matters for c in named),
            not named,
            -max((abs(c.share or 0.0) for c in named), default=0.0),
        )

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        found = None if self.comparison is None else self.comparison.to_json()
        document = {"recording": self.recording, "baseline": list(self.baseline), "headline": self.headline}
        return {**document, "comparison": found}


def find_baselines(where: Path, recordings: Iterable[str]) -> dict[str, list[Path]]:
    """Model files of each recording's machine, oldest name first; empty where there is none.

    ``where``: a folder as ``invid batch`` writes it, or of models by the cells' names; or a YAML file that
    says ``pattern of recordings: model file, or a list of them`` (from its own folder).
    """
    if where.is_dir():
        return {name: _in_folder(where, name) for name in recordings}
    try:
        stated = yaml.safe_load(where.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise InputError(f"--baseline {where}: neither a folder nor a list of cells: {error}") from None
    if not isinstance(stated, dict):
        raise InputError(
            f"--baseline {where}: it must say 'cell 7/*: models/cell7.json', a line each machine"
        )
    found: dict[str, list[Path]] = {}
    for name in recordings:
        files: Any = next((f for pattern, f in stated.items() if fnmatch(name, str(pattern))), [])
        found[name] = [where.parent / str(f) for f in (files if isinstance(files, list) else [files])]
    return found


def _in_folder(folder: Path, name: str) -> list[Path]:
    own = folder / Path(name).with_suffix("")
    places = [own, *sorted(p for p in own.parent.glob("*") if p.is_dir() and p != own)]
    if own.is_dir() or own.parent == folder:
        places = [own]
    files = [next((p / d for d in _DOCUMENTS if (p / d).is_file()), None) for p in places]
    named = [p.with_name(f"{p.name}.json") for p in (own, own.parent)]
    return [f for f in files if f is not None] or [f for f in named if f.is_file()][:1]


def compare_fleet(
    models: Mapping[str, Model | str], baselines: Mapping[str, list[Path]], alpha: float = FALSE_ALARMS
) -> list[FleetRow]:
    """Every recording beside its baseline, the weightiest change first.

    ``models``: the model of each recording, or why it has none.
    """
    tested = sum(not isinstance(m, str) and bool(baselines[name]) for name, m in models.items())
    each = alpha / (2 * max(tested, 1))
    rows = [_row(name, model, baselines[name], each) for name, model in models.items()]
    return sorted(rows, key=lambda r: (r.weight, r.recording))


def _row(name: str, model: Model | str, files: list[Path], alpha: float) -> FleetRow:
    shown = tuple(map(str, files))
    if isinstance(model, str):
        return FleetRow(name, shown, None, model)
    if not files:
        return FleetRow(name, (), None, "no baseline: nothing to compare with")
    try:
        *before, old = [load_model(f) for f in files]
        return FleetRow(name, shown, compare(old, model_of(model), before=before, alpha=alpha))
    except InvidError as error:
        return FleetRow(name, shown, None, f"not compared: {error}")


def write_changes(folder: Path, rows: Iterable[FleetRow]) -> Path:
    """Write ``changes.csv``: a line each change, or each recording without one, in the order of the fleet."""
    table: list[tuple[object, ...]] = []
    for rank, row in enumerate(rows, 1):
        for c in row.named:
            size = ("" if v is None else f"{v:.6g}" for v in (c.difference, c.std))
            table.append((rank, row.recording, "yes", c.axis, c.name or c.cause, *size, c.unit, row.headline))
        if not row.named:
            is_told = row.comparison is not None and row.comparison.told
            status = "no" if is_told else "cannot tell"
            table.append((rank, row.recording, status, "", "", "", "", "", row.headline))
    path = folder / CHANGES
    save_text(path, csv_text(_COLUMNS, table))
    return path
