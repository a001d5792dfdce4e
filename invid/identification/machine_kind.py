"""Decide whether a machine is elastic or rigid: where the motion does not, held-out rows of both fits do.

Periods and sweeps are made for chains; constant velocities and declared masses leave no choice. Any other
record (production moves, noise, a velocity alone) may be of either kind.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from invid.errors import InvidError
from invid.identification.contest import FURTHER_MASSES
from invid.identification.search_start import SearchStart
from invid.model.document import MISSED, Model
from invid.model.doubts import Doubt, DoubtCode
from invid.numerics import budget
from invid.numerics.arrays import Float64
from invid.recording.model import Kind, Recording
from invid.rigid_motion.analysis import Analysis, analyse, missed_by
from invid.rigid_motion.fit import axis_powers, noise_powers
from invid.rigid_motion.model import TRAJECTORY, identify_trajectory
from invid.rigid_motion.record_kind import is_trajectory
from invid.wording.sentence import sentence

RIGID_ENOUGH = 0.1
"""Missed share of the torque (rms, held-out rows) below which rigid axes are not doubted. Empirical: 0.007 to
0.17 on five real rigid machines, 0.11 and more on twenty simulated chains in moves, noise and chirps."""
MOSTLY_RIGID = 0.45
"""Missed share below which a machine that is shaken is one of rigid axes moved fast, and is doubted as others
that are moved. Empirical: 0.17 and less on the moves of three machines, 0.57 and more on the worst axis of
ten chains that noise or a stepped sine shook."""
CLEAR_RATIO = 0.5
"""Ratio of missed torque, chains over rigid axes, below which a moved machine counts as elastic (empirical):
a factor of two in amplitude."""
TIME_TO_DOUBT = 0.85
"""Least share of what is left of a budget for chains of a machine that is moved: where they lose, nothing
else needs it (empirical)."""


@dataclass(frozen=True, eq=False)
class MachineKind:
    """The kind of a machine."""

    rigid: bool
    sentence: str = ""
    """What either kind misses, in words; empty where only one was fitted."""
    analysis: Analysis | None = None
    """The analysis of rigid axes, where it was made and they are rigid."""


@dataclass(frozen=True)
class Tried:
    """What a fit of one kind came to: neither figure nor failure where it is no fit of that kind."""

    missed: float | None = None
    """Rms share of the torque that it misses on rows kept out."""
    failure: str = ""
    """Why there is no fit."""

    def __str__(self) -> str:
        """ "miss 3.0%"."""
        if self.missed is None:
            return f"are no fit ({self.failure})" if self.failure else "show no elasticity"
        return f"miss {self.missed:.1%}"


def machine_kind(
    recording: Recording,
    masses: Sequence[int] | str | None,
    chains: Callable[[], SearchStart],
    share: float = 1.0,
) -> MachineKind:
    """Rigid axes or chains; ``chains`` identifies them as chains, with ``masses`` as requested.

    ``share``: of the time that is left, for chains; the rest is for a search for their causes. Of a machine
    that is moved and hardly ever elastic the analysis of rigid axes is all of the diagnosis.
    """
    wanted = recording.masses_per_axis if masses is None else masses
    if wanted is not None and not isinstance(wanted, str):
        return MachineKind(
            max(wanted) == 1 and is_trajectory(replace(recording, masses_per_axis=tuple(wanted)))
        )
    if any(e.period_samples and e.periods >= 2 for e in recording.experiments):
        return MachineKind(rigid=False)
    if all(e.kind is Kind.CONSTANT_VELOCITY for e in recording.experiments):
        return MachineKind(rigid=True)
    is_moved = is_trajectory(recording)
    if not is_moved and not any(e.kind is Kind.OTHER for e in recording.experiments):
        return MachineKind(rigid=False)
    analysed = cache(partial(_analysed, recording))
    with budget.use_share(1.0 if is_moved else share):
        rigid = _tried(lambda: rigid_missed_share(analysed()))
    is_moved = is_moved or (rigid.missed is not None and rigid.missed < MOSTLY_RIGID)
    # There may be time for more of it, but of a machine that is moved it had all there was.
    is_whole = rigid.missed is not None and (is_moved or not analysed().is_cut_short)
    analysis = analysed() if is_whole else None
    if is_moved and rigid.missed is not None and rigid.missed < RIGID_ENOUGH:
        return MachineKind(rigid=True, analysis=analysis)
    with budget.use_share(max(share, TIME_TO_DOUBT) if is_moved else share):
        # One mass an axis is no elasticity: rigid axes hold that, and the weight that changes with the pose.
        elastic = _tried(lambda: begun.missed if max((begun := chains()).sizes) > 1 else None)
    is_single = elastic == Tried()
    if is_single and FURTHER_MASSES in budget.left_out():
        # Nothing is concluded from orders that were not tried.
        said = sentence(
            "whether the machine is elastic is open: the budget ended before further masses were tried"
        )
        return MachineKind(is_moved, said, analysis if is_moved else None)
    if rigid.missed is None and elastic.missed is None:
        return MachineKind(is_moved and not is_single)  # whoever fits it again says why
    missed = sentence(
        "of the torque on rows kept out rigid axes {rigid}, chains {elastic}", rigid=rigid, elastic=elastic
    )
    # The better one wins; of what is moved and not shaken only where it is so clearly.
    most = np.inf if rigid.missed is None else (CLEAR_RATIO if is_moved else 1.0) * rigid.missed
    if elastic.missed is not None and elastic.missed < most:
        return MachineKind(False, sentence("taken for an elastic machine: {missed}", missed=missed))
    return MachineKind(True, sentence("taken for a rigid machine: {missed}", missed=missed), analysis)


def _tried(fit: Callable[[], float | None]) -> Tried:
    """What a fit came to that returns the share it misses."""
    try:
        return Tried(fit())
    except (InvidError, np.linalg.LinAlgError) as error:
        return Tried(failure=str(error))


def _analysed(recording: Recording) -> Analysis:
    """The analysis of rigid axes all of which accelerate, or stand."""
    found = analyse(recording)
    identify_trajectory(recording, analysis=found)
    return found


def is_of_rigid_axes(model: Model, recording: Recording) -> bool:
    """Return whether a recording is to be diagnosed as one of rigid axes with the given model."""
    periodic = any(e.period_samples and e.periods >= 2 for e in recording.experiments)
    is_known = model.method == TRAJECTORY and not periodic
    return max(model.chains.masses_per_branch) == 1 and (is_trajectory(recording) or is_known)


def rigid_model(recording: Recording, kind: MachineKind) -> Model:
    """The model of rigid axes, with the sentence about the choice of the kind.

    One that misses more than half of the torque is marked as not to be trusted.
    """
    analysis = analyse(recording) if kind.analysis is None else kind.analysis
    model = identify_trajectory(recording, analysis=analysis)
    left, power = np.sum(_rigid_powers(analysis), axis=0)
    said = ""
    if left > MISSED**2 * power:
        said = sentence(
            "the model misses {value:.1%} of the torque on rows kept out",
            value=(share := float(np.sqrt(left / power))),
        )
        model = model.distrusted(Doubt(DoubtCode.MISSED_TORQUE, said, {"share": share}))
    return replace(model, warnings=(*filter(None, (said, kind.sentence)), *model.warnings))


def rigid_missed_share(analysis: Analysis) -> float:
    """Rms share of the torque that rigid axes miss beyond noise on rows kept out, of the worst that moves.

    One whose encoder flickers while it stands says nothing of the machine's kind.
    """
    left, power = _rigid_powers(analysis).T
    moves = analysis.reach.travel > 2.0 * np.max([m.blur for m in analysis.rows.motions], axis=0)
    return float(np.sqrt(np.max(left / np.maximum(power, 1e-300), where=moves, initial=0.0)))


def _rigid_powers(analysis: Analysis) -> Float64:
    """(M, 2) power that is missing on rows kept out, beyond noise, and that of the torque."""
    every = analysis.rows.every
    left = missed_by(analysis.rows, analysis.final) ** 2 - noise_powers(analysis.rows, analysis.final)
    return np.maximum(np.stack([left, axis_powers(every, every.judged, every.torque)], axis=1), 0.0)
