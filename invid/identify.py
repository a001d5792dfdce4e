"""Recording to model: starts from the paper's inverse, then the structured maximum-likelihood fit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from invid import __version__
from invid.arrays import Float64, frozen_float
from invid.chains import CoupledChains
from invid.errors import InputError, InvidError, NotIdentifiableError
from invid.frf import FrfMatrix, frf_matrix, local_frf_matrix
from invid.identifiability import Blind, blind_directions
from invid.inverse import PaperResult, identify_paper, starts
from invid.model import ChainStd, EffectTerm, Estimate, Model, parameter_vector, units
from invid.modes import Modes
from invid.modes.settle import settled_frf
from invid.pole_search import searched_modes
from invid.rational import FINE, TRUSTED, rational_modes
from invid.recording.model import Recording, Role
from invid.refine.fit import Fit, fit_structure
from invid.refine.mixed_drive import with_acting_torque
from invid.refine.problem import condense_dense
from invid.refine.structure import ChainStructure
from invid.spectra import LineSpectra, all_spectra

Masses = Sequence[int] | Literal["auto"] | None
Method = Literal["paper", "refined"]

MISFIT = 0.01
"""Relative FRF error granted to the modal fit that only gives a start: friction of a few per cent of the
peak torque leaves about that, and a modal fit that chases it is slow and no better a start."""
LOCAL_MISFIT = 0.03
"""The same for the local regression, which blunts resonances narrower than its window."""
SECOND_ROUTE = 100
"""Modes times motors squared up to which the paper's method runs beside the fit as a cross-check: its
modal fit then takes a second or two."""
SUSPECT = 5.0
"""χ²/ν against sensor noise above which the fit is compared with a rational FRF of no structure."""
DISAGREE = 0.05
"""Median relative difference of the two that is too much: friction of 3 % of the peak torque leaves one
or two per cent, a wrong minimum tens (empirical, on the plants of the benchmarks)."""
EXPLAINED = 0.9
"""Share of the torque a trustworthy model explains. Empirical: real drives with friction stand above
0.99, a wrong order or a torque that is none below 0.7 (flexible bench, case study)."""


def identify(recording: Recording, *, masses: Masses = None, method: Method = "refined") -> Model:
    """Masses, springs, dampers and couplings of every branch with their covariance.

    Parameters
    ----------
    masses
        Masses of each axis; ``None`` takes those of the recording, and "auto" where it names none;
        "auto" lets the data choose.
    method
        "refined" (maximum likelihood) or "paper" (the inverse eigenvalue method alone).

    Returns
    -------
    Model
        ``fit["trustworthy"]`` is False where a reason in ``warnings`` says that it cannot be relied on.

    Raises
    ------
    InputError
        An axis that is never excited; masses that do not match the axes.
    NotIdentifiableError
        Data from which no such model can be drawn at all; an excitation that drowns in the noise.
    """
    from invid.trajectory import identify_trajectory, is_rigid_case

    if method == "refined" and is_rigid_case(recording, masses):
        return identify_trajectory(recording)
    spectra = all_spectra(recording, Role.IDENTIFY)
    _check(recording, spectra)
    spectra = with_acting_torque(spectra, recording.experiments)
    wanted = recording.masses_per_axis if masses is None else masses
    warnings = [w for s in spectra for w in s.warnings]
    order: dict[str, Any] = {}
    if wanted is None or isinstance(wanted, str):
        from invid.order import choose_order

        choice = choose_order(spectra, recording.axes)
        sizes, order = choice.sizes, choice.evidence
        warnings += choice.warnings
    else:
        sizes = _sizes(recording, wanted)
    measured = measured_frf(spectra, misfit=0.0 if method == "paper" else MISFIT)
    if method == "paper":
        measured = settled_frf(spectra, sizes, measured)
    paper: PaperResult | InvidError
    if method == "refined" and (sum(sizes) - len(sizes)) * len(sizes) ** 2 > SECOND_ROUTE:
        paper = NotIdentifiableError("the plant is large: the second route takes minutes (--method paper)")
    elif method == "refined" and any(s.transient for s in spectra):
        paper = NotIdentifiableError("records that are not settled: the paper's method needs settled ones")
    else:
        if any(s.transient for s in spectra):
            rational = rational_modes(spectra, sizes)
            measured = measured if rational is None else rational[1]
        paper = _paper(measured, sizes, recording.axes)
    if method == "paper":
        if isinstance(paper, InvidError):
            raise paper
        return _paper_model(recording, paper, measured, warnings, order)
    fit = fit_sizes(spectra, sizes, recording.axes, measured, paper)
    return _refined_model(recording, spectra, fit, paper, warnings, order)


def measured_frf(spectra: Sequence[LineSpectra], *, misfit: float = MISFIT) -> FrfMatrix:
    """The FRF matrix the starts are drawn from; ``misfit`` is added to its relative errors."""
    found = FrfMatrix.empty(spectra[0].axis_count)
    if not any(s.transient for s in spectra):
        found = frf_matrix(spectra)
    if found.frequency_hz.size < 8:
        found, misfit = local_frf_matrix(spectra), max(misfit, LOCAL_MISFIT)
    return replace(found, variance=found.variance + (misfit * np.abs(found.frf)) ** 2)


def fit_sizes(
    spectra: Sequence[LineSpectra],
    sizes: Sequence[int],
    axes: Sequence[str],
    measured: FrfMatrix,
    paper: PaperResult | InvidError | None = None,
    *,
    thorough: bool = True,
    further: Sequence[CoupledChains] = (),
) -> Fit:
    """The fit of one order, from the paper's inverse and its fallbacks."""
    structure = ChainStructure(tuple(sizes), tuple(axes))
    attempts = _starts(spectra, sizes, axes, measured, paper, further, thorough)
    return fit_structure(spectra, structure, attempts, thorough=thorough)


def _starts(
    spectra: Sequence[LineSpectra],
    sizes: Sequence[int],
    axes: Sequence[str],
    measured: FrfMatrix,
    paper: PaperResult | InvidError | None,
    further: Sequence[CoupledChains],
    thorough: bool,
) -> Iterator[CoupledChains]:
    """Starts, most trusted first; each is made only when those before it did not do."""
    yield from further
    crude: list[CoupledChains] = []
    for modes, frf in _modal_starts(spectra, sizes, thorough):
        *physical, equal = starts(frf.frequency_hz, frf.frf, frf.variance, sizes, axes=axes, modes=modes)
        yield from physical
        crude.append(equal)
    if isinstance(paper, PaperResult):
        yield paper.chains
    elif measured.frequency_hz.size:
        yield from starts(measured.frequency_hz, measured.frf, measured.variance, sizes, axes=axes)
    yield from crude


def _modal_starts(
    spectra: Sequence[LineSpectra], sizes: Sequence[int], thorough: bool
) -> Iterator[tuple[Modes, FrfMatrix]]:
    """Rational fits, each made only when those before it did not do: quick, thorough, fine."""
    found = rational_modes(spectra, sizes, trusted=TRUSTED)
    if found is not None:
        yield found
    for model_error in (0.0, FINE) if thorough else (0.0,):
        found = searched_modes(spectra, sizes, model_error=model_error)
        if found is not None:
            yield found
    if thorough:
        found = rational_modes(spectra, sizes, trusted=FINE)
        if found is not None:
            yield found


# --- checks ------------------------------------------------------------------------------------
def _check(recording: Recording, spectra: Sequence[LineSpectra]) -> None:
    if not spectra:
        raise InputError(
            f"{recording.source}: no experiment with role 'identify' that shakes an axis; "
            f"found {len(recording.experiments)} experiments"
        )
    motors = recording.axis_count
    for i, axis in enumerate(recording.axes):
        driving = [s for s in spectra if s.driven[i]]
        if not driving:
            raise InputError(
                f"{recording.source}: axis {axis} is never excited (no experiment names it as excited_axis "
                "or excites several); measure it too, or leave the axis out of the recording"
            )
        if not any(_carries(s, i) or _carries(s, motors + i) for s in driving):
            # Named as excited, so the recording is no bad input: the excitation drowned in the noise.
            raise NotIdentifiableError(
                f"{recording.source}: the excitation of axis {axis} is too weak: neither its torque nor its "
                f"position rises above the noise in experiments {[s.key for s in driving]}; "
                "raise the amplitude or measure longer"
            )
    if not any(s.excited.any() for s in spectra):
        raise NotIdentifiableError(f"{recording.source}: no excited line found in any experiment")


def _carries(s: LineSpectra, channel: int) -> bool:
    """Whether a channel's excited lines rise above its noise, and it is not constant."""
    both = np.concatenate((s.position, s.torque), axis=1)[s.excited, channel]
    if both.size == 0 or not np.any(both):
        return False
    # Mean power of noise lines is the floor with relative error 1/√lines; five times it is no noise.
    return bool(np.mean(np.abs(both) ** 2) > 5.0 * s.floor[channel])


def _sizes(recording: Recording, wanted: Sequence[int]) -> tuple[int, ...]:
    sizes = tuple(int(n) for n in wanted)
    if len(sizes) != recording.axis_count or any(n < 1 for n in sizes):
        raise InputError(
            f"masses: {list(wanted)} for {recording.axis_count} axes {list(recording.axes)}; give one number "
            "≥ 1 for each axis, or auto"
        )
    return sizes


def _paper(measured: FrfMatrix, sizes: Sequence[int], axes: Sequence[str]) -> PaperResult | InvidError:
    if measured.frequency_hz.size == 0:
        return NotIdentifiableError(
            "no frequency at which all axes are excited: the FRF matrix is incomplete"
        )
    try:
        return identify_paper(measured.frequency_hz, measured.frf, measured.variance, sizes, axes=axes)
    except InvidError as error:
        return error
    except (np.linalg.LinAlgError, ValueError, FloatingPointError) as error:
        return NotIdentifiableError(f"the paper's method failed on these data: {error}")


# --- models ------------------------------------------------------------------------------------
def _provenance(recording: Recording) -> dict[str, Any]:
    return {
        "software": f"invid {__version__}",
        "recording": recording.source,
        "recorded": recording.created,
        "experiments": [e.key for e in recording.experiments if e.role is Role.IDENTIFY],
    }


def _paper_model(
    recording: Recording,
    paper: PaperResult,
    measured: FrfMatrix,
    warnings: list[str],
    order: dict[str, Any],
) -> Model:
    chains = paper.chains
    names = _paper_names(chains)
    names_all, values = parameter_vector(chains)
    std = np.full(len(names_all), np.nan)
    variance = np.diag(paper.covariance)
    known = {n: float(np.sqrt(max(v, 0.0))) for n, v in zip(names, variance, strict=True)}
    for k, name in enumerate(names_all):
        std[k] = known.get(name, np.nan)
    warnings = [*warnings, *paper.warnings]
    trust = True
    for name, value, error in zip(names_all, values, std, strict=True):
        if ".damper." in name or ".coupling" in name:
            continue
        if not np.isfinite(error) or error > Blind.LIMIT * abs(value):
            trust = False
            warnings.append(f"{name}: {value:.4g} ± {error:.2g} is not known; measure longer or use refined")
    return Model(
        robot=recording.robot,
        method="paper",
        chains=chains,
        std=_chain_std(chains, dict(zip(names_all, std, strict=True))),
        linear=recording.linear,
        warnings=tuple(dict.fromkeys(warnings)),
        covariance=frozen_float(paper.covariance),
        parameter_names=names,
        fit={
            "trustworthy": trust,
            "resonances_hz": (np.sort(paper.modes.omega) / 2 / np.pi).tolist(),
            "frf_error": float(paper.modes.model_error),
            "band_hz": [float(measured.frequency_hz[0]), float(measured.frequency_hz[-1])],
            **({"order": order} if order else {}),
        },
        provenance=_provenance(recording),
    )


def _paper_names(chains: CoupledChains) -> tuple[str, ...]:
    names: list[str] = []
    for axis, m in zip(chains.axes, chains.masses, strict=True):
        names += [f"{axis}.mass.{q + 1}" for q in range(m.size)]
        names += [f"{axis}.spring.{q + 1}" for q in range(m.size - 1)]
    count = chains.branches
    names += [
        f"{chains.axes[i]}-{chains.axes[j]}.coupling" for i in range(count) for j in range(i + 1, count)
    ]
    return tuple(names)


def _refined_model(
    recording: Recording,
    spectra: Sequence[LineSpectra],
    fit: Fit,
    paper: PaperResult | InvidError,
    warnings: list[str],
    order: dict[str, Any],
) -> Model:
    chains = fit.chains
    names, values = parameter_vector(chains)
    place = {name: k for k, name in enumerate(fit.names)}
    index = [place[n] for n in names]
    covariance = fit.covariance[np.ix_(index, index)]
    top = max(float(s.frequency_hz[s.excited].max()) for s in spectra if s.excited.any())
    bottom = min(float(s.frequency_hz[s.excited].min()) for s in spectra if s.excited.any())
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    blind = blind_directions(chains, names, values, covariance, (bottom, top), recording.linear)
    doubts: list[str] = []
    if fit.solution.result != "converged":
        doubts.append(
            f"the fit did not converge ({fit.solution.result} after {fit.solution.iterations} iterations)"
        )
    if blind.unseen:
        std = np.where([n in blind.unseen for n in names], np.nan, std)
        doubts += blind.sentences or [f"{', '.join(sorted(blind.unseen))}: not known from these data"]
    if fit.explained < EXPLAINED:
        doubts.append(
            f"the model explains {fit.explained:.0%} of the torque only: another number of masses, a torque "
            "channel that is not the motor torque, or axes that do not move freely"
        )
    apart = _apart(spectra, fit) if fit.noise_chi2 > SUSPECT else 0.0
    if apart > DISAGREE:
        doubts.append(
            f"the fitted plant differs by {apart:.0%} from the FRF that the records show: the fit stands in "
            "a wrong minimum, or the machine has another structure (number of masses, springs to ground)"
        )
    warnings += doubts
    if fit.noise_chi2 > 2.0:
        warnings.append(
            f"the torque is missed by {np.sqrt(fit.noise_chi2):.2g} times its noise: something acts that the "
            "model does not contain; standard deviations include it; invid diagnose names it where it can"
        )
    routes = _routes(paper, names, values, covariance, warnings)
    finite = np.isfinite(covariance).all()
    facts = {
        "trustworthy": not doubts,
        "doubts": doubts,
        "chi2": fit.solution.chi2,
        "dof": fit.solution.dof,
        "noise_chi2_per_dof": fit.noise_chi2,
        "explained": fit.explained,
        "band_hz": [bottom, top],
        "lines": {b.key: int(b.omega.size) for b in fit.problem.blocks},
        "periods": {s.key: s.periods for s in spectra},
        **{k: v for k, v in fit.facts.items() if k not in ("chi2", "dof")},
        "routes": routes,
        **({"order": order} if order else {}),
    }
    return Model(
        robot=recording.robot,
        method="refined",
        chains=chains,
        std=_chain_std(chains, dict(zip(names, std, strict=True))),
        linear=recording.linear,
        effects=_friction(fit, recording),
        warnings=tuple(dict.fromkeys(warnings)),
        covariance=frozen_float(covariance) if finite else None,
        parameter_names=names if finite else (),
        fit=_plain(facts),
        provenance=_provenance(recording),
    )


def _apart(spectra: Sequence[LineSpectra], fit: Fit) -> float:
    """Median relative difference of the fitted FRF and a rational one, over lines and motors."""
    rational = rational_modes(spectra, fit.structure.sizes)
    if rational is None:
        return 0.0
    measured = rational[1]
    omega = 2 * np.pi * measured.frequency_hz
    _, stiffness, _ = condense_dense(
        fit.problem.structure, fit.solution.p[: fit.problem.structure.count], omega
    )
    ours = np.linalg.inv(stiffness)
    # The rational fit took the torque a quarter of a sample late; magnitudes do not care.
    index = np.arange(ours.shape[1])
    ratio = np.abs(ours[:, index, index]) / np.maximum(np.abs(measured.frf[:, index, index]), 1e-300)
    return float(np.median(np.abs(np.log(np.maximum(ratio, 1e-300)))))


def _friction(fit: Fit, recording: Recording) -> tuple[EffectTerm, ...]:
    """Friction that the fit could not do without: part of the model, or its simulation would not damp."""
    torque = "N" if recording.linear else "N·m"
    damping = units(recording.linear)["damping"]
    found = []
    for name, estimate in fit.facts["friction"].items():
        # Names read A1.coulomb, A1.viscous, A1.viscous.2; axis names may hold dots of their own.
        value, std = estimate["value"], estimate["std"]
        if not value > 3.0 * std:
            continue
        if name.endswith(".coulomb"):
            axis = name.removesuffix(".coulomb")
            found.append(
                EffectTerm(
                    "coulomb_friction", axis, {"torque": Estimate(value, std, torque)}, element="mass 1"
                )
            )
            continue
        axis, _, number = name.rpartition(".viscous")
        element = f"mass {number.removeprefix('.') or 1}"
        found.append(
            EffectTerm(
                "viscous_friction", axis, {"coefficient": Estimate(value, std, damping)}, element=element
            )
        )
    return tuple(found)


def _plain(value: Any) -> Any:
    """Strict JSON has no NaN and no infinity: they become null."""
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    if isinstance(value, np.bool_):
        return bool(value)
    if isinstance(value, np.integer):
        return int(value)
    return value


def _routes(
    paper: PaperResult | InvidError,
    names: Sequence[str],
    values: Float64,
    covariance: Float64,
    warnings: list[str],
) -> dict[str, Any]:
    """Do the paper's inverse and the maximum-likelihood fit agree within their joint uncertainty?"""
    if isinstance(paper, InvidError):
        return {"paper": None, "reason": str(paper)}
    theirs = dict(zip(_paper_names(paper.chains), _paper_values(paper.chains), strict=True))
    spread = dict(zip(_paper_names(paper.chains), np.diag(paper.covariance), strict=True))
    worst_name, worst = "", 0.0
    table: dict[str, float] = {}
    for k, name in enumerate(names):
        if name not in theirs:
            continue
        table[name] = float(theirs[name])
        joint = float(np.sqrt(max(spread[name], 0.0) + max(covariance[k, k], 0.0)))
        # The paper's route knows no friction, no time offset and no hold: half a per cent beyond
        # the joint uncertainty is its own.
        joint = float(np.hypot(joint, 0.005 * abs(values[k])))
        z = abs(theirs[name] - values[k]) / joint if np.isfinite(joint) and joint > 0 else 0.0
        if z > worst:
            worst_name, worst = name, z
    # 4 standard deviations on the worst of a few dozen parameters.
    agree = worst < 4.0
    if not agree:
        warnings.append(
            f"the paper's inverse gives {theirs[worst_name]:.4g} for {worst_name}, the fit "
            f"{values[list(names).index(worst_name)]:.4g}, {worst:.1f} joint standard deviations apart: the "
            "structure (number of masses, friction, a spring to ground) may differ from the machine's"
        )
    return {"paper": table, "agree": agree, "worst": {"name": worst_name, "deviations": worst}}


def _paper_values(chains: CoupledChains) -> list[float]:
    out: list[float] = []
    for m, k in zip(chains.masses, chains.springs, strict=True):
        out += [*m.tolist(), *k.tolist()]
    count = chains.branches
    out += [float(chains.couplings[i, j]) for i in range(count) for j in range(i + 1, count)]
    return out


def _chain_std(chains: CoupledChains, std: dict[str, float]) -> ChainStd:
    def column(axis: str, kind: str, count: int) -> Float64:
        return frozen_float([std.get(f"{axis}.{kind}.{q + 1}", np.nan) for q in range(count)])

    couplings = np.full((chains.branches, chains.branches), np.nan)
    for i, a in enumerate(chains.axes):
        for j, b in enumerate(chains.axes):
            if i < j:
                couplings[i, j] = couplings[j, i] = std.get(f"{a}-{b}.coupling", np.nan)
    sizes = chains.masses_per_branch
    return ChainStd(
        masses=tuple(column(a, "mass", n) for a, n in zip(chains.axes, sizes, strict=True)),
        springs=tuple(column(a, "spring", n - 1) for a, n in zip(chains.axes, sizes, strict=True)),
        dampers=tuple(column(a, "damper", n - 1) for a, n in zip(chains.axes, sizes, strict=True)),
        couplings=frozen_float(couplings),
        ground_springs=frozen_float([std.get(f"{a}.ground_spring", np.nan) for a in chains.axes]),
    )


__all__ = ["fit_sizes", "identify", "measured_frf"]
