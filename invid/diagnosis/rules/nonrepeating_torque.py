"""Rule: torque that is missing in every period, in each another: neither a law nor sensor noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from invid.likelihood.evaluation import Evaluation
from invid.likelihood.null_test import informative_lines
from invid.model.diagnosis_document import Unexplained
from invid.recording.model import Recording


def describe_scatter(parts: Sequence[Evaluation], recording: Recording, unit: str) -> Unexplained | None:
    """Axis, size and frequencies of missing torque that does not repeat; ``None`` where there is none.

    None either where the scatter may be noise of a torque that the sensors do not show
    (``SpectralRecord.differs``). A torque that differs from period to period is noise to every test of what
    repeats: beside a ripple over which the axis wanders χ² was half its expectation, with a model that
    explained nothing of it.
    """
    best: tuple[float, float, int, tuple[float, ...]] | None = None
    for part in parts:
        for number, view in enumerate(part.views):
            record, covariance = view.record, part.covariance[number]
            if not record.differs:
                continue
            good = informative_lines(covariance, record)
            good[0] = False
            for axis in range(recording.axis_count):
                if record.set_aside.size and record.set_aside[axis]:
                    continue
                whole = np.where(good[:, axis], covariance[:, axis, axis].real, 0.0)
                added = np.where(good[:, axis], record.scatter[:, axis], 0.0)
                sensors = float((whole - added).sum())
                ratio = float(np.sqrt(whole.sum() / max(sensors, 1e-300)))
                if best is None or ratio > best[0]:
                    strongest = np.sort(np.argsort(-added)[:6])
                    hz = tuple(float(v) for v in record.omega[strongest] / (2 * np.pi))
                    best = (ratio, float(np.sqrt(0.5 * added.sum())), axis, hz)
    if best is None:
        return None
    ratio, size, axis, hz = best
    name, where = recording.axes[axis], ", ".join(f"{f:.3g}" for f in hz)
    return Unexplained(
        axis=name,
        frequencies_hz=hz,
        character=("time-dependent",),
        sentence=(
            f"Axis {name}: {size:.2g} {unit} of torque are missing that differ from period to period, "
            f"{ratio:.2g} times what its sensors' noise makes, most at {where} Hz. The "
            "model cannot be told right or wrong below that: let the motion settle longer, record more "
            "periods, and see what drives the axis beside its motor or changes with where it stands."
        ),
    )


__all__ = ["describe_scatter"]
