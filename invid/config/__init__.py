"""The cell's configuration."""

from invid.config.experiments import ChirpSpec, ConstantVelocitySpec, MultisineSpec, SteppedSineSpec
from invid.config.load import load_config, parse_config
from invid.config.schema import AxisConfig, CellConfig

__all__ = [
    "AxisConfig",
    "CellConfig",
    "ChirpSpec",
    "ConstantVelocitySpec",
    "MultisineSpec",
    "SteppedSineSpec",
    "load_config",
    "parse_config",
]
