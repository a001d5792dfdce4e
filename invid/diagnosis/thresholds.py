"""Thresholds of a diagnosis: significance, distance from the noise, verdict, rivals.

Each says whether it is statistical (a test), physical (a bound), of the contract, or empirical and on what.
"""

from __future__ import annotations

from invid.model.document import MISSED as MISSED

# --- Significance: is a cause there
SIGNIFICANCE = 1e-3
"""Chance, over all candidates together, that noise passes the training gain (statistical); the held-out gain
must pass as well, so a false alarm by selection is rarer than the null test's 1 %."""
MOST = 0.5
"""Share of all that is missing from which a further cause counts as sure, however small beside the first
(empirical)."""
SHARE = 0.05
"""Share of the first excess that a further cause must explain unless it brings χ²/ν below CLOSE. Empirical:
on the flexible bench ripples of 2 % were named otherwise with a phase known to ten radians. Of the excess in
motion: a constant torque, as a robot arm's weight, is a thousand times all friction and leaves nothing."""

# --- Distance from the noise: χ² over its degrees of freedom
CLOSE = 1.5
"""χ²/ν up to which a fit is close to the noise (empirical)."""
FAR = 3.0
"""χ²/ν from which the linear model itself may be wrong (empirical)."""
LEFT = 0.02
"""Share of the excess below which the same holds. Empirical (hidden plants): with the wrong number of masses
the best cause leaves 5 % and more (χ²/ν 300 to 9000), with the right one less than 1 %; with a cubic spring
beside a hold inside a drive it was 1.3 %."""

# --- Verdict: what was missing, what is left
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
NEAR = 0.3
"""Share of the best candidate's gain that a candidate may lack and still be examined as its rival
(empirical)."""
COMPETES = 9.0
"""Difference of −2 ln(likelihood) within which two causes count as indistinguishable (statistical, about 3
σ)."""
CONTESTED = 0.89
"""Largest confidence where alternatives remain (contract). exp(−COMPETES/4) leaves a rival at the edge a
tenth of the likelihood, so a cause with one has at most nine tenths."""
UNSIZED = 0.5
"""Largest confidence of a cause whose size does not differ significantly from zero, or that a search found
which was cut short and explains too little to name it otherwise."""
