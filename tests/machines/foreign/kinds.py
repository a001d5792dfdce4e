"""Kinds of drives and events: each takes an ordinary cell and makes it one of its kind.

A kind of ``PHASES`` happens at an instant of a phase (``draft.at``) to its victims; one of ``ALWAYS`` is
there all along. ``healthy`` ones must be measured.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

from .draft import ALWAYS, PHASES, Draft, DraftAxis

Make = Callable[[Draft], None]


@dataclass(frozen=True)
class Kind:
    """One row."""

    make: Make
    phases: tuple[str, ...] = PHASES
    loads: tuple[int, ...] = (0, 1, 2, 3)
    brakes: bool | None = None
    healthy: bool = False


KINDS: dict[str, Kind] = {}


def kind(
    phases: tuple[str, ...] = PHASES,
    loads: tuple[int, ...] = (0, 1, 2, 3),
    *,
    brakes: bool | None = None,
    healthy: bool = False,
) -> Callable[[Make], Make]:
    """Enter a kind into the table, by the name of its function."""

    def enter(make: Make) -> Make:
        KINDS[make.__name__.replace("_", " ")] = Kind(make, phases, loads, brakes, healthy)
        return make

    return enter


ONCE = (ALWAYS,)
LOADED = (1, 2, 3)


def loaded(d: Draft) -> list[DraftAxis]:
    """Victims that carry something."""
    return [a for a in d.victims if a.load]


# --- persons and computers ---------------------------------------------------------------------------
@kind()
def stop(d: Draft) -> None:
    """A person stops the run."""
    d.events.append({"what": "stop", "at": d.at})


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


@kind(("run",), (0, 1, 2))
def stop_with_a_slow_ramp(d: Draft) -> None:
    """0x6085 and 0x6084 take seconds to stop."""
    d.found[0x608500] = d.found[0x608400] = d.counts(0.1)
    d.events.append({"what": "stop", "at": d.at})


@kind()
def master_dies(d: Draft) -> None:
    """All of invid is killed."""
    d.events.append({"what": "master dies", "at": d.at})


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


@kind(loads=(0, 1, 2))
def computer_suspended(d: Draft) -> None:
    """Nothing of the computer runs for a while."""
    d.events.append({"what": "suspended", "at": d.at, "seconds": d.rng.choice([0.2, 1.5, 6.0])})
    d.never_again = True


# --- quick stop --------------------------------------------------------------------------------------
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
def option_refused_under_power(d: Draft) -> None:
    """0x605A is refused under power, or without effect before it is enabled again."""
    how = d.rng.choice(["refused", "ignored"])
    for a in d.victims:
        a.habit("OptionUnderPower", how=how)
    d.found[0x605A00] = d.rng.choice([0, 2])


@kind(ONCE, (0, 1, 2))
def own_quick_stop_torque(d: Draft) -> None:
    """Its quick stop gives up to 20 of 16 N·m."""
    for a in d.victims:
        a.habit("QuickStopTorque", permille=400)
        a.torque_limit = 16.0


# --- modes -------------------------------------------------------------------------------------------
@kind(ONCE, (0, 1, 2))
def modes_at_rest(d: Draft) -> None:
    """0x6060 is taken without power only: to be measured where nothing hangs on the drive alone."""
    for a in d.victims:
        a.habit("ModesAtRest")
    d.healthy = all(a.brake is not None or not a.load for a in d.axes)


@kind(PHASES, (0, 1, 2))
def modes_at_rest_enable_input_opened(d: Draft) -> None:
    """The same, and the enable input is opened for a while."""
    seconds = d.rng.choice([0.3, 5.0, 40.0])
    for a in d.victims:
        a.habit("ModesAtRest")
        a.habit("EnableInput", at=d.at, seconds=seconds)
        a.falls_until_braked()
    d.never_again, d.must_stop = True, True


@kind(ONCE, (0, 1), brakes=True)
def modes_at_rest_enable_input_opened_between(d: Draft) -> None:
    """The same, opened while it is off for its next mode, for longer than anybody waits."""
    leaving, seconds = d.rng.choice([1, 2, 3]), d.rng.choice([20.0, 60.0, 500.0])
    for a in d.victims:
        a.habit("ModesAtRest")
        a.habit("EnableInput", leaving=leaving, seconds=seconds)
    d.never_again, d.must_stop = True, True


@kind(ONCE, (0, 1, 2), healthy=True)
def mode_shown_early(d: Draft) -> None:
    """0x6061 shows a mode before it acts, or −1 until then."""
    how, seconds = d.rng.choice([("early", 0.03), ("early", 0.1), ("blank", 0.5), ("blank", 4.0)])
    for a in d.victims:
        a.habit("ModeShown", how=how, seconds=seconds)


# --- power -------------------------------------------------------------------------------------------
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


@kind(loads=(0, 1, 2))
def supply_lost(d: Draft) -> None:
    """A drive starts anew."""
    for a in d.victims:
        a.habit("Reboots", at=d.at)
        a.falls_until_braked()
    d.never_again, d.must_stop = True, True


@kind(loads=(1, 2))
def gives_less(d: Draft) -> None:
    """Less than its load weighs, by I²t: shown, or the demand is echoed."""
    echoes = d.rng.random() < 0.5
    for a in d.victims:
        a.habit("GivesLess", at=d.at, torque=0.5 * a.load or 1.0, echoes=echoes)
        a.falls_until_braked(0.15)


@kind(loads=(0, 1, 2))
def torque_gone_and_echoed(d: Draft) -> None:
    """No torque any more, and 0x6077 shows the demand."""
    for a in d.victims:
        a.habit("TorqueGone", at=d.at)
        a.falls_until_braked(0.15)


@kind(loads=(0, 1))
def torque_turns(d: Draft) -> None:
    """The motor's torque turns its sign."""
    for a in d.victims:
        a.habit("Signs", turns_at=d.at)
        if a.load:  # twice the load until it is seen, to the permitted speed
            a.falls = 0.35 if a.brake is not None else math.inf


# --- sensors -----------------------------------------------------------------------------------------
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
def torque_without_sign(d: Draft) -> None:
    """0x6077 shows the amount alone."""
    for a in d.victims:
        a.habit("TorqueShown", how="unsigned")


@kind(ONCE, (0, 1, 2))
def torque_echo(d: Draft) -> None:
    """0x6077 is the demand; in quick stop there is no torque."""
    for a in loaded(d) or d.victims:
        a.habit("TorqueShown", how="echo")
        a.habit("LetsGo", modes=[10])
    _person(d)


@kind(ONCE, (0, 1), healthy=True)
def torque_filtered(d: Draft) -> None:
    """0x6077 passes a filter for display."""
    for a in d.victims:
        a.habit("TorqueShown", filter_s=d.rng.choice([0.005, 0.02]))


# --- loads -------------------------------------------------------------------------------------------
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
def dry_friction(d: Draft) -> None:
    """4 % of rated torque."""
    for a in d.victims:
        a.plant["coulomb"] = 2.0


@kind(ONCE, (1, 2), healthy=True)
def worm_gear(d: Draft) -> None:
    """Friction above the load: it stands without torque."""
    for a in loaded(d):
        a.load, a.torque_limit, a.stated = 2.0, 30.0, d.rng.choice([True, False])
        a.plant["coulomb"] = 2.6
        a.brake = None


@kind(ONCE, (0,), healthy=True)
def dry_friction_free(d: Draft) -> None:
    """4 % of rated torque, nothing carried."""
    for a in d.victims:
        a.plant["coulomb"] = 2.0


# --- brakes ------------------------------------------------------------------------------------------
@kind(ONCE, LOADED, brakes=True, healthy=True)
def late_brake(d: Draft) -> None:
    """Opens late, closes late, switches on slowly."""
    for a in loaded(d):
        a.brake = d.rng.choice([0.05, 0.1])
        a.plant["opens"] = d.rng.choice([0.2, 0.4, 0.9])
        on = {"switch_on_s": d.rng.choice([0.3, 0.8]), "enable_s": d.rng.choice([0.02, 0.5])}
        a.habit("Constants", axis=on)


@kind(ONCE, LOADED, brakes=True, healthy=True)
def brake_after_torque(d: Draft) -> None:
    """The brake falls in after the torque has gone only."""
    for a in loaded(d):
        a.habit("Constants", axis={"brake_first": False})


@kind(ONCE, LOADED, brakes=True)
def brake_fails(d: Draft) -> None:
    """Holds so many closings, then no more; the drive holds."""
    for a in loaded(d):
        a.habit("BrakeFails", closings=d.rng.choice([0, 1, 2, 3]))
        a.habit("Constants", axis={"switch_on_s": d.rng.choice([0.02, 0.2])})


@kind(("trial", "run", "hold", "leaving"), LOADED, brakes=True)
def brake_worn_out(d: Draft) -> None:
    """From an instant on it does not hold."""
    for a in loaded(d):
        a.habit("BrakeFails", at=d.at)


# --- objects -----------------------------------------------------------------------------------------
@kind(ONCE, (0, 1))
def transient_abort(d: Draft) -> None:
    """One transfer of an object is aborted with a code that says nothing of the object."""
    index = d.rng.choice([0x6072, 0x6077, 0x605A, 0x6007, 0x607F, 0x6065])
    code = d.rng.choice([0x08000020, 0x05040000, 0x08000022, 0x06060000])
    for a in d.victims:
        a.habit("TransientAbort", index=index, code=code, only_writes=False)
        a.tightest = 10.0
    d.found[0x607200] = 200
    d.experiment["amplitude"] = 0.7


@kind(ONCE, (0, 1, 2))
def found_following_window(d: Draft) -> None:
    """0x6065 of 2 degrees, and a fault beyond it."""
    d.found[0x606500] = d.counts(0.035)
    d.found[0x606600] = 10
    for a in d.victims:
        a.falls_until_braked()


@kind(ONCE, (0, 1, 2))
def found_torque_limit(d: Draft) -> None:
    """0x6072 below what the config permits, or a limit of one direction."""
    at = d.rng.choice([0x607200, 0x60E000, 0x60E100])
    d.found[at] = 240
    d.experiment["amplitude"] = 0.7
    for a in d.victims:
        a.tightest = 12.0


@kind(ONCE, (1, 2))
def found_limit_below_the_load(d: Draft) -> None:
    """0x60E0 of half the load: whoever takes it up drops it."""
    d.victims = d.victims[:1] if d.victims[0].load else loaded(d)[:1]
    a = d.victims[0]
    d.found[0x60E000] = round(500 * a.load / 50.0)
    a.tightest = 0.5 * a.load
    a.falls_until_braked(0.15)


@kind(ONCE, (0, 1))
def added_position(d: Draft) -> None:
    """0x60B0 shifts each target."""
    d.found[0x60B000] = d.counts(d.rng.choice([0.03, -0.1, 0.2]))


@kind(ONCE, (0, 1))
def added_torque(d: Draft) -> None:
    """0x60B2 adds to each torque."""
    d.found[0x60B200] = d.rng.choice([40, -60, 100])


@kind(ONCE, (0, 1))
def added_home(d: Draft) -> None:
    """0x607C shifts each target."""
    d.found[0x607C00] = d.counts(d.rng.choice([0.05, -0.1]))
    for a in d.victims:
        a.habit("AddsHome")


@kind(ONCE, (0, 1))
def position_factor(d: Draft) -> None:
    """0x6093 is not 1: counts of 0x6064 are others than those of 0x608F."""
    d.found[0x609301], d.found[0x609302] = d.rng.choice([(5, 168), (336, 10), (2, 1)])


@kind(ONCE, (0, 1))
def polarity(d: Draft) -> None:
    """0x607E turns positions, and torque not."""
    d.found[0x607E00] = 0x80


@kind(ONCE, (0, 1), healthy=True)
def position_range(d: Draft) -> None:
    """0x607B: counts go round once a turn, and the axis stands near the seam."""
    d.found[0x607B01], d.found[0x607B02] = d.rng.choice([(-300, 65235), (-65300, 235)])


@kind(ONCE, (0, 1), healthy=True)
def sync_counter(d: Draft) -> None:
    """0x1019 is set: SYNC is taken with a counter only, and it can be set to 0."""
    d.found[0x101900] = 240


@kind(ONCE, (0, 1), healthy=True)
def inhibit_time(d: Draft) -> None:
    """0x1800:3 is 10 ms, and can be set to 0."""
    d.found[0x180003] = 100


@kind(ONCE, (0, 1), healthy=True)
def slow_heartbeat(d: Draft) -> None:
    """0x1017 takes 100 ms and more only."""
    d.nodes["least"] = {"101700": d.rng.choice([100, 200])}


@kind(ONCE, (0, 1), healthy=True)
def quick_stop_option_5(d: Draft) -> None:
    """Found with 0x605A = 5 or 6."""
    d.found[0x605A00] = d.rng.choice([5, 6])


@kind(ONCE, (0, 1, 2), healthy=True)
def slow_SDO(d: Draft) -> None:
    """6 ms to an answer."""
    d.nodes["sdo_s"] = 0.006


@kind(ONCE, (0, 1, 2), healthy=True)
def no_limit_in_torque_mode(d: Draft) -> None:
    """0x6072 counts in the drive's own loops only."""
    for a in d.victims:
        a.habit("NoLimitInTorqueMode")


@kind(ONCE, (0, 1), healthy=True)
def event_PDOs(d: Draft) -> None:
    """TPDO 1 comes every 10 ms as well."""
    d.nodes["event_s"] = 0.01


@kind(ONCE, (1, 2), brakes=True, healthy=True)
def heavy_load(d: Draft) -> None:
    """Twice the load on a brake of 0.1 s."""
    for a in loaded(d):
        a.load, a.inertia, a.brake, a.torque_limit = 2 * a.load, 2.0, 0.1, 40.0


@kind(ONCE, (0, 1, 2, 3), healthy=True)
def ordinary(d: Draft) -> None:
    """Nothing is the matter."""


# --- bus ---------------------------------------------------------------------------------------------
@kind(loads=(0, 1, 2))
def node_silent(d: Draft) -> None:
    """A node says nothing any more, and hears."""
    for a in d.victims:
        a.habit("Silent", at=d.at, what="all")


@kind(loads=(0, 1))
def answers_late(d: Draft) -> None:
    """Its PDOs come late from an instant on, or its SDO answers."""
    what, late = d.rng.choice([("pdo", 0.0045), ("slow sdo", 0.05)])
    for a in d.victims:
        a.habit("Silent", at=d.at, what=what, late=late)


@kind(loads=(0, 1, 2))
def adapter_sends_nothing(d: Draft) -> None:
    """The adapter receives and sends no more."""
    d.events.append({"what": "adapter sends nothing", "at": d.at})


@kind(("rest", "run", "hold"), (0, 1))
def computer_late(d: Draft) -> None:
    """From an instant on every wait takes longer than was asked."""
    d.events.append({"what": "computer late", "at": d.at, "seconds": d.rng.choice([0.0012, 0.0034])})


@kind(("rest", "run", "hold"), (0, 1))
def adapter_late(d: Draft) -> None:
    """From an instant on what is received comes cycles late."""
    d.events.append({"what": "adapter late", "at": d.at, "seconds": 0.0045})


# --- refused in plain words ----------------------------------------------------------------------------
@kind(ONCE, LOADED, brakes=False)
def lets_go_alone(d: Draft) -> None:
    """Switches off when its master is silent, whatever 0x6007 says. A person comes."""
    for a in loaded(d):
        a.habit("LetsGoAlone")
    _person(d)


@kind(ONCE, (0, 1))
def mode_never_comes(d: Draft) -> None:
    """0x6060 is taken and 0x6061 stays."""
    for a in d.victims:
        a.habit("ModeNeverComes")


@kind(ONCE, (0, 1))
def torque_shown_otherwise(d: Draft) -> None:
    """0x6077 is in other units than 0x6071."""
    scale = d.rng.choice([0.1, 0.5, 3.0])
    for a in d.victims:
        a.habit("TorqueShown", scale=scale)


@kind(ONCE, (0, 1), brakes=False)
def torque_mode_only(d: Draft) -> None:
    """0x6502 has no position mode: a load has nothing to hold it."""
    d.found[0x650200] = 1 << 9
    for a in d.axes:
        a.config["hold"] = {"mode": "master_pd", "gain_Nm_per_rad": 200, "damping_Nms_per_rad": 20}


@kind(ONCE, (0, 1, 2))
def lacks_protection(d: Draft) -> None:
    """0x605A, 0x6007, 0x607D, 0x6065 and 0x607F are missing, or 0x1016."""
    d.lacks = d.rng.choice([[0x605A, 0x6007, 0x607D, 0x6065, 0x607F], [0x1016], [0x605A]])


@kind(loads=(0, 1))
def no_SDO_answers(d: Draft) -> None:
    """A node answers no SDO any more; its PDOs come."""
    for a in d.victims:
        a.habit("Silent", at=d.at, what="sdo")


# --- one command after another ---------------------------------------------------------------------------
@kind(ONCE, (1, 2), healthy=True)
def measured_again(d: Draft) -> None:
    """Held at the end, checked, taken over and measured."""
    d.later = [("check", []), ("measure", [])]


@kind(("enabling", "rest", "trial", "run"), (0, 1, 2))
def dies_and_is_checked(d: Draft) -> None:
    """All of invid is killed, a person asks what is the matter, and then measures."""
    d.events.append({"what": "master dies", "at": d.at})
    d.later = [("check", []), ("measure", [])]


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


@kind(ONCE, (1, 2), brakes=False)
def held_and_takes_no_other_mode(d: Draft) -> None:
    """Held by its drive, which takes no mode in quick stop active, when it is to be measured again."""
    for a in loaded(d):
        a.habit("ModesAtRest", states=["stopping"])
    d.later = [("measure", [])]


@kind(ONCE, (1, 2), brakes=False)
def held_while_another_master_speaks(d: Draft) -> None:
    """Checked while somebody else sends SYNC: nothing is touched."""
    d.later = [("check", [{"what": "other master", "at": 0.0}])]


# --- two axes of one node ----------------------------------------------------------------------------
@kind(ONCE, (0, 1, 2), healthy=True)
def two_axes_of_one_node(d: Draft) -> None:
    """0x6000 and 0x6800 of one node: the config names the node twice."""
    if len(d.axes) == 1:
        d.axes.append(DraftAxis(stated=False))
    d.pair = True
