"""The interface of an effect.

An effect adds to the missing torque r = Z Θ − A T of the linear model a *contribution*: r plus the
contributions of all effects is zero for a perfect model. A resistance f (a force −f on the pattern b of
coordinates) contributes Wᵀ b f; what it does to the inner coordinates is q = W Θ − Z_ii⁻¹ b f.

The parameters of an effect inside a fit are a vector ``x``: first the linear coefficients, then the
shape parameters (logarithms where they must be positive).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, ClassVar, Literal, Self

import numpy as np

from invid.effects.elements import Element, ModelPlace
from invid.effects.laws.beyond_band import beyond_band, solve_beyond_band
from invid.effects.motion import View, along
from invid.effects.parameter import Parameter
from invid.effects.sizes import Size
from invid.errors import InputError, ModelError
from invid.model.chains import CoupledChains
from invid.model.document import EffectTerm
from invid.model.law_table import LawTable
from invid.model.parameters import ChainStructure
from invid.model.place import Pattern, Place
from invid.numerics.arrays import Complex128, Float64

FAMILIES = (
    "friction", "position", "spring", "constant", "time", "structure", "linear", "sensor", "sampling",
    "scale", "saturation", "actuator_dynamics", "other",
)  # fmt: skip
"""Kinds of cause. Two laws of friction sit at one place only where their ``parts`` differ."""
HOMES = ("motor", "end", "spring", "axis", "base")
OVER = ("", "velocity", "position", "deflection", "deflection rate", "torque", "torque rate")
"""Quantities over which missing torque can be drawn."""
KNOWN_LINES = 60
"""Laws at motors whose lines a record keeps: a few shapes of each motor's friction and ripples."""


@dataclass(frozen=True)
class Experiment:
    """The experiment that tells a cause from its look-alikes: kind of measurement, and the same in words.

    ``by_hand``: what a person has to do where no motion of the drives shows it.
    """

    KINDS: ClassVar = ("speeds", "positions", "amplitudes", "band", "lines", "time", "hand")
    kind: Literal["speeds", "positions", "amplitudes", "band", "lines", "time", "hand"]
    text: str = ""
    by_hand: str = ""

    def __post_init__(self) -> None:
        if self.kind not in self.KINDS:
            known = ", ".join(repr(k) for k in self.KINDS)
            raise InputError(f"Experiment: kind is {self.kind!r}; it is one of {known}")


@dataclass(frozen=True, eq=False)
class PlaceMotion:
    """The motion at a place over time as a law may use it, each (n,) [rad or m, s].

    ``rest`` is the speed below which noise hides the direction. ``load`` is the torque that the rest of the
    machine demands of the joint and ``torque_rate`` the rate of the drive's torque [N·m, N·m/s], where they
    are known.
    """

    position: Float64
    velocity: Float64
    time: Float64
    rest: float = 0.0
    load: Float64 | None = None
    torque_rate: Float64 | None = None

    @cached_property
    def direction(self) -> Float64:
        """(n,) sign of the velocity, softened over its noise."""
        v = self.velocity
        out: Float64 = np.sign(v) if self.rest <= 0 else np.tanh(2.0 * v / self.rest)
        return out


class Effect:
    """One cause of the catalogue. Subclasses are stateless; the catalogue holds one of each.

    ``numbers`` are its parameters. From them follow, where a class does not say otherwise, ``parameters``
    (the contract's names with their kinds of unit), ``coefficients``, which are linear (bounds in
    ``lower``/``upper``), ``shapes``, which are not (``logarithmic``: which of them move as logarithms), and
    ``main``, the first.
    """

    numbers: ClassVar[tuple[Parameter, ...]] = ()

    cause: str = ""
    title: str = ""
    check: str = ""
    """What a technician looks at."""
    separating: Experiment = Experiment("hand", "")
    """The experiment that tells it from its look-alikes."""
    looks_like: tuple[str, ...] = ()
    """Causes that it is easily mistaken for."""
    family: str = ""
    parts: tuple[str, ...] = ()
    """Kinds of friction that it consists of; two laws with a common part do not sit at one place."""
    home: Literal["motor", "end", "spring", "axis", "base"] = "motor"
    """Place of the effect in a model that does not state one."""
    over: str = ""
    """Quantity over which its missing torque is drawn (``invid.effects.curve``); "" where it has no such
    picture."""
    across: str = ""
    """Second quantity that it depends on, "" for none (``motion_effect.PAIRS``)."""
    path: bool = False
    """Whether its curve is a path in time, as a hysteresis is."""
    sizes: tuple[Size, ...] = ()
    """Measures of its size with published figures, the most informative first."""
    optional: ClassVar[Mapping[str, float]] = MappingProxyType({})
    """Parameters that a model need not name, as they are then."""
    in_samples: bool = False
    """Whether it sits in the samples and not in the plant; it is found there, and not fitted."""
    in_chain: bool = False
    """Whether the linear parameters already contain it; it is part of the fit, not to be found."""
    parameters: ClassVar[Mapping[str, str]] = MappingProxyType({})
    coefficients: tuple[str, ...] = ()
    lower: tuple[float, ...] = ()
    upper: tuple[float, ...] = ()
    shapes: tuple[str, ...] = ()
    logarithmic: tuple[bool, ...] = ()
    rotary: bool = False
    least_axes: int = 1
    main: str = ""
    along_pattern: bool = True
    """Whether its force lies along the pattern of its place and can be estimated from the missing torque."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if "numbers" not in cls.__dict__:
            return
        if not (isinstance(cls.numbers, tuple) and all(isinstance(p, Parameter) for p in cls.numbers)):
            raise InputError("numbers is a tuple of parameters: numbers = (Parameter(name, unit),)")
        linear = [p for p in cls.numbers if p.linear]
        shapes = [p for p in cls.numbers if not p.linear]
        follows: dict[str, Any] = {
            "parameters": {p.name: p.unit for p in cls.numbers},
            "coefficients": tuple(p.name for p in linear),
            "lower": tuple(p.low for p in linear),
            "upper": tuple(p.high for p in linear),
            "shapes": tuple(p.name for p in shapes),
            "logarithmic": tuple(p.logarithmic for p in shapes),
            "main": next((p.name for p in cls.numbers), ""),
        }
        for name, value in follows.items():
            if name not in cls.__dict__:
                setattr(cls, name, value)

    def places(self, structure: ChainStructure) -> list[Place]:
        """All places where it may sit."""
        raise NotImplementedError

    def grid(self, views: Sequence[View], place: Place) -> list[tuple[float, ...]]:
        """Shapes to start from, out of the data; [()] where it has none."""
        return [()]

    def limits(self, views: Sequence[View], place: Place) -> list[tuple[float, float]]:
        """Bounds of the shapes as they are fitted; unbounded by default."""
        return [(-np.inf, np.inf)] * len(self.shapes)

    def difference(self, view: View, shape: int, value: float) -> float:
        """Step of a shape for finite differences."""
        return 1e-4 * (1.0 if self.logarithmic[shape] else max(abs(value), 1e-6))

    def basis(self, view: View, place: Place, shape: Sequence[float]) -> Complex128:
        """(F, M, L) contribution for each coefficient at one."""
        raise NotImplementedError

    def contribution(
        self, view: View, place: Place, x: Sequence[float]
    ) -> tuple[Complex128, Complex128 | None]:
        """(F, M) contribution to r at ``x`` and (F, ΣN) the inner motion that it causes."""
        count = len(self.coefficients)
        columns = self.basis(view, place, x[count:])
        out: Complex128 = columns @ np.asarray(x[:count])
        return out, None

    def stands(self, view: View, place: Place) -> bool:
        """Return whether its force at a motor depends on inner motion, as friction does while the motor
        stands.
        """
        return False

    def remembers(self, view: View, place: Place, x: Sequence[float]) -> bool:
        """Return whether its force in a record depends on its initial state (``view.starts``)."""
        return False

    def follows_motor(self, place: Place) -> bool:
        """Return whether its force at a place of inner motion follows from the motor's measured motion
        alone.
        """
        return False

    def rarity(self, place: Place, structure: ChainStructure) -> float:
        """−2 ln of the prior odds that this cause sits here and not at its usual place."""
        return 0.0

    def noise_power(
        self, view: View, place: Place, x: Sequence[float]
    ) -> tuple[float | Float64, float | Float64]:
        """Factors on the noise powers of position and torque, as numbers or (F,).

        Removing a sensor's fault scales its noise, and an actuator that transmits less torque transmits less
        of its noise.
        """
        return 1.0, 1.0

    def values(self, x: Sequence[float], place: Place) -> dict[str, float]:
        """Parameters of the contract by name from the fitted vector, logarithms undone."""
        names = (*self.coefficients, *self.shapes)
        logarithms = (*(False for _ in self.coefficients), *self.logarithmic)
        return {
            name: float(np.exp(value) if log else value)
            for name, value, log in zip(names, x, logarithms, strict=True)
        }

    def vector(self, p: Mapping[str, float]) -> list[float]:
        """Fitted vector from the contract's parameters: the inverse of ``values``."""
        logs = dict(zip(self.shapes, self.logarithmic, strict=True))
        names = (*self.coefficients, *self.shapes)
        return [float(np.log(p[n])) if logs.get(n) else float(p[n]) for n in names]

    def stands_beside(self, other: Effect) -> bool:
        """Return whether both may sit at one place; of two laws of friction, whether they have no part
        in common.
        """
        if self.cause == other.cause:
            return False
        if self.family == other.family == "friction":
            return not set(self.parts or (self.cause,)) & set(other.parts or (other.cause,))
        return True

    def most_places(self, structure: ChainStructure) -> int | None:
        """Number of places at which it can be seen at once; ``None`` for no limit."""
        return None

    def pattern(self, structure: ChainStructure, place: Place, x: Sequence[float]) -> Pattern:
        """Coordinates that its force acts on at ``x``; those of the place unless it fits them."""
        return place.pattern(structure)

    def of_structure(self, structure: ChainStructure) -> Effect:
        """The law with as many parameters as a machine of this structure asks for."""
        return self

    def of_machine(self, chains: CoupledChains) -> Effect:
        """The law with what its parameters' names and values need of the machine."""
        return self

    def known(self, term: EffectTerm) -> Self:
        """The law with what a model states of it beyond its parameters."""
        return self

    def table(self, x: Float64, covariance: Float64, *, linear: bool) -> LawTable | None:
        """The law at ``x`` (k,) with ``covariance`` (k, k) as a table, where no parameters say it."""
        return None

    def curve(self, p: Mapping[str, float], x: Float64, stiffness: float) -> Float64 | None:
        """(n,) resistance over ``x`` (n,), the quantity ``over``, with the parameters ``p``; for pictures.

        ``stiffness`` [N·m/rad or N/m] is that of the spring it sits in.
        """
        return None

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        """Elements for the simulators; ModelError where it cannot be simulated."""
        raise ModelError(f"effect {self.cause} on {at.term.axis}: it says nothing on how to simulate it")

    def regressors(self, motion: PlaceMotion, shape: Sequence[float]) -> Float64:
        """(n, k) resistance for each coefficient at one, where an axis is one rigid mass.

        ``shape`` are the shape parameters themselves, no logarithms.
        """
        raise InputError(f"effect {self.cause}: it has no law for large motion")

    def size_text(self, size: str) -> str:
        """The size as a sentence states it."""
        return f" of {size}"

    def beyond(self, views: Sequence[View], place: Place, x: Sequence[float]) -> bool:
        """Return whether it is larger than what it acts on, or than the motion in the records, and so
        is none.

        A spring that drifts by more than itself stands for another spring, a gap that the deflection never
        crosses for none.
        """
        return False

    def is_null(self, x: Sequence[float]) -> bool:
        """Return whether it is at a bound where it has no force."""
        count = len(self.coefficients)
        return bool(count) and all(abs(c) < 1e-300 for c in x[:count])


class ForceEffect(Effect):
    """A resistance given by a law of motion over time."""

    smeared = False
    local: ClassVar[bool] = True
    """Whether the force at a sample depends only on the motion at it and at its neighbours."""
    answered: ClassVar[bool] = False
    """Whether the law responds to the motion beyond the band that its own force causes (``beyond_band``)."""

    def law(self, view: View, place: Place, shape: Sequence[float]) -> Float64:
        """(n, L) resistance for each coefficient at one."""
        raise NotImplementedError

    of_motor_motion: ClassVar[bool] = False
    """Whether its law at a motor follows from the measured motion alone, so that no fit changes its lines."""

    def force(self, view: View, place: Place, shape: Sequence[float]) -> Complex128:
        """(F, L) lines of the resistance for each coefficient at one."""
        if not view.is_measured(place.pattern(view.structure)):
            return view.at_motion(
                (self, place, tuple(shape)),
                lambda: view.to_lines(self.law(view, place, shape), smeared=self.smeared),
            )
        view = view.on_fine_grid()
        if not self.of_motor_motion:
            return view.to_lines(self.law(view, place, shape), smeared=self.smeared)
        known, key = view.record.law_lines, (self.cause, place, tuple(shape))
        if key not in known:
            known[key] = view.to_lines(self.law(view, place, shape), smeared=self.smeared)
        if len(known) > KNOWN_LINES:
            del known[next(iter(known))]
        return known[key]

    def compliance_beyond_band(self, view: View, place: Place) -> Float64 | None:
        """(n//2 + 1,) receptance beyond the band; ``None`` where the law does not respond to motion there.

        Nor does one with memory in a record that does not close, where its state at the start is open.
        """
        if not self.answered or (view.record.transient and not self.local):
            return None
        return beyond_band(view, place)

    def basis(self, view: View, place: Place, shape: Sequence[float]) -> Complex128:
        reached = view.condensed_force(place.pattern(view.structure))
        out: Complex128 = reached[:, :, None] * self.force(view, place, shape)[:, None, :]
        return out

    def contribution(
        self, view: View, place: Place, x: Sequence[float]
    ) -> tuple[Complex128, Complex128 | None]:
        if self.local and view.is_measured(place.pattern(view.structure)):
            fine = view.on_fine_grid()
            return view.cached((self, place, tuple(x)), lambda: self._contribution(fine, place, x))
        return self._contribution(view, place, x)

    def _contribution(self, view: View, place: Place, x: Sequence[float]) -> tuple[Complex128, Complex128]:
        count = len(self.coefficients)
        pattern = place.pattern(view.structure)
        compliance = self.compliance_beyond_band(view, place)
        if compliance is not None:

            def resisting() -> Float64:
                out: Float64 = self.law(view, place, x[count:]) @ np.asarray(x[:count])
                return out

            wave = solve_beyond_band(view, pattern, compliance, resisting)
            total = view.to_lines(wave[:, None], smeared=self.smeared)[:, 0]
        else:
            total = self.force(view, place, x[count:]) @ np.asarray(x[:count])
        return view.condensed_force(pattern) * total[:, None], -view.inner_receptance(pattern) * total[
            :, None
        ]


class ImpedanceEffect(Effect):
    """A resistance linear in the motion along its pattern: exact, whatever its size."""

    steady: ClassVar[bool] = True
    """Whether it is constant over a record, so that its force follows from the motors' spectra alone."""

    def impedance(self, view: View, place: Place, x: Sequence[float]) -> Complex128:
        """(F,) force per motion."""
        raise NotImplementedError

    def basis(self, view: View, place: Place, shape: Sequence[float]) -> Complex128:
        pattern = self.pattern(view.structure, place, (1.0, *shape))
        z = self.impedance(view, place, (1.0, *shape))
        if view.record.transient:  # the wave that laws are read from closes; the motion does not
            raw = view.unfiltered
            moved = along(pattern, raw + view.feedback + view.end_motion)
        else:
            moved = view.spectrum(pattern)
        force = z * moved + self.within(view, place, (1.0, *shape))
        out: Complex128 = view.condensed_force(pattern)[:, :, None] * force[:, None, None]
        return out

    def within(self, view: View, place: Place, x: Sequence[float]) -> Complex128 | float:
        """(F,) force beside the impedance, which is only the mean of an effect that changes over the
        record."""
        return 0.0

    def contribution(
        self, view: View, place: Place, x: Sequence[float]
    ) -> tuple[Complex128, Complex128 | None]:
        pattern = self.pattern(view.structure, place, x)
        raw = view.unfiltered
        z = self.impedance(view, place, x)
        force = (z * along(pattern, raw) + self.within(view, place, x)) / (
            1.0 + z * view.driving_point_receptance(pattern)
        )
        return view.condensed_force(pattern) * force[:, None], -view.inner_receptance(pattern) * force[
            :, None
        ]

    def of_jumps(self, view: View, place: Place, x: Sequence[float], moved: Complex128) -> Complex128:
        """(F, 2ΣN) force along the pattern, without its own answer, for a unit jump of each coordinate's
        position and velocity.

        ``moved`` (F, ΣN, 2ΣN): motion of the linear plant for the jumps. Masses and dampers have ends of
        their own, (2/T)((d + jωm)Δx + mΔv).
        """
        pattern = self.pattern(view.structure, place, x)
        force: Complex128 = self.impedance(view, place, x)[:, None] * along(pattern, moved)
        mass, damper = self.carries(view, x)
        stored = np.stack((damper + 1j * view.omega * mass, np.full(view.omega.size, mass, dtype=complex)))
        stored *= 2.0 / view.record.span
        stored[:, 0] *= 0.5
        for at, sign in pattern:
            force[:, at] += sign * stored[0]
            force[:, view.base.shape[1] + at] += sign * stored[1]
        return force

    def carries(self, view: View, x: Sequence[float]) -> tuple[float | Complex128, float]:
        """Mass, or (F,) what stands where a mass would, and damper that its impedance contains."""
        return 0.0, 0.0

    def of_own_jumps(self, view: View, place: Place, x: Sequence[float]) -> Complex128 | None:
        """(F, 2) force along the pattern, without its own answer, for jumps of a mass of its own.

        Of position and of velocity, each twice its motion; ``None`` for an effect without a mass of its own.
        """
        return None

    def force_per_motion(self, view: View, place: Place, x: Sequence[float]) -> Complex128:
        """(F,) force per motion that the pattern would have without the effect."""
        z = self.impedance(view, place, x)
        pattern = self.pattern(view.structure, place, x)
        out: Complex128 = z / (1.0 + z * view.driving_point_receptance(pattern))
        return out
