"""The short run that shows the loops of drives as they are: torque added while their own loops hold them."""

from __future__ import annotations

from invid.config import CellConfig
from invid.config.experiments import MultisineSpec

BAND = (0.001, 0.1)
"""Lowest and highest line as shares of the cycle's rate; the highest is the highest that is trusted."""
PERIOD_CYCLES = 2048
PERIODS, SETTLING = 5, 1
AMPLITUDE = 0.3
"""Of the torque limit at first; trials and limits scale it down."""


def closed_loop_config(config: CellConfig, amplitude: float = AMPLITUDE) -> CellConfig:
    """The cell with every drive's loops closed and one multisine an axis, a share of its torque limit."""
    cycle = config.bus.cycle_s
    experiments = [
        MultisineSpec(
            kind="multisine",
            axes=(axis.name,),
            band_Hz=(BAND[0] / cycle, BAND[1] / cycle),
            period_s=PERIOD_CYCLES * cycle,
            periods=PERIODS,
            settle_periods=SETTLING,
            experiments=1,
            lines="odd",
            amplitude=amplitude,
        )
        for axis in config.axes
    ]
    axes = [a.model_copy(update={"in_closed_loop": True}) for a in config.axes]
    return config.model_copy(update={"axes": axes, "experiments": experiments})
