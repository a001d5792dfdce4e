"""Laws of dry friction and play on an axis that stands still from the first sample to the last."""

from __future__ import annotations

import numpy as np

from invid.effects.laws.sign import clip_law, excess_law, sign_law


def test_an_axis_that_never_moves_feels_no_friction_and_no_play() -> None:
    still = np.zeros(32)
    for out in (sign_law(still, 1e-300), excess_law(still, 1e-300, 0.1), clip_law(still, 1e-3)):
        assert np.array_equal(out, still)
