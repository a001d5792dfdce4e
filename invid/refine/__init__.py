"""Structured errors-in-variables maximum likelihood on the missing torque."""

from invid.refine.blocks import carried, problem_from_spectra, with_columns
from invid.refine.channel import Block
from invid.refine.problem import Extra, MissingTorqueProblem, State
from invid.refine.solver import Solution, gauss_newton
from invid.refine.structure import ChainStructure, structure_of

__all__ = [
    "Block",
    "ChainStructure",
    "Extra",
    "MissingTorqueProblem",
    "Solution",
    "State",
    "carried",
    "gauss_newton",
    "problem_from_spectra",
    "structure_of",
    "with_columns",
]
