"""What a config may ask to be measured: one pydantic model per kind of experiment."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AliasChoices, BaseModel, ConfigDict, Field, model_validator


class Strict(BaseModel):
    """Unknown keys are errors: a misspelt limit must not be ignored."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, frozen=True, populate_by_name=True)


def with_units(name: str, *keys: str, **bounds: Any) -> Any:
    """A field that a config names with its unit, by one of ``keys``."""
    return Field(validation_alias=AliasChoices(name, *keys), **bounds)


class _Spec(Strict):
    role: Literal["identify", "validate"] = "identify"
    axes: tuple[str, ...] | None = None
    """Axes to excite, by name; ``None``: all."""
    amplitude: float = Field(default=0.7, gt=0, le=1.0)
    """Peak torque as a fraction of each axis's torque limit."""


class MultisineSpec(_Spec):
    """Random-phase multisine on all axes at once.

    One period without settling is recorded whole, from rest: its transient is fitted, not waited for.
    """

    kind: Literal["multisine"]
    band_Hz: tuple[float, float] = (0.5, 12.0)
    period_s: float = Field(default=10.5, gt=0, le=600)
    periods: int = Field(default=1, ge=1, le=1000)
    settle_periods: int = Field(default=0, ge=0, le=100)
    experiments: int | None = Field(default=None, ge=1, le=64)
    """How many runs; default: as many as axes are excited. With interleaved lines each axis has another share
    of them in each run; with common ones the phases are orthogonal over the runs."""
    lines: Literal["odd", "all", "interleaved"] = "interleaved"
    detection_fraction: float = Field(default=0.2, ge=0, le=0.9)
    """Share of the odd lines left out at random: there odd distortion shows without excitation."""
    seed: int = Field(default=0, ge=0)
    creep_velocity: float = with_units(
        "creep_velocity", "creep_velocity_rad_per_s", "creep_velocity_m_per_s", default=0.0, ge=0
    )
    """Slow motion under the excitation that keeps friction from changing sign."""

    @property
    def is_from_rest(self) -> bool:
        """Whether each run is one record from rest."""
        return self.periods == 1 and self.settle_periods == 0

    @model_validator(mode="after")
    def _band(self) -> MultisineSpec:
        low, high = self.band_Hz
        if not 0 < low < high:
            raise ValueError(f"band_Hz must rise from above zero, found {list(self.band_Hz)}")
        if self.period_s * (high - low) < 2:
            raise ValueError(
                f"a period of {self.period_s:g} s puts fewer than two lines into {low:g}…{high:g} Hz; "
                "lengthen period_s or widen band_Hz"
            )
        return self


class SteppedSineSpec(_Spec):
    """One axis after another, one frequency after another, cosine start."""

    kind: Literal["stepped_sine"]
    frequencies_Hz: tuple[Annotated[float, Field(gt=0)], ...] = Field(min_length=1, max_length=10_000)
    cycles: int = Field(default=10, ge=1)
    settle_cycles: int = Field(default=5, ge=0)


class ChirpSpec(_Spec):
    """Linear sweep, one axis after another."""

    kind: Literal["chirp"]
    band_Hz: tuple[float, float] = (0.5, 12.0)
    duration_s: float = Field(default=30.0, gt=0, le=3600)

    @model_validator(mode="after")
    def _band(self) -> ChirpSpec:
        if not 0 < self.band_Hz[0] < self.band_Hz[1]:
            raise ValueError(f"band_Hz must rise from above zero, found {list(self.band_Hz)}")
        return self


class ConstantVelocitySpec(_Spec):
    """Slow moves forth and back at each speed, under a master PD that follows the path."""

    kind: Literal["constant_velocity"]
    velocities: tuple[Annotated[float, Field(gt=0)], ...] = with_units(
        "velocities", "velocities_rad_per_s", "velocities_m_per_s", min_length=1, max_length=100
    )
    travel: float = with_units("travel", "travel_rad", "travel_m", gt=0)
    """Distance of one move; must fit into the position window."""


ExperimentSpec = Annotated[
    MultisineSpec | SteppedSineSpec | ChirpSpec | ConstantVelocitySpec, Field(discriminator="kind")
]
