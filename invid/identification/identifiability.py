"""Parameters that the data do not determine, in words, with the experiment that would."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np

from invid.model.chains import CoupledChains
from invid.model.forward import resonances
from invid.numerics.arrays import Float64, Int64
from invid.wording.sentence import sentence

_WORDS = {"mass": "m", "spring": "K", "damper": "D"}


LIMIT = 0.25
"""Relative standard deviation above which a mass or spring is not known: ±3σ then spans a factor of seven.
Couplings are judged against the geometric mean of the masses they join."""


def blind_directions(
    chains: CoupledChains, known: Mapping[str, float], covariance: Float64, band_hz: tuple[float, float]
) -> tuple[frozenset[str], tuple[str, ...]]:
    """Parameters that the data do not determine, and a sentence for every direction of large variance.

    ``known`` are all parameters by name in the order of ``covariance``; of dampers is said only what is not
    seen at all.
    """
    names = list(known)
    scale = np.array([_scale(chains, n, v) for n, v in known.items()])
    relative = np.sqrt(np.maximum(np.diag(covariance), 0.0)) / scale
    is_judged = np.array([".damper." not in n for n in names])
    loose = np.flatnonzero(is_judged & ~(relative < LIMIT))
    unseen = np.flatnonzero(~np.isfinite(relative))
    sentences = _direction_sentences(names, covariance, scale, loose, _advice(chains, band_hz))
    sentences += [
        sentence("{symbol}: not seen by these data at all", symbol=_symbol(names[k]))
        for k in unseen
        if not is_judged[k]
    ]
    return frozenset(names[k] for k in (*loose, *unseen)), tuple(sentences)


def _direction_sentences(
    names: Sequence[str], covariance: Float64, scale: Float64, loose: Int64, advice: str
) -> list[str]:
    is_lost = ~np.isfinite(np.diag(covariance)[loose])
    out = [
        sentence("{symbol}: not seen by these data; {advice}", symbol=_symbol(names[k]), advice=advice)
        for k in loose[is_lost]
    ]
    rest = loose[~is_lost]
    if rest.size == 0:
        return out
    size, vectors = np.linalg.eigh(covariance[np.ix_(rest, rest)] / scale[rest][:, None] / scale[rest])
    covered: set[int] = set()
    for at in np.argsort(size)[::-1]:
        if size[at] < LIMIT**2 or len(covered) == rest.size:
            break
        vector = vectors[:, at]
        members = [int(k) for k in np.flatnonzero(np.abs(vector) > 0.3 * np.abs(vector).max())]
        if covered.issuperset(members):
            continue
        covered |= set(members)
        labels = [_symbol(names[rest[m]]) for m in members]
        error = _percent(np.sqrt(size[at]))
        if len(members) == 1:
            m = rest[members[0]]
            error = _percent(np.sqrt(covariance[m, m]) / scale[m])
            out.append(
                sentence(
                    "{label}: known to ±{error} only; {advice}", label=labels[0], error=error, advice=advice
                )
            )
        elif len(members) == 2:
            is_ratio = vector[members[0]] * vector[members[1]] > 0
            relation = sentence("ratio") if is_ratio else sentence("product")
            out.append(
                sentence(
                    "{first} and {other}: only as a {relation} (±{error} each); {advice}",
                    first=labels[0],
                    other=labels[1],
                    relation=relation,
                    error=error,
                    advice=advice,
                )
            )
        else:
            out.append(
                sentence(
                    "{names}: only in combination (±{error}); {advice}",
                    names=", ".join(labels),
                    error=error,
                    advice=advice,
                )
            )
    return out


def _advice(chains: CoupledChains, band_hz: tuple[float, float]) -> str:
    try:
        modes = np.asarray(resonances(chains)) / 2 / np.pi
    except (ValueError, np.linalg.LinAlgError):
        modes = np.zeros(0)
    above = modes[modes > 0.97 * band_hz[1]]
    if above.size:
        return sentence(
            "no excitation above {band_hz:.3g} Hz, and the model has resonances up to "
            "{highest_hz:.3g} Hz: excite up to {wanted_hz:.3g} Hz, or use fewer masses",
            band_hz=band_hz[1],
            highest_hz=above.max(),
            wanted_hz=1.3 * above.max(),
        )
    return sentence("raise the amplitude or measure longer; if that does not help, use fewer masses")


def _scale(chains: CoupledChains, name: str, value: float) -> float:
    pair = name.removesuffix(".coupling")
    for (a, one), (b, other) in product(zip(chains.axes, chains.masses, strict=True), repeat=2):
        if pair != name and pair == f"{a}-{b}":
            return float(np.sqrt(one[-1] * other[-1]))
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
