"""The paper's inverse eigenvalue method, an equation a function, misprints corrected and said."""

from invid.inverse.coupling import branch_sum, coupling, couplings, motor_mass
from invid.inverse.eigenvector import Spectrum, checked_spectrum, first_row_of_eigenvectors
from invid.inverse.lanczos import LanczosRows, lanczos
from invid.inverse.measured import PaperResult, Readings, identify_paper
from invid.inverse.paper import chain_from_spectrum, paper_inverse
from invid.inverse.springs import Branch, inverse_end_mass, last_mass, springs_and_masses

__all__ = [
    "Branch",
    "LanczosRows",
    "PaperResult",
    "Readings",
    "Spectrum",
    "branch_sum",
    "chain_from_spectrum",
    "checked_spectrum",
    "coupling",
    "couplings",
    "first_row_of_eigenvectors",
    "identify_paper",
    "inverse_end_mass",
    "lanczos",
    "last_mass",
    "motor_mass",
    "paper_inverse",
    "springs_and_masses",
]
