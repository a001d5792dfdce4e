"""The numbers that decide a diagnosis: is a cause there, is it at the noise, the verdict, who competes.

Each says whether it is statistical (a test), physical (a bound), of the contract, or empirical and on what.
"""

from __future__ import annotations

from invid.model.document import MISSED as MISSED

# --- Significance: is a cause there
SIGNIFICANCE = 1e-3
"""Chance, over all candidates together, that noise passes the training gain; the held-out gain must pass as
well, so a false alarm by selection is rarer than the null test's 1 %."""
HELD_OUT = 6.6
"""Held-out χ² gain of one degree of freedom that noise exceeds once in a hundred."""
WEAK = 1e-6
"""Chance that noise passes where the null test finds no excess: then errors of the model far below the noise
count as well, and they are coherent. Empirical (hidden plants): a torque scale 5 σ from one was named on data
without it."""
LARGER = 9.2
"""χ² gain of two degrees of freedom that noise exceeds once in a hundred: what a larger friction model must
gain over a smaller one that it contains."""
REMAINDER = 0.25
"""A further cause must remove this share of what the first left beyond noise on its own axes. Empirical
(hidden plants): an imperfect model of a strong first cause leaves a per cent of it, of which other causes fit
some."""
SMALL_REMAINDER = 0.1
"""The same for a cause that is kept only where the search ends near the noise: one of several alike takes no
quarter of what they leave together. A guess."""
MOST = 0.5
"""A further cause that takes this share of all that is missing is sure however small it is beside the first.
A guess."""
SHARE = 0.05
"""A further cause that does not bring χ²/ν below CLOSE must remove this share of the first excess. Empirical:
on the flexible bench ripples of 2 % were named otherwise with a phase known to ten radians. Of the excess in
motion: a constant torque, as a robot arm's weight, is a thousand times all friction, and leaves nothing."""
NAMED_SHARE = 0.9
"""A further cause that takes this share of what is left and reaches the noise is there, however small beside
the first: what an imperfect model of the first leaves has no such law. A guess, no campaign counted it."""

# --- Distance from the noise: χ² over its degrees of freedom
CLOSE = 1.5
"""χ²/ν up to which a fit is close enough to the noise that what it leaves is a matter of that."""
AT_FLOOR = 1.44
"""χ²/ν up to which the extended model is at the noise: a residual of 1.2 times the floor, the product's bar.
Above it something is left that no cause took, the cause named may be a disguise of another (a delay of a lag
beside friction left χ²/ν at 300 and a hundredth of the excess), and nobody may be certain."""
REACHED = 2.0
"""χ²/ν below which the extended model is taken for right, whatever the linear fit looked like."""
FAR = 3.0
"""χ²/ν from which a fit leaves so much that the linear model itself may be wrong. A guess."""
LEFT = 0.02
"""Share of the excess below which the same holds. Empirical, on hidden plants: with the wrong number of
masses the best cause leaves 5 % and more (χ²/ν 300 to 9000), with the right one less than 1 % is left; of a
cubic spring beside a hold inside a drive it was 1.3 %."""

# --- Verdict: what was missing, what is left
FLOOR = 1.2
"""Held-out rms of the missing torque over its floor up to which an axis is at the noise (contract)."""
EXPLAINED = 0.9
"""Share of what was missing that named causes take away where a diagnosis is called explained (contract)."""
NAMED = 0.9
"""Share of the excess χ² below which nothing is named (prototype: separates named from outside)."""
MOST_OF_CHI2 = 0.5
"""Share of the excess χ² that must go at least where the share of the missing torque's power says NAMED. On
long periodic records of a real machine a few lines stand thousands of times above their noise and hold the
excess χ² (antiresonances, where the motor hardly moves), while next to no torque is missing there."""
OWN_SHARE = 0.5
"""Share of what its axis misses that a cause named on its own evidence takes, on training and held-out
records alike. A guess: whatever else there is, it is the smaller part there."""
OWN_RIVAL = 0.8
"""Share of its gain that no cause of another kind or place reaches beside it. A guess."""
BROUGHT_DOWN = 0.98
"""Share of what was missing that causes explain at least where the rest stands out of the noise."""

# --- Rivals: what the data cannot tell apart
NEAR = 0.3
"""Share of the best candidate's gain that one may miss of it and still be weighed as its rival. A guess."""
COMPETES = 9.0
"""Difference of −2 ln(likelihood) within which two causes are called indistinguishable (about 3 σ)."""
CONTESTED = 0.89
"""Most that is claimed where alternatives remain. exp(−COMPETES/4) leaves a rival at the edge a tenth of the
likelihood, so a cause with one has at most nine tenths."""
UNSIZED = 0.5
"""Most that is claimed of a cause whose size cannot be told from none: something is there, and it fits."""
