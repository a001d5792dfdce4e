"""A second try for tests in real time, one worker for those that share a fixture, the mark ``campaign``, and
what every diagnosis of every test has to keep.

Real processes share two cores with tests that compute: one that was not scheduled for half a second is the
machine's doing. A second failure is ours, and every second try stands in pytest's summary (RERUN).
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from promises import ruled_out_though_found

REAL_TIME = ("realtime", "service")
CAMPAIGN = Path(__file__).parent / "campaign.csv"
"""What `make test` leaves out: a file, a function or one case a line, its cost and what it alone runs."""


def campaign() -> set[str]:
    """Return the tests of the table, as pytest names them."""
    with CAMPAIGN.open(encoding="utf-8", newline="") as file:
        return {row["test"] for row in csv.DictReader(file)}


def _names(nodeid: str) -> tuple[str, str, str]:
    """Return the file, the function and the case that a test is."""
    return nodeid.partition("::")[0], nodeid.partition("[")[0], nodeid


def _shares_a_fixture(item: pytest.Item) -> bool:
    """Whether the test asks for a fixture that its own file makes once for all its tests."""
    made = item._fixtureinfo.name2fixturedefs.values()
    return any(d.scope == "module" and d.baseid == _names(item.nodeid)[0] for defs in made for d in defs)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    listed = campaign()
    names = {name for item in items for name in _names(item.nodeid)}
    for item in items:
        group = item.get_closest_marker("xdist_group")
        if group is not None and group.args[0] in REAL_TIME:
            item.add_marker(pytest.mark.flaky(reruns=1))
        if group is None and _shares_a_fixture(item):
            item.add_marker(pytest.mark.xdist_group(_names(item.nodeid)[0]))
        if listed.intersection(_names(item.nodeid)):
            item.add_marker(pytest.mark.campaign)
    whole_files = not any("::" in argument for argument in config.args)
    files = {test: test.partition("::")[0] for test in listed - names}
    stale = [
        t for t, f in files.items() if (whole_files and f in names) or not Path(config.rootpath, f).is_file()
    ]
    if stale:
        raise pytest.UsageError(f"{CAMPAIGN.name}: no such test: {', '.join(sorted(stale))}")


@pytest.fixture(scope="session", autouse=True)
def _nothing_that_is_found_is_ruled_out() -> Iterator[None]:
    """Judge every diagnosis that any test makes in this process."""
    module: Any = sys.modules.get("invid.diagnosis.diagnose")
    if module is None:
        yield
        return
    finish, document = module.grade_consequences, sys.modules["invid.model.diagnosis_document"]

    def judged(diagnosis: Any, recording: Any) -> Any:
        result = finish(diagnosis, recording)
        assert ruled_out_though_found(document.diagnosis_to_json(result), recording.created) == []
        return result

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "grade_consequences", judged)
        yield
