"""Parameters that the data do not determine, in words, with the experiment that would."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from invid.model.chains import CoupledChains
from invid.model.forward import resonances
from invid.numerics.arrays import Float64

_WORDS = {"mass": "m", "spring": "K", "damper": "D"}


@dataclass(frozen=True)
class Unidentifiable:
    """Parameters that the data do not determine, and sentences about them."""

    LIMIT: ClassVar[float] = 0.25
    """Relative standard deviation above which a mass or spring is not known: ±3σ then spans a factor
    of seven. Couplings are judged against the geometric mean of the masses they join."""

    unseen: frozenset[str]
    sentences: tuple[str, ...]


def blind_directions(
    chains: CoupledChains,
    names: Sequence[str],
    values: Float64,
    covariance: Float64,
    band_hz: tuple[float, float],
) -> Unidentifiable:
    """Directions of parameter space (masses, springs, couplings) that the data do not determine."""
    scale = np.array([_scale(chains, n, v) for n, v in zip(names, values, strict=True)])
    is_judged = np.array([".damper." not in n for n in names])
    relative = np.sqrt(np.maximum(np.diag(covariance), 0.0)) / scale
    undetermined = [int(k) for k in np.flatnonzero(is_judged & ~(relative < Unidentifiable.LIMIT))]
    sentences: list[str] = []
    if undetermined:
        sentences += _direction_sentences(chains, names, covariance, scale, undetermined, band_hz)
    unseen_at_all = [int(k) for k in np.flatnonzero(~np.isfinite(relative))]
    sentences += [
        f"{_symbol(names[k])}: not seen by these data at all" for k in unseen_at_all if not is_judged[k]
    ]
    unseen = frozenset(names[k] for k in [*undetermined, *unseen_at_all])
    return Unidentifiable(unseen, tuple(sentences))


def _direction_sentences(
    chains: CoupledChains,
    names: Sequence[str],
    covariance: Float64,
    scale: Float64,
    open_: Sequence[int],
    band_hz: tuple[float, float],
) -> list[str]:
    """One sentence for every direction of large variance."""
    advice = _advice(chains, band_hz)
    lost = [k for k in open_ if not np.isfinite(covariance[k, k])]
    out = [f"{_symbol(names[k])}: not seen by these data; {advice}" for k in lost]
    rest = np.array([k for k in open_ if np.isfinite(covariance[k, k])], dtype=int)
    if rest.size == 0:
        return out
    block = covariance[np.ix_(rest, rest)] / scale[rest][:, None] / scale[rest]
    size, vectors = np.linalg.eigh(block)
    covered: set[int] = set()
    for at in np.argsort(size)[::-1]:
        if size[at] < Unidentifiable.LIMIT**2 or len(covered) == rest.size:
            break
        vector = vectors[:, at]
        members = [int(k) for k in np.flatnonzero(np.abs(vector) > 0.3 * np.abs(vector).max())]
        if all(m in covered for m in members):
            continue
        covered |= set(members)
        labels = [_symbol(names[rest[m]]) for m in members]
        error = np.sqrt(size[at])
        if len(members) == 1:
            m = rest[members[0]]
            out.append(
                f"{labels[0]}: known to ±{_percent(np.sqrt(covariance[m, m]) / scale[m])} only; {advice}"
            )
        elif len(members) == 2:
            same = vector[members[0]] * vector[members[1]] > 0
            relation = "ratio" if same else "product"
            out.append(
                f"{labels[0]} and {labels[1]}: only as a {relation} (±{_percent(error)} each); {advice}"
            )
        else:
            out.append(f"{', '.join(labels)}: only in combination (±{_percent(error)}); {advice}")
    return out


def _advice(chains: CoupledChains, band_hz: tuple[float, float]) -> str:
    try:
        modes = np.asarray(resonances(chains)) / 2 / np.pi
    except (ValueError, np.linalg.LinAlgError):
        modes = np.zeros(0)
    above = modes[modes > 0.97 * band_hz[1]]
    if above.size:
        return (
            f"no excitation above {band_hz[1]:.3g} Hz, and the model has resonances up to "
            f"{above.max():.3g} Hz: excite up to {1.3 * above.max():.3g} Hz, or use fewer masses"
        )
    return "raise the amplitude or measure longer; if that does not help, use fewer masses"


def _scale(chains: CoupledChains, name: str, value: float) -> float:
    if name.endswith(".coupling"):
        pair = name.removesuffix(".coupling")
        for i, a in enumerate(chains.axes):
            for j, b in enumerate(chains.axes):
                if f"{a}-{b}" == pair:
                    return float(np.sqrt(chains.masses[i][-1] * chains.masses[j][-1]))
    return max(abs(value), 1e-300)


def _symbol(name: str) -> str:
    """ "K2 of A1" for "A1.spring.2"; "coupling A1-A2" for "A1-A2.coupling"."""
    if name.endswith(".coupling"):
        return f"coupling {name.removesuffix('.coupling')}"
    axis, kind, *number = name.rsplit(".", 2)
    if not number:
        return name
    return f"{_WORDS.get(kind, kind)}{number[0]} of {axis}"


def _percent(value: float) -> str:
    return f"{100 * value:.0f} %" if value < 10 else "any amount"
