"""Structured errors-in-variables maximum likelihood on the missing torque."""

from invid.refine.problem import Block, Extra, MissingTorqueProblem, State, blocks_from_spectra
from invid.refine.solver import Solution, gauss_newton
from invid.refine.structure import ChainStructure, structure_of

__all__ = [
    "Block",
    "ChainStructure",
    "Extra",
    "MissingTorqueProblem",
    "Solution",
    "State",
    "blocks_from_spectra",
    "gauss_newton",
    "structure_of",
]
