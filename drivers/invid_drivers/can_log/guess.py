"""What the frames of a CAN log may carry: known layouts, CiA 301's predefined connection set, and how
smoothly fields move. A first guess for a person to name and correct."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from invid.numerics.arrays import Float64
from invid.recording.import_map import Pdo, Signal
from invid.recording.readers.text_dialect import roughness
from invid_drivers.can_log.fields import Field, fields_of_pdo
from invid_drivers.can_log.frames import Frames

SMOOTH = 0.25
"""Mean square of a step over the variance below which a field is a signal, not bytes of something else:
2 for noise, ω²h² for a sinusoid; a quarter is a sinusoid of twelve samples. A guess to be looked at."""
ENOUGH = 0.5
"""Frames of an identifier for each SYNC from which on it counts as cyclic."""
LOOKED_AT = 20_000
"""Frames of a log by which it is told what they carry."""


@dataclass(frozen=True)
class Guess:
    """PDOs with a column for every field, and why."""

    pdos: tuple[Pdo, ...]
    reasons: tuple[str, ...]
    sync_id: int | None
    """None where the log has no SYNC."""
    units: dict[str, str] = field(default_factory=dict)
    """Of each column, where a known layout says what they mean."""
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Layout:
    """Frames of a known protocol: signals by type and unit; the quantity is the signal's name, empty to
    skip."""

    protocol: str
    signals: tuple[tuple[str, str, str], ...]
    command: int | None = None
    """Low five bits of the identifier, where the protocol has commands there."""
    byte_order: str = "little"
    remark: str = ""

    def pdo(self, identifier: int) -> Pdo:
        """The PDO of an identifier with this layout."""
        node = identifier >> 5 if self.command is not None else identifier
        signals = [
            {"name": f"n{node}_{name}", "type": kind, "byte_order": self.byte_order}
            if name
            else {"name": "", "type": "skip", "bits": int(kind)}
            for name, kind, _ in self.signals
        ]
        return Pdo.model_validate({"id": identifier, "signals": signals})


LAYOUTS = (
    # docs.odriverobotics.com, CAN protocol: Get_Encoder_Estimates, Get_Iq, Get_Torques; identifier = node ·
    # 32 + command.
    Layout("ODrive CANSimple", (("position", "float32", "rev"), ("velocity", "float32", "rev/s")), 0x09),
    Layout("ODrive CANSimple", (("torque_demand", "float32", "A"), ("torque", "float32", "A")), 0x14),
    Layout("ODrive CANSimple", (("torque_demand", "float32", "N·m"), ("torque", "float32", "N·m")), 0x1C),
    # Feedback of MIT mini cheetah drives (Damiao, CubeMars, AgileX): position over ± P_MAX, torque over ±
    # T_MAX.
    Layout(
        "MIT mini cheetah",
        (
            ("", "8", ""), ("position", "uint16", "counts"), ("velocity", "uint12", "counts"),
            ("torque", "uint12", "raw"),
        ),
        byte_order="big",
        remark="position runs over ± P_MAX rad in 65,536 steps (per_count 2·P_MAX/65535, offset 32767.5), "
        "torque over ± T_MAX N·m in 4,096 (scale 2·T_MAX/4095, offset 2047.5): see the motor's settings",
    ),
)  # fmt: skip


def guess_pdos(frames: Frames, sync_id: int | None) -> Guess:
    """PDOs among ``frames`` that come about as often as SYNC, or the commonest, with known layouts first."""
    counts = frames.counts()
    if sync_id not in counts:
        sync_id = None
    if sync_id is None and (known := _known(frames, counts)) is not None:
        return known
    counted = [sync_id] if sync_id is not None else [i for i in counts if _pdo_of(i) is not None]
    cycles = max((counts[i] for i in counted), default=1)
    pdos, reasons = [], [] if sync_id is not None else ["no SYNC: a row at each frame of the first PDO"]
    for identifier in sorted(counts):
        own = frames.where(frames["identifier"] == identifier)
        place, length = _pdo_of(identifier), int(own["length"].min(initial=64))
        if place is None or identifier == sync_id or length == 0 or counts[identifier] < ENOUGH * cycles:
            continue
        signals, said = _fields(own, length, identifier)
        number, node, to_drive = place
        pdos.append(Pdo(id=identifier, direction="to_drive" if to_drive else "from_drive", signals=signals))
        kind = "RPDO" if to_drive else "TPDO"
        reasons.append(f"0x{identifier:X} is {kind} {number} of node {node} by its number: {', '.join(said)}")
    return Guess(tuple(pdos), tuple(reasons), sync_id)


def _known(frames: Frames, counts: dict[int, int]) -> Guess | None:
    """The PDOs of a log whose frames move smoothly in a known layout."""
    pdos, reasons, remarks = list[Pdo](), list[str](), list[str]()
    units: dict[str, str] = {}
    for identifier in sorted(counts):
        own = frames.where(frames["identifier"] == identifier)
        for layout in LAYOUTS:
            if layout.command is not None and identifier & 0x1F != layout.command:
                continue
            pdo = layout.pdo(identifier)
            if not _fits(pdo, own):
                continue
            pdos.append(pdo)
            named = {s.name: u for s, (_, _, u) in zip(pdo.signals, layout.signals, strict=True) if s.name}
            units |= named
            reasons.append(f"0x{identifier:X} has the layout of {layout.protocol}: {', '.join(named)}")
            remarks += [layout.remark] if layout.remark else []
            break
    # The drive's answers, the most first: the first PDO is the clock.
    pdos.sort(key=lambda p: -counts[p.id])
    if not any("position" in n for n in units) or not any("torque" in n for n in units):
        return None
    reasons.append("no SYNC ('sync_id: null'): a row at each frame of the first PDO")
    return Guess(tuple(pdos), tuple(reasons), None, units, tuple(dict.fromkeys(remarks)))


def _fits(pdo: Pdo, frames: Frames) -> bool:
    """Whether all fields of a layout are there, and move smoothly where they move; a position moves."""
    if frames["time"].size < 100 or not (frames["length"] >= -(-sum(s.size for s in pdo.signals) // 8)).all():
        return False
    fields = fields_of_pdo(pdo, None)
    values = [f.values(frames) for f in fields]
    if not all(np.isfinite(v).all() and np.abs(v).max() < 1e9 for v in values):
        return False
    moving = [f.name.rsplit("_", 1)[-1] for f, v in zip(fields, values, strict=True) if np.ptp(v) > 0]
    must_move = {"position", "torque"} & {f.name.rsplit("_", 1)[-1] for f in fields}
    return must_move <= {*moving, "demand"} and all(roughness(v) < SMOOTH for v in values if np.ptp(v) > 0)


def _pdo_of(identifier: int) -> tuple[int, int, bool] | None:
    """Number, node and direction of a PDO in the predefined connection set; None for anything else."""
    function, node = identifier >> 7, identifier & 0x7F
    if not (node and 3 <= function <= 10):
        return None
    return (function - 1) // 2, node, function % 2 == 0


def _fields(frames: Frames, length: int, identifier: int) -> tuple[list[Signal], list[str]]:
    signals, said, at = list[Signal](), list[str](), 0
    while at < length:
        size = next(n for n in (4, 2, 1) if at + n <= length and (n < 4 or _is_long(frames, at)))
        name = f"x{identifier:X}_byte{at}"
        values = _number(frames, at, size)
        signals.append(Signal.model_validate({"name": name, "type": f"int{8 * size}"}))
        moves = "constant"
        if np.ptp(values) > 0:
            how = "smooth" if roughness(values) < SMOOTH else "rough"
            moves = f"{values.min():.0f} … {values.max():.0f}, {how}"
        said.append(f"{name} int{8 * size} {moves}")
        at += size
    return signals, said


def _number(frames: Frames, at: int, size: int) -> Float64:
    """(n,) the little-endian integer of some bytes."""
    return Field("", 8 * at, 8 * size, kind="int").values(frames)


def _is_long(frames: Frames, at: int) -> bool:
    """Whether four bytes are one number: it moves smoothly, and more so than its lower half alone or with an
    upper half that is no more than the sign."""
    whole, low, high = _number(frames, at, 4), _number(frames, at, 2), _number(frames, at + 2, 2)
    if np.ptp(whole) == 0:
        return False
    sign = bool(np.all(high == np.where(low < 0, -1, 0)))
    # Where the upper half moves of itself, the lower one has passed through all its values.
    carried = bool(np.ptp(low) > 2**15) and roughness(whole) < roughness(low)
    return roughness(whole) < SMOOTH and (sign or carried)
