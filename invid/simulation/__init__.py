"""Time-domain simulation of a model with its effects, exact for the linear part."""
