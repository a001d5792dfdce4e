"""All causes: the catalogue of the contract, those of installed packages, those of given files.

A package offers effects in the entry point group ``invid.effects`` (an ``Effect`` or several); a file holds
``EFFECT`` (or ``EFFECTS``). Helpers that are forked know what their caller knew.
"""

from __future__ import annotations

import hashlib
import importlib.util
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np

from invid.effects.catalogue.asymmetric_friction import AsymmetricFriction
from invid.effects.catalogue.backlash import Backlash
from invid.effects.catalogue.cogging import Cogging
from invid.effects.catalogue.coulomb_friction import CoulombFriction
from invid.effects.catalogue.coupling_stiffness import CouplingStiffness
from invid.effects.catalogue.cubic_stiffness import CubicStiffness
from invid.effects.catalogue.dropped_samples import DroppedSamples
from invid.effects.catalogue.encoder_eccentricity import EncoderEccentricity
from invid.effects.catalogue.extra_mode import ExtraMode
from invid.effects.catalogue.gravity import Gravity
from invid.effects.catalogue.load_dependent_friction import LoadDependentFriction
from invid.effects.catalogue.parameter_drift import ParameterDrift
from invid.effects.catalogue.payload_change import PayloadChange
from invid.effects.catalogue.presliding_friction import PreslidingFriction
from invid.effects.catalogue.quadratic_stiffness import QuadraticStiffness
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
from invid.effects.effect import Effect, PlaceMotion
from invid.effects.motion_effect import MotionEffect
from invid.effects.units import unit_of
from invid.errors import InputError
from invid.model.document import EffectTerm
from invid.model.parameters import ChainStructure

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
    PayloadChange(),
    ParameterDrift(),
)
"""Every cause of the contract."""
LARGE_MOTION: tuple[Effect, ...] = (LoadDependentFriction(), QuadraticStiffness())
"""Causes that show only in large motion of a rigid machine."""
GROUP = "invid.effects"
"""Entry point group of installed packages."""

_further: ContextVar[tuple[Effect, ...]] = ContextVar("further effects", default=())


def further_effects() -> tuple[Effect, ...]:
    """Effects besides the catalogue: of installed packages, then those registered at present."""
    return (*_installed_effects(), *_further.get())


def effects() -> tuple[Effect, ...]:
    """Every cause that a search tests."""
    return (*CATALOGUE, *further_effects())


def effect_of(cause: str) -> Effect | None:
    """The effect with this cause; ``None`` where there is none."""
    return next((e for e in (*effects(), *LARGE_MOTION) if e.cause == cause), None)


def effects_of_plant(terms: Sequence[EffectTerm]) -> tuple[EffectTerm, ...]:
    """The effects of a model without those that sit in the samples of a recording."""
    return tuple(t for t in terms if (e := effect_of(t.cause)) is None or not e.in_samples)


class _Causes(Mapping[str, Effect]):
    """All effects that are known at present, by name."""

    def __getitem__(self, cause: str) -> Effect:
        found = effect_of(cause)
        if found is None:
            raise KeyError(cause)
        return found

    def __iter__(self) -> Iterator[str]:
        return (e.cause for e in (*effects(), *LARGE_MOTION))

    def __len__(self) -> int:
        return len(effects()) + len(LARGE_MOTION)


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
    found = [e for one in sources for e in ([one] if isinstance(one, Effect) else load_effects(Path(one)))]
    for effect in found:
        _check_effect(effect, "effects")
    token = _further.set(_merge_effects(_further.get(), found))
    try:
        yield
    finally:
        _further.reset(token)


def load_effects(path: Path) -> tuple[Effect, ...]:
    """The effects of a Python file (``EFFECT`` or ``EFFECTS``); InputError says what is wrong."""
    where = f"effects file {path}"
    try:
        source = path.read_bytes()
    except OSError as error:
        raise InputError(f"{where}: cannot be read: {error.strerror}") from None
    key = hashlib.sha256(str(path.resolve()).encode() + b"\0" + source).hexdigest()[:16]
    name = f"invid_effects_{key}"  # as what is pickled between helpers names it
    module = sys.modules.get(name)
    if module is None:
        spec = importlib.util.spec_from_file_location(name, path)
        if spec is None or spec.loader is None:
            raise InputError(f"{where}: is no Python file; its name has to end in .py")
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        try:
            spec.loader.exec_module(module)
        except Exception as error:  # whatever a stranger's file raises
            del sys.modules[name]
            line = getattr(error, "lineno", None)
            at = f" in line {line}" if line else ""
            raise InputError(f"{where}: {type(error).__name__}{at}: {error}") from None
    held = getattr(module, "EFFECTS", None) or getattr(module, "EFFECT", None)
    return tuple(_check_effect(e, where) for e in _effects_held(held, where))


@cache
def _installed_effects() -> tuple[Effect, ...]:
    """The effects of installed packages; InputError names one that cannot be used."""
    found: list[Effect] = []
    for entry in sorted(entry_points(group=GROUP), key=lambda e: e.name):
        package = "a package" if entry.dist is None else f"package {entry.dist.name}"
        where = f"{package}, entry point {entry.name!r} of {GROUP}"
        try:
            held = entry.load()
        except Exception as error:  # whatever a stranger's package raises
            raise InputError(
                f"{where}: {type(error).__name__}: {error}; mend or uninstall the package"
            ) from None
        found += [_check_effect(e, where) for e in _effects_held(held, where)]
    return _merge_effects((), found)


def _effects_held(held: object, where: str) -> Sequence[object]:
    if held is None:
        raise InputError(f"{where}: holds no EFFECT; write EFFECT = YourEffect() at its end")
    return held if isinstance(held, list | tuple) else (held,)


def _check_effect(effect: object, where: str) -> Effect:
    """The effect itself; InputError where it lacks what an effect must have."""
    if isinstance(effect, type) and issubclass(effect, Effect):
        raise InputError(
            f"{where}: EFFECT is the class {effect.__name__}; write EFFECT = {effect.__name__}()"
        )
    if not isinstance(effect, Effect):
        raise InputError(f"{where}: EFFECT is {type(effect).__name__}, no invid.effects.Effect")
    where = f"{where}: {effect.cause or type(effect).__name__}"
    if not effect.cause.isidentifier():
        raise InputError(f"{where}: cause is {effect.cause!r}; give it a name as quadratic_drag")
    for name in ("title", "check", "family"):
        if not getattr(effect, name):
            raise InputError(f"{where}: {name} is empty; say it in a few words")
    if not effect.parameters:
        raise InputError(f"{where}: it has no parameters; give numbers = (Parameter(...),)")
    for kind in effect.parameters.values():
        unit_of(kind, linear=False)
    try:
        effect.places(ChainStructure((2, 2), ("A1", "A2"), viscous=False, grounded=()))
        if isinstance(effect, MotionEffect):
            _try_law(effect)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    except Exception as error:  # whatever a stranger's law raises
        raise InputError(f"{where}: {type(error).__name__} on a motion of ten samples: {error}") from None
    return effect


def _try_law(effect: MotionEffect) -> None:
    """Evaluates its law on a motion of ten samples; InputError where the result is not usable."""
    x = np.linspace(-1.0, 1.0, 10)
    starts = effect.starts(1.0, 1.0)
    if not starts:
        raise InputError("a parameter that is not linear needs starts, values to begin from")
    out = np.asarray(effect.resistance(PlaceMotion(x, x[::-1].copy(), x), starts[0]))
    if out.shape != (10, len(effect.coefficients)) or not np.isfinite(out).all():
        raise InputError(
            f"its resistance has shape {out.shape}; it must be finite, (samples, linear parameters), here "
            f"(10, {len(effect.coefficients)})"
        )


def _merge_effects(known: tuple[Effect, ...], more: Sequence[Effect]) -> tuple[Effect, ...]:
    """Known and further effects, each cause once; InputError where two have the same name."""
    out = list(known)
    taken = {e.cause for e in (*CATALOGUE, *LARGE_MOTION)}
    for effect in more:
        if effect.cause in taken:
            raise InputError(f"effect {effect.cause}: the catalogue has a cause of that name; choose another")
        if any(type(e) is type(effect) for e in out if e.cause == effect.cause):
            continue
        if any(e.cause == effect.cause for e in out):
            raise InputError(f"effect {effect.cause}: two effects have that name; choose another")
        out.append(effect)
    return tuple(out)
