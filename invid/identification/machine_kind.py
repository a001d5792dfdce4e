"""Decide whether a machine is elastic or rigid: where the motion does not, held-out rows of both fits do.

Periods and sweeps are made for chains; constant velocities and declared masses leave no choice. Any other
record (production moves, noise, a velocity alone) may be of either kind.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from invid.errors import InvidError
from invid.identification.begun import Begun
from invid.identification.contest import FURTHER_MASSES
from invid.model.document import MISSED, Model
from invid.model.doubts import Doubt, DoubtCode
from invid.numerics import budget
from invid.numerics.arrays import Float64
from invid.recording.model import Kind, Recording
from invid.rigid_motion.analysis import Analysis, analyse, row_floor
from invid.rigid_motion.model import TRAJECTORY, identify_trajectory
from invid.rigid_motion.record_kind import is_trajectory

RIGID_ENOUGH = 0.1
"""Missed share of the torque (rms, held-out rows) below which rigid axes are not doubted. Empirical: 0.007 to
0.17 on five real rigid machines, 0.11 and more on twenty simulated chains in moves, noise and chirps."""
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


def machine_kind(
    recording: Recording, masses: Sequence[int] | str | None, chains: Callable[[], Begun], share: float = 1.0
) -> MachineKind:
    """Rigid axes or chains; ``chains`` identifies them as chains, with ``masses`` as requested.

    ``share``: of the time that is left, for chains; the rest is for a search for their causes. Of a machine
    that is moved and hardly ever elastic the analysis of rigid axes is all of the diagnosis.
    """
    wanted = recording.masses_per_axis if masses is None else masses
    if wanted is not None and not isinstance(wanted, str):
        stated = replace(recording, masses_per_axis=tuple(wanted))
        return MachineKind(all(n == 1 for n in wanted) and is_trajectory(stated))
    experiments = recording.experiments
    if any(e.period_samples and e.periods >= 2 for e in experiments):
        return MachineKind(rigid=False)
    if all(e.kind is Kind.CONSTANT_VELOCITY for e in experiments):
        return MachineKind(rigid=True)
    is_moved = is_trajectory(recording)
    if not is_moved and not any(e.kind is Kind.OTHER for e in experiments):
        return MachineKind(rigid=False)
    try:
        with budget.use_share(1.0 if is_moved else share):
            found = analyse(recording)
        missed = rigid_missed_share(found)
        identify_trajectory(recording, analysis=found)  # an axis may not accelerate at all
        # There may be time for more of it, but of a machine that is moved it had all there was.
        analysis = None if found.is_cut_short and not is_moved else found
    except InvidError:
        analysis, missed = None, float("inf")
    if is_moved and missed < RIGID_ENOUGH:
        return MachineKind(rigid=True, analysis=analysis)
    tried, left = None, float("inf")
    try:
        with budget.use_share(max(share, TIME_TO_DOUBT) if is_moved else share):
            tried = chains()
        # One mass an axis is no elasticity: rigid axes hold that, and the weight that changes with the pose.
        if max(tried.sizes) > 1:
            left = tried.missed
    except (InvidError, np.linalg.LinAlgError):
        pass
    is_single = tried is not None and max(tried.sizes) == 1
    if is_single and FURTHER_MASSES in budget.left_out():
        # Nothing is concluded from orders that were not tried.
        said = "whether the machine is elastic is open: the budget ended before further masses were tried"
        if is_moved:
            return MachineKind(True, sentence=said, analysis=analysis)
        return MachineKind(False, said)
    if np.isinf(missed) and np.isinf(left):
        return MachineKind(is_moved and tried is None)  # whoever fits it again says why
    sentence = f"rigid axes miss {_share_text(missed)} of the torque on rows kept out, " + (
        "and no elasticity shows" if is_single else f"chains {_share_text(left)}"
    )
    # The better one wins; of what is moved and not shaken only where it is so clearly.
    if tried is not None and left < (CLEAR_RATIO if is_moved else 1.0) * missed:
        sentence = f"taken for an elastic machine: {sentence}"
        return MachineKind(False, sentence)
    return MachineKind(True, sentence=f"taken for a rigid machine: {sentence}", analysis=analysis)


def is_of_rigid_axes(model: Model, recording: Recording) -> bool:
    """Return whether a recording is to be diagnosed as one of rigid axes with the given model."""
    if max(model.chains.masses_per_branch) > 1:
        return False
    periodic = any(e.period_samples and e.periods >= 2 for e in recording.experiments)
    return is_trajectory(recording) or (model.method == TRAJECTORY and not periodic)


def rigid_model(recording: Recording, kind: MachineKind) -> Model:
    """The model of rigid axes, with the sentence about the choice of the kind.

    One that misses more than half of the torque is marked as not to be trusted.
    """
    analysis = analyse(recording) if kind.analysis is None else kind.analysis
    model = identify_trajectory(recording, analysis=analysis)
    left, power = np.sum(_rigid_powers(analysis), axis=0)
    warnings = [kind.sentence] if kind.sentence else []
    if left > MISSED**2 * power:
        share = float(np.sqrt(left / power))
        sentence = f"the model misses {_share_text(share)} of the torque on rows kept out"
        doubt = Doubt(DoubtCode.MISSED_TORQUE, sentence, {"share": share})
        model, warnings = model.distrusted(doubt), [sentence, *warnings]
    return replace(model, warnings=(*warnings, *model.warnings))


def rigid_missed_share(analysis: Analysis) -> float:
    """Rms share of the torque that rigid axes miss beyond noise on held-out rows, of the worst axis."""
    left, power = _rigid_powers(analysis).T
    return float(np.sqrt(np.max(left / np.maximum(power, 1e-300))))


def _rigid_powers(analysis: Analysis) -> Float64:
    """(M, 2) power that is missing on rows kept out, beyond noise, and that of the torque."""
    rows, left = analysis.rows, analysis.final.held_out**2 - row_floor(analysis)
    sums = [np.bincount(rows.axis[rows.judged], x[rows.judged], rows.axes) for x in (left, rows.torque**2)]
    return np.maximum(np.stack(sums, axis=1), 0.0)


def _share_text(missed: float) -> str:
    return "all" if np.isinf(missed) else f"{missed:.1%}"
