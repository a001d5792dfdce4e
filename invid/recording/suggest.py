"""A first map guessed from a file, with the reason for every guess; unsure guesses say so."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import yaml

from invid.errors import InputError
from invid.numerics.arrays import Float64
from invid.recording.clock import StampsRead, best_clock, find_restarts, is_count, read_stamps
from invid.recording.import_map import FORMAT, ImportMap
from invid.recording.meaning import EPISODE, WORDS, Meaning, is_current, meanings, tool_of, words_of
from invid.recording.period import find_period
from invid.recording.plausibility import doubt_of_sides
from invid.recording.tables import Table, on_clock, shorten
from invid.recording.units import BY_CONSTANT, BY_TORQUE_CONSTANT, FACTORS, LINEAR

_FROM_1970 = (946_684_800.0, 4_102_444_800.0)
"""Seconds since 1970 of 2000 and of 2100: a number between them is a date, and so its unit."""
_USUAL = {"position": "rad", "velocity": "rad/s", "torque": "N·m"}
_FEW = 16
_SLOTS = ("position", "velocity", "torque", "torque_demand", "position_demand")


@dataclass(frozen=True, eq=False)
class Suggestion:
    """A map with the reasons for it, as it grows.

    ``unsure`` lists guesses that a person must judge, ``asked`` what the file cannot tell: key in the map →
    question; such a key is null, and the map runs once it is filled in. ``cannot_tell``: what a record read
    by it leaves open.
    """

    document: dict[str, Any]
    reasons: list[str] = field(default_factory=list)
    unsure: list[str] = field(default_factory=list)
    asked: dict[str, str] = field(default_factory=dict)
    cannot_tell: list[str] = field(default_factory=list)

    def as_map(self) -> ImportMap:
        """Return the map, validated."""
        return ImportMap.model_validate(self.document)

    def as_yaml(self) -> str:
        """Return the map as YAML with the reasons as comments."""
        lines = ["# A first map, guessed by 'invid import --suggest'. Check every line before you trust it."]
        lines += [f"# - {r}" for r in self.reasons]
        lines += [f"# ? UNSURE: {u}" for u in self.unsure]
        lines += [f"# ! FILL IN {key}: {question}" for key, question in self.asked.items()]
        lines += [f"# ~ CANNOT TELL: {c}" for c in self.cannot_tell]
        document = yaml.safe_dump(
            self.document, sort_keys=False, allow_unicode=True, default_flow_style=None, width=110
        )
        return "\n".join([*lines, document])


@dataclass(frozen=True, eq=False)
class Found:
    """A file to suggest a map for: its table and the keys of ``source`` chosen for it, or why it has none."""

    path: Path
    table: Table | None
    source: Mapping[str, Any] = field(default_factory=dict)
    doubts: tuple[str, ...] = ()
    error: InputError | None = None


def suggest_for_all(found: Sequence[Found]) -> tuple[Path, Suggestion]:
    """A first map for the files whose columns most have, naming what it leaves out and why.

    Raises
    ------
    InputError
        None of them can be read.
    """
    kinds: dict[tuple[str, ...], list[Found]] = {}
    for f in found:
        if f.table is not None:
            kinds.setdefault(tuple(f.table.columns), []).append(f)
    if not kinds:
        raise found[0].error or InputError(f"{found[0].path}: cannot be read")
    own = max(kinds.values(), key=len)
    first = own[0]
    proposal = suggest(first.table or Table(str(first.path), {}), first.path, first.source)
    left_out = _add_files(proposal, found, own) if len(found) > 1 else []
    proposal.unsure[:0] = [*left_out, *dict.fromkeys(d for f in own for d in f.doubts)]
    return first.path, proposal


def _add_files(proposal: Suggestion, found: Sequence[Found], own: Sequence[Found]) -> list[str]:
    """Write into a map of the first of its ``own`` files the others, and the files left out, which are
    said.
    """
    first, rows, skip = own[0], [], dict[str, str]()
    for f in found:
        if f.table is None:
            skip[f.path.name] = f"cannot be read: {str(f.error).removeprefix(f'{f.path}: ')}"
        elif f in own:
            longest = max(c.size for c in f.table.columns.values())
            rows.append(f"{f.path.name}: {longest} rows of {len(f.table.columns)} columns")
        else:
            shown = shorten(list(f.table.columns), 8)
            skip[f.path.name] = f"other columns: {shown}; it needs a map of its own"
    (experiment,) = proposal.document.pop("experiments")
    names = [f.path.name for f in own]
    # One file's period need not be another's; that the first repeats is said in the reasons.
    plain = {"rows": [0, None], "role": "identify"}
    alone = [{"file": n, **(experiment if i == 0 else plain)} for i, n in enumerate(names)]
    together = [{"file": _pattern(names), **experiment}]
    proposal.document.update({"skip": skip} if skip else {})
    proposal.document["experiments"] = alone if "period_samples" in experiment else together
    proposal.reasons[:0] = [*rows, f"the columns below are those of {first.path.name}"]
    return [f"{name} is left out: {why}" for name, why in skip.items()]


def _pattern(names: Sequence[str]) -> str:
    """What file names have in common, with a star for the rest."""
    start = _common(names)
    end = _common([n[len(start) :][::-1] for n in names])[::-1]
    return names[0] if len(set(names)) == 1 else f"{start}*{end}"


def _common(names: Sequence[str]) -> str:
    """The letters that names begin with alike."""
    unlike = (i for i, letters in enumerate(zip(*names, strict=False)) if len(set(letters)) > 1)
    return names[0][: next(unlike, min(map(len, names)))]


def suggest(table: Table, path: Path, source: Mapping[str, Any] = MappingProxyType({})) -> Suggestion:
    """A first map for the columns of ``table``; ``source``: keys that were chosen to read it.

    Raises
    ------
    InputError
        Columns that are known, and are neither motion nor torque, or no record in time.
    """
    document: dict[str, Any] = {"format": FORMAT, "format_version": 1, "robot": path.stem}
    notes = Suggestion(document, list(table.reasons), list(table.remarks))
    longest = max(c.size for c in table.columns.values())
    # What is no channel, but stands beside them: sizes, styles, labels.
    table = replace(table, columns={n: c for n, c in table.columns.items() if c.size >= min(_FEW, longest)})
    said = meanings(list(table.columns), table.units)
    _refuse_no_record(table, said)
    if tool_of(table.columns):
        notes.reasons.append(f"the names are those of {tool_of(table.columns)}")
    if table.clocks:
        table = _one_clock(table, said, notes.unsure)
    guessed = ("sync_id", "pdos") if "pdos" in table.notes else ()
    reading = {k: table.notes[k] for k in guessed} | dict(source)
    document.update({"source": reading} if reading else {})
    document["time"], time_column = _time(table, said, notes)
    axes = _axes(table, time_column, said, notes)
    document["axes"] = [_axis(name, a, table, said, notes) for name, a in axes.items()]
    experiment: dict[str, Any] = {"rows": [0, None], "role": "identify", "kind": "other"}
    if axes:
        experiment |= _periodic(document["axes"][0], table, notes)
    else:
        notes.unsure.append("no column looks like a torque with a motion: name them by hand")
        notes.reasons.append("columns and what they hold: " + "; ".join(_ranges(table, time_column)))
        blank: dict[str, Any] = {"name": "A1"}
        for kind in ("position", "torque"):
            notes.asked[f"axes A1 {kind}.column"] = f"which of the columns is the {kind}, and its unit"
            blank[kind] = {"column": "?", "unit": _USUAL[kind]}
        document["axes"] = [blank]
    document["experiments"] = [experiment]
    named = json.dumps([document["time"], document["axes"]], ensure_ascii=False)
    rest = [n for n in table.columns if n != time_column and json.dumps(n, ensure_ascii=False) not in named]
    notes.reasons.extend(["left out: " + ", ".join(rest[:30])] * bool(rest))
    told = [a[q]["unit"] for a in document["axes"] for q in ("position", "velocity", "torque") if q in a]
    if all(u in BY_CONSTANT for u in told):
        document["motion"] = "rotary"
        notes.unsure.append("no unit tells a rotary from a linear machine: 'motion: rotary' is a guess")
    return replace(notes, reasons=together(notes.reasons), unsure=together(notes.unsure))


def _refuse_no_record(table: Table, said: Mapping[str, Meaning]) -> None:
    """InputError where the names say that the file holds no torque with a motion over time."""
    kinds = {n: said[n].quantity for n in table.columns}
    found = set(kinds.values())
    first = next(iter(table.columns))
    shown = shorten([n for n in kinds if kinds[n] in ("acceleration", "spectrum")], 6)
    if kinds[first] == "spectrum" and "time" not in found and not found & {"position", "velocity", "torque"}:
        raise InputError(
            f"{table.name}: is a spectrum over {first!r} ({shown}), no record in time",
            way_out="give the samples that it was computed of: time, motor position and torque",
            code="no_record_in_time",
        )
    if "acceleration" in found and not found & {"position", "velocity", "torque"}:
        raise InputError(
            f"{table.name}: holds neither position nor torque: {shown} are accelerations or rates of a "
            "sensor",
            way_out="log the motor's position and its torque or current beside them",
            code="no_motion_no_torque",
        )


def together(said: Sequence[str]) -> list[str]:
    """Sentences that differ by a number or an entry's name as one: six axes are not asked six times."""
    alike: dict[str, list[str]] = {}
    for sentence in said:
        alike.setdefault(re.sub(r"\[[^\]]*\]|^\S+: |\d+", "#", sentence), []).append(sentence)
    return [s[0] if len(s) == 1 else f"{len(s)} alike, the first: {s[0]}" for s in alike.values()]


def _ranges(table: Table, time_column: str | None) -> list[str]:
    known = {n: c[np.isfinite(c)] for n, c in list(table.columns.items())[:24] if n != time_column}
    return [f"{n} {c.min():.4g} … {c.max():.4g}" for n, c in known.items() if c.size]


def _one_clock(table: Table, said: Mapping[str, Meaning], unsure: list[str]) -> Table:
    """The table by the clock of the first torque; motion that runs on another clock beside it."""
    of = {q: [n for n in table.clocks if said[n].quantity == q] for q in _USUAL}
    first = next((of[q][0] for q in ("torque", "position", "velocity") if of[q]), next(iter(table.clocks)))
    clock = table.clocks[first]
    motion = of["position"] + of["velocity"]
    here = any(table.clocks[n] == clock for n in motion)
    table, moved = on_clock(table, clock, [] if here else motion)
    unsure.extend(moved)
    return table


def _time(table: Table, said: Mapping[str, Meaning], notes: Suggestion) -> tuple[dict[str, Any], str | None]:
    length = max(c.size for c in table.columns.values())
    whole = {n: c for n, c in table.columns.items() if c.size == length and c.size > 2}
    chosen = next(iter(table.clocks.values()), None) or _clock(whole, table, said)
    if chosen is None:
        counts = [n for n, c in whole.items() if is_count(c)][:1]
        why = f"{counts[0]!r} only counts the rows" if counts else "no column rises like time"
        notes.asked["time.sample_rate_hz"] = f"{why}; samples a second"
        return {"sample_rate_hz": None}, next(iter(counts), None)
    column = table.columns[chosen]
    step = np.diff(column[np.isfinite(column)])
    rise = float(np.median(step[step > 0])) if (step > 0).any() else 0.0
    unit = table.units.get(chosen) or said[chosen].unit
    sure = unit in FACTORS["time"]
    if sure:
        notes.reasons.append(f"time is {chosen!r} in {unit}, as the file says")
    else:
        unit, sure = _unit_of_stamps(column, rise)
        notes.reasons.append(
            f"time is {chosen!r}: "
            + ("by its name" if said[chosen].quantity == "time" else "it rises throughout")
        )
        if sure:
            notes.reasons.append(f"its unit is taken as {unit} from its median step {rise:g}")
        else:
            rates = [u for u in FACTORS["time"] if u != "min" and 1e-5 <= rise * FACTORS["time"][u] <= 1.0]
            shown = ", ".join(f"{u} is {1.0 / (rise * FACTORS['time'][u]):.4g} rows a second" for u in rates)
            notes.asked["time.unit"] = (
                f"{chosen!r} rises by {rise:g} a row: {shown}; masses come out by the square of it"
            )
    factor = FACTORS["time"][unit]
    how = StampsRead(chosen, factor)
    try:
        first = (find_restarts((column - column[0]) * factor, how) or [column.size])[0]
        stamps = read_stamps((column[:first] - column[0]) * factor, how, table.name)
    except InputError as error:
        notes.asked["time.sample_rate_hz"] = str(error).removeprefix(f"{table.name}: ")
        return {"sample_rate_hz": None}, chosen
    notes.reasons.append(f"its stamps: {stamps.said}" if sure else f"its stamps, if in {unit}: {stamps.said}")
    episodes = next((n for n in table.columns if EPISODE.match(n)), None)
    if first < column.size or episodes:
        by = f"{episodes!r} changes" if episodes else f"{chosen!r} starts anew"
        notes.reasons.append(f"an experiment each wherever {by}")
    return {"column": chosen, "unit": unit if sure else None}, chosen


def _clock(whole: Mapping[str, Float64], table: Table, said: Mapping[str, Meaning]) -> str | None:
    """The column that is the time: what is called so or has its unit outranks what only rises.

    A count of the rows is none, whatever rises as evenly: it has no unit. What is called time and does not
    rise is refused by name, not passed over for what happens to rise.
    """
    named = [n for n in whole if said[n].quantity == "time"]
    known = [
        n for n in named if n in table.stamped or said[n].unit or table.units.get(n) or not is_count(whole[n])
    ]
    last = [n for n in named if re.match(WORDS["time"], (words_of(n) or [""])[-1])]
    free = [n for n in whole if said[n].quantity is None and not is_count(whole[n]) and not EPISODE.match(n)]
    for candidates in (known, last or free):
        best = best_clock(whole[n] for n in candidates)
        if best is None:
            # Several records one after the other: each of them rises.
            best = next(
                (i for i, n in enumerate(candidates) if find_restarts(whole[n], StampsRead(n, 1.0))), None
            )
        if best is not None:
            return candidates[best]
    return next(iter(last), None)


def _unit_of_stamps(column: Float64, rise: float) -> tuple[str, bool]:
    """The unit of stamps that state none, and whether the file tells it.

    Drives are logged between 10 Hz and 100 kHz: where that leaves seconds it is seconds. Stamps since 1970
    tell theirs by their size. Else the largest unit that puts a step there.
    """
    first = float(column[np.isfinite(column)][0])
    for unit, factor in FACTORS["time"].items():
        if unit != "min" and _FROM_1970[0] < first * factor < _FROM_1970[1]:
            return unit, True
    fitting = [u for u in ("s", "ms", "us", "ns") if 1e-5 <= rise * FACTORS["time"][u] <= 0.1]
    return (fitting or ["s"])[0], fitting[:1] == ["s"] or not fitting


def _axes(
    table: Table, time_column: str | None, said: Mapping[str, Meaning], notes: Suggestion
) -> dict[str, dict[str, str]]:
    """Axis → slot → column, of the axes that have a torque (or a known law's place for it) and a motion."""
    length = table.columns[time_column].size if time_column else max(c.size for c in table.columns.values())
    groups: dict[str, dict[str, str]] = {}
    for name, column in table.columns.items():
        quantity = said[name].quantity or ""
        slot = quantity + "_demand" * said[name].demanded
        if (
            name == time_column
            or column.size != length
            or slot not in _SLOTS
            or not _can_be(said[name], column)
        ):
            continue
        axis = groups.setdefault(said[name].joint, {})
        held = axis.setdefault(slot, name)
        if held == name:
            continue
        better = _worth(said[name]) > _worth(said[held])
        axis[slot] = name if better else held
        taken, left = (re.sub(r"\[\w+\]$", "[…]", n) for n in ((name, held) if better else (held, name)))
        notes.unsure.append(f"both {taken!r} and {left!r} look like {slot}: {taken!r} was taken")
    whole = {k: a for k, a in groups.items() if _is_whole(a)}
    if not whole and groups:
        # Numbers in names, those of a drive's parameters, leave none with torque and motion: they are one
        # axis.
        merged = {slot: n for a in groups.values() for slot, n in a.items()}
        alone = sum(len(a) for a in groups.values()) == len(merged)
        whole = (
            {"": merged}
            if alone and (_is_whole(merged) or {"position", "position_demand"} <= merged.keys())
            else {}
        )
    if len(whole) > 1 and "" in whole and "1" not in whole:
        del whole[""]  # columns without a number beside those of axes: a sensor
    numbered = all(k.isdigit() or not k for k in whole)
    base = 0 if {"", "1"} <= whole.keys() or "0" in whole else 1
    order = sorted(whole, key=lambda k: int(k) if k else -1) if numbered else list(whole)
    return {(f"A{int(k) + 1 - base}" if k else "A1") if numbered else k or "A1": whole[k] for k in order}


def _can_be(meaning: Meaning, column: Float64) -> bool:
    """Whether a voltage goes both ways, as a motor's does and a supply's does not."""
    known = column[np.isfinite(column)]
    return meaning.unit != "V" or bool(known.size and known.min() < 0 < known.max())


def _worth(meaning: Meaning) -> float:
    return meaning.rank - 2 * (meaning.side == "load")


def _is_whole(axis: Mapping[str, str]) -> bool:
    return bool(axis.keys() & {"torque", "torque_demand"} and axis.keys() & {"position", "velocity"})


def _axis(
    name: str, axis: Mapping[str, str], table: Table, said: Mapping[str, Meaning], notes: Suggestion
) -> dict[str, Any]:
    quantity = "position" if "position" in axis else "velocity"
    motion, torque = axis[quantity], axis.get("torque") or axis.get("torque_demand")
    unit = _unit(motion, quantity, table, said, notes)
    entry: dict[str, Any] = {"name": name, quantity: {"column": motion, "unit": unit}}
    if unit == "counts":
        entry[quantity]["per_count"] = None
        notes.asked[f"axes {name} {quantity}.per_count"] = (
            "rad (or m) of one count: 2π / counts a turn of the motor"
            + "; per second" * (quantity == "velocity")
        )
    notes.reasons.append(f"{name}: {quantity} is {motion!r} by its name, in {unit}")
    if torque is None:
        entry["position_reference"] = {"column": axis["position_demand"], "unit": unit}
        entry["controller"] = {"stiffness": None, "damping": None}
        notes.asked[f"axes {name} controller"] = (
            "no column is a torque; where the law between the target and the torque is known write its gains "
            "(N·m/rad, N·m·s/rad; 'limit' where it has one): its torque is then read as demanded; else name "
            "a "
            "'torque'"
        )
        return entry
    linear = "N" if unit in LINEAR[quantity] else "N·m"
    channel: dict[str, Any] = {"column": torque, "unit": _unit(torque, "torque", table, said, notes, linear)}
    channel["meaning"] = "measured" if "torque" in axis else "demanded"
    if channel["unit"] in BY_TORQUE_CONSTANT:
        channel["torque_constant"] = 1.0
        notes.unsure.append(
            f"{torque!r} is in {channel['unit']}: with torque_constant 1 all comes out per that constant"
        )
    if channel["unit"] in ("%", "permille"):
        entry["rated_torque"] = None
        notes.asked[f"axes {name} rated_torque"] = f"{torque!r} is in {channel['unit']} of it; N·m (or N)"
    entry["torque"] = channel
    notes.unsure.extend(filter(None, [doubt_of_sides(name, torque, motion)]))
    notes.reasons.append(f"{name}: torque is {torque!r} by its name, taken as {channel['meaning']}")
    if {"torque", "torque_demand"} <= axis.keys():
        demand = axis["torque_demand"]
        # In the torque's unit where both names are of one kind and neither says another.
        alike = is_current(demand) == (channel["unit"] in BY_TORQUE_CONSTANT)
        usual = channel["unit"] if alike else linear
        own = said[demand].unit or (usual if alike else _unit(demand, "torque", table, said, notes, usual))
        constant = {"torque_constant": 1.0} if own in BY_TORQUE_CONSTANT else {}
        entry["torque_demand"] = {"column": demand, "unit": own, **constant}
    return entry


def _unit(
    name: str, quantity: str, table: Table, said: Mapping[str, Meaning], notes: Suggestion, usual: str = ""
) -> str:
    """The unit that name or file state, else the usual one, which is said."""
    if said[name].unit:
        return said[name].unit
    column = table.columns[name]
    known = column[np.isfinite(column)]
    stated = table.units.get(name)
    is_whole = known.size > 2 and bool(np.all(known == np.rint(known)) and np.ptp(known) > 8)
    if quantity != "torque" and is_whole:
        notes.unsure.append(f"unit of {name!r} is not stated; it holds whole numbers: counts is assumed")
        return "counts"
    unit = "A" if quantity == "torque" and is_current(name) else usual or _USUAL[quantity]
    notes.unsure.append(
        f"unit of {name!r} is not {f'known ({stated!r})' if stated else 'stated'}; {unit} is assumed"
    )
    return unit


def _periodic(axis: Mapping[str, Any], table: Table, notes: Suggestion) -> dict[str, Any]:
    """What an experiment's entry says of a torque and a motion that repeat alike."""
    motion = axis.get("position") or axis["velocity"]
    if "torque" not in axis:
        return {}
    signals = [table.column(c["column"]) for c in (axis["torque"], motion)]
    periods = {find_period(s[np.isfinite(s)]) for s in signals}
    if len(periods) != 1 or 0 in periods:
        return {}
    period = periods.pop()
    notes.reasons.append(f"torque and motion repeat every {period} samples: periodic, first period left out")
    notes.unsure.append("'frequencies_hz' of the excited lines is not known: add it where it is")
    return {"kind": "multisine", "period_samples": period, "drop_periods": 1}
