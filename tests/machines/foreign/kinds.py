"""Kinds of drives and events: each takes an ordinary cell and makes it one of its kind.

A kind of ``PHASES`` happens at an instant of a phase (``draft.at``) to its victims; one of ``ALWAYS`` is
there all along. ``healthy`` ones must be measured. What a row cannot hold is a function below the table.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from .dictionary import PER_RAD
from .draft import ALWAYS, PHASES, Draft, DraftAxis

ONCE = (ALWAYS,)
LOADED = (1, 2, 3)
AT = object()
"""The instant at which it happens."""


class OneOf(tuple[Any, ...]):
    """One of these, drawn once a run."""


def one_of(*options: Any) -> OneOf:
    """Whatever is drawn."""
    return OneOf(options)


def counts(radians: float) -> int:
    """Encoder counts."""
    return round(radians * PER_RAD)


def loaded(d: Draft) -> list[DraftAxis]:
    """Victims that carry something."""
    return [a for a in d.victims if a.load]


@dataclass(frozen=True)
class Kind:
    """One row."""

    phases: tuple[str, ...] = PHASES
    loads: tuple[int, ...] = (0, 1, 2, 3)
    brakes: bool | None = None
    healthy: bool = False
    habits: Any = ()
    """Of every victim: names and keys."""
    carrying: bool = False
    """Of those alone that carry something."""
    event: Any = None
    """What happens to the whole cell at the instant."""
    plant: dict[str, Any] = field(default_factory=dict)
    tightest: float | None = None
    falls_after: float | None = None
    """Seconds after which its brake takes what falls."""
    is_cut_off: bool = False
    """It stops the run, and nothing may enable it again before a person acts."""
    also: dict[str, Any] = field(default_factory=dict)
    """Further fields of the draft."""
    more: Callable[[Draft], None] | None = None
    """What no row holds."""

    def make(self, d: Draft) -> None:
        """Make a cell one of this kind."""

        def drawn(what: Any) -> Any:
            if isinstance(what, OneOf):
                return drawn(d.rng.choice(what))
            if isinstance(what, dict):
                return {key: drawn(value) for key, value in what.items()}
            if isinstance(what, list | tuple):
                return type(what)(map(drawn, what))
            return d.at if what is AT else what

        habits, event = drawn(self.habits), drawn(self.event)
        for name, value in drawn(self.also).items():
            setattr(d, name, value)
        d.events += [{"at": d.at, **event}] if event else []
        for a in loaded(d) if self.carrying else d.victims:
            for name, keys in habits:
                a.habit(name, **keys)
            a.plant |= self.plant
            a.tightest = self.tightest
            if self.falls_after is not None:
                a.falls_until_braked(self.falls_after)
        if self.is_cut_off:
            d.never_again = d.must_stop = True
        if self.more is not None:
            self.more(d)


STO = {"seconds": one_of(0.3, 5.0, 40.0)}
KINDS = {
    "ordinary": Kind(ONCE, healthy=True),
    # --- persons and computers -----------------------------------------------------------------------
    "stop": Kind(event={"what": "stop"}),
    # 0x6085 and 0x6084 take seconds to stop.
    "stop with a slow ramp": Kind(
        ("run",), (0, 1, 2), event={"what": "stop"},
        also={"found": {0x608500: counts(0.1), 0x608400: counts(0.1)}},
    ),
    "master dies": Kind(event={"what": "master dies"}),
    "computer suspended": Kind(
        loads=(0, 1, 2), event={"what": "suspended", "seconds": one_of(0.2, 1.5, 6.0)},
        also={"never_again": True},
    ),
    # --- quick stop ----------------------------------------------------------------------------------
    # 0x605A is refused under power, or without effect before it is enabled again.
    "option refused under power": Kind(
        ONCE, (0, 1, 2), habits=[("OptionUnderPower", {"how": one_of("refused", "ignored")})],
        also={"found": {0x605A00: one_of(0, 2)}},
    ),
    # --- modes ---------------------------------------------------------------------------------------
    # 0x6060 is taken without power only, and the enable input is opened for a while.
    "modes at rest enable input opened": Kind(
        PHASES, (0, 1, 2), habits=[("ModesAtRest", {}), ("EnableInput", {"at": AT, **STO})],
        falls_after=0.0, is_cut_off=True,
    ),
    # The same, opened while it is off for its next mode, for longer than anybody waits.
    "modes at rest enable input opened between": Kind(
        ONCE, (0, 1), brakes=True, is_cut_off=True,
        habits=[
            ("ModesAtRest", {}),
            ("EnableInput", {"leaving": one_of(1, 2, 3), "seconds": one_of(20.0, 60.0, 500.0)}),
        ],
    ),
    # 0x6061 shows a mode before it acts, or −1 until then.
    "mode shown early": Kind(
        ONCE, (0, 1, 2), healthy=True,
        habits=[
            ("ModeShown", one_of(
                {"how": "early", "seconds": 0.03}, {"how": "early", "seconds": 0.1},
                {"how": "blank", "seconds": 0.5}, {"how": "blank", "seconds": 4.0},
            ))
        ],
    ),
    # --- power ---------------------------------------------------------------------------------------
    # A drive starts anew.
    "supply lost": Kind(loads=(0, 1, 2), habits=[("Reboots", {"at": AT})], falls_after=0.0, is_cut_off=True),
    # No torque any more, and 0x6077 shows the demand.
    "torque gone and echoed": Kind(loads=(0, 1, 2), habits=[("TorqueGone", {"at": AT})], falls_after=0.15),
    # --- sensors -------------------------------------------------------------------------------------
    # 0x6077 shows the amount alone.
    "torque without sign": Kind(ONCE, (0, 1, 2), habits=[("TorqueShown", {"how": "unsigned"})]),
    # 0x6077 passes a filter for display.
    "torque filtered": Kind(
        ONCE, (0, 1), healthy=True, habits=[("TorqueShown", {"filter_s": one_of(0.005, 0.02)})]
    ),
    # --- loads ---------------------------------------------------------------------------------------
    # 4 % of rated torque, with a load and with nothing carried.
    "dry friction": Kind(ONCE, (1, 2), healthy=True, plant={"coulomb": 2.0}),
    "dry friction free": Kind(ONCE, (0,), healthy=True, plant={"coulomb": 2.0}),
    # --- brakes --------------------------------------------------------------------------------------
    # The brake falls in after the torque has gone only.
    "brake after torque": Kind(
        ONCE, LOADED, brakes=True, healthy=True, carrying=True,
        habits=[("Constants", {"axis": {"brake_first": False}})],
    ),
    # From an instant on it does not hold.
    "brake worn out": Kind(
        ("trial", "run", "hold", "leaving"), LOADED, brakes=True, carrying=True,
        habits=[("BrakeFails", {"at": AT})],
    ),
    # --- objects -------------------------------------------------------------------------------------
    # One transfer of an object is aborted with a code that says nothing of the object.
    "transient abort": Kind(
        ONCE, (0, 1), tightest=10.0,
        habits=[
            ("TransientAbort", {
                "index": one_of(0x6072, 0x6077, 0x605A, 0x6007, 0x607F, 0x6065),
                "code": one_of(0x08000020, 0x05040000, 0x08000022, 0x06060000), "only_writes": False,
            })
        ],
        also={"found": {0x607200: 200}, "experiment": {"amplitude": 0.7}},
    ),
    # 0x6065 of 2 degrees, and a fault beyond it.
    "found following window": Kind(
        ONCE, (0, 1, 2), falls_after=0.0, also={"found": {0x606500: counts(0.035), 0x606600: 10}}
    ),
    # 0x6072 below what the config permits, or a limit of one direction.
    "found torque limit": Kind(
        ONCE, (0, 1, 2), tightest=12.0,
        also={
            "found": one_of({0x607200: 240}, {0x60E000: 240}, {0x60E100: 240}),
            "experiment": {"amplitude": 0.7},
        },
    ),
    # 0x60B0, 0x607C and 0x60B2 shift each target, or add to each torque.
    "added position": Kind(
        ONCE, (0, 1), also={"found": {0x60B000: one_of(counts(0.03), counts(-0.1), counts(0.2))}}
    ),
    "added home": Kind(
        ONCE, (0, 1), habits=[("AddsHome", {})],
        also={"found": {0x607C00: one_of(counts(0.05), counts(-0.1))}},
    ),
    "added torque": Kind(ONCE, (0, 1), also={"found": {0x60B200: one_of(40, -60, 100)}}),
    # 0x6093 is not 1: counts of 0x6064 are others than those of 0x608F.
    "position factor": Kind(
        ONCE, (0, 1),
        also={
            "found": one_of(
                {0x609301: 5, 0x609302: 168}, {0x609301: 336, 0x609302: 10}, {0x609301: 2, 0x609302: 1}
            )
        },
    ),
    # 0x607E turns positions, and torque not.
    "polarity": Kind(ONCE, (0, 1), also={"found": {0x607E00: 0x80}}),
    # 0x607B: counts go round once a turn, and the axis stands near the seam.
    "position range": Kind(
        ONCE, (0, 1), healthy=True,
        also={"found": one_of({0x607B01: -300, 0x607B02: 65235}, {0x607B01: -65300, 0x607B02: 235})},
    ),
    # 0x1019 is set: SYNC is taken with a counter only, and it can be set to 0.
    "sync counter": Kind(ONCE, (0, 1), healthy=True, also={"found": {0x101900: 240}}),
    # 0x1800:3 is 10 ms, and can be set to 0.
    "inhibit time": Kind(ONCE, (0, 1), healthy=True, also={"found": {0x180003: 100}}),
    # 0x1017 takes 100 ms and more only.
    "slow heartbeat": Kind(
        ONCE, (0, 1), healthy=True, also={"nodes": {"least": {"101700": one_of(100, 200)}}}
    ),
    "quick stop option 5": Kind(ONCE, (0, 1), healthy=True, also={"found": {0x605A00: one_of(5, 6)}}),
    # 6 ms to an answer.
    "slow SDO": Kind(ONCE, (0, 1, 2), healthy=True, also={"nodes": {"sdo_s": 0.006}}),
    # 0x6072 counts in the drive's own loops only.
    "no limit in torque mode": Kind(ONCE, (0, 1, 2), healthy=True, habits=[("NoLimitInTorqueMode", {})]),
    # TPDO 1 comes every 10 ms as well.
    "event PDOs": Kind(ONCE, (0, 1), healthy=True, also={"nodes": {"event_s": 0.01}}),
    # --- bus -----------------------------------------------------------------------------------------
    # A node says nothing any more, and hears.
    "node silent": Kind(loads=(0, 1, 2), habits=[("Silent", {"at": AT, "what": "all"})]),
    # A node answers no SDO any more; its PDOs come.
    "no SDO answers": Kind(loads=(0, 1), habits=[("Silent", {"at": AT, "what": "sdo"})]),
    # Its PDOs come late from an instant on, or its SDO answers.
    "answers late": Kind(
        loads=(0, 1),
        habits=[
            ("Silent", one_of(
                {"at": AT, "what": "pdo", "late": 0.0045}, {"at": AT, "what": "slow sdo", "late": 0.05}
            ))
        ],
    ),
    # The adapter receives and sends no more.
    "adapter sends nothing": Kind(loads=(0, 1, 2), event={"what": "adapter sends nothing"}),
    # From an instant on every wait takes longer than was asked.
    "computer late": Kind(
        ("rest", "run", "hold"), (0, 1), event={"what": "computer late", "seconds": one_of(0.0012, 0.0034)}
    ),
    # From an instant on what is received comes cycles late.
    "adapter late": Kind(("rest", "run", "hold"), (0, 1), event={"what": "adapter late", "seconds": 0.0045}),
    # --- refused in plain words ----------------------------------------------------------------------
    # 0x6060 is taken and 0x6061 stays.
    "mode never comes": Kind(ONCE, (0, 1), habits=[("ModeNeverComes", {})]),
    # 0x6077 is in other units than 0x6071.
    "torque shown otherwise": Kind(ONCE, (0, 1), habits=[("TorqueShown", {"scale": one_of(0.1, 0.5, 3.0)})]),
    # 0x605A, 0x6007, 0x607D, 0x6065 and 0x607F are missing, or 0x1016.
    "lacks protection": Kind(
        ONCE, (0, 1, 2), also={"lacks": one_of([0x605A, 0x6007, 0x607D, 0x6065, 0x607F], [0x1016], [0x605A])}
    ),
    # --- one command after another -------------------------------------------------------------------
    # Held at the end, checked, taken over and measured.
    "measured again": Kind(
        ONCE, (1, 2), healthy=True, also={"later": [("check", []), ("measure", [])]}
    ),
    # All of invid is killed, a person asks what is the matter, and then measures.
    "dies and is checked": Kind(
        ("enabling", "rest", "trial", "run"), (0, 1, 2), event={"what": "master dies"},
        also={"later": [("check", []), ("measure", [])]},
    ),
    # Held by its drive, which takes no mode in quick stop active, when it is to be measured again.
    "held and takes no other mode": Kind(
        ONCE, (1, 2), brakes=False, carrying=True, habits=[("ModesAtRest", {"states": ["stopping"]})],
        also={"later": [("measure", [])]},
    ),
    # Checked while somebody else sends SYNC: nothing is touched.
    "held while another master speaks": Kind(
        ONCE, (1, 2), brakes=False, also={"later": [("check", [{"what": "other master", "at": 0.0}])]}
    ),
}  # fmt: skip


def kind(
    phases: tuple[str, ...] = PHASES, loads: tuple[int, ...] = (0, 1, 2, 3), **more: Any
) -> Callable[[Callable[[Draft], None]], Callable[[Draft], None]]:
    """Enter a kind into the table, by the name of its function."""

    def enter(make: Callable[[Draft], None]) -> Callable[[Draft], None]:
        KINDS[make.__name__.replace("_", " ")] = Kind(phases, loads, more=make, **more)
        return make

    return enter


@kind(("rest", "run", "leaving"))
def stop_twice(d: Draft) -> None:
    """A person stops the run, and soon once more."""
    d.events.append({"what": "stop", "at": d.at})
    d.events.append({"what": "stop", "at": d.at + d.rng.choice([0.05, 0.3, 1.0])})


@kind(("rest",), (0, 1))
def stop_in_a_long_silence(d: Draft) -> None:
    """A heartbeat of 2 s makes the stop test's silence long."""
    d.safety["heartbeat_s"] = 2.0
    d.events.append({"what": "stop", "at": d.at + d.rng.choice([0.0, 4.0])})


@kind(("run", "hold", "trial"), (0, 1))
def master_dies_watch_without_effect(d: Draft) -> None:
    """The same, and the heartbeat watch has no effect, counts whole seconds, or 0x6007 stays 0."""
    how = d.rng.choice([{"watches": False}, {"min_watch_s": 1.0}, None])
    d.lacks = [0x140005]
    for a in d.victims:
        a.plant |= {"coulomb": 0.02, "viscous": 0.02}
    for a in d.victims:
        if how is None:
            a.habit("Forgets", index=0x6007)
            d.found[0x600700] = 0
        else:
            a.habit("Constants", node=how)
    d.events.append({"what": "master dies", "at": d.at})


def _person(d: Draft) -> None:
    seconds = d.rng.choice([3.0, 8.0])
    for a in loaded(d):
        a.habit("Person", seconds=seconds)


@kind(ONCE, LOADED, brakes=False)
def lets_go_in_quick_stop(d: Draft) -> None:
    """Quick stop active gives no torque: from torque mode, or ever. A person comes with a support."""
    modes = d.rng.choice([[10], [8, 10]])
    for a in loaded(d):
        a.habit("LetsGo", modes=modes)
        _until_seen(a)
    _person(d)


def _until_seen(a: DraftAxis) -> None:
    if a.brake is not None:
        a.falls = max(a.falls, a.by_brake)


@kind(ONCE, LOADED, brakes=False)
def lets_go_and_leaves_with_NMT(d: Draft) -> None:
    """The same; and the power stage goes off with NMT operational."""
    for a in loaded(d):
        a.habit("LetsGo", modes=[10])
        a.habit("NeedsOperational")
    _person(d)


@kind(ONCE, LOADED, brakes=False)
def stop_while_catching(d: Draft) -> None:
    """The same as letting go; a person stops the run while the axes are caught, and then supports them."""
    for a in loaded(d):
        a.habit("LetsGo", modes=[10])
    _person(d)
    d.events.append({"what": "stop", "after": "lets go", "delay": d.rng.uniform(0.05, 2.0)})


@kind(("trial", "run", "hold"), LOADED, brakes=False)
def stop_in_torque_mode_lets_go_later(d: Draft) -> None:
    """Held in every trial of the stop; lets go when a person stops the run."""
    d.victims = [a for a in d.axes if a.load]
    for a in d.victims:
        a.habit("LetsGo", modes=[10], at=d.at - 0.01)
    _person(d)
    d.events.append({"what": "stop", "at": d.at})


@kind(("trial", "run", "hold"), (1, 2), brakes=False)
def stop_lets_go_and_leaves_with_NMT(d: Draft) -> None:
    """The same, and the power stage goes off with NMT operational."""
    stop_in_torque_mode_lets_go_later(d)
    for a in d.victims:
        a.habit("NeedsOperational")


@kind(ONCE, LOADED, brakes=False)
def held_then_not(d: Draft) -> None:
    """Quick stop with a time limit, a fault that comes late, or a creep."""
    how = d.rng.choice(["off", "fault", "creep"])
    seconds = d.rng.choice([0.6, 1.5, 4.0])
    for a in loaded(d):
        a.habit("QuickStopEnds", seconds=seconds, how=how, creep=d.rng.choice([0.003, 0.02]))
        a.habit("Person", seconds=6.0)
        if how == "fault":  # no master takes a fault back
            a.falls_until_braked()
            a.told = r"Support it so that it cannot fall|After a fault of the drive itself nothing holds it"


@kind(ONCE, (0, 1, 2))
def own_quick_stop_torque(d: Draft) -> None:
    """Its quick stop gives up to 20 of 16 N·m."""
    for a in d.victims:
        a.habit("QuickStopTorque", permille=400)
        a.torque_limit = 16.0


@kind(ONCE, (0, 1, 2))
def modes_at_rest(d: Draft) -> None:
    """0x6060 is taken without power only: to be measured where nothing hangs on the drive alone."""
    for a in d.victims:
        a.habit("ModesAtRest")
    d.healthy = all(a.brake is not None or not a.load for a in d.axes)


@kind()
def emergency_stop_released(d: Draft) -> None:
    """Safe torque off, and released after a while."""
    seconds = d.rng.choice([0.1, 0.3, 1.0, 4.0])
    into = d.rng.choice(["off", "fault"])
    for a in d.axes:
        a.habit("EnableInput", at=d.at, seconds=seconds, into=into)
        a.falls_until_braked()
    d.never_again, d.must_stop = True, True


@kind(loads=(0, 1, 2))
def fault(d: Draft) -> None:
    """A drive faults, at once or by its reaction."""
    for a in d.victims:
        a.habit("Faults", at=d.at, at_once=d.rng.random() < 0.5)
        a.falls_until_braked()
    d.never_again, d.must_stop = True, True


@kind(loads=(1, 2))
def gives_less(d: Draft) -> None:
    """Less than its load weighs, by I²t: shown, or the demand is echoed."""
    echoes = d.rng.random() < 0.5
    for a in d.victims:
        a.habit("GivesLess", at=d.at, torque=0.5 * a.load or 1.0, echoes=echoes)
        a.falls_until_braked(0.15)


@kind(loads=(0, 1))
def torque_turns(d: Draft) -> None:
    """The motor's torque turns its sign."""
    for a in d.victims:
        a.habit("Signs", turns_at=d.at)
        if a.load:  # twice the load until it is seen, to the permitted speed
            a.falls = 0.35 if a.brake is not None else math.inf


@kind(loads=(0, 1, 2))
def encoder_freezes(d: Draft) -> None:
    """Its encoder stands, where it is or elsewhere."""
    for a in d.victims:
        a.habit("EncoderFreezes", at=d.at, leap=d.rng.choice([0.0, 0.0, 0.05, -0.05]))
        if a.load:
            a.falls = 0.2 if a.brake is not None else math.inf


@kind(loads=(0, 1, 2))
def encoder_leaps(d: Draft) -> None:
    """Its encoder is off by so much."""
    for a in d.victims:
        leap = d.rng.choice([0.02, 0.1]) * d.rng.choice([1, -1])
        a.habit("EncoderLeaps", at=d.at, leap=leap)
        a.falls = abs(leap) + (0.1 if a.load else 0.0)


@kind(ONCE, healthy=True)
def encoder_noise(d: Draft) -> None:
    """16 bits with 3 to 8 counts rms."""
    rms = d.rng.choice([3.0, 5.0, 8.0])
    for k, a in enumerate(d.victims):
        a.habit("EncoderNoise", rms=rms, seed=d.seed + k)


@kind(ONCE, (0, 1, 2), healthy=True)
def resolver(d: Draft) -> None:
    """12 to 14 bits, and noise of half a step."""
    step = d.rng.choice([4, 8, 16])
    for k, a in enumerate(d.victims):
        a.habit("EncoderNoise", rms=0.5 * step, step=step, seed=d.seed + k)


@kind(ONCE, (0, 1))
def encoder_opposed(d: Draft) -> None:
    """Motor and encoder count against each other."""
    for a in d.victims:
        a.habit("Signs", encoder_sign=-1)
        if a.load:
            a.falls = 0.15 if a.brake is not None else math.inf


@kind(ONCE, (0, 1, 2))
def torque_echo(d: Draft) -> None:
    """0x6077 is the demand; in quick stop there is no torque."""
    for a in loaded(d) or d.victims:
        a.habit("TorqueShown", how="echo")
        a.habit("LetsGo", modes=[10])
    _person(d)


@kind(ONCE, (1, 2))
def light_load(d: Draft) -> None:
    """Below 2 % of rated torque, hidden by the sensor's offset, or upright; the user does not say so."""
    how = d.rng.choice(["small", "offset", "upright"])
    for a in loaded(d):
        a.stated, a.brake = d.rng.choice([None, False]), None
        if how == "small":
            a.load, a.inertia = 0.8, 0.3
            a.plant |= {"coulomb": 0.02, "viscous": 0.05}
        elif how == "offset":
            a.load, a.inertia = 1.5, 0.5
            a.plant |= {"coulomb": 0.05, "viscous": 0.05}
            a.habit("TorqueShown", offset=-1000 * a.load / 50.0)
        else:
            a.load = 0.0
            a.plant |= {"upright": 3.0, "coulomb": 0.02, "viscous": 0.05}
        a.plant |= {"propped": how != "upright"}


@kind(ONCE, LOADED)
def supported_while_weighed(d: Draft) -> None:
    """Something stands under the load while it is weighed, and is taken away later."""
    seconds = d.rng.choice([1.0, 4.0, 8.0, 14.0, 18.0])
    for a in loaded(d):
        a.habit("Propped", seconds=seconds)
        a.stated = d.rng.choice([True, None])
        a.brake = None


@kind(ONCE, (1, 2), healthy=True)
def worm_gear(d: Draft) -> None:
    """Friction above the load: it stands without torque."""
    for a in loaded(d):
        a.load, a.torque_limit, a.stated = 2.0, 30.0, d.rng.choice([True, False])
        a.plant["coulomb"] = 2.6
        a.brake = None


@kind(ONCE, LOADED, brakes=True, healthy=True)
def late_brake(d: Draft) -> None:
    """Opens late, closes late, switches on slowly."""
    for a in loaded(d):
        a.brake = d.rng.choice([0.05, 0.1])
        a.plant["opens"] = d.rng.choice([0.2, 0.4, 0.9])
        on = {"switch_on_s": d.rng.choice([0.3, 0.8]), "enable_s": d.rng.choice([0.02, 0.5])}
        a.habit("Constants", axis=on)


@kind(ONCE, LOADED, brakes=True)
def brake_fails(d: Draft) -> None:
    """Holds so many closings, then no more; the drive holds."""
    for a in loaded(d):
        a.habit("BrakeFails", closings=d.rng.choice([0, 1, 2, 3]))
        a.habit("Constants", axis={"switch_on_s": d.rng.choice([0.02, 0.2])})


@kind(ONCE, (1, 2))
def found_limit_below_the_load(d: Draft) -> None:
    """0x60E0 of half the load: whoever takes it up drops it."""
    d.victims = d.victims[:1] if d.victims[0].load else loaded(d)[:1]
    a = d.victims[0]
    d.found[0x60E000] = round(500 * a.load / 50.0)
    a.tightest = 0.5 * a.load
    a.falls_until_braked(0.15)


@kind(ONCE, (1, 2), brakes=True, healthy=True)
def heavy_load(d: Draft) -> None:
    """Twice the load on a brake of 0.1 s."""
    for a in loaded(d):
        a.load, a.inertia, a.brake, a.torque_limit = 2 * a.load, 2.0, 0.1, 40.0


@kind(ONCE, LOADED, brakes=False)
def lets_go_alone(d: Draft) -> None:
    """Switches off when its master is silent, whatever 0x6007 says. A person comes."""
    for a in loaded(d):
        a.habit("LetsGoAlone")
    _person(d)


@kind(ONCE, (0, 1), brakes=False)
def torque_mode_only(d: Draft) -> None:
    """0x6502 has no position mode: a load has nothing to hold it."""
    d.found[0x650200] = 1 << 9
    for a in d.axes:
        a.config["hold"] = {"mode": "master_pd", "gain_Nm_per_rad": 200, "damping_Nms_per_rad": 20}


@kind(ONCE, LOADED, brakes=True)
def brake_fails_in_a_later_run(d: Draft) -> None:
    """Good in the first run; in the next it holds once more, or never."""
    closings = d.rng.choice([0, 1])
    changes = [
        {"what": "changes", "at": 0.0, "axis": k, "habit": "BrakeFails", "keys": {"closings": closings}}
        for k, a in enumerate(d.axes)
        if a in loaded(d)
    ]
    d.later = [("measure", changes)]


@kind(ONCE, (0, 1, 2), healthy=True)
def two_axes_of_one_node(d: Draft) -> None:
    """0x6000 and 0x6800 of one node: the config names the node twice."""
    if len(d.axes) == 1:
        d.axes.append(DraftAxis(stated=False))
    d.pair = True
