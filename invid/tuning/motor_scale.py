"""How an axis of the model hangs at its motor: what a drive's own units need."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class MotorScale(BaseModel):
    """How an axis of the model hangs at its motor: what a drive's own units need."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    gear: float = Field(default=1.0, gt=0)
    """Turns of the motor [rad] per unit of the axis [rad or m]: the gear ratio, for a screw 2π/pitch."""
    torque_constant_Nm_per_A: float | None = Field(default=None, gt=0)
    """Of the motor's shaft."""
    node_id: int = Field(default=1, ge=1, le=127)
