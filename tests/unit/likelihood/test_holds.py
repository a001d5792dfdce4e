"""Holds that a file does not state are read from its records, and each record has its own."""

from dataclasses import replace

import numpy as np
import pytest
from unit.likelihood.chain_plant import ChainPlant

from invid.identification.kept_out import all_records


def test_an_axis_that_is_held_more_softly_while_it_is_driven_is_known_to_be():
    """One stiffness for both was half of one, five times the other, and made friction of what it missed."""
    recording = ChainPlant(dry=(0.0, 0.0)).recording(seed=5)
    unstated = [replace(e, hold_gain=np.full(2, np.nan)) for e in recording.experiments]
    for record in all_records(replace(recording, experiments=tuple(unstated))):
        assert record.hold == pytest.approx(np.where(record.driven, 40.0, 400.0), rel=0.05)
