"""What a person says was changed before a measurement, as it stands in the body of a start."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from invid.model.expectation import Expectation, Subject

_SIZES = ("mass_kg", "arm_m", "inertia_kgm2")


class StatedChange(BaseModel):
    """What was changed, where, about how much; a tool by its inertia, or by its mass and where it sits."""

    model_config = ConfigDict(extra="forbid", strict=True)
    what: Literal["tool", "transmission", "lubrication"] = "tool"
    """transmission: gear, belt or coupling."""
    axis: str | None = Field(default=None, max_length=64)
    """Default: it is not said which."""
    mass_kg: float | None = Field(default=None, gt=-1e6, lt=1e6, allow_inf_nan=False)
    """Of a tool: how much heavier it is, negative where it is lighter [kg]."""
    arm_m: float | None = Field(default=None, gt=0, lt=1e3, allow_inf_nan=False)
    """Distance of that mass from the axis of rotation [m]; without it its inertia is not known."""
    inertia_kgm2: float | None = Field(default=None, gt=-1e6, lt=1e6, allow_inf_nan=False)
    """In place of mass and distance [kg·m²]."""

    @model_validator(mode="after")
    def _one_size(self) -> Self:
        given = [name for name in _SIZES if getattr(self, name) is not None]
        if given and self.what != "tool":
            raise ValueError(f"{given[0]} is of a tool; leave it out of a change of the {self.what}")
        if self.inertia_kgm2 is not None and len(given) > 1:
            raise ValueError(
                f"give inertia_kgm2 or mass_kg with arm_m, not both; here are {', '.join(given)}"
            )
        if self.arm_m is not None and self.mass_kg is None:
            raise ValueError("arm_m is the distance of mass_kg from the axis; give mass_kg too")
        for name in ("mass_kg", "inertia_kgm2"):
            if getattr(self, name) == 0:
                raise ValueError(f"{name} is 0, which is no change; leave it out where it is not known")
        return self

    def refusal(self, axes: tuple[str, ...], *, linear: bool) -> str | None:
        """Return why it cannot be said of a cell with these axes; ``None`` where it can."""
        if self.axis is not None and self.axis not in axes:
            return f"changed.axis: no axis {self.axis!r}; the cell has {list(axes)}"
        if linear and (self.arm_m, self.inertia_kgm2) != (None, None):
            return "changed: on this cell's linear axes a tool counts by its mass: give mass_kg alone"
        return None

    def expectation(self, *, linear: bool) -> Expectation:
        """Return it as the result is compared with it."""
        size = self.inertia_kgm2
        if self.mass_kg is not None and linear:
            size = self.mass_kg
        elif self.mass_kg is not None and self.arm_m is not None:
            size = self.mass_kg * self.arm_m**2
        mass = self.mass_kg if size is None else None
        return Expectation(Subject(self.what), self.axis, size, mass, linear)
