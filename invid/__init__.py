"""invid: field identification of elastic robot drives, and what the simulation still gets wrong."""

__version__ = "0.1.0"
