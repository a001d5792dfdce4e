"""May only some axes be shaken? Not for a model: what couples the axes is seen where all of them are."""

from __future__ import annotations

from collections.abc import Sequence

from invid.config import CellConfig
from invid.errors import ConfigError

WAY_OUT = (
    "shake all axes; where the cell has an accepted model, `invid measure --model MODEL.json --screen` tells "
    "in seconds what changed and shakes only that again"
)


def axes_left_out(config: CellConfig, axes: Sequence[str] | None) -> tuple[str, ...]:
    """Axes that an identification needs and a selection leaves out."""
    if axes is None:
        return ()
    return tuple(a.name for a in config.axes if a.name not in axes)


def subset_sentence(left_out: Sequence[str]) -> str:
    """Why a selection without these axes cannot yield a model."""
    some = ", ".join(left_out)
    one = len(left_out) == 1
    return (
        f"axis {some} would be held and not shaken: with one side of each coupling standing still neither "
        f"{'its' if one else 'their'} masses and springs nor the couplings can be identified"
    )


def require_all_axes(config: CellConfig, axes: Sequence[str] | None) -> None:
    """ConfigError, before anything moves, where a selection of axes cannot yield a model."""
    names = {a.name for a in config.axes}
    if axes is None or not set(axes) <= names:
        return  # an unknown axis is the plan's to refuse
    left_out = axes_left_out(config, axes)
    if left_out:
        raise ConfigError(f"axes: {subset_sentence(left_out)}; {WAY_OUT}")
