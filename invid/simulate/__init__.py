"""Time-domain simulation of a model with its effects, exact for the linear part."""

from invid.simulate.run import simulate

__all__ = ["simulate"]
