"""The shortest plan that is expected to tell whether anything changed since an accepted model.

Blocks are runs of the usual multisine, one record from rest each: all axes at once on interleaved lines. The
first is the climb of the trial, at about a third of the amplitude.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from invid.config import CellConfig
from invid.planning.belief import Belief
from invid.planning.build import DEFAULT, make_plan, multisine_of
from invid.planning.expected_covariance import Noise, expected
from invid.planning.forecast import turning_back
from invid.planning.model import Plan
from invid.planning.phases import REST_S
from invid.recording.model import Role
from invid.wording.sentence import sentence

GOAL = 0.01
"""Relative uncertainty that the record is laid out for: a change of a few per cent is then seen (a
convention)."""
BLOCKS_S = (2.0, 2.5, 3.2, 4.0, 6.0, 8.0, 10.0, 13.0, 16.0, 20.0)
"""Lengths of a block; the fit starts at the accepted model, which says where the resonances are. They scale
with the lowest frequency below 0.5 Hz."""
LONGEST_S = 120.0
"""Robot time of the blocks after the climb."""
MARGIN = 0.9
"""The expected uncertainty must be this much below the goal: the measured one scatters about it."""
FRICTION_FACTOR = 13.0
"""Peak torque over Coulomb torque below which sticking shows (notes, case study)."""


def screening_plan(config: CellConfig, belief: Belief, noise: Noise, *, amplitude_scale: float = 1.0) -> Plan:
    """The climb and the blocks on all axes that the goal needs, at least one: the climb alone is too weak to
    tell which of two coupled axes changed.

    Raises
    ------
    ConfigError
        A bus over its budget.
    """
    base = multisine_of(config)
    longest = LONGEST_S - REST_S
    scaled = [t * max(1.0, 0.5 / base.band_Hz[0]) for t in BLOCKS_S]

    def plan_of(length: float, runs: int) -> Plan:
        changes = {"period_s": length, "experiments": runs, "lines": "interleaved", "seed": DEFAULT.seed}
        block = base.model_copy(update={**changes, "periods": 1, "settle_periods": 0})
        asked = config.model_copy(update={"experiments": [block]})
        made = make_plan(asked, amplitude_scale=amplitude_scale, model=belief)
        # nothing is validated: the climb counts like every block
        trials = [replace(t, experiment=replace(t.experiment, role=Role.IDENTIFY)) for t in made.trials]
        return replace(made, trials=tuple(trials))

    runs = 1
    for length in [t for t in scaled if t <= longest] or [longest]:
        plan = plan_of(length, runs)
        uncertainty = expected(config, plan.recorded, belief, noise).worst[1]
        if uncertainty <= MARGIN * GOAL:
            break
    most = max(int(LONGEST_S // (length + REST_S)), 1)
    while MARGIN * GOAL < uncertainty < np.inf and runs < most:
        # information adds up over blocks: the number that is missing, at once
        runs = min(most, max(runs + 1, int(np.ceil(runs * (uncertainty / (MARGIN * GOAL)) ** 2))))
        plan = plan_of(length, runs)
        uncertainty = expected(config, plan.recorded, belief, noise).worst[1]
    return replace(plan, warnings=(*plan.warnings, *_friction(config, plan, belief)))


def _friction(config: CellConfig, plan: Plan, belief: Belief) -> list[str]:
    """What is said of axes that stick while they are shaken, and of figures that rest on a guess."""
    said = turning_back(config, plan.experiments[0], belief)
    creeps = plan.experiments[0].reference is not None
    for i in () if creeps else plan.excited:
        peak, coulomb = float(plan.peak_torque[i]), float(belief.coulomb[i])
        if coulomb > 0 and peak < FRICTION_FACTOR * coulomb:
            said.append(
                sentence(
                    "axis {axis}: the peak torque of {peak:.3g} is only {times:.1f} times the Coulomb "
                    "friction of {coulomb:.3g}; allow a creep_velocity in the config",
                    axis=plan.axes[i],
                    peak=peak,
                    times=peak / coulomb,
                    coulomb=coulomb,
                )
            )
    return (
        [*said, sentence("expected figures rest on {source}", source=belief.source)]
        if belief.guessed
        else said
    )
