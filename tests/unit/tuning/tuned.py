"""A small machine with friction, free play and a mode, tuned once for all tests of a process."""

from functools import cache

from invid.model.chains import CoupledChains
from invid.model.document import EffectTerm, Estimate, Model, parameter_vector, std_by_name
from invid.tuning.tune import TuneSettings, Tuning, tune_model


def machine(*, relative: float = 0.02) -> Model:
    """Two coupled axes, 8 to 25 Hz, with dry and viscous friction, weight and free play."""
    chains = CoupledChains.build(
        [[0.02, 0.05], [0.03, 0.02, 0.04]],
        [[200.0], [600.0, 900.0]],
        [[0.03], [0.03, 0.03]],
        [[0.0, 0.01], [0.01, 0.0]],
        axes=["A1", "A2"],
    )
    names, values = parameter_vector(chains)
    std = std_by_name(chains, {n: relative * abs(v) for n, v in zip(names, values, strict=True)})
    return Model("robot", "refined", chains, std).extended(
        _term("coulomb_friction", "A1", "mass 1", torque=0.3),
        _term("viscous_friction", "A1", "mass 1", coefficient=0.05),
        _term("gravity", "A2", "mass 3", torque=0.4, angle=0.3),
        _term("backlash", "A2", "spring 1", gap=0.0008),
        _term("extra_mode", "A2", "mass 3", mass=0.008, stiffness=400.0),
    )


def _term(cause: str, axis: str, element: str, **sizes: float) -> EffectTerm:
    return EffectTerm(cause, axis, {k: Estimate(v, 0.02 * v) for k, v in sizes.items()}, element)


@cache
def tuned() -> Tuning:
    """``machine`` tuned."""
    return tune_model(machine(), TuneSettings(draws=200))
