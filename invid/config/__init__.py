"""The cell's configuration."""

from invid.config.experiments import (
    ChirpSpec,
    ConstantVelocitySpec,
    ExperimentSpec,
    MultisineSpec,
    SteppedSineSpec,
)
from invid.config.load import load_config, parse_config
from invid.config.schema import (
    AcceptableConfig,
    AxisConfig,
    BusConfig,
    CellConfig,
    HoldConfig,
    LimitsConfig,
    SafetyConfig,
)

__all__ = [
    "AcceptableConfig",
    "AxisConfig",
    "BusConfig",
    "CellConfig",
    "ChirpSpec",
    "ConstantVelocitySpec",
    "ExperimentSpec",
    "HoldConfig",
    "LimitsConfig",
    "MultisineSpec",
    "SafetyConfig",
    "SteppedSineSpec",
    "load_config",
    "parse_config",
]
