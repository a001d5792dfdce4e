"""A second try for tests in real time, and one worker for those that share a fixture.

Real processes share two cores with tests that compute: one that was not scheduled for half a second is the
machine's doing. A second failure is ours, and every second try stands in pytest's summary (RERUN).
"""

from __future__ import annotations

import pytest


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
