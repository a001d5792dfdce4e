"""Stopping distance of an axis: after a stop, and after the death of its master.

v is the speed at which it happens [rad/s], t the time until the drive brakes [s], a₀ = τ/J the acceleration
by the torque that goes on meanwhile, at worst the largest planned one in the direction of motion. The drive
brakes with a: its ramp, or (T − L)/J, what its torque limit leaves beside the load, where that is less.

    v₁ = v + a₀·t        s = v·t + a₀·t²/2 + v₁²/(2·a) + v₁·t_s

t_s is the time in which what is behind the motor swings on.

The speed that may be permitted is the v at which the longer of the two ways is the room that there is. Before
that the torque is lowered until it takes at most half of the room from rest, so that the other half is left
to speed; never below a stated least excitation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from invid.config import AxisConfig, CellConfig
from invid.config.frames import WATCH_BEATS
from invid.errors import ConfigError
from invid.wording.sentence import joined, sentence

SPEED_TOLERANCE = 1.05
"""The watch lets a speed pass that is 5 % over its limit: SYNC is known to a fifth of a cycle, over four."""
SIGHT_CYCLES = 5
"""From what happens to the controlword at the drive, beyond the cycles in which nothing need be seen: two
until a mean over four cycles shows it, one until its sample has come, one for the frame, one for its SYNC."""
FEEDBACK_FACTOR = 1.25
"""Torque beyond the planned excitation: the weak centring of an excited axis (as ``forecast.MARGIN``)."""
LOAD_SHARE = 0.5
"""Load of a gravity-loaded axis as a share of its torque limit, before its hold torque has been measured."""
COASTING_SHARE = 0.5
"""Share of the room that the torque which goes on may take from rest. How fast an axis will be is not known
before it has moved: the room is divided evenly between torque and speed."""
LEAST_EXCITATION = 0.05
"""Peak torque, as a share of its limit, below which no plan is lowered for the way to rest: the signs are
tried with as much whatever is planned (``invid.planning.phases.sign_amplitude``)."""
BISECTIONS = 30
ROUNDING = 1 - 1e-6
"""A plan that was lowered once is not lowered again by what rounding left."""
SETTLE_S = 0.08
"""What is behind the motor swings on: half a period of a resonance of 6 Hz at the speed of the stop
(empirical, ``bench_stopping.py``)."""


@dataclass(frozen=True)
class StoppingFacts:
    """What a drive says of the way it stops by itself."""

    deceleration: float | None
    """Of its quick stop [rad/s² or m/s²]; ``None``: not known."""
    ramp: str
    """Who says it."""
    watch_s: float | None
    """From the death of the master to the drive's quick stop [s]; ``None``: it does not notice, or nobody
    knows what it does then."""
    watch: str
    """Who says it."""
    capped: bool = True
    """Whether the torque limit may make the ramp longer."""
    by_torque: bool = False
    """Whether it is what the torque limit allows, not what the drive was found with."""
    stays: bool = True
    """Whether it gives torque on when its ramp has ended."""
    edge: float | None = None
    """Distance to the nearer edge of the drive's own position range [rad or m]; ``None``: it has none."""


@dataclass(frozen=True)
class StoppingCase:
    """One axis before its budget: SI units, rotary or linear."""

    axis: str
    facts: StoppingFacts
    inertia: float | None
    torque: float
    """What the drive may brake with."""
    load: float
    """What acts in the direction of motion at worst, ≥ 0."""
    planned: float
    """Largest torque that goes on when nobody commands any more, ≥ 0."""
    reaction_s: float
    """From what happens to the quick stop at the drive, at worst."""
    sight_s: float
    """Time for which a speed may be too high before it is seen."""
    room: float
    """How far beyond its window it may come to rest."""
    velocity: float
    """Limit that config and drive set."""
    shortest_watch_s: float = 0.0
    """The shortest watch that cycle, bus and what is forgiven allow."""

    @property
    def longest_s(self) -> float:
        """Return the time [s] to the quick stop, whichever takes longer: after a stop or a dead master."""
        watch = self.facts.watch_s
        return max(self.reaction_s, 0.0 if watch is None else watch + self.sight_s)

    @property
    def strongest(self) -> float:
        """Torque that may go on so that it takes a share of the room from rest; ∞ where that is not known."""
        a, t = self.deceleration, self.longest_s
        if a is None or self.inertia is None:
            return math.inf
        if a <= 0:
            return 0.0
        # k²·t²/(2a) + k·(t²/2 + t·t_s) = share·room, for the acceleration k
        squared, linear, room = t**2 / (2 * a), t**2 / 2 + t * SETTLE_S, COASTING_SHARE * self.room
        return self.inertia * 2 * room / (linear + math.sqrt(linear**2 + 4 * squared * room))

    def longest_watch(self) -> float:
        """Time until the drive stops [s] in which the torque that goes on takes its share of the room."""
        low, high = 0.0, self.longest_s
        for _ in range(BISECTIONS):
            middle = (low + high) / 2
            way = self.distance(0.0, middle)
            fits = way is not None and way <= COASTING_SHARE * self.room
            low, high = (middle, high) if fits else (low, middle)
        return low

    @property
    def deceleration(self) -> float | None:
        """Return the deceleration by ramp, torque limit, load and inertia; 0: it cannot brake;
        ``None``: not known.
        """
        ramp = self.facts.deceleration
        if ramp is None or self.inertia is None or not self.facts.capped:
            return ramp
        return min(ramp, max(self.torque - self.load, 0.0) / self.inertia)

    @property
    def acceleration(self) -> float:
        """Return the acceleration by the torque that goes on; 0 where the inertia is not known."""
        return self.planned / self.inertia if self.inertia else 0.0

    def distance(self, speed: float, seconds: float) -> float | None:
        """Way to rest from a speed, where the drive brakes after so long; ``None``: not known."""
        a, a0 = self.deceleration, self.acceleration
        if a is None:
            return None
        if a <= 0:
            return math.inf
        entry = SPEED_TOLERANCE * speed + a0 * seconds
        return SPEED_TOLERANCE * speed * seconds + a0 * seconds**2 / 2 + entry * SETTLE_S + entry**2 / (2 * a)

    def fastest(self, seconds: float) -> float:
        """Speed whose way to rest is the room; ≤ 0: even from rest it is longer. ∞ where it is not known."""
        a, a0 = self.deceleration, self.acceleration
        if a is None:
            return math.inf
        if a <= 0:
            return 0.0
        growth = 1 + a0 / a
        b = seconds * growth + SETTLE_S
        c = a0 * seconds**2 / 2 * growth + a0 * seconds * SETTLE_S - self.room
        if c >= 0:
            return 0.0
        # v²/(2a) + b·v + c = 0, in the form that a → ∞ allows
        return -2 * c / (b + math.sqrt(b**2 - 2 * c / a)) / SPEED_TOLERANCE


@dataclass(frozen=True)
class StoppingBudget:
    """What one axis may need to come to rest, and the speed that is permitted for it."""

    case: StoppingCase
    permitted: float
    """[rad/s or m/s]; ≤ 0: none."""

    @property
    def stop(self) -> float | None:
        """Way beyond the window after a stop, at the permitted speed [rad or m]; ``None``: not known."""
        return self.case.distance(self.permitted, self.case.reaction_s)

    @property
    def dead_master(self) -> float | None:
        """Return the way beyond the window after the master's death; ``None``: not known, or the drive
        does not notice.
        """
        watch = self.case.facts.watch_s
        return None if watch is None else self.case.distance(self.permitted, self.blind_s)

    @property
    def blind_s(self) -> float:
        """From the death of the master to the quick stop [s]."""
        return (self.case.facts.watch_s or 0.0) + self.case.sight_s

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        case, facts = self.case, self.case.facts
        braking = case.deceleration
        return {
            "axis": case.axis,
            "permitted_velocity": self.permitted,
            "stopping_distance": self.stop,
            "dead_master_distance": self.dead_master,
            "room": case.room,
            "deceleration": braking if braking is not None and math.isfinite(braking) else None,
            "ramp": facts.ramp,
            "reaction_s": case.reaction_s,
            "watch_s": facts.watch_s,
            "watch": facts.watch,
            "load": case.load,
        }

    def text(self, *, linear: bool) -> str:
        """Return the budget as one line of a dry run."""
        unit = "m" if linear else "rad"
        case, facts = self.case, self.case.facts
        a = case.deceleration
        if a is None:
            return sentence(
                "{axis}: how far it goes after a stop is not known: {ramp}", axis=case.axis, ramp=facts.ramp
            )
        stop = self.stop or 0.0
        by = facts.ramp if a == facts.deceleration else self._torque_clause(linear=linear)
        blind = (
            f"not known where this computer dies ({facts.watch})"
            if self.dead_master is None
            else f"{self.dead_master:.3g} {unit} where this computer dies ({self.blind_s * 1e3:.0f} ms: "
            f"{facts.watch})"
        )
        if case.inertia is None:
            blind += f"; before the trial has measured its inertia, and by {facts.ramp} alone"
        return (
            f"{case.axis}: from {self.permitted:.3g} {unit}/s it comes to rest within {stop:.3g} {unit} "
            f"of a stop, at {a:.3g} {unit}/s² ({by}); {blind}"
        )

    def _torque_clause(self, *, linear: bool) -> str:
        case, unit = self.case, "N" if linear else "N·m"
        beside = f" beside a load of {case.load:.3g}" if case.load else ""
        return f"{case.torque:.3g} {unit}{beside}, of {case.facts.deceleration:.3g} by {case.facts.ramp}"

    def said(self, *, linear: bool) -> tuple[str, ...]:
        """Return what a person must know: a speed that was lowered, a limit of the drive that may be
        passed.
        """
        unit = "m" if linear else "rad"
        case, facts = self.case, self.case.facts
        furthest = max(self.stop or 0.0, self.dead_master or 0.0)
        found = []
        if self.permitted < case.velocity:
            found.append(
                sentence(
                    "axis {axis}: at most {permitted:.3g} {unit}/s are permitted, not {velocity:.3g}: from "
                    "there it needs {furthest:.3g} {unit} to come to rest, as much as "
                    "limits.stopping_room_{unit} (else the position window) allows; {way_out}",
                    axis=case.axis,
                    permitted=self.permitted,
                    unit=unit,
                    velocity=case.velocity,
                    furthest=furthest,
                    way_out=self.way_out(linear=linear),
                )
            )
        if case.deceleration is None or facts.deceleration is None:
            found.append(
                sentence(
                    "axis {axis}: how far it goes after a stop is not known: {ramp}; state "
                    "quick_stop_deceleration_{unit}_per_s2",
                    axis=case.axis,
                    ramp=facts.ramp,
                    unit=unit,
                )
            )
        elif case.deceleration < facts.deceleration and not facts.stays:
            found.append(
                sentence(
                    "axis {axis}: its torque limit of {torque:.3g} {unit} does not reach its ramp "
                    "({ramp}): the drive may switch off before the axis stands, and let it coast; "
                    "raise the torque limit",
                    axis=case.axis,
                    torque=case.torque,
                    unit="N" if linear else "N·m",
                    ramp=facts.ramp,
                )
            )
        if facts.watch_s is None:
            found.append(
                sentence(
                    "axis {axis}: how far it goes when this computer dies is not known: {watch}; see "
                    "that something else stops it then",
                    axis=case.axis,
                    watch=facts.watch,
                )
            )
        if facts.edge is not None and case.room + furthest > facts.edge:
            found.append(
                sentence(
                    "axis {axis}: after a stop it may come to rest {furthest:.3g} {unit} beyond its "
                    "window; the drive's own range (0x607D) ends {edge:.3g} {unit} from where it stands",
                    axis=case.axis,
                    furthest=furthest,
                    unit=unit,
                    edge=facts.edge,
                )
            )
        return tuple(found)

    def way_out(self, *, linear: bool) -> str:
        """Return what would make the way shorter."""
        unit = "m" if linear else "rad"
        case, facts = self.case, self.case.facts
        ways = []
        watch = facts.watch_s
        if (
            watch is not None
            and watch > max(case.reaction_s, case.shortest_watch_s)
            and case.fastest(case.reaction_s) > self.permitted
        ):
            ways.append(self._heartbeat_clause())
        if case.deceleration == facts.deceleration and not facts.by_torque:
            ways.append(sentence("raise 0x6085 with the drive's tool"))
        else:
            raise_it = sentence("raise the torque limit")
            unload = sentence("raise the torque limit or unload the axis")
            ways.append(unload if case.load else raise_it)
        if case.planned:
            ways.append(sentence("lower the amplitude"))
        return sentence(
            "{ways}, or widen limits.stopping_room_{unit}",
            ways=joined(ways) or sentence("lower the load"),
            unit=unit,
        )

    def _heartbeat_clause(self) -> str:
        """Return what to do to the heartbeat, with the longest that would do where no speed is permitted."""
        case = self.case
        longest = (case.longest_watch() - case.sight_s) / WATCH_BEATS
        most = math.floor(1e3 * longest) / 1e3
        if self.permitted > 0 or longest <= 0 or WATCH_BEATS * most < max(case.shortest_watch_s, 0.001):
            return sentence("shorten safety.heartbeat_s")
        return sentence("shorten safety.heartbeat_s to {most:g} at most", most=most)


@dataclass(frozen=True)
class Permitted:
    """The config with permitted speeds, and the share of torque that each axis keeps."""

    config: CellConfig
    """With the permitted speeds as limits."""
    torque: tuple[float, ...]
    """Share of its planned torque that each axis keeps."""


def case_of(
    axis: AxisConfig,
    facts: StoppingFacts,
    config: CellConfig,
    *,
    planned: float,
    inertia: float | None,
    load: float | None = None,
) -> StoppingCase:
    """The case of one axis whose limits are the effective ones.

    Parameters
    ----------
    load
        Measured hold torque [N·m or N]; ``None``: not measured yet.
    """
    safety = config.safety
    if load is None:
        load = LOAD_SHARE * axis.limits.torque if axis.gravity_loaded else 0.0
    cycle = config.bus.cycle_s
    return StoppingCase(
        axis=axis.name,
        facts=facts,
        inertia=inertia,
        torque=axis.limits.torque,
        load=abs(load),
        planned=min(FEEDBACK_FACTOR * planned, axis.limits.torque),
        reaction_s=(max(safety.missed_tpdos, safety.overrun_cycles) + SIGHT_CYCLES) * cycle,
        sight_s=SIGHT_CYCLES * cycle,
        room=axis.limits.stopping_room or axis.limits.position,
        velocity=axis.limits.velocity,
        shortest_watch_s=WATCH_BEATS * config.shortest_heartbeat_s,
    )


def budget_of(case: StoppingCase) -> StoppingBudget:
    """The speed at which both ways are within the room, at most the limit."""
    fastest = case.fastest(case.reaction_s)
    if case.facts.watch_s is not None:
        fastest = min(fastest, case.fastest(case.facts.watch_s + case.sight_s))
    return StoppingBudget(case, min(case.velocity, fastest))


def torque_shares(
    config: CellConfig,
    facts: Sequence[StoppingFacts],
    planned: Sequence[float],
    inertia: Sequence[float | None],
    loads: Sequence[float | None] | None = None,
) -> tuple[float, ...]:
    """Share of its planned torque with which each axis comes to rest in its room and has some left for speed.

    Never less than ``LEAST_EXCITATION`` of the torque limit, where as much is planned: whether that is still
    too much is for ``budgets_of`` to say.
    """
    shares = []
    for a, f, p, m, x in zip(
        config.axes, facts, planned, inertia, loads or [None] * len(config.axes), strict=True
    ):
        strongest = case_of(a, f, config, planned=p, inertia=m, load=x).strongest
        share = strongest / (FEEDBACK_FACTOR * p) if p > 0 else 1.0
        least = LEAST_EXCITATION * a.limits.torque / p if p > 0 else 1.0
        shares.append(min(1.0, max(share, least)))
    return tuple(s if s < ROUNDING else 1.0 for s in shares)


def budgets_of(
    config: CellConfig,
    facts: Sequence[StoppingFacts],
    planned: Sequence[float],
    inertia: Sequence[float | None],
    loads: Sequence[float | None] | None = None,
) -> tuple[StoppingBudget, ...]:
    """The budget of every axis; ConfigError where one cannot come to rest within its room."""
    loads = loads or [None] * len(config.axes)
    found = tuple(
        budget_of(case_of(a, f, config, planned=p, inertia=m, load=x))
        for a, f, p, m, x in zip(config.axes, facts, planned, inertia, loads, strict=True)
    )
    for budget in found:
        if budget.permitted <= 0:
            raise _refusal(budget, linear=config.linear)
    return found


def permitted(config: CellConfig, budgets: Sequence[StoppingBudget]) -> CellConfig:
    """The config with the permitted speeds as limits; itself where none is lower."""
    if all(b.permitted >= a.limits.velocity for a, b in zip(config.axes, budgets, strict=True)):
        return config
    axes = [
        a.model_copy(
            update={"limits": a.limits.model_copy(update={"velocity": min(a.limits.velocity, b.permitted)})}
        )
        for a, b in zip(config.axes, budgets, strict=True)
    ]
    return config.model_copy(update={"axes": axes})


def _refusal(budget: StoppingBudget, *, linear: bool) -> ConfigError:
    case, unit = budget.case, "m" if linear else "rad"
    torque = "N" if linear else "N·m"
    if case.deceleration is not None and case.deceleration <= 0:
        return ConfigError(
            f"axis {case.axis}: it could not be stopped: its torque limit of {case.torque:.3g} {torque} "
            f"leaves nothing beside a load of {case.load:.3g}",
            way_out="unload the axis or raise its torque limit",
        )
    still = replace(budget, permitted=0.0)
    way = max(still.stop or 0.0, still.dead_master or 0.0)
    is_least = case.planned <= 1.01 * FEEDBACK_FACTOR * LEAST_EXCITATION * case.torque
    least = f", the least excitation of {LEAST_EXCITATION:.0%} of its torque limit" * is_least
    return ConfigError(
        f"axis {case.axis}: even from rest it may go {way:.3g} {unit} before it stands "
        f"({budget.blind_s * 1e3:.0f} ms until the drive stops without this computer, {case.facts.watch}, "
        f"with up to {case.planned:.3g} {torque} meanwhile{least}), and {case.room:.3g} are allowed",
        way_out=f"{still.way_out(linear=linear)} to {math.ceil(100 * way) / 100:g}",
    )
