"""`explained` is what the residual shows, not what χ² over all lines says."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from invid.diagnosis import confidence


@pytest.mark.parametrize(
    ("left", "floors", "at_it"),
    [
        ((0.047, 0.012), (0.040, 0.010), True),
        ((0.047, 0.019), (0.040, 0.010), False),  # one axis of two: χ² over both was within 1.44
        ((0.063, 0.010), (0.040, 0.010), False),
    ],
)
def test_every_axis_is_within_a_fifth_of_its_floor(
    left: tuple[float, ...], floors: tuple[float, ...], at_it: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    structure = SimpleNamespace(motors=len(left))
    final = SimpleNamespace(
        fit=SimpleNamespace(layout=SimpleNamespace(structure=structure)), held=None, cost=130.0, dof=100
    )
    monkeypatch.setattr(confidence, "rms_torque", lambda _, axis: (left[axis], floors[axis]))
    assert confidence.is_at_floor(final) == at_it  # type: ignore[arg-type]
