"""Sizes that no cause has: larger than what it works on, or than the motion in the records."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from invid.effects.registry import BY_CAUSE
from invid.model.parameters import ChainStructure
from invid.model.place import Place

SPRING = Place("spring", 0, 1)


def views(*amplitudes: float) -> list[SimpleNamespace]:
    """Records of 100 s one after the other; a spring of 1000 N·m/rad deflects by the amplitudes [rad]."""
    wave = np.sin(np.linspace(0.0, 20.0, 400))
    return [
        SimpleNamespace(
            structure=ChainStructure((2,), ("A1",)),
            springs=np.array([1000.0]),
            origin=0.0,
            record=SimpleNamespace(end_time=100.0 * (k + 1)),
            wave=lambda _, a=a: a * wave,
        )
        for k, a in enumerate(amplitudes)
    ]


@pytest.mark.parametrize(
    ("cause", "x", "beyond"),
    [
        ("parameter_drift", [4.9], False),  # 980 N·m/rad in 200 s
        ("parameter_drift", [-5.1], True),
        ("backlash", [np.log(0.038)], False),  # ±0.019 rad of ±0.02 in the larger motion
        ("backlash", [np.log(0.042)], True),
        ("transmission_error", [0.019, 0.0, np.log(2.0)], False),
        ("transmission_error", [0.021, 0.0, np.log(2.0)], True),  # more than the motor ever turned
        ("transmission_error", [0.019, 0.0, np.log(60.0)], True),  # the gear turns back
        ("cubic_stiffness", [-2.4e6], False),  # 960 of 1000 N·m/rad gone at 0.02 rad
        ("cubic_stiffness", [-2.6e6], True),
        ("cubic_stiffness", [1e8], False),  # forty times as stiff is stiff
        ("transmission_error", [0.0114, 0.0152, np.log(50.0)], False),
        ("transmission_error", [0.03, 0.04, np.log(21.0)], True),  # slope 1.05: it would turn back
    ],
)
def test_a_size_beyond_what_it_works_on_is_no_such_cause(cause: str, x: list[float], beyond: bool) -> None:
    assert BY_CAUSE[cause].beyond(views(0.01, 0.02), SPRING, x) is beyond
