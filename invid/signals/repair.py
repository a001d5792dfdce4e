"""What a recording shows of its making is repaired first: identification and diagnosis see the same rows."""

from __future__ import annotations

from collections.abc import Collection

from invid.recording.check import check_experiment
from invid.recording.model import Recording
from invid.recording.plausibility import without_repeats
from invid.recording.still_axes import moving_part
from invid.signals.encoder_glitches import remove_glitches
from invid.signals.encoder_interpolation import remove_interpolation_error


def repair(recording: Recording, axes: Collection[str] | None = None) -> tuple[Recording, list[str]]:
    """The recording without held rows, glitches, axes that stand and errors of interpolation; a sentence on
    each.

    ``axes``: those of a model, which stay whatever they do.

    Raises
    ------
    RecordingError
        Samples that are no numbers, or fewer of one column than of another.
    """
    for experiment in recording.experiments:
        check_experiment(experiment, recording.axes, source=recording.source)
    recording, repeats = without_repeats(recording)
    recording, glitches = remove_glitches(recording)
    recording, still = moving_part(recording, axes)
    recording, waves = remove_interpolation_error(recording)
    return recording, [*repeats, *glitches, *still, *waves]


__all__ = ["repair"]
