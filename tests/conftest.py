"""A second try for tests in real time, one worker for those that share a fixture, and what every diagnosis of
every test has to keep.

Real processes share two cores with tests that compute: one that was not scheduled for half a second is the
machine's doing. A second failure is ours, and every second try stands in pytest's summary (RERUN).
"""

import sys
from collections.abc import Iterator
from typing import Any

import pytest
from promises import ruled_out_though_found


def _shares_a_fixture(item: pytest.Item) -> bool:
    """Whether the test asks for a fixture that its own file makes once for all its tests."""
    file = item.nodeid.partition("::")[0]
    made = item._fixtureinfo.name2fixturedefs.values()
    return any(d.scope == "module" and d.baseid == file for defs in made for d in defs)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        group = item.get_closest_marker("xdist_group")
        if item.get_closest_marker("service") or (group is not None and group.args[0] == "realtime"):
            item.add_marker(pytest.mark.flaky(reruns=1))
        if group is None and _shares_a_fixture(item):
            item.add_marker(pytest.mark.xdist_group(item.nodeid.partition("::")[0]))


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
