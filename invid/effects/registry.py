"""All causes: the catalogue of the contract, those of installed packages, those of given files.

A package offers effects in the entry point group ``invid.effects`` (an ``Effect`` or several); a file holds
``EFFECT`` (or ``EFFECTS``). Helpers that are forked know what their caller knew.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from pathlib import Path

from invid.effects.catalogue.asymmetric_friction import AsymmetricFriction
from invid.effects.catalogue.backlash import Backlash
from invid.effects.catalogue.base_compliance import BaseCompliance
from invid.effects.catalogue.cogging import Cogging
from invid.effects.catalogue.coulomb_friction import CoulombFriction
from invid.effects.catalogue.coupling_stiffness import CouplingStiffness
from invid.effects.catalogue.cubic_stiffness import CubicStiffness
from invid.effects.catalogue.dropped_samples import DroppedSamples
from invid.effects.catalogue.encoder_eccentricity import EncoderEccentricity
from invid.effects.catalogue.extra_mode import ExtraMode
from invid.effects.catalogue.gravity import Gravity
from invid.effects.catalogue.parameter_drift import ParameterDrift
from invid.effects.catalogue.payload_change import PayloadChange
from invid.effects.catalogue.presliding_friction import PreslidingFriction
from invid.effects.catalogue.spring_damping import SpringDamping
from invid.effects.catalogue.spring_hysteresis import SpringHysteresis
from invid.effects.catalogue.stribeck_friction import StribeckFriction
from invid.effects.catalogue.torque_delay import TorqueDelay
from invid.effects.catalogue.torque_gain import TorqueGain
from invid.effects.catalogue.torque_lag import TorqueLag
from invid.effects.catalogue.torque_offset import TorqueOffset
from invid.effects.catalogue.torque_saturation import TorqueSaturation
from invid.effects.catalogue.transmission_error import TransmissionError
from invid.effects.catalogue.viscous_friction import ViscousFriction
from invid.effects.effect import Effect
from invid.effects.effect_files import check_effect, installed_effects, load_effects
from invid.effects.large_motion.load_dependent_friction import LoadDependentFriction
from invid.effects.large_motion.quadratic_stiffness import QuadraticStiffness
from invid.effects.laws.empirical_law import EmpiricalLaw
from invid.errors import InputError
from invid.model.document import EffectTerm

CATALOGUE: tuple[Effect, ...] = (
    CoulombFriction(),
    ViscousFriction(),
    StribeckFriction(),
    PreslidingFriction(),
    AsymmetricFriction(),
    TorqueOffset(),
    Cogging(),
    TorqueDelay(),
    TorqueLag(),
    TorqueGain(),
    TorqueSaturation(),
    EncoderEccentricity(),
    DroppedSamples(),
    SpringDamping(),
    CubicStiffness(),
    Backlash(),
    SpringHysteresis(),
    TransmissionError(),
    Gravity(),
    ExtraMode(),
    CouplingStiffness(),
    BaseCompliance(),
    PayloadChange(),
    ParameterDrift(),
)
"""Every cause of the contract."""
LARGE_MOTION: tuple[Effect, ...] = (LoadDependentFriction(), QuadraticStiffness())
"""Causes that show only in large motion of a rigid machine."""
UNSOUGHT: tuple[Effect, ...] = (*LARGE_MOTION, EmpiricalLaw())
"""Causes that models hold and that no screen of the catalogue tests."""

_further: ContextVar[tuple[Effect, ...]] = ContextVar("further effects", default=())


def further_effects() -> tuple[Effect, ...]:
    """Effects besides the catalogue: of installed packages, then those registered at present."""
    return (*_installed_effects(), *_further.get())


def effects() -> tuple[Effect, ...]:
    """Every cause that a search tests."""
    return (*CATALOGUE, *further_effects())


def effect_of(cause: str) -> Effect | None:
    """The effect with this cause; ``None`` where there is none."""
    return next((e for e in (*effects(), *UNSOUGHT) if e.cause == cause), None)


def law_of(term: EffectTerm) -> Effect | None:
    """The effect of a term of a model with what the term states of it; ``None`` for an unknown cause."""
    effect = effect_of(term.cause)
    return None if effect is None else effect.known(term)


class _Causes(Mapping[str, Effect]):
    """All effects that are known at present, by name."""

    def __getitem__(self, cause: str) -> Effect:
        found = effect_of(cause)
        if found is None:
            raise KeyError(cause)
        return found

    def __iter__(self) -> Iterator[str]:
        return (e.cause for e in (*effects(), *UNSOUGHT))

    def __len__(self) -> int:
        return len(effects()) + len(UNSOUGHT)


BY_CAUSE: Mapping[str, Effect] = _Causes()
"""The effects of the catalogue and all further ones, by name."""


@contextmanager
def registered_effects(sources: Sequence[Effect | str | Path]) -> Iterator[None]:
    """Context manager that registers further effects, or those of files.

    Raises
    ------
    InputError
        A file that cannot be read, holds no effect, or one that does not do what an effect must.
    """
    found = [
        e
        for one in sources
        for e in ([check_effect(one, "effects")] if isinstance(one, Effect) else load_effects(Path(one)))
    ]
    _check_looks_like(found)
    token = _further.set(_merge_effects(_further.get(), found))
    try:
        yield
    finally:
        _further.reset(token)


@cache
def _installed_effects() -> tuple[Effect, ...]:
    """The effects of installed packages; InputError names one that cannot be used."""
    return _merge_effects((), installed_effects())


def _check_looks_like(found: Sequence[Effect]) -> None:
    """Refuse look-alikes that nothing known is called."""
    known = sorted({e.cause for e in (*effects(), *UNSOUGHT, *found)})
    for effect in found:
        strange = sorted(set(effect.looks_like) - set(known))
        if strange:
            raise InputError(
                f"effect {effect.cause}: looks_like names {strange[0]!r}; known: {', '.join(known)}"
            )


def _merge_effects(known: tuple[Effect, ...], more: Sequence[Effect]) -> tuple[Effect, ...]:
    """Known and further effects, each cause once; InputError where two have the same name."""
    out = list(known)
    taken = {e.cause for e in (*CATALOGUE, *UNSOUGHT)}
    for effect in more:
        if effect.cause in taken:
            raise InputError(f"effect {effect.cause}: the catalogue has a cause of that name; choose another")
        if any(type(e) is type(effect) for e in out if e.cause == effect.cause):
            continue
        if any(e.cause == effect.cause for e in out):
            raise InputError(f"effect {effect.cause}: two effects have that name; choose another")
        out.append(effect)
    return tuple(out)
