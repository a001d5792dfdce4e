"""Size of an effect on its machine, and the sizes from which it matters.

Each measure is a function of the effect and the machine; it returns ``None`` where the recording does not say
enough (no rated torque, no spring). Published figures for geared servo axes stand beside them: up to
``expected`` a finding is what such drives are like; from ``serious`` on somebody should look. Where the
config gives a limit of its own (``acceptable``), that counts instead; a size without a figure is judged by
nothing. Where a source gives a range, its upper end is usual and twice that is serious (a convention), unless
the source has another class of drives above it. Angles are those at the output of the gear; publications are
for rotary robot axes, and figures with ``linear`` hold by physics for both kinds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from invid.effects.laws.moving_base import moved_by_base
from invid.model.chains import CoupledChains
from invid.model.document import EffectTerm
from invid.model.forward import resonances
from invid.numerics.arrays import Float64, frozen_float
from invid.wording.sentence import Figure, marked, sentence

ARCMIN = math.pi / 180 / 60
"""One minute of arc [rad]."""
ARCSEC = ARCMIN / 60

JOINT_SOURCE = sentence(
    "friction of an industrial robot's joint, 3 to 15 % of its largest torque ({source})",
    source="Bittencourt and Gunnarsson, J. Dyn. Syst. Meas. Control 134, 2012, 051013",
)
PLAY_SOURCE = sentence(
    "1′ of cycloidal robot gears ({rv}), 3′ of standard servo planetary gears ({planetary})",
    rv="Nabtesco RV",
    planetary="Wittenstein glossary",
)
HYSTERESIS_SOURCE = sentence(
    "hysteresis loss of strain-wave gears, up to 2′ ({source})", source="Harmonic Drive CSF and CSG, p. 49"
)
ACCURACY_SOURCE = sentence(
    "positional accuracy of strain-wave gearheads, 1 to 1.5′ ({source})", source="Harmonic Drive SHD"
)
ENCODER_SOURCE = sentence(
    "accuracy of motor encoders, ±20″ optical, ±65″ inductive ({source})",
    source="Heidenhain, Encoders for Servo Drives",
)
COGGING_SOURCE = sentence(
    "cogging of servo motors, ±1 to ±2 % of rated torque ({source})", source="Kollmorgen, Synchronism"
)
CONSTANT_SOURCE = sentence(
    "tolerance of a servo motor's torque constant, ±10 % ({source})", source="Kollmorgen AKM"
)
STIFFENING_SOURCE = sentence(
    "rise of a strain-wave gear's stiffness up to rated torque, K3/K1 of about 2 ({source})",
    source="Harmonic Drive CSF",
)
RATED_SOURCE = sentence(
    "rated torque is what the motor can give for ever ({source})", source="IEC 60034-1, duty S1"
)


@dataclass(frozen=True)
class Machine:
    """References for sizes: the identified chains, and by axis rated torque [N·m or N], speed [rad/s or m/s]
    and limits by measure; ``duration`` of the measurement [s]."""

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


Measured = Callable[[EffectTerm, Machine], float | None]


def share(*names: str) -> Measured:
    """Measure: the largest of these torques over rated torque."""

    def measure(term: EffectTerm, machine: Machine) -> float | None:
        rated = machine.rated.get(term.axis)
        sizes = [abs(term.parameters[n].value) for n in names if n in term.parameters]
        return max(sizes) / rated if rated and sizes else None

    return measure


def viscous_share(term: EffectTerm, machine: Machine) -> float | None:
    rated, speed = machine.rated.get(term.axis), machine.speed.get(term.axis)
    return abs(term.value("coefficient")) * speed / rated if rated and speed else None


def asymmetric_share(term: EffectTerm, machine: Machine) -> float | None:
    rated, speed = machine.rated.get(term.axis), machine.speed.get(term.axis) or 0.0
    if not rated:
        return None
    sides = ("positive", "negative")
    return (
        max(abs(term.value(f"coulomb_{s}")) + abs(term.value(f"viscous_{s}")) * speed for s in sides) / rated
    )


def shortfall(term: EffectTerm, machine: Machine) -> float | None:
    rated = machine.rated.get(term.axis)
    return max(0.0, 1.0 - term.value("limit") / rated) if rated else None


def size(name: str, factor: float = 1.0) -> Measured:
    return lambda term, machine: factor * abs(term.value(name))


def scale_error(term: EffectTerm, machine: Machine) -> float | None:
    """Absolute difference of a scale from one."""
    return abs(term.value("gain") - 1.0)


def lost_motion(term: EffectTerm, machine: Machine) -> float | None:
    """Deflection by which the slider still holds the spring apart without load, to either side:
    torque/stiffness."""
    stiffness = machine.spring(term.axis, term.element)
    return 2.0 * abs(term.value("torque")) / stiffness if stiffness else None


def sag(term: EffectTerm, machine: Machine) -> float | None:
    """Angle by which an outer mass lags behind the motor under a torque."""
    compliance = machine.compliance(term.axis, term.element)
    return abs(term.value("torque")) * compliance if compliance else None


def stiffening(term: EffectTerm, machine: Machine) -> float | None:
    """Relative change of the stiffness, 3 c d²/k, at the deflection of rated torque, d = T/k."""
    stiffness, rated = machine.spring(term.axis, term.element), machine.rated.get(term.axis)
    if not stiffness or not rated or term.value("coefficient") < 0:
        return None
    return 3.0 * term.value("coefficient") * (rated / stiffness) ** 2 / stiffness


def drift(term: EffectTerm, machine: Machine) -> float | None:
    stiffness = machine.spring(term.axis, term.element)
    return abs(term.value("rate")) * machine.duration / stiffness if stiffness else None


def load_change(term: EffectTerm, machine: Machine) -> float | None:
    return abs(term.value("mass")) / float(machine.chains.masses[machine.chains.axes.index(term.axis)][-1])


def resonance_change(alter: Callable[[EffectTerm, Machine], tuple[Float64, Float64]]) -> Measured:
    """Relative change of the lowest resonance of the robot, signed; ``alter``: stiffness and mass with it."""

    def measure(term: EffectTerm, machine: Machine) -> float | None:
        natural = resonances(machine.chains)
        before = natural[natural > 0]
        if before.size == 0:
            return None
        stiffness, mass = alter(term, machine)
        try:
            values = scipy.linalg.eigh(stiffness, mass, eigvals_only=True)
        except np.linalg.LinAlgError:  # a load that takes away more than there is
            return None
        # Rigid motion is zero up to rounding; a resonance is not.
        after = np.sqrt(values[values > 1e-9 * values[-1]])
        return float(after[0] / before[0] - 1.0) if after.size else None

    return measure


def with_mode(term: EffectTerm, machine: Machine) -> tuple[Float64, Float64]:
    chains = machine.chains
    count, at = chains.dofs, _coordinate(term, machine)
    k, m = np.zeros((count + 1, count + 1)), np.zeros((count + 1, count + 1))
    k[:count, :count], m[:count, :count] = chains.stiffness_matrix, chains.mass_matrix
    m[count, count] = term.value("mass")
    pull = np.zeros(count + 1)
    pull[at], pull[count] = 1.0, -1.0
    return k + term.value("stiffness") * np.outer(pull, pull), m


def with_base(term: EffectTerm, machine: Machine) -> tuple[Float64, Float64]:
    chains, inertia = machine.chains, machine.chains.end_mass_matrix
    total, force = moved_by_base({name: e.value for name, e in term.parameters.items()}, inertia)
    k, m = (scipy.linalg.block_diag(part, own) for part, own in (
        (chains.stiffness_matrix, term.value("stiffness")), (chains.mass_matrix, total)
    ))  # fmt: skip
    m[-1, chains.end_dofs] = m[chains.end_dofs, -1] = force
    return k, m


def with_tie(term: EffectTerm, machine: Machine) -> tuple[Float64, Float64]:
    chains, pull = machine.chains, np.zeros(machine.chains.dofs)
    ends = chains.end_dofs
    pull[ends[chains.axes.index(term.axis)]] = 1.0
    if term.other_axis in chains.axes:
        pull[ends[chains.axes.index(term.other_axis)]] = -1.0
    return chains.stiffness_matrix + term.value("stiffness") * np.outer(pull, pull), chains.mass_matrix


def with_load(term: EffectTerm, machine: Machine) -> tuple[Float64, Float64]:
    mass = machine.chains.mass_matrix.copy()
    at = machine.chains.end_dofs[machine.chains.axes.index(term.axis)]
    mass[at, at] += term.value("mass")
    return machine.chains.stiffness_matrix, mass


def with_drift(term: EffectTerm, machine: Machine) -> tuple[Float64, Float64]:
    chains, (_, number) = machine.chains, place_of(term.element)
    axis = chains.axes.index(term.axis)
    if not 0 < number <= chains.springs[axis].size:
        return chains.stiffness_matrix, chains.mass_matrix
    springs = [s.copy() for s in chains.springs]
    # Never below a hundredth: a rate is extrapolated over the whole measurement.
    springs[axis][number - 1] = max(
        springs[axis][number - 1] + term.value("rate") * machine.duration, 0.01 * springs[axis][number - 1]
    )
    changed = replace(chains, springs=tuple(frozen_float(s) for s in springs))
    return changed.stiffness_matrix, changed.mass_matrix


def _coordinate(term: EffectTerm, machine: Machine) -> int:
    chains = machine.chains
    i = chains.axes.index(term.axis)
    _, number = place_of(term.element)
    return int(chains.motor_dofs[i]) + min(max(number, 1), chains.masses[i].size) - 1


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


@dataclass(frozen=True)
class Quantity:
    """A measured quantity of an effect, with its words ("{size} of rated torque") and number format.

    ``limit``: key of the config's ``acceptable`` where it is not the own name. ``torque``: whether it is a
    share of rated torque.
    """

    name: str
    words: str
    write: Callable[[float, bool], str]
    torque: bool = False
    limit: str = ""

    def phrase(self, value: float, linear: bool) -> str:
        """ "0.2 % of rated torque", "0.3 mrad (1′) of play"."""
        return sentence(self.words, size=Figure(self.write(value, linear)))


FRICTION = Quantity("friction_fraction_of_rated", marked("{size} of rated torque"), _percent, torque=True)
AT_SPEED = Quantity(
    "friction_at_speed_fraction_of_rated",
    marked("{size} of rated torque at full speed"),
    _percent,
    torque=True,
    limit=FRICTION.name,
)
OFFSET = Quantity("torque_offset_fraction_of_rated", marked("{size} of rated torque"), _percent, torque=True)
RIPPLE = Quantity("torque_ripple_fraction_of_rated", marked("±{size} of rated torque"), _percent, torque=True)
GRAVITY = Quantity("gravity_fraction_of_rated", marked("{size} of rated torque"), _percent, torque=True)
SPRING_FRICTION = Quantity("friction_of_spring", marked("{size} of rated torque"), _percent, torque=True)
SHORTFALL = Quantity("torque_shortfall_fraction_of_rated", marked("{size} short of rated torque"), _percent)
SCALE = Quantity("torque_gain_error_fraction", marked("torque wrong by {size}"), _percent)
LATE = Quantity("torque_delay", marked("{size} late"), _milliseconds)
AT_LOAD = Quantity("angle_at_load", marked("{size} at the load"), _angle)
PLAY = Quantity("backlash", marked("{size} of play"), _angle)
LOST = Quantity("lost_motion", marked("{size} of lost motion"), _angle)
GEAR_ERROR = Quantity("transmission_error", marked("{size} peak to peak"), _angle)
READING = Quantity("encoder_error", marked("±{size} of the reading"), _angle)
STIFFER = Quantity("stiffening_fraction", marked("{size} stiffer at rated torque"), _percent)
DRIFTED = Quantity(
    "stiffness_drift_fraction", marked("stiffness moved by {size} in this measurement"), _percent
)
LOAD = Quantity("load_change_fraction", marked("{size} of the load"), _percent)
RESONANCE = Quantity("resonance_change_fraction", marked("lowest resonance {size}"), _signed_percent)
SAMPLES = Quantity("dropped_samples_fraction", marked("{size} of the samples"), _percent)
QUANTITIES = {q.name: q for q in (
    FRICTION, AT_SPEED, OFFSET, RIPPLE, GRAVITY, SPRING_FRICTION, SHORTFALL, SCALE, LATE, AT_LOAD, PLAY, LOST,
    GEAR_ERROR, READING, STIFFER, DRIFTED, LOAD, RESONANCE, SAMPLES,
)}  # fmt: skip


@dataclass(frozen=True)
class Size:
    """One measure of an effect, with its published figures where there are any: usual up to ``expected``,
    serious from ``serious`` on."""

    quantity: Quantity
    of: Measured
    expected: float | None = None
    serious: float | None = None
    source: str = ""
    linear: bool = False

    def number(self, value: float, linear: bool) -> str:
        """The size as text: "0.2 %", "0.3 mrad (1′)"."""
        return self.quantity.write(value, linear)

    def phrase(self, value: float, linear: bool) -> str:
        """ "0.2 % of rated torque", "0.3 mrad (1′) of play"."""
        return self.quantity.phrase(value, linear)


def measured_sizes(sizes: Sequence[Size], term: EffectTerm, machine: Machine) -> list[tuple[Size, float]]:
    """Every size of an effect that the machine's data allow, the most informative first."""
    found = [(size, size.of(term, machine)) for size in sizes]
    return [(size, value) for size, value in found if value is not None and math.isfinite(value)]
