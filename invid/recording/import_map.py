"""The map file of ``invid import``: which columns of a foreign log are what, in which units.

YAML, validated, unknown keys refused. The reference with examples is ``docs/reference/recording.md``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from invid.config.load import explain_errors, load_yaml
from invid.errors import ConfigError, InputError
from invid.numerics.arrays import Float64
from invid.recording.clock import StampsRead
from invid.recording.model import Kind, Role
from invid.recording.text_encoding import decode_text
from invid.recording.units import Quantity, factor

FORMAT = "invid-import-map"
MAX_BYTES = 1_000_000


class Strict(BaseModel):
    """Unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, frozen=True)


class Channel(Strict):
    """One column with its unit: SI value = sign · scale · unit factor · (column − offset)."""

    column: str | int
    """Name as in the file, or its index from 0."""
    unit: str
    sign: Literal[1, -1] = 1
    scale: float = Field(default=1.0, gt=0)
    offset: float = 0.0
    """In the column's unit, subtracted first."""
    remove_mean: bool = False
    per_count: float | None = Field(default=None, gt=0)
    """SI value of one count, where the unit is counts."""
    read_as: Literal["int8", "int16", "int24", "int32", "sign8", "sign16", "sign24", "sign32"] | None = None
    """Whole numbers whose sign the file lost: two's complement, or a sign bit beside a magnitude."""


class TorqueChannel(Channel):
    """The torque: where the number comes from decides what a diagnosis may blame on the actuator."""

    meaning: Literal["applied", "measured", "demanded"] = "measured"
    torque_constant: float | None = Field(default=None, gt=0)
    """N·m (or N) per A or V, where the unit is A or V; 1 where unknown: all comes out per that constant."""


QUANTITIES: dict[str, Quantity] = {
    "position": "position", "velocity": "velocity", "torque": "torque", "torque_demand": "torque",
    "position_reference": "position", "torque_feedforward": "torque",
}  # fmt: skip
"""Of each channel of an axis."""


class Controller(Strict):
    """Known control law: torque = stiffness·(reference − position) − damping·velocity + feedforward."""

    stiffness: float = Field(ge=0)
    """N·m/rad or N/m."""
    damping: float = Field(ge=0)
    """N·m·s/rad or N·s/m."""
    limit: float | None = Field(default=None, gt=0)
    """Largest torque the law may ask for."""


class AxisMap(Strict):
    """One axis: a torque, or the law that made it; and a position or a velocity."""

    name: str = Field(min_length=1)
    position: Channel | None = None
    velocity: Channel | None = None
    """Only where there is no position; the position is then the velocity's integral, and marked so."""
    torque: TorqueChannel | None = None
    """Only where there is a ``controller`` may it be missing: its torque is then read as demanded."""
    torque_demand: TorqueChannel | None = None
    position_reference: Channel | None = None
    """What the controller was told; kept beside the contract's datasets, for simulating closed-loop data."""
    torque_feedforward: TorqueChannel | None = None
    controller: Controller | None = None
    status: str | int | None = None
    rated_torque: float | None = Field(default=None, gt=0)
    encoder_resolution: float | None = Field(default=None, gt=0)
    masses: int | None = Field(default=None, ge=1)

    def channels(self) -> dict[str, Channel]:
        """The channels that are given, by their field."""
        return {field: channel for field in QUANTITIES if (channel := getattr(self, field)) is not None}

    @model_validator(mode="after")
    def _one_motion(self) -> AxisMap:
        if (self.position is None) == (self.velocity is None):
            raise ValueError(f"axis {self.name}: give either 'position' or 'velocity', not both or none")
        if self.torque is None and (
            self.controller is None or self.position_reference is None or self.position is None
        ):
            raise ValueError(
                f"axis {self.name}: give 'torque', or where the file has none the law that made it: "
                "'controller' "
                "with 'position_reference' and 'position'"
            )
        return self


class TimeMap(Strict):
    """The time column, or a constant rate where the file has none."""

    column: str | int | None = None
    unit: str = "s"
    sample_rate_hz: float | None = Field(default=None, gt=0)
    wraps_at: float | None = Field(default=None, gt=0)
    """Where the counter starts over, in the column's unit; usual ones (2^32 µs, a minute, …) are known."""
    differences: bool = False
    """Each stamp is the time since the one before."""

    def reading(self, where: str, sums: Float64 | None = None) -> StampsRead:
        """How the column is read; ``sums`` (n,): stamps added up over everything that the file stamps.

        Raises
        ------
        InputError
            A unit that is none of time.
        """
        unit = factor("time", self.unit, {}, where)
        wraps = None if self.wraps_at is None else self.wraps_at * unit
        return StampsRead(
            str(self.column), unit, wraps, self.differences, None if sums is None else sums * unit
        )

    @model_validator(mode="after")
    def _one(self) -> TimeMap:
        if (self.column is None) == (self.sample_rate_hz is None):
            raise ValueError(
                "give either 'column' (with 'unit') or 'sample_rate_hz' (samples a second, where the "
                "file has no time column)"
            )
        return self


class Signal(Strict):
    """One mapped object of a PDO; becomes a column of this name."""

    name: str
    type: str = Field(pattern=r"^(u?int([1-9]|[1-5]\d|6[0-4])|float(16|32|64)|skip)$")
    """int or uint with any number of bits (int8, uint12, …, uint64), float32, float64, or skip."""
    bits: int | None = Field(default=None, gt=0, le=64)
    """Length of a ``skip``."""
    byte_order: Literal["little", "big"] | None = None
    """Little-endian as CANopen has them where nothing is said; a number that is no whole bytes long follows
    the other signals of its frame."""

    @property
    def size(self) -> int:
        """Return its length in bits."""
        return self.bits or 8 if self.type == "skip" else int(self.type.lstrip("uintfloa"))


class Pdo(Strict):
    """One PDO: its CAN identifier and the objects in it, first byte first (little-endian)."""

    id: int = Field(ge=0, le=0x1FFFFFFF)
    direction: Literal["from_drive", "to_drive"] = "from_drive"
    """``to_drive``: the value acts from the next SYNC on, and is listed with that sample."""
    signals: list[Signal] = []
    channel: str | int | None = None
    """The log's name of the bus it is on, where that is not the source's ``channel``."""


class Source(Strict):
    """How the file is to be read; whatever is left out is found out from the file."""

    kind: str | None = None
    """Its format by name (csv, mat, …, or what an installed package reads), whatever its bytes say."""
    delimiter: str | None = Field(default=None, min_length=1, max_length=1)
    decimal: Literal[".", ","] | None = None
    thousands: Literal[".", ",", " ", "'"] | None = None
    """Sign between thousands, where numbers are written with one."""
    header_lines: int | None = Field(default=None, ge=0)
    """Lines before the first row of data, the line of names among them."""
    names: list[str] | None = None
    """Column names, where the file's are missing or unfit."""
    encoding: str | None = None
    sync_id: int | None = 0x80
    """CAN identifier of SYNC; null: a sample is taken at each frame of the first PDO."""
    channel: str | int | None = None
    """The log's name of the bus (can0, 1) whose frames are read, where several carry the same identifiers."""
    echo: Literal["received", "sent", "first"] | None = None
    """Which to read of frames that were logged twice: by their direction, or the first of each pair."""
    byte_order: Literal["little", "big"] | None = None
    """Of all signals that do not say their own."""
    pdos: list[Pdo] = []
    dbc: str | None = None
    """Database of frames beside the map (DBC, KCD, SYM, ARXML): columns ``Message.Signal`` in its units."""
    eds: str | None = None
    """EDS file beside the map: the PDOs are read from it, for ``nodes``."""
    nodes: list[int] = []


class JoinedSource(Source):
    """One of several files that are one record: its columns are ``name:column``, its clock
    ``name:time`` [s]."""

    name: str = Field(pattern=r"^[\w.-]+$")
    file: str
    """Pattern of its file's name; with several matches the first of each source are a record, the second,
    …"""
    time: TimeMap
    shift_s: float = 0.0
    """Added to its clock [s]."""


class ExperimentMap(Strict):
    """Which rows are one experiment, and what it is for."""

    file: str = "*"
    """Pattern of file names (or of paths below a folder given as SOURCE)."""
    rows: tuple[int | None, int | None] = (None, None)
    """First row and row after the last, from 0, among the file's rows of data."""
    role: Role = Role.IDENTIFY
    kind: Kind = Kind.OTHER
    excited_axis: int = -1
    period_samples: int = Field(default=0, ge=0)
    every: int = Field(default=1, ge=1)
    """Rows that each value stands for: the one at which it is new is read, the others are left out. Other
    numbers of rows here count rows of the file."""
    drop_periods: int = Field(default=0, ge=0)
    """Periods left out at the start, before steady state."""
    frequencies_hz: list[float] = []
    hold_gain: list[float] | None = None
    columns: dict[str | int, str | int] = {}
    """Columns that this experiment has under other names: the map's column → the one to read instead."""
    attributes: dict[str, str | int | float | bool] = {}
    """Kept with the experiment; for the reader."""

    @model_validator(mode="after")
    def _periods(self) -> ExperimentMap:
        if self.drop_periods and not self.period_samples:
            raise ValueError("'drop_periods' needs 'period_samples': how long one period is")
        if self.period_samples % self.every:
            raise ValueError(
                f"'period_samples' ({self.period_samples}) must be a multiple of 'every' ({self.every})"
            )
        return self


class ImportMap(Strict):
    """The whole map."""

    format: Literal["invid-import-map"]
    format_version: Literal[1] = 1
    robot: str = "unnamed"
    files: list[str] = []
    """Files, folders or patterns, from the map's folder, where the command names none."""
    skip: dict[str, str] = {}
    """Pattern of files that are left out → the reason."""
    description: str = ""
    motion: Literal["rotary", "linear"] | None = None
    """Needed only where the units do not tell (counts, raw)."""
    source: Source = Source()
    sources: list[JoinedSource] = Field(default=[], max_length=16)
    """Files that are joined by time, each with a clock of its own."""
    time: TimeMap
    axes: list[AxisMap] = Field(min_length=1, max_length=64)
    experiments: list[ExperimentMap] = Field(default=[ExperimentMap()], min_length=1, max_length=1000)
    attributes: dict[str, str | int | float | bool] = {}

    @field_validator("skip")
    @classmethod
    def _reasons(cls, skip: dict[str, str]) -> dict[str, str]:
        for pattern, reason in skip.items():
            if not reason.strip():
                raise ValueError(
                    f"say why {pattern!r} is left out: a reason that somebody can read next year"
                )
        return skip

    @model_validator(mode="after")
    def _renamed(self) -> ImportMap:
        known = {str(c) for c in self.columns()}
        for number, entry in enumerate(self.experiments):
            for old in entry.columns:
                if str(old) not in known:
                    raise ValueError(
                        f"experiments.{number}.columns: {old!r} is no column of the map's time and axes; "
                        f"those are {', '.join(sorted(known))}"
                    )
        return self

    def columns(self) -> list[str | int]:
        """Every column that the time and the axes name, in order."""
        names: list[str | int] = [] if self.time.column is None else [self.time.column]
        for axis in self.axes:
            names += [channel.column for channel in axis.channels().values()]
            names += [] if axis.status is None else [axis.status]
        return names


def load_map(path: Path) -> ImportMap:
    """The map in a YAML file; InputError says where and what is wrong."""
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    if len(raw) > MAX_BYTES:
        raise InputError(f"{path}: {len(raw)} bytes; a map is a short YAML file")
    return parse_map(raw, source=str(path))


def parse_map(text: str | bytes, *, source: str = "map") -> ImportMap:
    """The map in a YAML text."""
    if isinstance(text, bytes):
        text, _ = decode_text(text, None, source)
    try:
        document, lines = load_yaml(text, source)
    except ConfigError as error:
        raise InputError(str(error)) from None
    if not isinstance(document, dict):
        raise InputError(f"{source}: holds no mapping; a map starts with 'format: {FORMAT}'")
    try:
        return ImportMap.model_validate(document)
    except ValidationError as error:
        raise InputError(explain_errors(error, source, lines, "map", ImportMap)) from None
