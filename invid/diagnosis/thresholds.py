"""Thresholds of a diagnosis: verdict and rivals.

Each says whether it is statistical (a test), physical (a bound), of the contract, or empirical and on what.
"""

from __future__ import annotations

from invid.model.document import MISSED as MISSED

# --- Verdict: what was missing, what is left
MOST = 0.5
"""Share of all that is missing from which a further cause counts as sure, however small beside the first
(empirical)."""
FLOOR = 1.2
"""Held-out rms of the missing torque over its floor up to which an axis is at the noise (contract)."""
EXPLAINED = 0.9
"""Share of what was missing that named causes take away where a diagnosis is called explained (contract)."""
SMALL = 0.002
"""Share of rated torque below which what is left of every axis counts as explained (contract)."""
NAMED = 0.9
"""Share of the excess χ² below which nothing is named. Empirical (prototype): it separates right names from
wrong ones."""

# --- Rivals: what the data cannot tell apart
SOFTER = 4.0
"""Divisor of a rise of −2 ln L in the exponent of the odds: two by definition, and two more since likelihood
ratios overstate certainty where models are imperfect (empirical, hidden plants)."""
COMPETES = 9.0
"""Difference of −2 ln(likelihood) within which two causes count as indistinguishable (statistical, about 3
σ)."""
CONTESTED = 0.89
"""Largest confidence where alternatives remain (contract). exp(−COMPETES/4) leaves a rival at the edge a
tenth of the likelihood, so a cause with one has at most nine tenths."""
UNSIZED = 0.5
"""Largest confidence of a cause whose size does not differ significantly from zero, or that a search found
which was cut short and explains too little to name it otherwise."""
