"""First-order lag of the torque; see ``torque_delay`` for what actuator effects share."""

from __future__ import annotations

from invid.effects.catalogue.torque_delay import TorqueLag

__all__ = ["TorqueLag"]
