"""The cell's configuration: bus, axes, holds, limits, experiments, and (optionally) a simulation.

Units stand in the keys. A rotary axis uses the keys ending in _Nm and _rad, a linear axis those in
_N and _m; both fill the same field. ``simulation`` is validated by the simulated drives, which own it.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from invid.config.experiments import ExperimentSpec, Strict, with_units
from invid.config.frames import LONGEST_HEARTBEAT_S, shortest_heartbeat


class BusConfig(Strict):
    """Any python-can interface. ``invid-virtual`` steps simulated drives in virtual time."""

    interface: str
    channel: str
    bitrate_bit_per_s: int = Field(default=1_000_000, gt=0)
    cycle_s: float = Field(default=0.001, gt=0, le=0.1)
    """SYNC period."""
    max_load: float = Field(default=0.8, gt=0, le=1.0)
    round_trip_s: float | None = Field(default=None, gt=0, le=0.1)
    """A frame out and one back through the adapter, where it is known better than ``check`` can probe it: the
    drives' own time for SDO is in the probe."""
    options: dict[str, Any] = Field(default_factory=dict)
    """Passed to python-can as they are."""


class HoldConfig(Strict):
    """How an axis is held while others are shaken; see docs on the stability of holds."""

    mode: Literal["drive", "master_pd", "master_p"] = "drive"
    gain: float = with_units("gain", "gain_Nm_per_rad", "gain_N_per_m", default=0.0, ge=0)
    damping: float | None = with_units(
        "damping", "damping_Nms_per_rad", "damping_Ns_per_m", default=None, ge=0
    )


class LimitsConfig(Strict):
    """Checked before and during motion, on swept and on held axes."""

    torque: float = with_units("torque", "torque_Nm", "force_N", gt=0)
    position: float = with_units("position", "position_window_rad", "position_window_m", gt=0)
    """Largest distance from where the axis stood at the start."""
    velocity: float = with_units("velocity", "velocity_rad_per_s", "velocity_m_per_s", gt=0)
    stopping_room: float | None = with_units(
        "stopping_room", "stopping_room_rad", "stopping_room_m", default=None, gt=0
    )
    """How far beyond its window an axis may come to rest after a stop, or after this computer has died.
    Default: as far as the window. Where it could go further, less speed is permitted."""


def _angle(name: str) -> Any:
    """A positive angle, or a length on a linear axis."""
    return with_units(name, f"{name}_rad", f"{name}_m", default=None, gt=0)


class AcceptableConfig(Strict):
    """How much of a finding this axis may show: the diagnosis says ``as_expected`` up to it, ``act`` beyond.

    Each is optional; where one is missing, published figures for such drives are the measure
    (docs/reference/causes.md). Angles and lengths are those of the recording's positions.
    """

    friction_fraction_of_rated: float | None = Field(default=None, gt=0)
    torque_ripple_fraction_of_rated: float | None = Field(default=None, gt=0)
    torque_offset_fraction_of_rated: float | None = Field(default=None, gt=0)
    gravity_fraction_of_rated: float | None = Field(default=None, gt=0)
    torque_gain_error_fraction: float | None = Field(default=None, gt=0)
    torque_delay: float | None = with_units("torque_delay", "torque_delay_s", default=None, gt=0)
    backlash: float | None = _angle("backlash")
    """Full free play."""
    lost_motion: float | None = _angle("lost_motion")
    """Between loading from one side and from the other (hysteresis)."""
    transmission_error: float | None = _angle("transmission_error")
    """Peak to peak."""
    encoder_error: float | None = _angle("encoder_error")
    """Amplitude."""
    stiffening_fraction: float | None = Field(default=None, gt=0)
    """Change of the stiffness at rated torque."""
    stiffness_drift_fraction: float | None = Field(default=None, gt=0)
    """Change during one measurement."""
    load_change_fraction: float | None = Field(default=None, gt=0)
    """Of the final mass, during one measurement."""
    resonance_change_fraction: float | None = Field(default=None, gt=0)
    """Of the lowest resonance, by anything that is not in the chain of masses and springs."""
    dropped_samples_fraction: float | None = Field(default=None, gt=0)


OVERRIDABLE = {
    "0x1000": "",
    "0x6072": "",
    "0x6075": "",
    "0x6076": "rated_torque",
    "0x608F": "position_per_count",
    "0x6091": "position_per_count",
    "0x6092": "position_per_count",
    "0x6093": "position_per_count",
    "0x6096": "",
    "0x607E": "",
}
"""Objects that an axis may override, and the field that then counts."""


def _known(value: Any) -> Any:
    """Return ``None`` for "unknown", which a config says where nobody has looked yet."""
    return None if value == "unknown" else value


class AxisConfig(Strict):
    """One drive."""

    name: str = Field(min_length=1)
    node_id: int = Field(ge=1, le=126)
    axis_of_node: int = Field(default=1, ge=1, le=4)
    """Which of the node's axes: the second one has its objects at 0x6800, 0x800 beyond the first."""
    eds: str | None = None
    """The drive's EDS or DCF file, beside the config: what it lacks is known before the drive is asked."""
    vendor: str = "generic"
    """Row of the table of vendors' differences."""
    rated_torque: float | None = with_units(
        "rated_torque", "rated_torque_Nm", "rated_force_N", default=None, gt=0
    )
    """From the plate; must agree with the drive's 0x6076, and is used where that is missing or zero."""
    position_per_count: float | None = with_units(
        "position_per_count", "position_rad_per_count", "position_m_per_count", default=None, gt=0
    )
    """Motor position per count of 0x6064; must agree with 0x608F, 0x6091 and 0x6092, its default."""
    direction: Literal[1, -1] = 1
    inertia: float | None = with_units("inertia", "inertia_kgm2", "mass_kg", default=None, gt=0)
    """Rigid inertia seen by the motor, roughly: predicts travel before anything moves. The trial of the signs
    compares it with what it measures, which is then used."""
    gravity_loaded: Annotated[bool | None, BeforeValidator(_known)] = None
    """Zero torque would let it fall: it is never left without torque or brake. ``None`` ("unknown", or not
    stated): treated so until the torque that holds it at rest tells."""
    brake: Literal["none", "drive"] = "none"
    """``drive``: the drive closes a brake by itself when it is disabled. How late it closes is measured."""
    allow_missing_heartbeat: bool = False
    """Opt-in needed where the drive cannot watch the master's heartbeat (0x1016)."""
    overrides: dict[str, str] = Field(default_factory=dict)
    """Objects of the drive that this config contradicts on purpose, each with the reason: "0x6076", "0x608F",
    "0x6091", "0x6092" and "0x6093" give way to the config's rated torque and position per count, "0x6075" to
    the vendor table's nominal current; "0x6072" may be raised where it is 0 as shipped; "0x6096" does not
    convert 0x607F, "0x607E" turns torque as it turns position; "0x1000" may say another kind of drive."""
    quick_stop_deceleration: float | None = with_units(
        "quick_stop_deceleration",
        "quick_stop_deceleration_rad_per_s2",
        "quick_stop_deceleration_m_per_s2",
        default=None,
        gt=0,
    )
    """Of the drive's quick stop, by its manual or its tool: used where 0x6085 is missing, and where it is not
    known in what unit it counts."""
    in_closed_loop: bool = False
    """Shaken by its torque offset (0x60B2) while the drive's own loops hold it, as `invid verify` does."""
    masses: int | None = Field(default=None, ge=1)
    hold: HoldConfig = HoldConfig()
    limits: LimitsConfig
    acceptable: AcceptableConfig = AcceptableConfig()
    """What of a finding is nothing to worry about on this axis."""

    @property
    def place(self) -> str:
        """Node, and which of its axes where that is not the first."""
        further = f" (axis_of_node {self.axis_of_node})" * (self.axis_of_node > 1)
        return f"{self.node_id}{further}"

    @model_validator(mode="after")
    def _overrides(self) -> AxisConfig:
        for name, reason in self.overrides.items():
            if name not in OVERRIDABLE:
                raise ValueError(f"overrides names {name!r}; it may name {', '.join(OVERRIDABLE)}")
            if not reason.strip():
                raise ValueError(
                    f"overrides names {name} without a reason; say why the drive is not believed"
                )
            field = OVERRIDABLE[name]
            if field and getattr(self, field) is None:
                raise ValueError(
                    f"overrides names {name}, but there is no {field} to use in its place; give it or leave "
                    f"{name} out"
                )
        return self


class SafetyConfig(Strict):
    """What the master watches beside the limits of each axis."""

    heartbeat_s: float = Field(default=LONGEST_HEARTBEAT_S, gt=0, le=5)
    """Period of the master's heartbeat; a drive that misses three of them stops by itself. Until then it goes
    on with its last torque, so that it is part of the way to rest of a cell whose master has died. Default:
    the shortest whose watch outlasts what ``overrun_cycles`` and ``missed_tpdos`` forgive and that the bus
    carries, at most this."""
    missed_tpdos: int = Field(default=5, ge=1, le=1000)
    """Cycles in a row without an axis's TPDO before everything stops."""
    overrun_cycles: int = Field(default=20, ge=1)
    """SYNC slots skipped in a row before everything stops."""
    test_amplitude: float = Field(default=0.1, gt=0, le=0.1)
    """Share of the full amplitude at which torque and encoder signs are tried first."""


class InterestConfig(Strict):
    """Sizes of causes that a plan is to show where they are there (``invid.planning.detection``)."""

    dry_friction: float = Field(default=0.005, gt=0)
    """Of a motor, as a share of its rated torque."""
    viscous_friction: float = Field(default=0.005, gt=0)
    """Of a motor at the axis' velocity limit, as a share of its rated torque."""
    free_play: float = with_units("free_play", "free_play_rad", "free_play_m", default=5e-4, gt=0)
    """Of a spring: 1.7 minutes of arc, what is sold as low backlash."""
    mode: float = Field(default=0.05, gt=0)
    """Mass that swings on a load, as a share of the axis' inertia."""


class CellConfig(Strict):
    """A robot cell."""

    format: Literal["invid-config"]
    format_version: Literal[1] = 1
    robot: str
    motion: Literal["rotary", "linear"] = "rotary"
    bus: BusConfig
    axes: list[AxisConfig] = Field(min_length=1)
    safety: SafetyConfig = SafetyConfig()
    sizes_of_interest: InterestConfig = InterestConfig()
    experiments: list[ExperimentSpec] = Field(default_factory=list)
    """Empty: the default plan of ``invid.planning``."""
    simulation: dict[str, Any] | None = None
    """Validated by ``invid_drivers.simulated``; a cell with this section has no hardware behind it."""

    @model_validator(mode="after")
    def _consistent(self) -> CellConfig:
        for what, values in (
            ("axis name", [a.name for a in self.axes]),
            ("node_id", [a.place for a in self.axes]),
        ):
            twice = sorted({v for v in values if values.count(v) > 1})
            if twice:
                dual = (
                    ". Further axes of one node (objects from 0x6800 on) are not driven: log its bus, and "
                    "'invid import' reads them (source.eds)"
                )
                raise ValueError(
                    f"{what} {', '.join(twice)} is used by more than one axis; each needs its own"
                    + dual * (what == "node_id")
                )
        if "heartbeat_s" not in self.safety.model_fields_set:
            beat = {"heartbeat_s": self.shortest_heartbeat_s}
            # the model is frozen for its users; this is still its making
            self.__dict__["safety"] = self.safety.model_copy(update=beat)
        names = {a.name for a in self.axes}
        for i, experiment in enumerate(self.experiments):
            unknown = [n for n in experiment.axes or () if n not in names]
            if unknown:
                raise ValueError(f"experiments[{i}].axes names {unknown[0]!r}; the axes are {sorted(names)}")
        return self

    @property
    def shortest_heartbeat_s(self) -> float:
        """The shortest period of the master's heartbeat that cycle, bus and what is forgiven allow [s]."""
        bus = self.bus
        return shortest_heartbeat(
            bus.cycle_s,
            max(self.safety.overrun_cycles, self.safety.missed_tpdos),
            drives=len(self.axes),
            bitrate=bus.bitrate_bit_per_s,
            max_load=bus.max_load,
        )

    @property
    def linear(self) -> bool:
        """True for axes in metres and newtons."""
        return self.motion == "linear"

    @property
    def simulated(self) -> bool:
        """True where no hardware stands behind the config."""
        return self.simulation is not None
