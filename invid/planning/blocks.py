"""One block of shaking for a goal: interleaved lines, low crest factor, within travel and velocity.

How much torque on which line: lines are interleaved, line k belongs to axis k mod M. In the steady state the
information of a record is a sum over lines, each proportional to its power, M(w) = Σ w_l M_l; the powers that
minimise the scaled trace of M⁻¹ (A-optimality) under a budget for each axis come from the multiplicative
algorithm (Silvey, Titterington, Torsney 1978). The budget is torque power, plus a price on travel and speed
where those limits are near.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from invid.config import CellConfig, MultisineSpec
from invid.errors import ConfigError
from invid.model.chains import CoupledChains
from invid.model.document import parameter_vector
from invid.model.matrices import Condensed, Terms, damper
from invid.numerics.arrays import Complex128, Float64, Int64, frozen_float
from invid.planning.belief import Belief
from invid.planning.build import CREEP_TRAVEL
from invid.planning.expected_covariance import Expected, Noise, expected, is_in_goal, parameter_scale
from invid.planning.forecast import QUANTITIES, usable, with_margin
from invid.planning.model import PlannedExperiment
from invid.planning.phases import played_once
from invid.planning.response import foretold_motion, hold_gains, rubbing
from invid.recording.model import Kind
from invid.signals import excitation

LIMITS = ("position window", "velocity limit", "torque limit")
TORQUE = QUANTITIES.index("torque")
FRICTION_FACTOR = 13.0
"""Peak torque over Coulomb torque below which sticking shows (notes, case study)."""
ITERATIONS = 40
"""Of the multiplicative algorithm: within 2 % of the optimum from there on (case study)."""
ROBUST_SHARE = 0.3
"""Share of the power kept on f^−½ over all lines, for a plant that has moved since the model was made."""
MOST_PRICINGS = 3
"""Times the price of travel and speed is raised before amplitudes are cut."""


@dataclass(eq=False)
class BlockDesigner:
    """Makes blocks of any length and amplitude for one cell, and knows which limits they touch."""

    config: CellConfig
    belief: Belief
    noise: Noise
    excited: tuple[int, ...]
    amplitude_scale: float = 1.0
    seed: int = 1

    def __post_init__(self) -> None:
        config = self.config
        specs = [s for s in config.experiments if isinstance(s, MultisineSpec) and s.role == "identify"]
        self.band = (
            (min(s.band_Hz[0] for s in specs), max(s.band_Hz[1] for s in specs)) if specs else (0.5, 12.0)
        )
        self.share = self.amplitude_scale * max((s.amplitude for s in specs), default=0.7)
        self.creep = max((s.creep_velocity for s in specs), default=0.0)
        self.limits = np.array([a.limits.torque for a in config.axes])
        self.prices = (np.zeros(len(config.axes)), np.zeros(len(config.axes)))
        self.reduced = np.ones(len(config.axes))
        self.touched: set[str] = set()
        self.length = 0.0

    def expected(self, blocks: Sequence[PlannedExperiment]) -> Expected:
        """Expected covariance."""
        numbered = [replace(e, key=f"{k:03d}") for k, e in enumerate(blocks)]
        return expected(self.config, numbered, self.belief, self.noise)

    def block(self, length: float, number: int) -> PlannedExperiment:
        """One block, within travel and velocity by the belief; number 0 is the climb, every line on all axes:
        the watch over signs learns on it how each follows its torque."""
        if length != self.length:
            self._fit_prices(length)
        made = self._build_block(length, number)
        # laid out for the first block; the climb and the others have other lines and phases
        over = (
            max((ratio for *_, ratio in self._excess_over_limits(made)), default=1.0) if number != 1 else 1.0
        )
        return replace(made, torque=frozen_float(made.torque / over))

    def _fit_prices(self, length: float) -> None:
        """Prices and amplitudes that keep blocks of this length within travel and velocity.

        Power is first moved away from the lines that cause the motion; what is still over is scaled.
        """
        self.length = length
        self.prices = (np.zeros(len(self.config.axes)), np.zeros(len(self.config.axes)))
        self.reduced = np.ones(len(self.config.axes))
        self.touched.clear()
        for attempt in range(MOST_PRICINGS + 4):
            over = self._excess_over_limits(self._build_block(length, 1))
            if not over:
                return
            # Less torque moves less: travel and speed have their price after that.
            strong = [o for o in over if o[1] == TORQUE]
            for axis, kind, ratio in strong or over:
                limits = self.config.axes[axis].limits
                self.touched.add(f"{LIMITS[kind]} of {self.config.axes[axis].name}")
                if attempt < MOST_PRICINGS and kind != TORQUE:
                    limit = (limits.position, limits.velocity)[kind]
                    price = self.prices[kind]
                    price[axis] = max(price[axis], (self.limits[axis] * self.share / limit) ** 2) * ratio**2
                    continue
                for i in (axis,) if axis in self.excited else self.excited:
                    self.reduced[i] /= 1.02 * ratio

    def _excess_over_limits(self, block: PlannedExperiment) -> list[tuple[int, int, float]]:
        """Return axis, kind of limit and how far beyond what is usable of it the announcement would lie."""
        motion = foretold_motion(self.config, block, self.belief)
        over = with_margin(motion, block.torque) / usable(self.config)
        return [(int(i), int(k), float(over[k, i])) for i, k in np.argwhere(over.T > 1.0)]

    @property
    def peaks(self) -> Float64:
        """(M,) peak torque."""
        return self.share * self.limits * self.reduced

    def _build_block(self, length: float, number: int) -> PlannedExperiment:
        config, cycle = self.config, self.config.bus.cycle_s
        period = round(length / cycle)
        spacing = 1.0 / (period * cycle)
        first = max(1, int(np.ceil(self.band[0] / spacing - 1e-9)))
        lines = np.arange(first, int(np.floor(self.band[1] / spacing + 1e-9)) + 1)
        spread, axis = lines, interleaved(lines, self.excited, number)
        if number == 0:
            spread, axis = np.tile(lines, len(self.excited)), np.repeat(self.excited, lines.size)
        peaks = self.peaks
        torque = np.zeros((period, len(config.axes)))
        shell = PlannedExperiment(
            kind=Kind.MULTISINE,
            excited=self.excited,
            torque=torque,
            record_to=period + 1,
            frequencies_hz=frozen_float(lines * spacing),
            attributes={
                "seed": self.seed + number,
                "amplitude": self.share,
                "lines": "interleaved" if number else "all",
                "from_rest": True,
            },
        )
        design = self._design(spread, spacing, axis, shell)
        rng = np.random.default_rng((self.seed, number))
        for i in self.excited:
            own, amplitude = design.of(i)
            if own.size == 0:
                raise ConfigError(
                    f"goal: a block of {length:g} s has no line for axis {config.axes[i].name} in "
                    f"{self.band[0]:g}…{self.band[1]:g} Hz; widen band_Hz"
                )
            wave = excitation.multisine(own, period, 1.0 / cycle, rng=rng, shape=amplitude).period()
            torque[:, i] = peaks[i] * wave
        torque = played_once(torque, cycle)
        return replace(shell, torque=frozen_float(torque), reference=self._creep_path(peaks, period + 1))

    def _creep_path(self, peaks: Float64, samples: int) -> Float64 | None:
        """Slow motion where friction is near the amplitude, if the config allows any."""
        near = [i for i in self.excited if peaks[i] < FRICTION_FACTOR * self.belief.coulomb[i]]
        if self.creep <= 0 or not near:
            return None
        path = np.zeros((samples, len(self.config.axes)))
        for i in near:
            window = self.config.axes[i].limits.position * CREEP_TRAVEL
            path[:, i] = excitation.triangle_path(self.creep, samples, 1.0 / self.config.bus.cycle_s, window)
        return frozen_float(path)

    def _design(
        self,
        lines: np.ndarray,
        spacing: float,
        axis: np.ndarray,
        shell: PlannedExperiment,
    ) -> LineDesign:
        quantum = self.noise.position_step / np.sqrt(12)
        steps = self.noise.torque_step / np.sqrt(12)
        return line_design(
            self.belief,
            lines,
            spacing,
            axis,
            hold=hold_gains(self.config, shell, self.belief),
            torque_noise=np.maximum(np.hypot(self.noise.torque, steps), 1e-300),
            position_noise=np.hypot(self.noise.position, quantum),
            goal_scale=None if self.belief.guessed else self._scale(),
            prices=self.prices,
        )

    def _scale(self) -> Float64:
        """What the uncertainty of each of the chains' parameters is relative to; infinite for dampers."""
        names, _ = parameter_vector(self.belief.chains)
        scale: Float64 = np.where(is_in_goal(names), parameter_scale(self.belief.chains), np.inf)
        return scale

    def warnings(self) -> list[str]:
        low, coulomb = self.peaks, self.belief.coulomb
        way_out = "it creeps while it is shaken" if self.creep > 0 else "allow a creep_velocity in the config"
        near = [
            f"axis {self.config.axes[i].name}: the peak torque of {low[i]:.3g} is only "
            f"{low[i] / coulomb[i]:.1f} times the Coulomb friction of {coulomb[i]:.3g}; {way_out}"
            for i in self.excited
            if coulomb[i] > 0 and low[i] < FRICTION_FACTOR * coulomb[i]
        ]
        if self.belief.guessed:
            near.append(f"expected figures rest on {self.belief.source}")
        return near


@dataclass(frozen=True, eq=False)
class LineDesign:
    """Relative amplitudes of every line.

    Attributes
    ----------
    lines, axis
        (L,) line numbers, and the axis each is given to.
    amplitude
        (L,) relative within an axis; the sum of squares is 1 on each.
    """

    lines: Int64
    axis: Int64
    amplitude: Float64

    def of(self, axis: int) -> tuple[Int64, Float64]:
        """Lines and amplitudes of one axis."""
        own = self.axis == axis
        return self.lines[own], self.amplitude[own]


def interleaved(lines: Int64, excited: Sequence[int], turn: int = 0) -> Int64:
    """(L,) axis of each line; ``turn`` moves the pattern on, so that blocks complement each other."""
    result: Int64 = np.asarray(excited, dtype=np.int64)[(np.arange(lines.size) + turn) % len(excited)]
    return result


def line_design(  # noqa: PLR0913 - the terms of the optimum
    belief: Belief,
    lines: Int64,
    spacing_hz: float,
    axis: Int64,
    *,
    hold: tuple[Float64, Float64],
    torque_noise: Float64,
    position_noise: Float64,
    goal_scale: Float64 | None,
    prices: tuple[Float64, Float64],
) -> LineDesign:
    """The design of one record.

    Parameters
    ----------
    hold
        (M,) stiffness and damping of the hold of every axis.
    torque_noise, position_noise
        (M,) standard deviations per sample (only their ratio to each other matters).
    goal_scale
        (n,) scale of the chains' parameters; infinite for those that do not matter.
        ``None``: amplitudes ∝ f^−½, no optimisation.
    prices
        (M,) price of travel² and of speed² of each motor beside a torque² of 1.
    """
    omega: Float64 = np.asarray(2 * np.pi * spacing_hz * lines, dtype=np.float64)
    chains, motors = belief.chains, belief.chains.branches
    plant = rubbing(chains, belief.viscous).dynamic_stiffness(1j * omega)
    seen = Condensed.of(plant, chains.motor_dofs.tolist())
    law = hold[0] + 1j * omega[:, None] * hold[1]
    index = np.arange(motors)
    closed = seen.stiffness.copy()
    closed[:, index, index] += law
    push = np.eye(motors)[axis]
    unit_push: Complex128 = push[..., None].astype(np.complex128)
    theta: Complex128 = np.asarray(np.linalg.solve(closed, unit_push)[..., 0], dtype=np.complex128)
    travel = np.abs(theta)
    speed = omega[:, None] * travel
    robust = _normalised(1.0 / np.maximum(lines, 1).astype(float), axis)  # power ∝ 1/f
    cost = 1.0 + travel**2 @ prices[0] + speed**2 @ prices[1]
    if goal_scale is None:
        power = _normalised(robust / cost, axis)
        return LineDesign(lines, axis, np.sqrt(power))
    torque: Complex128 = np.asarray(push - law * theta, dtype=np.complex128)
    response = _Response(omega, seen, theta, torque)
    matrices = _information(chains, response, torque_noise, position_noise)
    weight = _normalised(np.full(lines.size, 1.0) / cost, axis)
    importance = np.where(np.isfinite(goal_scale), 1.0 / goal_scale, 0.0)
    importance = np.concatenate((importance, np.zeros(matrices.shape[1] - importance.size)))
    ruler = np.sqrt(np.maximum(np.einsum("l,lkk->k", weight, matrices), 1e-300))
    scaled = matrices / ruler[:, None] / ruler
    for _ in range(ITERATIONS):
        total = np.einsum("l,lab->ab", weight, scaled)
        # What the band cannot show must not blow up the rest: a millionth of the scaled information.
        inverse = np.linalg.inv(total + 1e-6 * np.eye(total.shape[0]))
        root = inverse * (importance / ruler)
        gain = np.einsum("ab,lbc,ca->l", root.T, scaled, root).real
        weight = _normalised(weight * np.sqrt(np.maximum(gain, 0.0) / cost), axis, cost)
    power = (1 - ROBUST_SHARE) * weight + ROBUST_SHARE * _normalised(robust, axis, cost)
    return LineDesign(lines, axis, np.sqrt(_normalised(power, axis)))


def _normalised(power: Float64, axis: Int64, cost: Float64 | None = None) -> Float64:
    spent = power if cost is None else power * cost
    sums = np.bincount(axis, weights=spent, minlength=int(axis.max()) + 1)
    result: Float64 = power / np.maximum(sums[axis], 1e-300)
    return result


@dataclass(frozen=True, eq=False)
class _Response:
    """The held cell under unit torque on each line.

    ``omega`` (L,) [rad/s], ``seen`` by the motors, ``theta`` and ``torque`` (L, M) of the
    motors, loops included.
    """

    omega: Float64
    seen: Condensed
    theta: Complex128
    torque: Complex128


def _information(
    chains: CoupledChains, response: _Response, torque_noise: Float64, position_noise: Float64
) -> Float64:
    """(L, p, p) Fisher information of unit torque on each line: on the chains' parameters, then on viscous
    friction and time offset of each motor."""
    omega, motion, plant = response.omega, response.seen.motion, response.seen.stiffness
    theta, torque = response.theta, response.torque
    elements = [e for e, _ in (*chains.parts, *(damper(1.0, at) for at in chains.motor_dofs.tolist()))]
    terms = Terms.of(chains.dofs, elements)
    reach = motion @ terms.vectors
    moved = np.einsum("fmt,fm->ft", reach, theta) * terms.factors(omega, np.ones(len(elements)))
    jacobian = terms.by_parameter(reach * moved[:, None])
    offset = (1j * omega[:, None] * torque)[..., None] * np.eye(chains.branches)
    both = np.concatenate((jacobian, offset), axis=2)
    noise = np.einsum("fij,j,fkj->fik", plant, position_noise**2 + 0j, plant.conj())
    noise = noise + np.diag(torque_noise**2)
    result: Float64 = np.einsum("fia,fib->fab", both.conj(), np.linalg.solve(noise, both)).real
    return result
