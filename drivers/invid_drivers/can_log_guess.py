"""What the frames of a CAN log may carry: identifiers by CiA 301's predefined connection set, fields by how
smoothly they move. A first guess for a person to name and correct."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from invid.numerics.arrays import Float64
from invid.recording.import_map import Pdo, Signal

SMOOTH = 0.25
"""Mean square of a step over the variance below which a field is a signal, not bytes of something else:
2 for noise, ω²h² for a sinusoid; a quarter is a sinusoid of twelve samples. A guess to be looked at."""
ENOUGH = 0.5
"""Frames of an identifier for each SYNC from which on it counts as cyclic."""


@dataclass(frozen=True)
class Guess:
    """PDOs with a column for every field, and why."""

    pdos: tuple[Pdo, ...]
    reasons: tuple[str, ...]
    sync_id: int | None
    """None where the log has no SYNC."""


def guess_pdos(frames: Mapping[int, Sequence[bytes]], sync_id: int | None) -> Guess:
    """PDOs among ``frames`` (payloads by identifier) that come about as often as SYNC, or the commonest."""
    if sync_id not in frames:
        sync_id = None
    counted = [sync_id] if sync_id is not None else [i for i in frames if _pdo_of(i) is not None]
    cycles = max((len(frames[i]) for i in counted), default=1)
    pdos, reasons = [], [] if sync_id is not None else ["no SYNC: a row at each frame of the first PDO"]
    for identifier in sorted(frames):
        payloads = frames[identifier]
        length = min((len(p) for p in payloads), default=0)
        place = _pdo_of(identifier)
        if place is None or identifier == sync_id or length == 0 or len(payloads) < ENOUGH * cycles:
            continue
        data = np.array([list(p[:length]) for p in payloads], dtype=np.uint8)
        signals, said = _fields(data, identifier)
        number, node, to_drive = place
        pdos.append(Pdo(id=identifier, direction="to_drive" if to_drive else "from_drive", signals=signals))
        kind = "RPDO" if to_drive else "TPDO"
        reasons.append(f"0x{identifier:X} is {kind} {number} of node {node} by its number: {', '.join(said)}")
    return Guess(tuple(pdos), tuple(reasons), sync_id)


def _pdo_of(identifier: int) -> tuple[int, int, bool] | None:
    """Number, node and direction of a PDO in the predefined connection set; None for anything else."""
    function, node = identifier >> 7, identifier & 0x7F
    if not (node and 3 <= function <= 10):
        return None
    return (function - 1) // 2, node, function % 2 == 0


def _fields(data: np.ndarray, identifier: int) -> tuple[list[Signal], list[str]]:
    signals, said = [], []
    at, length = 0, data.shape[1]
    while at < length:
        size = next(n for n in (4, 2, 1) if at + n <= length and (n < 4 or _is_long(data[:, at : at + 4])))
        name = f"x{identifier:X}_byte{at}"
        values = data[:, at : at + size].copy().view(f"<i{size}")[:, 0].astype(float)
        signals.append(Signal.model_validate({"name": name, "type": f"int{8 * size}"}))
        if np.ptp(values) == 0:
            moves = "constant"
        else:
            moves = f"{values.min():.0f} … {values.max():.0f}"
            moves += ", smooth" if roughness(values) < SMOOTH else ", rough"
        said.append(f"{name} int{8 * size} {moves}")
        at += size
    return signals, said


def _is_long(four: np.ndarray) -> bool:
    """Whether four bytes are one number: it moves smoothly, and more so than its lower half alone or with an
    upper half that is no more than the sign."""
    whole = four.copy().view("<i4")[:, 0].astype(float)
    if np.ptp(whole) == 0:
        return False
    low = four[:, :2].copy().view("<i2")[:, 0].astype(float)
    high = four[:, 2:].copy().view("<i2")[:, 0]
    sign = bool(np.all(high == np.where(low < 0, -1, 0)))
    # Where the upper half moves of itself, the lower one has passed through all its values.
    carried = np.ptp(low) > 2**15 and roughness(whole) < roughness(low)
    return roughness(whole) < SMOOTH and (sign or carried)


def roughness(values: Float64) -> float:
    """Mean square of a step over the variance."""
    spread = float(np.var(values))
    return float(np.mean(np.diff(values) ** 2)) / spread if spread > 0 and values.size > 2 else 0.0


__all__ = ["SMOOTH", "Guess", "guess_pdos", "roughness"]
