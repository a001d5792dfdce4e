"""Recording to model: starts from the paper's inverse, then the structured maximum-likelihood fit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from invid.errors import InputError, InvidError, NotIdentifiableError
from invid.identification.crosscheck import (
    MOST_BEATEN,
    SUSPECT,
    compare_routes,
    missed_by_structure,
    second_route,
    widen_by_method_error,
)
from invid.identification.fewer_masses import fewer_masses_warnings
from invid.identification.ground_springs import fit_ground_springs
from invid.identification.machine_kind import ChainsTried, machine_kind, rigid_model
from invid.identification.model_facts import paper_model, refined_model
from invid.identification.model_order import choose_order
from invid.identification.starts import chain_starts, fit_sizes, measured_frf
from invid.identification.stated_inertia import against_stated
from invid.identification.torque_timing import refit_with_late_torque
from invid.inverse import PaperResult, identify_paper
from invid.likelihood.fit import AT_NOISE, Fit, fit_structure
from invid.model.chains import CoupledChains
from invid.model.document import Model
from invid.model.parameters import ChainStructure
from invid.modes.pole_search import search_modes
from invid.modes.settle import settled_frf
from invid.numerics import budget
from invid.recording.model import Recording, Role
from invid.recording.still_axes import masses_of_moving
from invid.signals.drive_torque import replace_by_acting_torque
from invid.signals.frf import FrfMatrix
from invid.signals.plausibility import check_excitation
from invid.signals.repair import repair
from invid.signals.spectra import LineSpectra, all_spectra

TIME_TO_SEARCH = 0.9
"""Share of a budget for everything but covariances and sentences about the model (empirical)."""

Masses = Sequence[int] | Literal["auto"] | None
Method = Literal["paper", "refined"]


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
    whole = recording
    recording, warnings = repair(recording)
    masses = masses_of_moving(masses, whole, recording)
    # Steps far from the solution may overflow; the search sees it in their cost and takes them back.
    with budget.use_share(TIME_TO_SEARCH), np.errstate(all="ignore"):
        try:
            model = _identify_kind(recording, masses, method)
        except np.linalg.LinAlgError as error:
            raise NotIdentifiableError(
                f"{recording.source}: no chain of masses and springs fits these records to any finite error "
                f"({error}); check the signs and units of position and torque, and the number of masses"
            ) from None
    budget_warning = budget.warning()
    warnings = warnings if budget_warning is None else [*warnings, budget_warning]
    model = replace(model, warnings=(*model.warnings, *warnings)) if warnings else model
    return against_stated(model, whole)


def _identify_kind(recording: Recording, masses: Masses, method: Method) -> Model:
    """Model of rigid inertias or of chains, by the kind of the recording."""
    if method == "refined":
        kind = machine_kind(
            recording, masses, lambda: ChainsTried.of(recording, identify_chains(recording, masses))
        )
        if kind.rigid:
            return rigid_model(recording, kind)
        if kind.model is not None:
            return kind.model
    return identify_chains(recording, masses, method)


def identify_chains(recording: Recording, masses: Masses, method: Method = "refined") -> Model:
    """``identify`` for a machine that is known to be elastic."""
    budget.tell("reading spectra", 0.0)
    spectra = all_spectra(recording, Role.IDENTIFY)
    check_excitation(recording, spectra)
    spectra = replace_by_acting_torque(spectra, recording.experiments)
    wanted = recording.masses_per_axis if masses is None else masses
    warnings = [w for s in spectra for w in s.warnings]
    order: dict[str, Any] = {}
    further: list[CoupledChains] = []
    if wanted is None or isinstance(wanted, str):
        choice = choose_order(spectra, recording.axes)
        sizes, order = choice.sizes, choice.evidence
        warnings += choice.warnings
        further = [] if choice.chains is None else [choice.chains]
    else:
        sizes = _checked_sizes(recording, wanted)
    if method == "paper":
        result, measured = _identify_by_paper(spectra, sizes, recording.axes)
        return paper_model(recording, result, measured, warnings, order)
    measured = measured_frf(spectra)
    fit = fit_sizes(spectra, sizes, recording.axes, measured, further=further, declared=not order)
    if not order:
        fit = restart_mode_by_mode(spectra, fit)
    paper: PaperResult | InvidError = NotIdentifiableError("the budget was spent before the second route")
    if not budget.is_left_out("the paper's method as a second route"):
        fit, paper = restart_from_second_route(spectra, fit)
    doubtful = fit.noise_chi2 > SUSPECT and not budget.is_left_out("springs to ground and late torque")
    if doubtful and min(missed_by_structure(spectra, fit)) > MOST_BEATEN:

        def starts_for(corrected: Sequence[LineSpectra]) -> Iterator[CoupledChains]:
            return chain_starts(corrected, sizes, recording.axes, measured_frf(corrected), (), False)

        other = refit_with_late_torque(spectra, fit, starts_for)
        other = other if other is not fit else fit_ground_springs(spectra, fit, starts_for)
        fit, paper = other, paper if other is fit else second_route(spectra, other)
    warnings += fewer_masses_warnings(sizes, fit)
    return refined_model(recording, spectra, fit, paper, warnings, order)


def restart_mode_by_mode(spectra: Sequence[LineSpectra], fit: Fit) -> Fit:
    """The better of the fit and one from the plant that the search for the number of masses ends at.

    Restarted only where the fit stalled far above the noise and misses more than two per cent: a wrong
    minimum, or a machine that is not linear. An FRF without structure may miss as much there. Of one axis
    alone, for of several that search takes minutes. Empirical: three masses behind a torque late by more than
    half a sample stalled on two of ten plants, from starts by their modes; a plant that grows by the mode
    that is missing did not.
    """
    sizes, axes = fit.structure.sizes, fit.structure.axes
    stalled = fit.solution.result != "converged" and fit.noise_chi2 > SUSPECT
    if not stalled or len(sizes) > 1 or missed_by_structure(spectra, fit)[1] < MOST_BEATEN:
        return fit
    if budget.is_left_out("a start of the identification mode by mode"):
        return fit
    choice = choose_order(spectra, axes)
    if choice.sizes != sizes or choice.chains is None:
        return fit
    refitted = fit_structure(spectra, ChainStructure(sizes, axes), [choice.chains])
    return refitted if refitted.noise_cost < 0.9 * fit.noise_cost else fit


def restart_from_second_route(
    spectra: Sequence[LineSpectra], fit: Fit
) -> tuple[Fit, PaperResult | InvidError]:
    """The better of the fit and one restarted from the paper's result, and the paper's result.

    Restarted only where the paper's modes explain the FRF to its noise while the fit is above it and
    disagrees: one of the two is then in a wrong minimum.
    """
    paper = second_route(spectra, fit)
    if isinstance(paper, InvidError) or paper.modes.model_error > 0.0:
        return fit, paper
    at_noise = fit.solution.result == "converged" and fit.noise_chi2 < AT_NOISE
    if at_noise or compare_routes(paper, fit.names, fit.values, fit.covariance, [])["agree"]:
        return fit, paper
    structure = ChainStructure(fit.structure.sizes, fit.structure.axes)
    refitted = fit_structure(spectra, structure, [paper.chains])
    if refitted.noise_cost < 0.9 * fit.noise_cost:
        return refitted, second_route(spectra, refitted)
    return fit, paper


def _identify_by_paper(
    spectra: Sequence[LineSpectra], sizes: Sequence[int], axes: Sequence[str]
) -> tuple[PaperResult, FrfMatrix]:
    """The paper's route, its standard deviations widened by the error of its method, and the FRF matrix.

    Held torque acts later than recorded; modes are searched on the records, under their noise, before they
    are fitted to the FRF matrix.
    """
    found = search_modes(spectra, sizes)
    start = None
    if found is not None:
        start, _, delay = found
        spectra = [
            replace(s, torque=s.torque * np.exp(-1j * s.omega * delay)[:, None], staircase=0.0 * s.staircase)
            for s in spectra
        ]
    measured = settled_frf(spectra, sizes, measured_frf(spectra, misfit=0.0))
    if measured.frequency_hz.size == 0:
        raise NotIdentifiableError("no frequency at which all axes are excited: the FRF matrix is incomplete")
    data = (measured.frequency_hz, measured.frf, measured.variance)
    try:
        try:
            result = identify_paper(*data, sizes, axes=axes, start=start)
        except NotIdentifiableError:
            if start is None:
                raise
            result = identify_paper(*data, sizes, axes=axes)
    except (np.linalg.LinAlgError, ValueError, FloatingPointError) as error:
        raise NotIdentifiableError(f"the paper's method failed on these data: {error}") from None
    return widen_by_method_error(result, measured), measured


def _checked_sizes(recording: Recording, wanted: Sequence[int]) -> tuple[int, ...]:
    sizes = tuple(int(n) for n in wanted)
    if len(sizes) != recording.axis_count or any(n < 1 for n in sizes):
        raise InputError(
            f"masses: {list(wanted)} for {recording.axis_count} axes {list(recording.axes)}; give one number "
            "≥ 1 for each axis, or auto"
        )
    return sizes


__all__ = ["fit_sizes", "identify", "identify_chains", "measured_frf"]
