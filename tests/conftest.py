"""One second try, said loudly, for tests of real processes over real time.

They share two cores with tests that compute: a process that was not scheduled for half a second is the
machine's doing. A second failure is ours, and every second try stands in pytest's summary (RERUN).
"""

from __future__ import annotations

import pytest

REAL_TIME = ("realtime", "service")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        group = item.get_closest_marker("xdist_group")
        if group is not None and group.args[0] in REAL_TIME:
            item.add_marker(pytest.mark.flaky(reruns=1))
