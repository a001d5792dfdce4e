"""The likelihood with unknown forces of unknown strength: plant, noise, value, fit, smoother (ADR 14)."""
