"""Elastic or rigid: where the motion does not say it, both are fitted, and rows kept out decide.

Periods and sweeps are made for chains; constant velocities and declared masses leave no choice. Any other
record (production moves, noise, a velocity alone) may be of either kind.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from invid.errors import InvidError
from invid.likelihood.fit import Fit, fit_structure
from invid.likelihood.nuisance.torque_lags import with_coulomb
from invid.likelihood.records import carried, problem_from_spectra
from invid.model.chains import CoupledChains
from invid.model.document import Model
from invid.model.parameters import ChainStructure
from invid.numerics.arrays import frozen_float
from invid.recording.model import Experiment, Kind, Recording, Role
from invid.rigid_motion.analysis import Analysis, analyse, row_floor
from invid.rigid_motion.model import identify_trajectory
from invid.rigid_motion.record_kind import is_trajectory
from invid.rigid_motion.selection import judged
from invid.signals.drive_torque import with_acting_torque
from invid.signals.spectra import LineSpectra, all_spectra

RIGID_ENOUGH = 0.1
"""Share of the torque (rms, rows kept out) below which rigid axes are not doubted. Empirical: 0.007 to 0.17
on five real rigid machines, 0.11 and more on twenty simulated chains in moves, noise and chirps."""
CLEARLY = 0.5
"""What chains may miss of what rigid axes miss: a factor of two in amplitude, as wherever one structure is
believed over another (``model_facts.BEATEN``)."""
PIECES = 12
"""Pieces of each record; chains are judged on every third, from all over it: the end of a chirp shows what
its beginning does not."""


@dataclass(frozen=True, eq=False)
class MachineKind:
    """What the machine is taken for, and the model that was fitted to tell."""

    rigid: bool
    model: Model | None = None
    said: str = ""
    """What either kind misses; empty where only one was fitted."""
    analysis: Analysis | None = None
    """That of rigid axes, where it was made and they are."""


def machine_kind(
    recording: Recording, masses: Sequence[int] | str | None, chains: Callable[[], Model]
) -> MachineKind:
    """Rigid axes or chains; ``chains`` identifies them as such, with ``masses`` as asked for."""
    wanted = recording.masses_per_axis if masses is None else masses
    if wanted is not None and not isinstance(wanted, str):
        return MachineKind(all(n == 1 for n in wanted) and is_trajectory(recording))
    experiments = recording.experiments
    if any(e.period_samples and e.periods >= 2 for e in experiments):
        return MachineKind(rigid=False)
    if all(e.kind is Kind.CONSTANT_VELOCITY for e in experiments):
        return MachineKind(rigid=True)
    moved = is_trajectory(recording)
    if not moved and not any(e.kind is Kind.OTHER for e in experiments):
        return MachineKind(rigid=False)
    try:
        found = analyse(recording)
        missed = rigid_misses(found)
        identify_trajectory(recording, analysis=found)  # an inertia may come out negative
        analysis = None if found.selection.cut else found  # there may be time for more of it
    except InvidError:
        analysis, missed = None, float("inf")
    if moved and missed < RIGID_ENOUGH:
        return MachineKind(rigid=True, analysis=analysis)
    try:
        model = chains()
        left = chains_miss(recording, model.chains)
    except (InvidError, np.linalg.LinAlgError):
        model, left = None, float("inf")
    said = f"rigid axes miss {_share(missed)} of the torque on rows kept out, chains {_share(left)}"
    # What looks like shaking is taken for moves only where that is clearly better, and the other way round;
    # one mass an axis is no elasticity.
    elastic = model is not None and max(model.chains.masses_per_branch) > 1
    if model is not None and (elastic and left < CLEARLY * missed if moved else not missed < CLEARLY * left):
        said = f"taken for an elastic machine: {said}"
        return MachineKind(False, replace(model, warnings=(*model.warnings, said)), said)
    if np.isinf(missed):
        return MachineKind(moved)  # neither can be fitted: whoever fits it again says why
    return MachineKind(True, said=f"taken for a rigid machine: {said}", analysis=analysis)


def rigid_model(recording: Recording, kind: MachineKind) -> Model:
    """The model of rigid axes, with what was said when the kind was chosen."""
    model = identify_trajectory(recording, analysis=kind.analysis)
    return replace(model, warnings=(*model.warnings, kind.said)) if kind.said else model


def rigid_misses(analysis: Analysis) -> float:
    """Rms share of the torque that rigid axes miss beyond noise on rows kept out; that of the worst axis."""
    design, rows, floor = analysis.design, judged(analysis.design), row_floor(analysis)
    shares = [0.0]
    for i in range(design.axes):
        mine = rows & (design.axis == i)
        power = float(np.sum(design.torque[mine] ** 2))
        left = float(np.sum(analysis.final.held_out[mine] ** 2) - np.sum(floor[mine]))
        shares.append(float(np.sqrt(max(left, 0.0) / power)) if power > 0 else 0.0)
    return max(shares)


def chains_miss(recording: Recording, chains: CoupledChains) -> float:
    """The same for chains, fitted anew to two of three pieces of each record and judged on the others.

    Lines are weighted by their noise: beside the clamped resonances what is missing is mostly noise.
    """
    structure = ChainStructure(chains.masses_per_branch, recording.axes)
    start = replace(chains, ground_dampers=frozen_float(np.zeros(recording.axis_count)))
    judged_on = set(range(1, PIECES, 3))
    fitted = fit_structure(
        _pieces(recording, set(range(PIECES)) - judged_on), structure, [start], thorough=False
    )
    return _missed(fitted, _pieces(recording, judged_on))


def _missed(fitted: Fit, spectra: Sequence[LineSpectra]) -> float:
    """Share that a fit misses of other records: nothing is fitted there but their ends."""
    problem = with_coulomb(problem_from_spectra(fitted.structure, spectra), spectra)
    left = power = 0.0
    for state in problem.states(carried(fitted.problem, fitted.solution.p, problem)):
        noise = np.einsum("fii->fi", state.covariance).real
        left += float((np.abs(state.residual) ** 2 / noise - 1.0).sum())
        power += float((np.abs(state.block.torque) ** 2 / noise).sum())
    return float(np.sqrt(max(left, 0.0) / max(power, 1e-300)))


def _pieces(recording: Recording, numbers: Collection[int]) -> tuple[LineSpectra, ...]:
    """Spectra of some of the pieces of each experiment that is not for validation."""
    own = tuple(_cut(e, n) for e in recording.experiments if e.role is Role.IDENTIFY for n in sorted(numbers))
    return with_acting_torque(all_spectra(replace(recording, experiments=own), Role.IDENTIFY), own)


def _cut(experiment: Experiment, number: int) -> Experiment:
    first, last = (k * experiment.samples // PIECES for k in (number, number + 1))
    rows = slice(first, last)
    demand, status = experiment.torque_demand, experiment.status
    return replace(
        experiment,
        key=f"{experiment.key} {number}",
        period_samples=0,
        time=experiment.time[rows],
        position=experiment.position[rows],
        torque=experiment.torque[rows],
        torque_demand=None if demand is None else demand[rows],
        status=None if status is None else status[rows],
        position_reference=None,
        torque_feedforward=None,
    )


def _share(missed: float) -> str:
    return "all" if np.isinf(missed) else f"{missed:.1%}"
