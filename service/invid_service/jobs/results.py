"""Keep what a run leaves: files in the store, its model in the history, the comparison with the model in
force.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from typing import Any

from sqlalchemy.exc import SQLAlchemyError

from invid.comparison.answers import answer_expectation, judge_screening
from invid.comparison.changes import Comparison
from invid.comparison.compare import compare
from invid.diagnosis.headline import Beside, with_headline
from invid.errors import InvidError
from invid.model.diagnosis_document import Diagnosis, diagnosis_to_json, load_diagnosis
from invid.model.document import Model, dump_json, model_from_json, parse_json, save_text
from invid.model.doubts import Doubt, DoubtCode
from invid.model.expectation import Agreement, Answer
from invid_service.cells.changes import changes_view
from invid_service.jobs.doubts import doubt_view, doubts_against
from invid_service.jobs.folder import complete_recording
from invid_service.jobs.stated_change import StatedChange
from invid_service.settings import Settings
from invid_service.store.blobs import KINDS, Blobs
from invid_service.store.store import RunRecord, Store, StoredModel

log = logging.getLogger(__name__)
HISTORY = 40
"""Models of a cell that its repeatability is judged on."""


class Results:
    """Store files and models of runs; synchronous, called from threads."""

    def __init__(self, store: Store, blobs: Blobs, settings: Settings) -> None:
        self._store, self._blobs, self._settings = store, blobs, settings

    def keep(self, run: RunRecord, now: datetime) -> set[str]:
        """Move what the runner wrote into the store; return the kinds that are safe there. Twice is no
        error.
        """
        folder = self._blobs.work / run.id
        blobs = {}
        complete_recording(folder)
        for kind, (name, _media) in KINDS.items():
            blob = self._blobs.put(run.id, kind, folder / name)
            if blob is not None:
                blobs[kind] = blob
        if blobs:
            self._store.add_artefacts(run.id, blobs, now)
        if run.cell is not None and "model" in blobs and "diagnosis" in blobs:
            text = self._blobs.path(blobs["model"].path).read_text(encoding="utf-8")
            self._store.add_model(StoredModel(run.id, run.cell, now, run.mode, text))
        return set(blobs)

    def clear(self, run_id: str) -> None:
        """Delete the working folder; the tail of the runner's log goes to ours."""
        log_file = self._blobs.work / run_id / "worker.log"
        try:
            tail = log_file.read_text(encoding="utf-8", errors="replace")[-2000:].strip()
        except OSError:
            tail = ""
        if tail:
            log.info("run %s: log of the runner: %s", run_id, tail)
        self._blobs.clear_scratch(run_id)

    def in_force(self, cell: str) -> StoredModel | None:
        """Return the accepted model."""
        approvals = self._store.approvals(cell)
        return self._store.model(cell, approvals[0].model) if approvals else None

    def changes(
        self, cell: str, old: StoredModel, new: StoredModel, *, averaged: bool
    ) -> tuple[Comparison, tuple[list[str], list[str]]]:
        """Return what changed between two models, with this cell's repeatability, and the models behind
        either side.

        ``averaged``: accepted runs before each of the two that agree with it are averaged with it.
        """
        loaded: dict[str, Model] = {}
        history = []
        for stored in reversed(self._store.models(cell, HISTORY)):
            if stored.mode == new.mode or stored.id in (old.id, new.id):
                try:
                    loaded[stored.id] = load(stored)
                except InvidError as error:
                    log.warning("model %s is left out of the history: %s", stored.id, error)
                    continue
                history.append(loaded[stored.id])
        before, after = self._accepted_around(cell, old, new) if averaged else ([], [])
        before, after = ([m for m in side if m in loaded] for side in (before, after))
        found = compare(
            loaded.get(old.id) or load(old),
            loaded.get(new.id) or load(new),
            history=history,
            before=[loaded[m] for m in before],
            after=[loaded[m] for m in after],
            tolerance=self._settings.unchanged_percent / 100.0,
        )
        return found, ([*before, old.id][-found.runs[0] :], [*after, new.id][-found.runs[1] :])

    def _accepted_around(self, cell: str, old: StoredModel, new: StoredModel) -> tuple[list[str], list[str]]:
        """Return the models accepted before ``old``, and between ``old`` and ``new``; oldest first, each
        once.
        """
        newest_first = list(dict.fromkeys(a.model for a in self._store.approvals(cell)))
        if old.id not in newest_first:
            return [], []
        at = newest_first.index(old.id)
        start = newest_first.index(new.id) + 1 if new.id in newest_first[:at] else 0
        before = [m for m in reversed(newest_first[at + 1 :]) if m != new.id]
        return before[-HISTORY:], list(reversed(newest_first[start:at]))[-HISTORY:]

    def concluded(self, run: RunRecord, summary: dict[str, Any], now: datetime) -> dict[str, Any]:
        """Return the summary of a fresh result with what changed since the model in force: headline, grade,
        doubts.

        The stored diagnosis says the same.
        """
        doubts = doubts_against(run.mode, summary)
        summary = {**summary, "doubts": [doubt_view(d) for d in doubts]}
        try:
            found = self._against_accepted(run)
            if found is not None:
                summary["changes"] = found[1]
            answer = _answer(run, None if found is None else found[0], doubts)
            summary["answer"] = None if answer is None else str(answer.agreement)
            diagnosis = self._diagnosis(run)
            if diagnosis is None:
                return {**summary, **({} if found is None else {"headline": found[1]["headline"]})}
            test = next((d for d in doubts if d.code is DoubtCode.TEST), None)
            beside = Beside(test, answer)
            if run.mode == "screen" and found is not None:
                screening = judge_screening(diagnosis, found[2], found[0], beside)
                told = screening.diagnosis or diagnosis
                summary["screening"] = {"verdict": screening.verdict, "changed": list(screening.changed)}
                summary["findings"] = []
            else:
                changes = None if found is None else found[0].named
                told = with_headline(replace(diagnosis, changes=changes), beside)
            self._rewrite(run, told, now)
        except (InvidError, SQLAlchemyError, OSError) as error:
            log.error("run %s: no comparison with the accepted model: %s", run.id, error)
            return summary
        grade = None if told.grade is None else str(told.grade)
        return {**summary, "headline": told.headline, "grade": grade}

    def _against_accepted(self, run: RunRecord) -> tuple[Comparison, dict[str, Any], Model] | None:
        """Return what changed since the model in force, how the interface shows it, and that model; ``None``
        without one.
        """
        if run.cell is None:
            return None
        old, new = self.in_force(run.cell), self._store.model(run.cell, run.id)
        if old is None or new is None:
            return None
        found, sides = self.changes(run.cell, old, new, averaged=True)
        return found, {"from": old.id, **changes_view(found, sides)}, load(old)

    def _diagnosis(self, run: RunRecord) -> Diagnosis | None:
        """Return the stored diagnosis; ``None`` where there is none that can be read."""
        blob = self._store.artefacts(run.id).get("diagnosis")
        if blob is None:
            return None
        try:
            return load_diagnosis(self._blobs.path(blob.path))
        except InvidError as error:
            log.error("run %s: its diagnosis cannot be read: %s", run.id, error)
            return None

    def _rewrite(self, run: RunRecord, diagnosis: Diagnosis, now: datetime) -> None:
        """Store the diagnosis with what the comparison added; the runner knows no accepted model."""
        text = dump_json({**diagnosis_to_json(diagnosis), "simulated": run.simulated})
        source = self._blobs.scratch(run.id) / KINDS["diagnosis"][0]
        save_text(source, text)
        blob = self._blobs.put(run.id, "diagnosis", source)
        if blob is not None:
            self._store.add_artefacts(run.id, {"diagnosis": blob}, now)


def _answer(run: RunRecord, found: Comparison | None, doubts: Sequence[Doubt]) -> Answer | None:
    """Return the answer to whoever said at the start what was changed."""
    said = run.facts.get("changed")
    if said is None:
        return None
    linear = found is not None and any(p.kind == "mass" and p.unit == "kg" for p in found.parameters)
    expectation = StatedChange.model_validate(said).expectation(linear=linear)
    if found is not None and any(d.spoils_changes for d in doubts):
        return Answer(expectation, Agreement.CANNOT_TELL)
    return answer_expectation(expectation, found)


def load(stored: StoredModel) -> Model:
    """Return a stored model; ModelError where the text is damaged."""
    return model_from_json(parse_json(stored.document), source=f"model {stored.id}")
