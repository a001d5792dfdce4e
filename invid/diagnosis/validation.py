"""What is kept out of every fit to validate it: a table, of which the first row whose condition holds counts.

A search pass may ask for another row (``ValidationRequest``) where the validation records show nothing of
what the others do, or were measured after a change. The regression of large motion keeps blocks of time out
(``invid.rigid_motion.regression``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from invid.diagnosis.evidence import CandidateEvidence
from invid.diagnosis.thresholds import NAMED_SHARE
from invid.likelihood.evaluation import Evaluation, count_per_line
from invid.likelihood.joint_fit import JointFit, evaluate_held_out
from invid.likelihood.null_test import LEAST_SCATTER
from invid.likelihood.prepare_records import line_weights, spectral_record, uses_demand
from invid.recording.model import Recording, Role
from invid.signals.spectra import LineSpectra
from invid.signals.spectral_record import SpectralRecord

Parts = tuple[list[SpectralRecord], list[SpectralRecord]]
"""Training and held-out records."""


@dataclass(frozen=True)
class ValidationRequest:
    """How a search pass wants its records split and taken.

    Attributes
    ----------
    spare
        A record that is more than the linear model needs may be kept out whole.
    split_every_record
        A part of every other record is kept out beside those for validation.
    by_period
        Every record is taken period by period; the first held-out one joins the training.
    by_period_if_differing
        Records whose periods differ far beyond the sensors' noise are taken period by period.
    beside_friction
        The time constant of each drive's reported torque is free, for the identification could not see it
        behind friction; and waves are on the fine grid, where reversals show.
    """

    spare: bool = True
    split_every_record: bool = False
    by_period: bool = False
    by_period_if_differing: bool = False
    beside_friction: bool = False


PLAIN = ValidationRequest()
"""The table as it is."""


@dataclass(frozen=True, eq=False)
class ValidationRecords:
    """The records of a recording, as the rows of the table use them."""

    recording: Recording
    spectra: Sequence[LineSpectra]
    request: ValidationRequest

    @cached_property
    def train(self) -> list[LineSpectra]:
        """Spectra of the records that are for identification."""
        return [s for s in self.spectra if s.role is Role.IDENTIFY]

    @cached_property
    def validate(self) -> list[SpectralRecord]:
        """Records that are for validation."""
        return [self.record(s) for s in self.spectra if s.role is Role.VALIDATE]

    @cached_property
    def spare(self) -> LineSpectra:
        """The last record that drives all axes, or the last of all."""
        return ([s for s in self.train if s.driven.all()] or self.train)[-1]

    @cached_property
    def record(self) -> Callable[..., SpectralRecord]:
        """Function that makes a record of spectra, or of some of their periods."""
        experiments = {e.key: e for e in self.recording.experiments}
        made = partial(spectral_record, demand=uses_demand(self.recording, self.spectra))
        return lambda s, *periods: made(s, experiments[s.key], *periods)

    @property
    def missing(self) -> str:
        """Reason why something else has to be kept out, for the warnings."""
        if self.validate:
            return "validation does not show what the others do"
        return "no validation experiment (role 'validate')"


@dataclass(frozen=True)
class ValidationRow:
    """One way to keep something out: its condition, the split, and the warning about it."""

    name: str
    applies: Callable[[ValidationRecords], bool]
    parts: Callable[[ValidationRecords], Parts]
    sentence: Callable[[ValidationRecords], str | None]


def _split_by_role(data: ValidationRecords) -> Parts:
    return [data.record(s) for s in data.train], data.validate


def _has_spare_record(data: ValidationRecords) -> bool:
    """Whether there is a record more than the linear model needs: each axis once, or M of all at once."""
    motors = data.recording.axis_count
    everything = any(s.driven.all() for s in data.train)
    is_allowed = data.request.spare and not data.request.split_every_record
    return is_allowed and len(data.train) > motors and (everything or motors == 1)


def _keep_out_spare(data: ValidationRecords) -> Parts:
    kept = data.spare
    return [data.record(s) for s in data.train if s is not kept], [data.record(kept)]


def _keep_out_last_period(data: ValidationRecords) -> Parts:
    train = [data.record(s, slice(0, s.periods - 1)) for s in data.train]
    last = [data.record(s, slice(s.periods - 1, None)) for s in data.train]
    return train, [*last, *data.validate]


def _keep_out_fifth_lines(data: ValidationRecords) -> Parts:
    train, held = [], []
    for s in data.train:
        record = data.record(s)
        lines = np.arange(record.omega.size)
        last = lines % 5 == 4
        train.append(line_weights(record, ~last))
        # There is only one line at 0 Hz: without it a weight would have no held-out gain.
        held.append(line_weights(record, last | (lines == 0)))
    return train, [*held, *data.validate]


VALIDATION: tuple[ValidationRow, ...] = (
    ValidationRow(
        "role",
        lambda data: bool(data.validate) and not data.request.split_every_record,
        _split_by_role,
        lambda data: None,
    ),
    ValidationRow(
        "spare record",
        _has_spare_record,
        _keep_out_spare,
        lambda data: (
            f"no validation experiment (role 'validate'): experiment {data.spare.key} is kept out of every "
            "fit instead; record one with another realisation and amplitude"
        ),
    ),
    ValidationRow(
        "last period",
        lambda data: all(s.periods >= 2 and s.deviations.shape[0] == s.periods for s in data.train),
        _keep_out_last_period,
        lambda data: (
            f"{data.missing}: the last period of each experiment is kept out of every fit instead, which "
            "repeats the same motion; record one with another realisation"
        ),
    ),
    ValidationRow(
        "fifth line",
        lambda data: True,
        _keep_out_fifth_lines,
        lambda data: (
            f"{data.missing} and no whole period to spare: every fifth line is kept out of every fit "
            "instead; record an experiment of its own for validation"
        ),
    ),
)
"""What is kept out; the first row whose condition holds counts."""


def validation_row(data: ValidationRecords) -> ValidationRow:
    """The first row of the table whose condition holds."""
    return next(row for row in VALIDATION if row.applies(data))


def split_records(
    recording: Recording, spectra: Sequence[LineSpectra], request: ValidationRequest = PLAIN
) -> tuple[list[SpectralRecord], list[SpectralRecord], list[str]]:
    """Training and held-out records, and what to warn about."""
    data = ValidationRecords(recording, spectra, request)
    row = validation_row(data)
    train, held = row.parts(data)
    warning = row.sentence(data)
    return train, held, [] if warning is None else [warning]


def unfold_periods(recording: Recording) -> Recording:
    """The recording with every experiment as one record without a period.

    A law of motion is not linear: for the mean of periods that differ it gives something else than its own
    mean, and the difference passes for noise. Taken whole, with the ends of a record that does not close,
    such a record is as exact as any other.
    """
    experiments = tuple(replace(e, period_samples=0) for e in recording.experiments)
    return replace(recording, experiments=experiments)


def scatter_ratio(fit: JointFit, held: Sequence[SpectralRecord]) -> float:
    """Power of the scatter between periods over that of the sensors' noise; zero where it is not above
    ``LEAST_SCATTER``.

    The larger of the training and the held-out records.
    """
    level = max(_mean_scatter_ratio(fit.evaluation), _mean_scatter_ratio(evaluate_held_out(fit, held)))
    return level if level > LEAST_SCATTER else 0.0


def _mean_scatter_ratio(part: Evaluation) -> float:
    ratios = []
    for view, covariance, root in zip(part.views, part.covariance, part.roots, strict=True):
        record = view.record
        if record.alone or not record.scatter.any():
            continue
        counted = count_per_line(record, root) > 0
        counted[0] = False
        own = np.einsum("fii->fi", covariance).real - record.scatter
        ratios.append(float(np.mean(record.scatter[counted] / np.maximum(own[counted], 1e-300))))
    return float(np.mean(ratios)) if ratios else 0.0


def is_law_of_motion(final: CandidateEvidence, scatter: float) -> bool:
    """Whether the laws found leave at most a tenth of the ``scatter`` in whole records.

    Torque noise or a disturbance, which no law of motion explains, would be left unchanged.
    """
    return final.excess < (1.0 - NAMED_SHARE) * scatter * final.dof
