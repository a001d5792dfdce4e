"""What a search found, judged on its records and by the extended model simulated over time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

from invid.diagnosis.search_pass import SearchPass
from invid.diagnosis.selection import Selection
from invid.diagnosis.time_domain_check import REFUSED, Replay, add_time_domain_check, simulate_held_out
from invid.diagnosis.verdict import build_diagnosis, extended_model
from invid.likelihood.null_test import null_test
from invid.model.diagnosis_document import Diagnosis
from invid.model.document import model_to_json
from invid.numerics import budget


class Simulated(NamedTuple):
    """A selection with the uncertainty that its simulation shows, its diagnosis, and whether the simulation
    refuses its causes."""

    selection: Selection
    diagnosis: Diagnosis
    is_refused: bool = False


@dataclass(frozen=True, eq=False)
class JudgedSearch:
    """A search whose selections are judged; ``warnings`` are beside its own."""

    search: SearchPass
    warnings: list[str]

    def diagnosis(self, selection: Selection, *, is_refused: bool = False) -> Diagnosis:
        """The diagnosis of a selection by its residuals alone."""
        s, more = self.search, [REFUSED] if is_refused else []
        warnings = [*s.warnings, *self.warnings, *more]
        parts = (s.recording, s.model, selection, s.bare, s.train, s.held, s.tones, warnings)
        return build_diagnosis(*parts, is_refused=is_refused)

    def simulated(self, selection: Selection, result: Diagnosis) -> Simulated:
        """A selection and its diagnosis after its extended model was simulated over time."""
        if not result.findings or budget.is_left_out("the extended model simulated over time"):
            return Simulated(selection, result)
        answer, held = self._simulate(selection, result), self.search.held
        if isinstance(answer, str):
            return Simulated(selection, self._with_simulation(result, answer))
        reached = selection.final.held
        is_lost = answer.is_lost and not null_test(reached.cost, reached.dof, held).rejects
        is_refused = answer.is_refused and not is_lost
        if is_refused:
            result = self.diagnosis(selection, is_refused=True)
        elif not is_lost:
            selection = selection.widen_covariance(answer.shift)
            result = self.diagnosis(selection)
        return Simulated(selection, self._with_simulation(result, answer, is_lost=is_lost), is_refused)

    def _simulate(self, selection: Selection, result: Diagnosis) -> Replay | str:
        s = self.search
        linear = extended_model(s.model, s.bare, ())
        return simulate_held_out(s.recording, s.spectra, linear, result.model, selection.final.fit, s.held)

    def _with_simulation(
        self, result: Diagnosis, answer: Replay | str, *, is_lost: bool = False
    ) -> Diagnosis:
        result = add_time_domain_check(result, answer, self.search.recording, is_lost=is_lost)
        linear = model_to_json(extended_model(self.search.model, self.search.bare, ()))
        return replace(result, details={**result.details, "linear_model": linear})
