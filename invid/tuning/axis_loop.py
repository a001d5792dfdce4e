"""What the drive of one axis is given, and the way back to it from the document of a tuning."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, Field, ValidationError

from invid.errors import InputError
from invid.model.document import Model, describe_validation_error, model_from_json
from invid.tuning.feedforward import NONE, Feedforward
from invid.tuning.servo_loop import DriveTiming, Gains
from invid.tuning.shapers import Shaper

FORMAT = "invid-tuning"
FORMAT_VERSION = 1


@dataclass(frozen=True)
class AxisLoop:
    """All that the drive of one axis is given."""

    gains: Gains
    feedforward: Feedforward = NONE
    shaper: Shaper | None = None


def _with_integral(side: Any) -> Any:
    """One side of an axis; gains that somebody wrote by hand may leave the integral out."""
    gains = side.get("gains") if isinstance(side, dict) else None
    return {**side, "gains": {"integral_time": None, **gains}} if isinstance(gains, dict) else side


class _AxisJson(BaseModel):
    axis: str
    after: Annotated[AxisLoop, BeforeValidator(_with_integral)]


class _TuningJson(BaseModel):
    format: str = Field(pattern=f"^{FORMAT}$")
    format_version: int = Field(ge=1, le=FORMAT_VERSION)
    axes: list[_AxisJson]
    cycle_s: float = Field(default=0.001, gt=0, allow_inf_nan=False)
    dead_cycles: int = Field(default=1, ge=0)
    model: dict[str, Any] | None = None


def prediction_from_json(document: Any, source: str) -> tuple[Model, dict[str, AxisLoop], DriveTiming]:
    """Model, loops and timing on which a tuning's margins stand; InputError where it does not hold them."""
    loops = loops_from_json(document, source)
    read = _TuningJson.model_validate(document)
    if read.model is None:
        raise InputError(f"{source}: it holds no model, so nothing is predicted; tune anew")
    return model_from_json(read.model, source=source), loops, DriveTiming(read.cycle_s, read.dead_cycles)


def loops_from_json(document: Any, source: str) -> dict[str, AxisLoop]:
    """The ``after`` of every axis of an ``invid-tuning`` document, by its name; InputError says what is
    wrong.

    Written by hand it needs ``format``, ``format_version`` and per axis ``after.gains``.
    """
    try:
        read = _TuningJson.model_validate(document)
    except ValidationError as error:
        raise InputError(describe_validation_error(error, source)) from None
    return {a.axis: a.after for a in read.axes}
