"""Whatever drives, plant, computer or persons do, in whatever phase and with how many loads: nothing falls,
nothing runs away, nothing untrue is said, and what is healthy is measured.

Judged at the command line, by the true motion of plants that share no code with the product
(`tests/machines/foreign`); the whole campaign is `benchmarks/drivers/bench_foreign_drives.py`.
"""

from itertools import cycle

import pytest

from tests.machines.foreign.campaign import Campaign
from tests.machines.foreign.draft import ALWAYS
from tests.machines.foreign.kinds import KINDS

SEED = 62
OFTEN = (
    ("ordinary", ALWAYS, 3),
    ("lets go in quick stop", ALWAYS, 2),
    ("encoder noise", ALWAYS, 1),
    ("held then not", ALWAYS, 1),
    ("emergency stop released", "run", 3),
)
"""Before every commit: the kinds that have cost most; the last one happens in the run of the first."""


def rest() -> list[tuple[str, str, int]]:
    """Every kind in every phase, its numbers of loads in turn; and every number once."""
    cases = []
    for name, kind in KINDS.items():
        loads = cycle(kind.loads)
        phases = [
            phase
            for phase, _ in zip(
                cycle(kind.phases), range(max(len(kind.phases), len(kind.loads))), strict=False
            )
        ]
        cases += [(name, phase, next(loads)) for phase in phases]
    return [case for case in cases if case not in OFTEN]


def marked(case: tuple[str, str, int], mark: pytest.MarkDecorator) -> object:
    return pytest.param(*case, marks=mark, id=" - ".join(map(str, case)))


@pytest.fixture(scope="module")
def campaign() -> Campaign:
    return Campaign()


@pytest.mark.parametrize(
    ("kind", "phase", "loads"),
    [
        *(marked(case, pytest.mark.xdist_group("foreign")) for case in OFTEN),
        *(marked(case, pytest.mark.campaign) for case in rest()),
    ],
)
def test_nothing_falls_runs_away_or_is_said_wrongly_and_what_is_healthy_is_measured(
    campaign: Campaign, kind: str, phase: str, loads: int
) -> None:
    outcome = campaign.run(kind, phase, loads, SEED)
    verdict = outcome.verdict
    assert not verdict.bad, f"{verdict.note}: {'; '.join(verdict.bad)}"
    assert not verdict.refused, f"healthy, and refused: {'' if outcome.run is None else outcome.run.words}"
