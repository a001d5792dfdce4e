"""What the simulation gets wrong: missing torque, causes, verdict."""

from invid.discrepancy.diagnosing import diagnose

__all__ = ["diagnose"]
