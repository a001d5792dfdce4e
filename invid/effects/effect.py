"""The interface of an effect.

An effect adds to the missing torque r = Z Θ − A T of the linear model a *contribution*: r plus the
contributions of all effects is zero for a perfect model. A resistance f (a force −f on the pattern b of
coordinates) contributes Wᵀ b f; what it does to the inner coordinates is q = W Θ − Z_ii⁻¹ b f.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, ClassVar, Literal, Self

import numpy as np

from invid.effects.elements import Element, ModelPlace
from invid.effects.parameter import Parameter
from invid.effects.sizes import Size
from invid.errors import InputError, ModelError
from invid.model.document import EffectTerm
from invid.model.law_table import LawTable
from invid.model.place import Place
from invid.model.plant import Structure
from invid.numerics.arrays import Float64
from invid.wording.sentence import sentence

FAMILIES = (
    "friction", "position", "spring", "constant", "time", "structure", "linear", "sensor", "sampling",
    "scale", "saturation", "actuator_dynamics", "other",
)  # fmt: skip
"""Kinds of cause."""
HOMES = ("motor", "end", "spring", "axis", "base")
OVER = ("", "velocity", "position", "deflection", "deflection rate", "torque", "torque rate")
"""Quantities over which missing torque can be drawn."""


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
    (the contract's names with their kinds of unit) and ``main``, the first.
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
    home: Literal["motor", "end", "spring", "axis", "base"] = "motor"
    """Place of the effect in a model that does not state one."""
    stands: ClassVar[tuple[Callable[[Structure], list[Place]], ...] | None] = None
    """Kinds of places where it may sit (``invid.model.place``); none where no search of chains asks."""
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
    parameters: ClassVar[Mapping[str, str]] = MappingProxyType({})
    rotary: bool = False
    main: str = ""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if "numbers" not in cls.__dict__:
            return
        if not (isinstance(cls.numbers, tuple) and all(isinstance(p, Parameter) for p in cls.numbers)):
            raise InputError("numbers is a tuple of parameters: numbers = (Parameter(name, unit),)")
        follows: dict[str, Any] = {
            "parameters": {p.name: p.unit for p in cls.numbers},
            "main": next((p.name for p in cls.numbers), ""),
        }
        for name, value in follows.items():
            if name not in cls.__dict__:
                setattr(cls, name, value)

    def places(self, structure: Structure) -> list[Place]:
        """All places where it may sit: those of ``stands``, each once."""
        return list(dict.fromkeys(p for places in self.stands or () for p in places(structure)))

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

    def size_text(self, size: str) -> str:
        """The size as a sentence states it."""
        return sentence(" of {size}", size=size)

    @property
    def title_text(self) -> str:
        """The title as a part of a sentence."""
        return sentence(self.title)
