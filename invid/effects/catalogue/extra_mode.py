"""A mass on a spring that the model does not have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from invid.effects.effect import Experiment, ImpedanceEffect
from invid.effects.elements import AddedMass, Element, ModelPlace
from invid.effects.motion import View, along
from invid.effects.sizes import RESONANCE, Size, resonance_change, with_mode
from invid.model.parameters import ChainStructure
from invid.model.place import Pattern, Place, mass_places
from invid.numerics.arrays import Complex128

MOST_PEAKS = 8
"""Peaks of the missing torque that are tried as frequencies of the mode."""
MOST_BEYOND_BAND = 2.0
"""Highest frequency of a mode over the highest excited line. Physical: a mode m, ω₀ above the band adds
m·ω⁴/ω₀²·(1 + (ω/ω₀)² + …) to a mass: m/ω₀² shows first, the two apart only by the terms after it, a quarter
of it here. Nearer, a strong one is determined (``is_frequency_known``); farther off it is a compliance of any
kind."""


class ExtraMode(ImpedanceEffect):
    """A mass m on a spring k (and a light damper) at one of the masses; shapes: frequency and damping."""

    cause = "extra_mode"
    title = "a resonance that the model does not have"
    check = "Look for a flexible attachment: a tool, a cable carrier, a loose foot or cover."
    separating = Experiment("lines", "a finer and wider grid of frequencies around the resonance")
    family = "structure"
    looks_like = ("coupling_stiffness", "viscous_friction")
    home = "end"
    optional: ClassVar[Mapping[str, float]] = {"damping_ratio": 0.01}
    sizes = (Size(RESONANCE, resonance_change(with_mode)),)
    parameters: ClassVar[Mapping[str, str]] = {
        "mass": "mass",
        "stiffness": "stiffness",
        "damping_ratio": "ratio",
    }
    coefficients = ("mass",)
    lower, upper = (0.0,), (np.inf,)
    shapes, logarithmic = ("frequency", "damping"), (True, True)
    main = "mass"

    def places(self, structure: ChainStructure) -> list[Place]:
        return mass_places(structure)

    def grid(self, views: Sequence[View], place: Place) -> list[tuple[float, ...]]:
        frequencies = frequency_grid(views, (place.pattern(views[0].structure),))
        return [(float(np.log(w)), float(np.log(0.02))) for w in frequencies]

    def limits(self, views: Sequence[View], place: Place) -> list[tuple[float, float]]:
        low, high = excited_band(views)
        return [
            (float(np.log(low)), float(np.log(MOST_BEYOND_BAND * high))),
            (float(np.log(1e-3)), float(np.log(0.2))),
        ]

    def impedance(self, view: View, place: Place, x: Sequence[float]) -> Complex128:
        own, zeta = float(np.exp(x[1])), float(np.exp(x[2]))
        w = view.omega
        spring = own**2 + 2j * zeta * own * w
        out: Complex128 = -(w**2) * x[0] * spring / (spring - w**2)
        return out

    def of_own_jumps(self, view: View, place: Place, x: Sequence[float]) -> Complex128:
        # m·(−ω²Y + (2/T)(jωΔx + Δv)) with Y from the mass' own balance: both reach the host by its spring.
        own, zeta, w = float(np.exp(x[1])), float(np.exp(x[2])), view.omega
        spring = own**2 + 2j * zeta * own * w
        pattern = place.pattern(view.structure)
        moved = along(pattern, view.base) * spring / (spring - w**2)
        bound = 2.0 * np.array([np.linalg.norm(moved), np.linalg.norm(w * moved)])
        jumps = np.stack((1j * w * own**2, spring), axis=-1) * bound
        out: Complex128 = (2.0 * x[0] / view.record.span) * jumps / (spring - w**2)[:, None]
        out[0] *= 0.5
        return out

    def values(self, x: Sequence[float], place: Place) -> dict[str, float]:
        return {
            "mass": float(x[0]),
            "stiffness": float(x[0] * np.exp(2 * x[1])),
            "damping_ratio": float(np.exp(x[2])),
        }

    def vector(self, p: Mapping[str, float]) -> list[float]:
        own = 0.5 * np.log(p["stiffness"] / p["mass"])
        return [p["mass"], float(own), float(np.log(p["damping_ratio"]))]

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        ratio = at.optional("damping_ratio", self.optional["damping_ratio"])
        size = at.positive("mass"), at.positive("stiffness")
        return [AddedMass(at.mass(at.last), *size, max(ratio, 0.0))]


def frequency_grid(views: Sequence[View], patterns: Sequence[Pattern]) -> list[float]:
    """Frequencies [rad/s] to start from, ascending: the band, and where a force along one of the patterns is
    missed most."""
    low = min(float(v.omega[1:].min()) for v in views)
    high = 0.95 * MOST_BEYOND_BAND * excited_band(views)[1]
    wide = [float(w) for w in np.geomspace(3 * low, high, 17)]
    # A light mode is narrower than this grid's spacing: the record itself says where to look.
    narrow = [w for pattern in patterns for w in _peak_frequencies(views, pattern)]
    return sorted({*wide, *narrow})


def is_frequency_known(views: Sequence[View], frequency: float, std: float) -> bool:
    """Return whether a mode's frequency [rad/s] is within the band or significantly below the highest
    allowed one.

    ``std`` is that of its logarithm; three standard deviations.
    """
    high = excited_band(views)[1]
    return frequency <= high or float(np.log(frequency)) + 3.0 * std < float(np.log(MOST_BEYOND_BAND * high))


def _peak_frequencies(views: Sequence[View], pattern: Pattern) -> list[float]:
    """Frequencies [rad/s] at which a force along the pattern explains most of the missing torque.

    Three neighbouring lines (of every record) are taken together, at the centroid of their power: a light
    mode is narrower than the lines are apart. None within a twentieth of a larger one.
    """
    omega, power, records = [], [], 0
    for view in views:
        missing = view.missing if view.remaining is None else view.remaining
        if missing is None:
            continue
        used = np.flatnonzero(np.asarray(view.record.excited, dtype=bool))
        reached = view.condensed_force(pattern)[used]
        weighted = np.einsum("fij,fj->fi", view.certainty[used], reached).conj()
        information = np.einsum("fi,fi->f", weighted, reached).real
        force = np.einsum("fi,fi->f", weighted, missing[used])
        omega.append(view.omega[used])
        power.append(np.abs(force) ** 2 / np.maximum(information, 1e-300))
        records += 1
    if not records:
        return []
    w, p = np.concatenate(omega), np.concatenate(power)
    order = np.argsort(w)
    window = min(3 * records, w.size)
    kernel = np.ones(window) / window
    centred = np.convolve(w[order] * p[order], kernel, mode="same")
    p = np.convolve(p[order], kernel, mode="same")
    w = np.divide(centred, p, out=w[order], where=p > 0.0)
    found: list[float] = []
    for k in np.argsort(-p):
        if all(abs(w[k] / f - 1.0) > 0.05 for f in found):
            found.append(float(w[k]))
        if len(found) == MOST_PEAKS:
            break
    return found


def excited_band(views: Sequence[View]) -> tuple[float, float]:
    """Lowest and highest excited line [rad/s].

    Below all of them a damped mode is the same as friction at its mass.
    """
    lines = []
    for view in views:
        omega = view.omega
        excited = np.asarray(view.record.excited, dtype=bool).reshape(omega.size, -1).any(axis=1)
        lines.append(omega[excited] if excited.any() else omega[1:])
    all_lines = np.concatenate(lines)
    return float(all_lines.min()), float(all_lines.max())
