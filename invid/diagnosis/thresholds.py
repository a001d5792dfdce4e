"""Thresholds of a diagnosis: significance, distance from the noise, verdict, rivals.

Each says whether it is statistical (a test), physical (a bound), of the contract, or empirical and on what.
"""

from __future__ import annotations

from invid.model.document import MISSED as MISSED

# --- Significance: is a cause there
SIGNIFICANCE = 1e-3
"""Chance, over all candidates together, that noise passes the training gain (statistical); the held-out gain
must pass as well, so a false alarm by selection is rarer than the null test's 1 %."""
HELD_OUT = 6.6
"""Held-out χ² gain of one degree of freedom that noise exceeds once in a hundred (statistical)."""
WEAK = 1e-6
"""Chance that noise passes where the null test finds no excess. There coherent errors of the model far below
the noise count as well. Empirical (hidden plants): a torque scale 5 σ from one was named without one."""
LARGER = 9.2
"""χ² gain of two degrees of freedom that noise exceeds once in a hundred (statistical): what a larger
friction model must gain over a smaller one that it contains."""
REMAINDER = 0.25
"""Share of the remainder beyond noise on its own axes that a further cause must explain. Empirical (hidden
plants): an imperfect model of a strong first cause leaves a per cent of it, of which other causes fit
some."""
SMALL_REMAINDER = 0.1
"""The same for a cause that is kept only where the search ends near the noise (empirical): of several alike
none explains a quarter of what they leave together."""
MOST = 0.5
"""Share of all that is missing from which a further cause counts as sure, however small beside the first
(empirical)."""
SHARE = 0.05
"""Share of the first excess that a further cause must explain unless it brings χ²/ν below CLOSE. Empirical:
on the flexible bench ripples of 2 % were named otherwise with a phase known to ten radians. Of the excess in
motion: a constant torque, as a robot arm's weight, is a thousand times all friction and leaves nothing."""
NAMED_SHARE = 0.9
"""Share of the remainder that a further cause must explain, and reach the noise, to be accepted however small
beside the first (empirical): the remainder of an imperfect model follows no such law."""

# --- Distance from the noise: χ² over its degrees of freedom
CLOSE = 1.5
"""χ²/ν up to which a fit is close to the noise (empirical)."""
AT_FLOOR = 1.44
"""χ²/ν up to which the extended model is at the noise: a residual of 1.2 times the floor (contract). Above it
something is unexplained and the cause named may be another in disguise (a delay of a lag beside friction left
χ²/ν at 300 and a hundredth of the excess), so nothing is certain."""
REACHED = 2.0
"""χ²/ν below which the extended model counts as right, whatever the linear fit looked like (empirical)."""
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
NAMED = 0.9
"""Share of the excess χ² below which nothing is named. Empirical (prototype): it separates right names from
wrong ones."""
MOST_OF_CHI2 = 0.5
"""Share of the excess χ² that must go where the power of the missing torque reaches NAMED. Empirical (long
periodic records of a real machine): a few lines at antiresonances, where the motor hardly moves, stand
thousands of times above their noise and hold the excess χ², while next to no torque is missing there."""
OWN_SHARE = 0.5
"""Share of what its axis misses that a cause on its own evidence must explain, in training and held-out
records alike (empirical): whatever else there is, it is the smaller part."""
OWN_RIVAL = 0.8
"""Share of its gain that no cause of another kind or place may reach (empirical)."""
BROUGHT_DOWN = 0.98
"""Least share of what was missing that causes must explain where the rest stands out of the noise
(empirical)."""

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
