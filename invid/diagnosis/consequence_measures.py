"""What a cause amounts to on its machine: shares of rated torque, angles at the load, shifts of resonance.

Each measure is a function of the effect and the machine; it returns ``None`` where the recording does not say
enough (no rated torque, no spring).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from invid.diagnosis.consequence_rules import ARCMIN
from invid.model.chains import CoupledChains
from invid.model.document import EffectTerm
from invid.model.forward import resonances
from invid.numerics.arrays import Float64, frozen_float


@dataclass(frozen=True)
class Machine:
    """What a size is compared with: the identified chains, and by axis rated torque [N·m or N], the speed it
    works at [rad/s or m/s], limits of its own (by measure); ``duration`` of the measurement [s]."""

    chains: CoupledChains
    linear: bool
    rated: Mapping[str, float]
    speed: Mapping[str, float]
    duration: float
    acceptable: Mapping[str, Mapping[str, float]]

    def compliance(self, axis: str, element: str | None) -> float | None:
        """Angle per torque [rad/(N·m)] of the springs between the motor and a mass."""
        springs = self.chains.springs[self.chains.axes.index(axis)]
        kind, number = place_of(element)
        end = number - 1 if kind == "mass" else springs.size
        return float(np.sum(1.0 / springs[:end])) if end > 0 else None

    def spring(self, axis: str, element: str | None) -> float | None:
        """Stiffness of the spring that an effect acts at [N·m/rad]."""
        springs = self.chains.springs[self.chains.axes.index(axis)]
        kind, number = place_of(element)
        return float(springs[number - 1]) if kind == "spring" and 0 < number <= springs.size else None


def place_of(element: str | None) -> tuple[str, int]:
    """Kind and number of an element ("spring 2"); ("", 0) where there is none."""
    kind, _, number = (element or "").partition(" ")
    return (kind, int(number)) if number.isdigit() else ("", 0)


Measure = Callable[[EffectTerm, Machine], float | None]


def _share(*names: str) -> Measure:
    """The largest of these torques over rated torque."""

    def measure(term: EffectTerm, machine: Machine) -> float | None:
        rated = machine.rated.get(term.axis)
        sizes = [abs(term.parameters[n].value) for n in names if n in term.parameters]
        return max(sizes) / rated if rated and sizes else None

    return measure


def _viscous_share(term: EffectTerm, machine: Machine) -> float | None:
    rated, speed = machine.rated.get(term.axis), machine.speed.get(term.axis)
    return abs(term.value("coefficient")) * speed / rated if rated and speed else None


def _asymmetric_share(term: EffectTerm, machine: Machine) -> float | None:
    rated, speed = machine.rated.get(term.axis), machine.speed.get(term.axis) or 0.0
    if not rated:
        return None
    sides = ("positive", "negative")
    return (
        max(abs(term.value(f"coulomb_{s}")) + abs(term.value(f"viscous_{s}")) * speed for s in sides) / rated
    )


def _shortfall(term: EffectTerm, machine: Machine) -> float | None:
    rated = machine.rated.get(term.axis)
    return max(0.0, 1.0 - term.value("limit") / rated) if rated else None


def _size(name: str, factor: float = 1.0) -> Measure:
    return lambda term, machine: factor * abs(term.value(name))


def _lost_motion(term: EffectTerm, machine: Machine) -> float | None:
    """Without load the slider still holds the spring apart by torque/stiffness, to either side."""
    stiffness = machine.spring(term.axis, term.element)
    return 2.0 * abs(term.value("torque")) / stiffness if stiffness else None


def _sag(term: EffectTerm, machine: Machine) -> float | None:
    """Angle by which a torque at an outer mass stays behind the motor."""
    compliance = machine.compliance(term.axis, term.element)
    return abs(term.value("torque")) * compliance if compliance else None


def _stiffening(term: EffectTerm, machine: Machine) -> float | None:
    """Relative change of the stiffness, 3 c d²/k, at the deflection of rated torque, d = T/k."""
    stiffness, rated = machine.spring(term.axis, term.element), machine.rated.get(term.axis)
    if not stiffness or not rated or term.value("coefficient") < 0:
        return None
    return 3.0 * term.value("coefficient") * (rated / stiffness) ** 2 / stiffness


def _drift(term: EffectTerm, machine: Machine) -> float | None:
    stiffness = machine.spring(term.axis, term.element)
    return abs(term.value("rate")) * machine.duration / stiffness if stiffness else None


def _load_change(term: EffectTerm, machine: Machine) -> float | None:
    return abs(term.value("mass")) / float(machine.chains.masses[machine.chains.axes.index(term.axis)][-1])


def _resonance_change(term: EffectTerm, machine: Machine) -> float | None:
    """Relative change of the lowest resonance of the robot by the effect, signed."""
    alter = _STRUCTURES.get(term.cause)
    natural = resonances(machine.chains)
    before = natural[natural > 0]
    if alter is None or before.size == 0:
        return None
    stiffness, mass = alter(term, machine)
    try:
        values = scipy.linalg.eigh(stiffness, mass, eigvals_only=True)
    except np.linalg.LinAlgError:  # a load that takes away more than there is
        return None
    # Rigid motion is zero up to rounding; a resonance is not.
    after = np.sqrt(values[values > 1e-9 * values[-1]])
    return float(after[0] / before[0] - 1.0) if after.size else None


def _with_mode(term: EffectTerm, machine: Machine) -> tuple[Float64, Float64]:
    chains = machine.chains
    count, at = chains.dofs, _dof(term, machine)
    k, m = np.zeros((count + 1, count + 1)), np.zeros((count + 1, count + 1))
    k[:count, :count], m[:count, :count] = chains.stiffness_matrix, chains.mass_matrix
    m[count, count] = term.value("mass")
    pull = np.zeros(count + 1)
    pull[at], pull[count] = 1.0, -1.0
    return k + term.value("stiffness") * np.outer(pull, pull), m


def _with_tie(term: EffectTerm, machine: Machine) -> tuple[Float64, Float64]:
    chains, pull = machine.chains, np.zeros(machine.chains.dofs)
    ends = chains.end_dofs
    pull[ends[chains.axes.index(term.axis)]] = 1.0
    if term.other_axis in chains.axes:
        pull[ends[chains.axes.index(term.other_axis)]] = -1.0
    return chains.stiffness_matrix + term.value("stiffness") * np.outer(pull, pull), chains.mass_matrix


def _with_load(term: EffectTerm, machine: Machine) -> tuple[Float64, Float64]:
    mass = machine.chains.mass_matrix.copy()
    at = machine.chains.end_dofs[machine.chains.axes.index(term.axis)]
    mass[at, at] += term.value("mass")
    return machine.chains.stiffness_matrix, mass


def _with_drift(term: EffectTerm, machine: Machine) -> tuple[Float64, Float64]:
    chains, (_, number) = machine.chains, place_of(term.element)
    axis = chains.axes.index(term.axis)
    if not 0 < number <= chains.springs[axis].size:
        return chains.stiffness_matrix, chains.mass_matrix
    springs = [s.copy() for s in chains.springs]
    # Never below a hundredth: a rate is extrapolated over the whole measurement.
    springs[axis][number - 1] = max(
        springs[axis][number - 1] + term.value("rate") * machine.duration, 0.01 * springs[axis][number - 1]
    )
    moved = replace(chains, springs=tuple(frozen_float(s) for s in springs))
    return moved.stiffness_matrix, moved.mass_matrix


def _dof(term: EffectTerm, machine: Machine) -> int:
    chains = machine.chains
    i = chains.axes.index(term.axis)
    _, number = place_of(term.element)
    return int(chains.motor_dofs[i]) + min(max(number, 1), chains.masses[i].size) - 1


_STRUCTURES: Mapping[str, Callable[[EffectTerm, Machine], tuple[Float64, Float64]]] = {
    "extra_mode": _with_mode,
    "coupling_stiffness": _with_tie,
    "payload_change": _with_load,
    "parameter_drift": _with_drift,
}

_FRICTION, _AT_SPEED = "friction_fraction_of_rated", "friction_at_speed_fraction_of_rated"
OWN_LIMIT: Mapping[str, str] = {_AT_SPEED: _FRICTION}
"""Key of the config's ``acceptable`` where it is not the measure's own name."""
MEASURES: Mapping[str, tuple[tuple[str, Measure], ...]] = {
    "coulomb_friction": ((_FRICTION, _share("torque")), ("angle_at_load", _sag)),
    "viscous_friction": ((_AT_SPEED, _viscous_share),),
    "stribeck_friction": ((_FRICTION, _share("static", "coulomb")),),
    "presliding_friction": ((_FRICTION, _share("torque")),),
    "asymmetric_friction": ((_FRICTION, _asymmetric_share),),
    "torque_offset": (("torque_offset_fraction_of_rated", _share("torque")),),
    "cogging": (("torque_ripple_fraction_of_rated", _share("torque")),),
    "gravity": (("gravity_fraction_of_rated", _share("torque")), ("angle_at_load", _sag)),
    "torque_delay": (("torque_delay", _size("delay")),),
    "torque_lag": (("torque_delay", _size("time_constant")),),
    "torque_gain": (("torque_gain_error_fraction", lambda term, _: abs(term.value("gain") - 1.0)),),
    "torque_saturation": (("torque_shortfall_fraction_of_rated", _shortfall),),
    "encoder_eccentricity": (("encoder_error", _size("amplitude")),),
    "dropped_samples": (("dropped_samples_fraction", _size("fraction")),),
    "cubic_stiffness": (("stiffening_fraction", _stiffening),),
    "backlash": (("backlash", _size("gap")),),
    "spring_hysteresis": (("lost_motion", _lost_motion), ("friction_of_spring", _share("torque"))),
    "transmission_error": (("transmission_error", _size("amplitude", 2.0)),),
    "extra_mode": (("resonance_change_fraction", _resonance_change),),
    "coupling_stiffness": (("resonance_change_fraction", _resonance_change),),
    "payload_change": (
        ("load_change_fraction", _load_change),
        ("resonance_change_fraction", _resonance_change),
    ),
    "parameter_drift": (
        ("stiffness_drift_fraction", _drift),
        ("resonance_change_fraction", _resonance_change),
    ),
}
"""What is measured of each cause; the first is its size in a headline."""

TORQUES = frozenset(
    {
        _FRICTION,
        _AT_SPEED,
        "torque_offset_fraction_of_rated",
        "torque_ripple_fraction_of_rated",
        "gravity_fraction_of_rated",
        "friction_of_spring",
    }
)
"""Measures that are a share of rated torque."""


def _percent(value: float, _linear: bool) -> str:
    return f"{100 * value:.2g} %"


def _signed_percent(value: float, _linear: bool) -> str:
    return f"{100 * value:+.2g} %".replace("-", "−")


def _angle(value: float, linear: bool) -> str:
    if linear:
        return f"{1e3 * value:.2g} mm"
    return f"{1e3 * value:.2g} mrad ({value / ARCMIN:.2g}′)"


def _milliseconds(value: float, _linear: bool) -> str:
    return f"{1e3 * value:.2g} ms"


_PHRASES: Mapping[str, tuple[str, Callable[[float, bool], str]]] = {
    _FRICTION: ("{} of rated torque", _percent),
    _AT_SPEED: ("{} of rated torque at full speed", _percent),
    "torque_offset_fraction_of_rated": ("{} of rated torque", _percent),
    "torque_ripple_fraction_of_rated": ("±{} of rated torque", _percent),
    "gravity_fraction_of_rated": ("{} of rated torque", _percent),
    "friction_of_spring": ("{} of rated torque", _percent),
    "torque_shortfall_fraction_of_rated": ("{} short of rated torque", _percent),
    "torque_gain_error_fraction": ("torque wrong by {}", _percent),
    "torque_delay": ("{} late", _milliseconds),
    "angle_at_load": ("{} at the load", _angle),
    "backlash": ("{} of play", _angle),
    "lost_motion": ("{} of lost motion", _angle),
    "transmission_error": ("{} peak to peak", _angle),
    "encoder_error": ("±{} of the reading", _angle),
    "stiffening_fraction": ("{} stiffer at rated torque", _percent),
    "stiffness_drift_fraction": ("stiffness moved by {} in this measurement", _percent),
    "load_change_fraction": ("{} of the load", _percent),
    "resonance_change_fraction": ("lowest resonance {}", _signed_percent),
    "dropped_samples_fraction": ("{} of the samples", _percent),
}


def phrase(measure: str, value: float, linear: bool) -> str:
    """ "0.2 % of rated torque", "0.3 mrad (1′) of play"."""
    return _PHRASES[measure][0].format(number(measure, value, linear))


def number(measure: str, value: float, linear: bool) -> str:
    """The size alone: "0.2 %", "0.3 mrad (1′)"."""
    return _PHRASES[measure][1](value, linear)


def measures_of(term: EffectTerm, machine: Machine) -> dict[str, float]:
    """Every measure of an effect that the machine's data allow, the most telling first."""
    found: dict[str, float] = {}
    for name, measure in MEASURES.get(term.cause, ()):
        value = measure(term, machine)
        if value is not None and math.isfinite(value):
            found[name] = value
    return found
