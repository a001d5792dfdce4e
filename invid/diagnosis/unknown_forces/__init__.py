"""The search over causes in the likelihood with unknown forces (ADR 14)."""
