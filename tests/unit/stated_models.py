"""Models with numbers and deviations that a test states: what comparisons are judged on."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from invid.model.chains import CoupledChains
from invid.model.document import (
    EffectTerm,
    Estimate,
    Model,
    parameter_vector,
    std_by_name,
    stds_by_name,
    with_parameters,
)


def model_of(
    chains: CoupledChains,
    values: Mapping[str, float] | np.ndarray | None = None,
    std: float | np.ndarray = 0.002,
    *effects: EffectTerm,
    covariance: np.ndarray | None = None,
    verdict: str | None = None,
) -> Model:
    """``chains`` with other ``values`` by name, or all of them; ``std`` of all, or relative to their size."""
    names, own = parameter_vector(chains)
    found = (
        {}
        if values is None
        else values
        if isinstance(values, Mapping)
        else dict(zip(names, values, strict=True))
    )
    stds = std * np.abs(own) if isinstance(std, float) else std
    return Model(
        "cell",
        "refined",
        with_parameters(chains, dict(zip(names, own, strict=True)) | dict(found)),
        std_by_name(chains, dict(zip(names, stds, strict=True))),
        effects=effects,
        covariance=covariance,
        parameter_names=() if covariance is None else names,
        fit={} if verdict is None else {"verdict": verdict},
    )


def term(cause: str, axis: str, element: str, **sizes: tuple[float, float]) -> EffectTerm:
    """An effect with its parameters as value and deviation."""
    unit = {"gap": "rad", "phase": "rad", "coefficient": "N·m·s/rad", "cycles_per_rev": "1"}
    values = {n: Estimate(v, std, unit.get(n, "N·m")) for n, (v, std) in sizes.items()}
    return EffectTerm(cause, axis, values, element)


def again(base: Model, rng: np.random.Generator) -> Model:
    """Another estimate of the same robot: every number off by its own standard deviation."""
    names, values = parameter_vector(base.chains)
    std = np.array([stds_by_name(base)[n] for n in names])
    found = dict(zip(names, values + std * rng.standard_normal(values.size), strict=True))
    off = [
        replace(
            t, parameters={n: replace(e, value=rng.normal(e.value, e.std)) for n, e in t.parameters.items()}
        )
        for t in base.effects
    ]
    return replace(base, chains=with_parameters(base.chains, found), effects=tuple(off))
