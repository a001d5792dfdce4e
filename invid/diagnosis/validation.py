"""What is kept out of every fit and asked in its stead: a table, of which the first row that holds counts.

A look at a recording may ask for another row (``Asked``): where what is for validation shows nothing of what
the others do, or lies on the other side of a change. The rigid engine keeps blocks of time out
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
from invid.likelihood.null_test import DIFFERS
from invid.likelihood.prepare_records import line_weights, spectral_record, uses_demand
from invid.recording.model import Recording, Role
from invid.signals.spectra import LineSpectra
from invid.signals.spectral_record import SpectralRecord

Parts = tuple[list[SpectralRecord], list[SpectralRecord]]
"""Training and held-out records."""


@dataclass(frozen=True)
class ValidationRequest:
    """What a search pass asks of the validation, and of how records are taken.

    Attributes
    ----------
    spare
        A record that is more than the linear model needs may be kept out whole.
    within
        A part of every other record is kept out beside those for validation.
    apart
        Every record is followed from period to period; the first that is held out joins the training.
    each
        So are records whose periods differ far beyond the sensors' noise.
    whole
        The records are ``unfolded``: what their identification could not see behind the scatter, torque that
        the drive smooths, is free.
    """

    spare: bool = True
    within: bool = False
    apart: bool = False
    each: bool = False
    whole: bool = False


PLAIN = ValidationRequest()
"""Nothing but what the table gives."""


@dataclass(frozen=True, eq=False)
class ValidationRecords:
    """The records of a recording, as the rows of the table see them."""

    recording: Recording
    spectra: Sequence[LineSpectra]
    asked: ValidationRequest

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
        """Makes a record of spectra, or of some of their periods."""
        experiments = {e.key: e for e in self.recording.experiments}
        made = partial(spectral_record, demand=uses_demand(self.recording, self.spectra))
        return lambda s, *periods: made(s, experiments[s.key], *periods)

    @property
    def missing(self) -> str:
        """Why something else has to be kept out."""
        if self.validate:
            return "validation does not show what the others do"
        return "no validation experiment (role 'validate')"


@dataclass(frozen=True)
class ValidationRow:
    """One way to keep something out: when it is taken, what it keeps out, and the warning that says so."""

    name: str
    holds: Callable[[ValidationRecords], bool]
    parts: Callable[[ValidationRecords], Parts]
    sentence: Callable[[ValidationRecords], str | None]


def _by_role(offer: ValidationRecords) -> Parts:
    return [offer.record(s) for s in offer.train], offer.validate


def _is_spare(offer: ValidationRecords) -> bool:
    """Whether there is a record more than the linear model needs: each axis once, or M of all at once."""
    motors = offer.recording.axis_count
    everything = any(s.driven.all() for s in offer.train)
    asked = offer.asked.spare and not offer.asked.within
    return asked and len(offer.train) > motors and (everything or motors == 1)


def _without_spare(offer: ValidationRecords) -> Parts:
    kept = offer.spare
    return [offer.record(s) for s in offer.train if s is not kept], [offer.record(kept)]


def _without_last_period(offer: ValidationRecords) -> Parts:
    train = [offer.record(s, slice(0, s.periods - 1)) for s in offer.train]
    last = [offer.record(s, slice(s.periods - 1, None)) for s in offer.train]
    return train, [*last, *offer.validate]


def _without_fifth_lines(offer: ValidationRecords) -> Parts:
    train, held = [], []
    for s in offer.train:
        record = offer.record(s)
        lines = np.arange(record.omega.size)
        last = lines % 5 == 4
        train.append(line_weights(record, ~last))
        # There is one mean only: a weight would have no held-out gain without it.
        held.append(line_weights(record, last | (lines == 0)))
    return train, [*held, *offer.validate]


VALIDATION: tuple[ValidationRow, ...] = (
    ValidationRow(
        "role",
        lambda offer: bool(offer.validate) and not offer.asked.within,
        _by_role,
        lambda offer: None,
    ),
    ValidationRow(
        "spare record",
        _is_spare,
        _without_spare,
        lambda offer: (
            f"no validation experiment (role 'validate'): experiment {offer.spare.key} is kept out of every "
            "fit instead; record one with another realisation and amplitude"
        ),
    ),
    ValidationRow(
        "last period",
        lambda offer: all(s.periods >= 2 and s.deviations.shape[0] == s.periods for s in offer.train),
        _without_last_period,
        lambda offer: (
            f"{offer.missing}: the last period of each experiment is kept out of every fit instead, which "
            "repeats the same motion; record one with another realisation"
        ),
    ),
    ValidationRow(
        "fifth line",
        lambda offer: True,
        _without_fifth_lines,
        lambda offer: (
            f"{offer.missing} and no whole period to spare: every fifth line is kept out of every fit "
            "instead; record an experiment of its own for validation"
        ),
    ),
)
"""What is kept out; the first row that holds counts."""


def validation_row(offer: ValidationRecords) -> ValidationRow:
    """The first row of the table whose condition holds."""
    return next(row for row in VALIDATION if row.holds(offer))


def split_records(
    recording: Recording, spectra: Sequence[LineSpectra], asked: ValidationRequest = PLAIN
) -> tuple[list[SpectralRecord], list[SpectralRecord], list[str]]:
    """Training and held-out records, and what to warn about."""
    offer = ValidationRecords(recording, spectra, asked)
    row = validation_row(offer)
    train, held = row.parts(offer)
    said = row.sentence(offer)
    return train, held, [] if said is None else [said]


def unfolded(recording: Recording) -> Recording:
    """The recording with every experiment as one record without a period.

    A law of motion is not linear: on the mean of periods that differ it gives something else than its own
    mean, and what it gives otherwise in each of them passes for noise. Taken whole, with the ends of a record
    that does not close, such a record is as exact as any other.
    """
    experiments = tuple(replace(e, period_samples=0) for e in recording.experiments)
    return replace(recording, experiments=experiments)


def scatter_of(fit: JointFit, held: Sequence[SpectralRecord]) -> float:
    """Power of the scatter between periods over that of the sensors' noise, of the training or the held-out
    records the larger; zero where the periods are alike but for noise."""
    level = max(_scatter_in(fit.evaluation), _scatter_in(evaluate_held_out(fit, held)))
    return level if level > DIFFERS else 0.0


def _scatter_in(part: Evaluation) -> float:
    ratios = []
    for view, covariance, root in zip(part.views, part.covariance, part.roots, strict=True):
        record = view.record
        if record.alone or not record.scatter.any():
            continue
        seen = count_per_line(record, root) > 0
        seen[0] = False
        own = np.einsum("fii->fi", covariance).real - record.scatter
        ratios.append(float(np.mean(record.scatter[seen] / np.maximum(own[seen], 1e-300))))
    return float(np.mean(ratios)) if ratios else 0.0


def is_law_of_motion(final: CandidateEvidence, scatter: float) -> bool:
    """Whether the laws found leave a tenth of the ``scatter`` at most in whole records.

    Noise of the torque or a disturbance, which no law of the motion gives, is left there as it was.
    """
    return final.excess < (1.0 - NAMED_SHARE) * scatter * final.dof
