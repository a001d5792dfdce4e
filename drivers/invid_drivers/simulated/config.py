"""The ``simulation`` section of a cell's configuration: plant, drives, effects, faults.

Units stand in the keys. For a linear axis read N for Nm and m for rad: both spellings are accepted.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import Any, Literal, get_args

import numpy as np
from pydantic import AliasChoices, Field, ValidationError, field_validator, model_validator

from invid.config.experiments import Strict
from invid.config.schema import CellConfig
from invid.errors import ConfigError, ModelError
from invid.model.chains import CoupledChains, case_study
from invid.model.document import describe_validation_error, model_from_json
from invid.numerics.arrays import frozen_float
from invid.planning.expected_covariance import Noise, assumed_noise
from invid.tuning.servo_loop import Notch
from invid_drivers.simulated import kernel
from invid_drivers.simulated.vendors import PROFILES


class BranchConfig(Strict):
    """One chain, the motor first."""

    axis: str
    masses: list[float] = Field(
        min_length=1, validation_alias=AliasChoices("masses", "masses_kgm2", "masses_kg")
    )
    springs: list[float] = Field(
        default=[], validation_alias=AliasChoices("springs", "springs_Nm_per_rad", "springs_N_per_m")
    )
    dampers: list[float] = Field(
        default=[], validation_alias=AliasChoices("dampers", "dampers_Nms_per_rad", "dampers_Ns_per_m")
    )


class CouplingConfig(Strict):
    """Inertia shared by the final masses of two branches."""

    between: tuple[str, str]
    value: float = Field(validation_alias=AliasChoices("value", "value_kgm2", "value_kg"))


class PlantConfig(Strict):
    """The mechanics: either the paper's case study or branches of one's own."""

    case_study: bool = False
    damping_ratio: float = Field(default=0.0, ge=0, lt=1)
    branches: list[BranchConfig] = Field(default_factory=list)
    couplings: list[CouplingConfig] = Field(default_factory=list)
    substep_s: float = Field(default=0.00025, gt=0, le=0.005)
    """Longest sub-step; the drives' inner position loops run once in each."""

    @model_validator(mode="after")
    def _one_plant(self) -> PlantConfig:
        if self.case_study == bool(self.branches):
            raise ValueError("give either case_study: true or branches, not both and not neither")
        return self


class FrictionConfig(Strict):
    """Motor friction; ``coulomb`` is the sliding level, ``static`` the break-away level."""

    coulomb: float = Field(
        default=0.0, ge=0, validation_alias=AliasChoices("coulomb", "coulomb_Nm", "coulomb_N")
    )
    viscous: float = Field(
        default=0.0,
        ge=0,
        validation_alias=AliasChoices("viscous", "viscous_Nms_per_rad", "viscous_Ns_per_m"),
    )
    static: float | None = Field(
        default=None, ge=0, validation_alias=AliasChoices("static", "static_Nm", "static_N")
    )
    stribeck_velocity: float = Field(
        default=0.01,
        gt=0,
        validation_alias=AliasChoices(
            "stribeck_velocity", "stribeck_velocity_rad_per_s", "stribeck_velocity_m_per_s"
        ),
    )


class LoopValues(Strict):
    """Values of the loops at the axis; units as ``invid tune`` writes them."""

    velocity_gain: float = Field(ge=0)
    """K_v [N·m·s/rad or N·s/m]"""
    position_gain: float = Field(ge=0)
    """K_p [1/s]"""
    integral_time: float = Field(default=math.inf, gt=0)
    """T_i [s]; infinite: nothing is integrated."""
    viscous: float = Field(default=0.0, ge=0)
    """Feedforward of speed [N·m·s/rad or N·s/m]"""
    inertia: float = Field(default=0.0, ge=0)
    """Feedforward of acceleration [kg·m² or kg]"""
    notches: list[Notch] = Field(default_factory=list, max_length=kernel.NOTCH_COUNT)


class LoadConfig(Strict):
    """A constant torque, as gravity exerts on an arm that hardly turns."""

    torque: float = Field(default=0.0, validation_alias=AliasChoices("torque", "torque_Nm", "force_N"))
    element: Literal["motor", "last mass"] = "last mass"
    propped: bool = True
    """Something carries it until the drive is enabled for the first time; else it falls from the start."""


class ObjectsConfig(Strict):
    """How one drive's object dictionary departs from the generic one."""

    profile: str = "generic"
    """Row of the table in ``vendors``."""
    lacks: list[str] = Field(default_factory=list)
    """Objects that do not exist, as "0x6072"."""
    values: dict[str, int | str] = Field(default_factory=dict)
    """Start values, as "0x605A": 6 or "0x608F:1": 4096."""
    read_only: list[str] = Field(default_factory=list)
    """Objects that cannot be written though they usually can."""
    eds: str | None = None
    """An EDS file: its objects and no others, with its values."""

    @field_validator("profile")
    @classmethod
    def _known(cls, value: str) -> str:
        if value not in PROFILES:
            raise ValueError(f"unknown profile; known are {list(PROFILES)}")
        return value

    @field_validator("lacks", "values", "read_only")
    @classmethod
    def _addresses(cls, value: Any) -> Any:
        for name in value:
            if not re.fullmatch(r"0[xX][0-9a-fA-F]{1,4}(:\d{1,3})?", name):
                raise ValueError(f'{name!r} is no object; write "0x6072" or "0x607D:1"')
        return value


class AxisSimulation(Strict):
    """One simulated drive and motor."""

    rated_torque: float | None = Field(
        default=None, gt=0, validation_alias=AliasChoices("rated_torque", "rated_torque_Nm", "rated_force_N")
    )
    """Default: the axis's own rated torque, else 100."""
    encoder_counts: float = Field(
        default=524288,
        gt=0,
        validation_alias=AliasChoices("encoder_counts", "encoder_counts_per_rev", "encoder_counts_per_m"),
    )
    torque_steps_permille: int = Field(default=1, ge=1)
    """Steps of 0x6077 in thousandths of rated torque."""
    torque_noise: float = Field(
        default=0.0, ge=0, validation_alias=AliasChoices("torque_noise", "torque_noise_fraction_of_rated")
    )
    """Standard deviation of the noise on 0x6077, as a fraction of rated torque."""
    position_noise_counts: float = Field(default=0.0, ge=0)
    command_delay_cycles: int = Field(default=0, ge=0, le=20)
    """Whole SYNC cycles from the SYNC that makes a target torque valid to the torque acting."""
    current_loop_s: float = Field(default=0.0, ge=0)
    """Time constant of the current loop; 0x6077 shows it."""
    friction: FrictionConfig = FrictionConfig()
    position_loop_Hz: float = Field(default=25.0, gt=0, le=300)
    """Bandwidth of the drive's own position loop on the motor mass alone, as it comes."""
    loops: LoopValues | None = None
    """Values of its loops in place of those that it comes with."""
    loop_cycle_s: float = Field(default=0.0, ge=0, le=0.02)
    """Cycle of the drive's loops: the speed is then the difference of two readings, and torque acts one cycle
    late, as `invid tune` has it. 0: as they come they run in each sub-step on the speed itself, those of
    ``loops`` once in a millisecond."""
    brake: bool = True
    brake_torque: float | None = Field(
        default=None, gt=0, validation_alias=AliasChoices("brake_torque", "brake_torque_Nm", "brake_force_N")
    )
    """Default: twice rated torque."""
    brake_delay_s: float = Field(default=0.0, ge=0, le=2)
    """From the loss of torque to the brake's closing; the axis is free meanwhile."""
    load: LoadConfig = LoadConfig()
    limits_in_torque_mode: bool = True
    """False: 0x6072, 0x607D and 0x607F count in position mode and on ramps only, as with many drives."""
    quick_stop_deceleration: float = Field(
        default=10.0,
        gt=0,
        validation_alias=AliasChoices(
            "quick_stop_deceleration",
            "quick_stop_deceleration_rad_per_s2",
            "quick_stop_deceleration_m_per_s2",
        ),
    )
    """What 0x6085 holds, in the drive's own unit."""
    ramp_unit: Literal["counts_per_s2", "rpm_per_s"] = "counts_per_s2"
    """Unit of 0x6084 and 0x6085."""
    enable_s: float = Field(default=0.0, ge=0, le=2)
    """From the command to enable to operation enabled; there is no torque before."""
    sdo_response_s: float = Field(default=0.0002, ge=0, le=1)
    mode_change_s: float = Field(default=0.0, ge=0, le=10)
    """From 0x6060 to the mode acting; the old one acts meanwhile."""
    mode_display_s: float = Field(default=0.0, ge=0, le=10)
    """From the mode acting to 0x6061 showing it."""
    mode_shown_enabled: bool = False
    """0x6061 is 0 until the drive is enabled."""
    mode_from_switched_on: bool = False
    """0x6060 is refused below switched on."""
    objects: ObjectsConfig = ObjectsConfig()


FrameFaultKind = Literal["drop", "delay", "duplicate", "corrupt"]
DriveFaultKind = Literal[
    "node_reset", "node_silent", "bus_off", "emcy", "drive_fault", "ignore_quick_stop", "ignore_controlword",
    "encoder_jump", "encoder_stuck", "sign_flip", "brake_stuck", "torque_saturation", "push", "statusword",
    "mode_display", "torque_display", "torque_scale", "ignore_target",
]  # fmt: skip
FRAME_FAULTS: tuple[str, ...] = get_args(FrameFaultKind)
DRIVE_FAULTS: tuple[str, ...] = get_args(DriveFaultKind)


class FaultConfig(Strict):
    """One injected fault; the fields that a kind does not use must be left out."""

    kind: FrameFaultKind | DriveFaultKind
    axis: str | None = None
    """None: the master's own port for bus_off, every frame for faults on frames."""
    at_s: float | None = Field(default=None, ge=0)
    at_state: (
        Literal["ready_to_switch_on", "switched_on", "operation_enabled", "quick_stop_active", "fault"] | None
    ) = None
    after_s: float = Field(default=0.0, ge=0)
    duration_s: float | None = Field(default=None, gt=0)
    # faults on frames
    can_ids: list[int] | None = None
    """11-bit identifiers; None: all of the axis, or all."""
    rate: float = Field(default=1.0, ge=0, le=1)
    count: int | None = Field(default=None, ge=1)
    """Stop after so many frames (a burst)."""
    delay_s: float = Field(default=0.001, gt=0)
    # faults of drives
    code: int = Field(default=0x2310, ge=0, le=0xFFFF)
    length: int = Field(default=8, ge=1, le=8)
    counts: int = 0
    signal: Literal["torque", "encoder"] = "torque"
    limit: float = Field(default=0.0, ge=0, validation_alias="limit_Nm")
    torque: float = Field(default=0.0, validation_alias="torque_Nm")
    value: int = Field(default=0, ge=-32768, le=0xFFFF)
    gain: float = 1.0
    """0x6077 over the torque."""

    @model_validator(mode="after")
    def _when_and_where(self) -> FaultConfig:
        if (self.at_s is None) == (self.at_state is None):
            raise ValueError(f"fault {self.kind}: give either at_s or at_state")
        needs_axis = self.kind in DRIVE_FAULTS and self.kind != "bus_off"
        if (needs_axis or self.at_state is not None) and self.axis is None:
            raise ValueError(f"fault {self.kind}: give the axis")
        if self.kind == "mode_display" and not -128 <= self.value <= 127:
            raise ValueError(f"fault mode_display: value {self.value} is no mode; it must be -128 to 127")
        return self


class EffectConfig(Strict):
    """One departure from the linear model, by its name in the contract's list of causes."""

    cause: str
    axis: str
    element: str | None = None
    """"mass q" or "spring s", counted from the motor; default mass 1 or spring 1."""
    other_axis: str | None = None
    parameters: dict[str, float] = Field(default_factory=dict)


class SimulationConfig(Strict):
    """What stands behind the bus instead of hardware."""

    seed: int = Field(default=0, ge=0)
    plant: PlantConfig
    defaults: AxisSimulation = AxisSimulation()
    axes: dict[str, AxisSimulation] = Field(default_factory=dict)
    effects: list[EffectConfig] = Field(default_factory=list)
    faults: list[FaultConfig] = Field(default_factory=list)
    boot_s: float = Field(default=0.002, ge=0, le=60)

    def axis(self, name: str) -> AxisSimulation:
        """The settings of one axis: its own over ``defaults``."""
        own = self.axes.get(name)
        if own is None:
            return self.defaults
        return self.defaults.model_copy(update={k: getattr(own, k) for k in own.model_fields_set})


def simulation_of(config: CellConfig) -> SimulationConfig:
    """The validated ``simulation`` section; ConfigError where it is missing or wrong."""
    if config.simulation is None:
        raise ConfigError(
            f"config of {config.robot!r}: no section 'simulation'; it says what stands behind the bus"
        )
    try:
        simulation = SimulationConfig.model_validate(config.simulation)
    except ValidationError as error:
        where = f"config of {config.robot!r}: simulation"
        raise ConfigError(describe_validation_error(error, where)) from None
    names = [axis.name for axis in config.axes]
    used: list[tuple[str, str | None]] = [("simulation.axes", name) for name in simulation.axes]
    used += [("simulation.effects", name) for e in simulation.effects for name in (e.axis, e.other_axis)]
    used += [("simulation.faults", fault.axis) for fault in simulation.faults]
    for where, axis in used:
        if axis is not None and axis not in names:
            raise ConfigError(f"config of {config.robot!r}: {where}: no axis {axis!r}; the cell has {names}")
    return simulation


def truth(config: CellConfig) -> CoupledChains:
    """The linear part of the simulated plant, motor viscous friction as ground dampers.

    Raises
    ------
    ConfigError
        Where the section is missing, or its plant does not fit the cell's axes.
    """
    simulation = simulation_of(config)
    plant = simulation.plant
    names = [axis.name for axis in config.axes]
    viscous = frozen_float([simulation.axis(name).friction.viscous for name in names])
    if plant.case_study:
        paper = case_study(damping_ratio=plant.damping_ratio)
        if len(names) != paper.branches:
            raise ConfigError(
                f"config of {config.robot!r}: simulation.plant.case_study has {paper.branches} axes, "
                f"the cell has {len(names)}"
            )
        return replace(paper, ground_dampers=viscous, axes=tuple(names))
    by_axis = {branch.axis: branch for branch in plant.branches}
    if sorted(by_axis) != sorted(names) or len(plant.branches) != len(names):
        raise ConfigError(
            f"config of {config.robot!r}: simulation.plant.branches are for "
            f"{[b.axis for b in plant.branches]}, the cell has {names}; one branch per axis is needed"
        )
    document = {
        "format": "invid-model",
        "format_version": 1,
        "branches": [
            {
                "axis": name,
                "masses": _estimates(by_axis[name].masses),
                "springs": _estimates(by_axis[name].springs),
                "dampers": _estimates(by_axis[name].dampers or _dampers(by_axis[name], plant.damping_ratio)),
            }
            for name in names
        ],
        "couplings": [c.model_dump() for c in plant.couplings],
    }
    try:
        model = model_from_json(document, source=f"config of {config.robot!r}: simulation.plant")
    except ModelError as error:
        raise ConfigError(str(error)) from None
    return replace(model.chains, ground_dampers=viscous)


def _estimates(values: list[float]) -> list[dict[str, float]]:
    return [{"value": value} for value in values]


def _dampers(branch: BranchConfig, ratio: float) -> list[float]:
    """d = 2ζ√(K·m_reduced) of the two masses each spring joins."""
    values: list[float] = []
    for k, a, b in zip(branch.springs, branch.masses[:-1], branch.masses[1:], strict=False):
        values.append(2.0 * ratio * max(k * a * b / (a + b), 0.0) ** 0.5)
    return values


def sensor_noise(config: CellConfig) -> Noise:
    """Noise and lattice of every axis: those of the simulated drives, else assumed ones."""
    if not config.simulated:
        return assumed_noise(config)
    simulation = simulation_of(config)
    turn = 1.0 if config.linear else 2 * math.pi
    own = [simulation.axis(a.name) for a in config.axes]
    # as the simulated drive takes it: its own, else the axis's, else 100
    rated = np.array(
        [s.rated_torque or a.rated_torque or 100.0 for s, a in zip(own, config.axes, strict=True)]
    )
    step = np.array(
        [a.position_per_count or turn / s.encoder_counts for s, a in zip(own, config.axes, strict=True)]
    )
    return Noise(
        position=frozen_float(step * [s.position_noise_counts for s in own]),
        position_step=frozen_float(step),
        torque=frozen_float(rated * [s.torque_noise for s in own]),
        torque_step=frozen_float(rated * [1e-3 * s.torque_steps_permille for s in own]),
        source="the simulated drives of the config",
    )
