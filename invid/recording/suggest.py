"""A first map guessed from a file, with the reason for every guess; unsure guesses say so."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import zip_longest
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from invid.errors import InputError
from invid.numerics.arrays import Float64
from invid.recording.clock import StampsRead, best_clock, is_count, read_stamps
from invid.recording.drive_tools import named_by, tool_of
from invid.recording.import_map import FORMAT, ImportMap
from invid.recording.plausibility import doubt_of_sides
from invid.recording.record_names import further_experiments, only_first, records_by_name
from invid.recording.tables import Table, on_clock, shorten
from invid.recording.units import (
    BY_MACHINE,
    BY_RATED_TORQUE,
    BY_TORQUE_CONSTANT,
    FACTORS,
    LINEAR,
    normal_unit,
)

_WORDS = {
    "time": (
        r"(time|t|ts|timestamps?|zeit|zeitstempel|clock|stamps?|datetime|date|utc|epoch|elapsed|millis|micros|"
        r"tiempo)$|.*(时间|時間|時刻)"
    ),
    "demand": (
        r"(ref|cmd|command|demand|target|setpoint|set|des|desired|soll|goal|consigne)|"
        r".*(给定|指令|目标|目標|设定)"
    ),
    "velocity": (
        r"(vel|speed|omega|dq|qd|qvel|rpm|vitesse)|.*(drehzahl|geschwindigkeit|速度|转速|回転数|속도|скорость)"
    ),
    "torque": (
        r"(tau|torque|trq|force|iq|current|effort|vir|couple|par$|corriente|courant|coppia)|"
        r".*(moment|strom|力矩|扭矩|转矩|电流|トルク|電流|토크|момент)"
    ),
    "position": (
        r"(pos|theta|angle|phi|enc|q|qm|joint|ángulo|lage(?!r))|.*(position|winkel|位置|角度|위치|각도|положение|угол)"
    ),
}
"""How words of a name begin; a compound's last part says what it is."""
_ASIDE = {"act", "actual", "meas", "measured", "msr", "joint", "joints", "state", "states", "data", "value"}
_UNITS = {u for table in FACTORS.values() for u in table} | {*BY_MACHINE, *BY_TORQUE_CONSTANT}
_VOLTS = {"voltage", "volt", "volts", "spannung", "pwm", "duty"}
_FROM_1970 = (946_684_800.0, 4_102_444_800.0)
"""Seconds since 1970 of 2000 and of 2100: a number between them is a date, and so its unit."""
_SECOND = r"(^|[^a-z])(se|load|link|second|secondary|abtrieb|out)([^a-z]|$)|y$"


@dataclass
class _Axis:
    position: str | None = None
    velocity: str | None = None
    torque: str | None = None
    torque_demand: str | None = None
    others: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Suggestion:
    """A map with the reasons for it.

    ``unsure`` lists guesses that a person must judge, ``asked`` what the file cannot tell: key in the map →
    question; such a key is null, and the map runs once it is filled in.
    """

    document: dict[str, Any]
    reasons: tuple[str, ...]
    unsure: tuple[str, ...]
    asked: dict[str, str] = field(default_factory=dict)

    def as_map(self) -> ImportMap:
        """Return the map, validated."""
        return ImportMap.model_validate(self.document)

    def as_yaml(self) -> str:
        """Return the map as YAML with the reasons as comments."""
        lines = ["# A first map, guessed by 'invid import --suggest'. Check every line before you trust it."]
        lines += [f"# - {r}" for r in self.reasons]
        lines += [f"# ? UNSURE: {u}" for u in self.unsure]
        lines += [f"# ! FILL IN {key}: {question}" for key, question in self.asked.items()]
        return "\n".join(lines) + "\n" + _yaml(self.document, 0)


@dataclass(frozen=True)
class _Notes:
    """Notes of a suggestion, as it grows: see ``Suggestion``."""

    reasons: list[str]
    unsure: list[str]
    asked: dict[str, str]


def _yaml(value: Any, depth: int) -> str:
    pad = "  " * depth
    text = ""
    for key, item in value.items():
        if isinstance(item, dict) and depth < 1 and item:
            text += f"{pad}{key}:\n" + _yaml(item, depth + 1)
        elif isinstance(item, list) and item and isinstance(item[0], dict):
            text += f"{pad}{key}:\n"
            for entry in item:
                rows = [f"{k}: {json.dumps(v, ensure_ascii=False)}" for k, v in entry.items()]
                text += f"{pad}  - " + f"\n{pad}    ".join(rows) + "\n"
        else:
            text += f"{pad}{key}: {json.dumps(item, ensure_ascii=False)}\n"
    return text


@dataclass(frozen=True, eq=False)
class Found:
    """A file to suggest a map for: its table and the keys of ``source`` chosen for it, or why it has none."""

    path: Path
    table: Table | None
    source: Mapping[str, str | int] = field(default_factory=dict)
    doubts: tuple[str, ...] = ()
    error: str = ""


def suggest_for_all(found: Sequence[Found]) -> tuple[Path, Suggestion]:
    """A first map for the files whose columns most have, naming what it leaves out and why.

    Raises
    ------
    InputError
        None of them can be read.
    """
    read = [f for f in found if f.table is not None]
    if not read:
        raise InputError(found[0].error)
    kinds: dict[tuple[str, ...], list[Found]] = {}
    for f in read:
        kinds.setdefault(tuple(f.table.columns) if f.table else (), []).append(f)
    own = max(kinds.values(), key=len)
    first = own[0]
    proposal = suggest(first.table or Table(str(first.path), {}), first.path, first.source)
    if len(found) == 1:
        return first.path, replace(proposal, unsure=(*first.doubts, *proposal.unsure))
    reasons, skip = [], {}
    for f in found:
        if f in own and f.table is not None:
            rows = max(c.size for c in f.table.columns.values())
            reasons.append(f"{f.path.name}: {rows} rows of {len(f.table.columns)} columns")
        elif f.table is not None:
            skip[f.path.name] = (
                f"other columns: {shorten(list(f.table.columns), 8)}; it needs a map of its own"
            )
        else:
            skip[f.path.name] = f"cannot be read: {f.error.removeprefix(f'{f.path}: ')}"
    document = dict(proposal.document)
    experiments = document.pop("experiments")
    # One file's period need not be another's; that the first repeats is said in the reasons.
    entries = [
        {"file": f.path.name, **e} for f in own for e in (experiments if f is first else experiments[:1])
    ]
    for entry in entries:
        if entry["file"] != first.path.name:
            for key in ("period_samples", "drop_periods", "kind"):
                entry.pop(key, None)
    pattern = _pattern([f.path.name for f in own])
    if "period_samples" not in experiments[0] and len(experiments) == 1:
        entries = [{"file": pattern, **experiments[0]}]
    document = {**document, **({"skip": skip} if skip else {}), "experiments": entries}
    unsure = [f"{name} is left out: {why}" for name, why in skip.items()]
    doubts = tuple(dict.fromkeys(d for f in own for d in f.doubts))
    return first.path, replace(
        proposal,
        document=document,
        reasons=(*reasons, f"the columns below are those of {first.path.name}", *proposal.reasons),
        unsure=(*unsure, *doubts, *proposal.unsure),
    )


def _pattern(names: Sequence[str]) -> str:
    """What file names have in common, with a star for the rest."""
    if len(set(names)) == 1:
        return names[0]
    start = _alike(names)
    return f"{names[0][:start]}*{names[0][len(names[0]) - _alike([n[start:][::-1] for n in names]) :]}"


def _alike(names: Sequence[str]) -> int:
    """How many letters names have in common from their first on."""
    unlike = (i for i, letters in enumerate(zip(*names, strict=False)) if len(set(letters)) > 1)
    return next(unlike, min(map(len, names)))


def suggest(table: Table, path: Path, source: Mapping[str, str | int] = MappingProxyType({})) -> Suggestion:
    """A first map for the columns of ``table``; ``source``: keys that were chosen to read it."""
    notes = _Notes(list(table.reasons), list(table.remarks), {})
    reasons, unsure, asked = notes.reasons, notes.unsure, notes.asked
    tool = tool_of(table.columns)
    if tool:
        reasons.append(f"the names are those of {tool}")
    if table.clocks:
        table = _one_clock(table, tool, unsure)
    records = records_by_name(table.columns)
    if records:
        table = replace(table, columns=only_first(table.columns, records))
        reasons.append(f"{len(records)} records under different names: one experiment each")
    document: dict[str, Any] = {"format": FORMAT, "format_version": 1, "robot": path.stem}
    if "pdos" in table.notes:
        document["source"] = {k: table.notes[k] for k in ("sync_id", "pdos")}
        reasons.extend(table.notes["reasons"])
        unsure.append("which field of the PDOs is what, and its unit: name position and torque by hand")
    elif table.notes:
        kept = {k: table.notes[k] for k in ("delimiter", "decimal", "header_lines") if k in table.notes}
        document["source"] = kept
        reasons.append("the file is delimited text: " + ", ".join(f"{k} {v!r}" for k, v in kept.items()))
        if table.units:
            document["source"]["names"] = [n for n in table.columns if n not in table.added]
    if source:
        document["source"] = {**document.get("source", {}), **source}
    document["time"], time_column = _time(table, reasons, unsure, asked)
    axes = _axes(table, time_column, tool, reasons, unsure)
    document["axes"] = [_axis(name, a, table, tool, notes) for name, a in axes.items()]
    document["axes"] = [a for a in document["axes"] if a] or _input_output(table, unsure)
    experiment: dict[str, Any] = {"rows": [0, None], "role": "identify", "kind": "other"}
    if document["axes"]:
        first = document["axes"][0]
        motion = first.get("position") or first["velocity"]
        signals = [table.column(c["column"]) for c in (first["torque"], motion)]
        period, moved = (find_period(s[np.isfinite(s)]) for s in signals)
        if period and period == moved:
            experiment.update(kind="multisine", period_samples=period, drop_periods=1)
            reasons.append(
                f"torque and motion repeat every {period} samples: periodic, first period left out"
            )
            unsure.append("'frequencies_hz' of the excited lines is not known: add it where it is")
    else:
        unsure.append("no column looks like a torque with a motion: name them by hand")
        reasons.append("columns and what they hold: " + "; ".join(_ranges(table, time_column)))
        for field_name in ("position", "torque"):
            asked[f"axes A1 {field_name}.column"] = f"which of the columns is the {field_name}, and its unit"
        blank = {"position": {"column": "?", "unit": "rad"}, "torque": {"column": "?", "unit": "N·m"}}
        document["axes"] = [{"name": "A1", **blank}]
    named = json.dumps([document["time"], document["axes"]], ensure_ascii=False)
    document["experiments"] = [experiment, *further_experiments(records, lambda n: f'"{n}"' in named)]
    rest = [n for n in table.columns if n != time_column and f'"{n}"' not in named]
    if rest:
        reasons.append("left out: " + ", ".join(rest[:30]))
    if document["axes"] and _motion_untold(document["axes"]):
        document["motion"] = "rotary"
        unsure.append("no unit tells a rotary from a linear machine: 'motion: rotary' is a guess")
    return Suggestion(document, together(reasons), together(unsure), asked)


def together(said: Sequence[str]) -> tuple[str, ...]:
    """Sentences that differ by a number or an entry's name as one: six axes are not asked six times."""
    alike: dict[str, list[str]] = {}
    for sentence in said:
        alike.setdefault(re.sub(r"\[[^\]]*\]|^\S+: |\d+", "#", sentence), []).append(sentence)
    return tuple(s[0] if len(s) == 1 else f"{len(s)} alike, the first: {s[0]}" for s in alike.values())


def _ranges(table: Table, time_column: str | None) -> list[str]:
    found = []
    for name, column in list(table.columns.items())[:24]:
        known = column[np.isfinite(column)]
        if name != time_column and known.size:
            found.append(f"{name} {known.min():.4g} … {known.max():.4g}")
    return found


def _motion_untold(axes: list[dict[str, Any]]) -> bool:
    said = [a[q]["unit"] for a in axes for q in ("position", "velocity", "torque") if q in a]
    return all(u in BY_MACHINE for u in said)


def _one_clock(table: Table, tool: str | None, unsure: list[str]) -> Table:
    """The table by the clock of the first torque; motion that runs on another clock beside it."""
    kinds = {n: _guess_quantity(n, tool) for n in table.clocks}
    first = next((n for q in ("torque", "position", "velocity") for n, k in kinds.items() if k == q), None)
    clock = table.clocks[first or next(iter(table.clocks))]
    told = {k for n, k in kinds.items() if table.clocks[n] == clock}
    wanted = (
        []
        if told & {"position", "velocity"}
        else [n for n, k in kinds.items() if k in ("position", "velocity")]
    )
    table, moved = on_clock(table, clock, wanted)
    unsure.extend(moved)
    return table


def _time(
    table: Table, reasons: list[str], unsure: list[str], asked: dict[str, str]
) -> tuple[dict[str, Any], str | None]:
    length = max(c.size for c in table.columns.values())
    whole = {n: c for n, c in table.columns.items() if c.size == length and c.size > 2}
    chosen = next(iter(table.clocks.values()), None) or _clock(whole, table)
    if chosen is None:
        counts = [n for n, c in whole.items() if is_count(c)][:1]
        why = f"{counts[0]!r} only counts the rows" if counts else "no column rises like time"
        asked["time.sample_rate_hz"] = f"{why}; samples a second"
        return {"sample_rate_hz": None}, next(iter(counts), None)
    column = table.columns[chosen]
    step = np.diff(column[np.isfinite(column)])
    rise = float(np.median(step[step > 0])) if (step > 0).any() else 0.0
    stated = table.units.get(chosen) or _unit_in_name(chosen)
    unit = normal_unit(stated or "")
    sure = unit in FACTORS["time"]
    if sure:
        reasons.append(f"time is {chosen!r} in {unit}, as the file says")
    else:
        unit, sure = _unit_of_stamps(column, rise)
        why = "by its name" if _is_named_time(chosen) else "it rises throughout"
        reasons.append(f"time is {chosen!r}: {why}")
        if sure:
            reasons.append(f"its unit is taken as {unit} from its median step {rise:g}")
        else:
            asked["time.unit"] = (
                f"{chosen!r} rises by {rise:g} a row: {_rates(rise)}; masses come out by the square of it"
            )
    factor = FACTORS["time"][unit]
    try:
        stamps = read_stamps((column - column[0]) * factor, StampsRead(chosen, factor), table.name)
    except InputError as error:
        asked["time.sample_rate_hz"] = str(error).removeprefix(f"{table.name}: ")
        return {"sample_rate_hz": None}, chosen
    reasons.append(f"its stamps: {stamps.said}" if sure else f"its stamps, if in {unit}: {stamps.said}")
    return {"column": chosen, "unit": unit if sure else None}, chosen


def _is_named_time(name: str) -> bool:
    words = _words(name)
    return any(re.match(_WORDS["time"], w) for w in (words[-1:] + words[:1]))


def _clock(whole: Mapping[str, Float64], table: Table) -> str | None:
    """The column that is the time: what is called so or has its unit outranks what only rises.

    A count of the rows is none, whatever rises as evenly: it has no unit.
    """
    units = {n: normal_unit(table.units.get(n) or _unit_in_name(n) or "") for n in whole}
    in_time = [n for n in whole if units[n] in FACTORS["time"] and _guess_quantity(n) is None]
    named = [n for n in whole if _is_named_time(n) and _guess_quantity(n) is None]
    free = [n for n in whole if _guess_quantity(n) is None and not is_count(whole[n])]
    stamps = [n for n in named if n in in_time or n in table.stamped or not is_count(whole[n])]
    # What is called time and does not rise is refused by name, not passed over for what happens to rise.
    last = [n for n in named if re.match(_WORDS["time"], _words(n)[-1])]
    for candidates in ([*stamps, *(n for n in in_time if n not in stamps)], last or free):
        best = best_clock(whole[n] for n in candidates)
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


def _rates(rise: float) -> str:
    """What rates the units that a step may be in make."""
    fitting = [u for u in ("s", "ms", "us", "ns") if 1e-5 <= rise * FACTORS["time"][u] <= 1.0]
    return ", ".join(f"{u} is {1.0 / (rise * FACTORS['time'][u]):.4g} rows a second" for u in fitting)


def _words(name: str) -> list[str]:
    bare = re.sub(r"[\[(].*?[\])]", " ", name)
    bare = re.sub(r"(?<=[a-z])(?=[A-Z][a-z])", " ", bare)  # ActPosition is two words
    return [w for w in re.split(r"[\W\d_]+", bare.lower()) if w]


def _rank(name: str) -> int:
    """Rank columns by the words people use: measured beats unsaid beats derived."""
    words = set(_words(name))
    if words & {"act", "actual", "meas", "measured", "mot", "motor", "m", "qm", "msr"}:
        return 1
    return -1 if words & {"err", "error", "ref", "qg", "rel", "ff", "calc", "model", "ext", "external"} else 0


def _worth(name: str, table: Table, tool: str | None) -> tuple[bool, int]:
    """Return what decides between columns of one kind: a torque beats a current or a voltage, then the
    words.
    """
    known = named_by(tool, name)
    unit = normal_unit(table.units.get(name) or _unit_in_name(name) or (known.unit if known else ""))
    return not (unit in BY_TORQUE_CONSTANT or (not unit and _is_current(name))), _rank(name)


def _family(name: str) -> str:
    return re.sub(r"\[\d+\]$", "[…]", name)


def _guess_quantity(name: str, tool: str | None = None) -> str | None:
    known = named_by(tool, name)
    if known is not None:
        return known.quantity
    # The q-axis of a motor is its current, not a joint's coordinate.
    words = _words(name)
    if words and (re.match(_WORDS["time"], words[-1]) or words[:2] == ["time", "of"]):
        return None
    if any(w.startswith(("temp", "温")) for w in words):
        return None
    words = [w for w, after in zip_longest(words, words[1:]) if (w, after) != ("q", "axis")]
    for quantity in ("velocity", "torque", "position"):
        if any(re.match(_WORDS[quantity], w) for w in words if len(w) > 1 or w == "q"):
            return quantity
    return None


def _unit_in_name(name: str) -> str | None:
    bracket = re.findall(r"[\[(]\s*([^\])]+?)\s*[\])]", name)
    candidates = [b for b in bracket if not b.isdigit() and b != _entry_of(name)]
    bare = re.sub(r"[\[(].*?[\])]", "", name).rstrip()
    if (per := re.search(r"_(deg|rad)_per_s$", bare.lower())) is not None:
        return candidates[0] if candidates else f"{per[1]}/s"
    last = re.split(r"[_ ]", bare)[-1] if re.search(r"[_ ]", bare) or _is_named_time(bare) else ""
    if (over := re.fullmatch(r"[^/]+/([^/]+)", bare)) is not None:
        return candidates[0] if candidates else over[1] if normal_unit(over[1]) in _UNITS else None
    last = {"ticks": "counts", "nm": "N·m"}.get(last.lower(), last)
    # 'in' and 'min' are words before they are inches and minutes, and so is a capital after a blank.
    if normal_unit(last) in _UNITS - {"in", "min"} and ("_" in bare or len(last) > 1 or last.islower()):
        candidates.append(last)
    return candidates[0] if candidates else None


def _axes(
    table: Table, time_column: str | None, tool: str | None, reasons: list[str], unsure: list[str]
) -> dict[str, _Axis]:
    length = table.columns[time_column].size if time_column else max(c.size for c in table.columns.values())
    groups: dict[str, _Axis] = {}
    joints = _joint_stems(table.columns, tool)
    for name, column in table.columns.items():
        if name == time_column or column.size != length:
            continue
        quantity = _guess_quantity(name, tool)
        if quantity is None:
            continue
        words = _words(name)
        known = named_by(tool, name)
        demanded = known.demand if known else _is_demand(words)
        axis = groups.setdefault(_joint_of(name, joints), _Axis())
        slot = f"{quantity}_demand" if demanded else quantity
        if slot in ("position_demand", "velocity_demand"):
            continue
        if slot == "position" and any(re.search(_SECOND, w) for w in words):
            axis.others.append(name)
            continue
        held = getattr(axis, slot)
        better = held is not None and _worth(name, table, tool) > _worth(held, table, tool)
        if held is None or better:
            setattr(axis, slot, name)
        if held is not None:
            taken, left = (name, held) if better else (held, name)
            one, other = _family(taken), _family(left)
            doubt = f"both {one!r} and {other!r} look like {slot}: {one!r} was taken"
            if doubt not in unsure:
                unsure.append(doubt)
    if not any(map(_is_whole, groups.values())):
        groups = _as_one(groups)
    # A second column of the same name is numbered 1.
    twice = all(k in groups and _is_whole(groups[k]) for k in ("", "1"))
    base = 0 if "0" in groups or twice else 1
    numbered = all(not k or k.isdigit() for k in groups)
    named: dict[str, _Axis] = {}
    for key in sorted(groups, key=lambda k: int(k) if k else -1) if numbered else groups:
        axis = groups[key]
        _complete(axis, key, table, time_column, unsure)
        for other in axis.others[:1]:
            reasons.append(f"{other!r} looks like a second encoder: kept out of the recording")
            if axis.position is not None and _moves_as_far(table, axis.position, other):
                unsure.append(
                    f"{axis.position!r} moves as far as the second encoder {other!r}: it is in the link's "
                    f"angle, and the torque must be the link's too ('scale' with the gear ratio where it is "
                    f"the motor's)"
                )
        name = (f"A{int(key) + 1 - base}" if key else "A1") if numbered else key or "A1"
        # Columns without a number are the only axis, or none: a sensor beside the axes.
        if name not in named or not _is_whole(named[name]):
            named[name] = axis
    return named


def _as_one(groups: Mapping[str, _Axis]) -> dict[str, _Axis]:
    """One axis where numbers in names, those of a drive's parameters, leave none with torque and motion."""
    one = _Axis()
    for axis in groups.values():
        for slot in ("position", "velocity", "torque", "torque_demand"):
            if (name := getattr(axis, slot)) is not None:
                if getattr(one, slot) is not None:
                    return dict(groups)
                setattr(one, slot, name)
        one.others += axis.others
    return {"": one}


def _is_demand(words: Sequence[str]) -> bool:
    """Whether the words of a name say what was asked for; ``tau_J_d`` and ``q_d`` are Franka's."""
    return any(re.match(_WORDS["demand"], w) for w in words) or words[-1:] in (["d"], ["sp"])


def _entry_of(name: str) -> str:
    """The name or number of a list's entry, ``position[elbow]``; a unit stands in brackets too."""
    bracket = re.findall(r"\S\[([^\]\[]+)\]$", name)
    # A list of a topic's messages has no unit, whatever its joints are called; nor is one written [a].
    is_topic = re.match(r"/\S+\.\w+\[", name) is not None or bracket[:1] in (["a"], ["v"])
    return str(bracket[0]) if bracket and (is_topic or normal_unit(bracket[0]) not in _UNITS) else ""


def _joint_of(name: str, joints: Collection[str]) -> str:
    """What of a column's name tells its axis from others: a name in brackets, else a joint's and a number."""
    entry = _entry_of(name)
    if entry:
        return entry
    digits = re.findall(r"(\d+)\D*$", name)
    return " ".join([*([_stem(name)] if _stem(name) in joints else []), *digits])


def _stem(name: str) -> str:
    """What a name says beside quantity, unit and source: ``elbow`` of ``elbow_pos_deg``."""
    aside = [_WORDS[q] for q in ("velocity", "torque", "position", "demand")]
    words = [w for w in _words(name) if not any(re.match(a, w) for a in aside) and w not in _ASIDE]
    return " ".join(w for w in words if normal_unit(w) not in _UNITS)


def _joint_stems(names: Iterable[str], tool: str | None) -> frozenset[str]:
    """Stems that are joints: two or more of which each has a torque and a motion."""
    has: dict[str, set[str]] = {}
    for name in names:
        quantity = _guess_quantity(name, tool)
        if quantity is not None and not _entry_of(name):
            has.setdefault(_stem(name), set()).add("torque" if quantity == "torque" else "motion")
    whole = {stem for stem, kinds in has.items() if stem and len(kinds) == 2}
    return frozenset(whole) if len(whole) > 1 else frozenset()


def _is_whole(axis: _Axis) -> bool:
    return bool((axis.torque or axis.torque_demand) and (axis.position or axis.velocity))


def _complete(axis: _Axis, key: str, table: Table, time_column: str | None, unsure: list[str]) -> None:
    """Give an axis what stands for its torque or its motion where nothing is called so."""
    if axis.position is None and axis.velocity is None and axis.others:
        axis.position = axis.others.pop(0)
    if axis.torque is None and axis.torque_demand is None and (axis.position or axis.velocity):
        for name, column in table.columns.items():
            unit = normal_unit(table.units.get(name) or _unit_in_name(name) or "")
            own = _joint_of(name, ()) == key
            known = column[np.isfinite(column)]
            # A supply's voltage hardly moves about its mean; a motor's goes both ways.
            driving = known.size > 2 and float(known.min()) < 0 < float(known.max())
            volts = unit in BY_TORQUE_CONSTANT or bool(_VOLTS & set(_words(name)))
            volts = volts or _words(name) == ["u"]  # as control calls its input
            if name != time_column and own and driving and volts and _guess_quantity(name) is None:
                axis.torque, axis.torque_demand = (name, None) if unit == "A" else (None, name)
                unsure.append(f"nothing is called torque: {name!r} is taken for it, as what drives the motor")
                return


def _moves_as_far(table: Table, one: str, other: str) -> bool:
    spans = [float(np.ptp(c[np.isfinite(c)])) for c in (table.columns[one], table.columns[other])]
    return min(spans) > 0.9 * max(spans) > 0


def _input_output(table: Table, unsure: list[str]) -> list[dict[str, Any]]:
    """One axis from ``u`` and ``y``, as system identification calls input and output."""
    found = {letter: [n for n in table.columns if _words(n)[:1] == [letter]] for letter in "uy"}
    if any(len(names) != 1 for names in found.values()):
        return []
    (u,), (y,) = found["u"], found["y"]
    unsure.append(
        f"{u!r} and {y!r} are taken for torque [N·m] and position [rad], as input and output are called; "
        "where the output is a velocity write 'velocity' in place of 'position'"
    )
    torque = {"column": u, "unit": "N·m", "meaning": "measured"}
    return [{"name": "A1", "position": {"column": y, "unit": "rad"}, "torque": torque}]


def _axis(
    name: str,
    axis: _Axis,
    table: Table,
    tool: str | None,
    notes: _Notes,
) -> dict[str, Any]:
    reasons, unsure, asked = notes.reasons, notes.unsure, notes.asked
    torque = axis.torque or axis.torque_demand
    motion = axis.position or axis.velocity
    if torque is None or motion is None:
        return {}
    quantity = "position" if axis.position else "velocity"
    unit, sure = _unit(motion, quantity, table, tool)
    if not sure and _is_whole_numbers(table.columns[motion]):
        unit = "counts"
        unsure.append(f"unit of {motion!r} is not stated; it holds whole numbers: {unit} is assumed")
        sure = True
    linear = unit in LINEAR[quantity]
    entry: dict[str, Any] = {"name": name, quantity: {"column": motion, "unit": unit}}
    if unit == "counts":
        entry[quantity]["per_count"] = None
        asked[f"axes {name} {quantity}.per_count"] = (
            "rad (or m) of one count: 2π / counts a turn of the motor"
            + ("; per second" * (quantity == "velocity"))
        )
    reasons.append(f"{name}: {quantity} is {motion!r} by its name, in {unit}")
    if not sure:
        unsure.append(f"unit of {motion!r} is not {_said(motion, table)}; {unit} is assumed")
    torque_unit, sure = _unit(torque, "torque", table, tool)
    if not sure:
        torque_unit = "A" if _is_current(torque) else "N" if linear else "N·m"
        unsure.append(f"unit of {torque!r} is not {_said(torque, table)}; {torque_unit} is assumed")
    channel: dict[str, Any] = {"column": torque, "unit": torque_unit}
    channel["meaning"] = "measured" if axis.torque else "demanded"
    if torque_unit in BY_TORQUE_CONSTANT:
        channel["torque_constant"] = 1.0
        unsure.append(
            f"{torque!r} is in {torque_unit}: with torque_constant 1 all comes out per that constant"
        )
    if torque_unit in BY_RATED_TORQUE:
        entry["rated_torque"] = None
        asked[f"axes {name} rated_torque"] = f"{torque!r} is in {torque_unit} of it; N·m (or N)"
    entry["torque"] = channel
    doubt = doubt_of_sides(name, torque, motion)
    unsure.extend([doubt] if doubt else [])
    reasons.append(f"{name}: torque is {torque!r} by its name, taken as {channel['meaning']}")
    if axis.torque and axis.torque_demand:
        entry["torque_demand"] = _demand(axis.torque_demand, channel, table, tool, notes)
    return entry


def _demand(
    name: str, torque: Mapping[str, Any], table: Table, tool: str | None, notes: _Notes
) -> dict[str, Any]:
    """The torque that was asked for, in its own unit; in the torque's where both names are of one kind."""
    unit, sure = _unit(name, "torque", table, tool)
    if not sure:
        alike = _is_current(name) == (torque["unit"] in BY_TORQUE_CONSTANT)
        unit = torque["unit"] if alike else "A" if _is_current(name) else "N·m"
        if not alike:
            notes.unsure.append(f"unit of {name!r} is not {_said(name, table)}; {unit} is assumed")
    entry = {"column": name, "unit": unit}
    return {**entry, "torque_constant": 1.0} if unit in BY_TORQUE_CONSTANT else entry


def _is_whole_numbers(column: Float64) -> bool:
    """Whether a motion comes in whole numbers of more than a few values, as no angle in rad does."""
    known = column[np.isfinite(column)]
    return bool(known.size > 2 and np.all(known == np.rint(known)) and np.ptp(known) > 8)


def _is_current(name: str) -> bool:
    return any(
        re.match(r"(iq|currents?|amps?|courant|corriente)$|.*(strom|电流|電流)$", w) for w in _words(name)
    )


def _said(name: str, table: Table) -> str:
    stated = table.units.get(name) or _unit_in_name(name)
    return f"known ({stated!r})" if stated else "stated"


def _unit(name: str, quantity: str, table: Table, tool: str | None) -> tuple[str, bool]:
    known = named_by(tool, name)
    stated = table.units.get(name) or _unit_in_name(name) or (known.unit if known else None)
    if stated:
        unit = normal_unit(stated)
        by_machine = unit in BY_MACHINE and (unit == "counts") == (quantity != "torque")
        if unit in FACTORS[quantity] or by_machine:
            return unit, True
    return {"position": "rad", "velocity": "rad/s", "torque": "N·m"}[quantity], False


_LONGEST = 1 << 20
"""Samples that are looked at for a period: four of a minute at 4 kHz."""


def find_period(values: Float64) -> int:
    """Samples after which a signal repeats at least four times over; 0 where it does not.

    Candidates come from the autocorrelation. A candidate stands where the mean over periods explains
    98 % of the power. That bound is empirical: a measured multisine with 5 % noise reaches 99.7 %; moves
    repeated under closed loop with friction reach 95 %, and are not periodic in the sense of spectra.
    """
    n = min(values.size, _LONGEST)
    if n < 64:
        return 0
    x = values[:n] - values[:n].mean()
    power = float(np.mean(x**2))
    if power <= 0:
        return 0
    spectrum = np.fft.rfft(x, 1 << (2 * n - 1).bit_length())
    half = n // 4 + 1
    lags = np.fft.irfft(spectrum * spectrum.conj())[:half] / (n - np.arange(half)) / power
    below = np.flatnonzero(lags < 0.2)
    if below.size == 0 or int(below[0]) >= half - 1:
        return 0
    start = int(below[0])
    peaks = [start + int(i) for i in np.flatnonzero(lags[start:] > lags[start:].max() - 0.02)]
    for period in peaks[:20]:
        count = n // period
        blocks = x[n - count * period :].reshape(count, period)[count // 4 :]
        if np.mean((blocks - blocks.mean(axis=0)) ** 2) < 0.02 * power:
            return period
    return 0
