"""Arguments of the public functions: what cannot be used is one sentence with the way out.

Python hands anything to anything: a path where a recording belongs would end as an AttributeError deep
inside, and a word nobody knows would quietly be taken for the default.
"""

from __future__ import annotations

import math
import os
from collections.abc import Collection, Iterable, Sequence
from datetime import datetime
from numbers import Integral, Real
from pathlib import Path
from typing import Any

import numpy as np

from invid.effects.effect import Effect
from invid.errors import InputError
from invid.model.diagnosis_document import Diagnosis, model_of
from invid.model.document import Model
from invid.recording.model import Recording


def _refused(name: str, value: object, needed: str) -> InputError:
    if isinstance(value, os.PathLike):
        text = repr(os.fspath(value))
    elif value is None or isinstance(value, str | int | float):
        text = repr(value)
    elif isinstance(value, list | tuple) and all(
        v is None or isinstance(v, str | int | float) for v in value
    ):
        text = repr(list(value))
    else:
        text = f"of type {type(value).__name__}"
    return InputError(f"{name} is {text if len(text) <= 80 else text[:77] + '…'}; {needed}")


def a_path(value: object, name: str) -> Path:
    """A file's path."""
    if not isinstance(value, str | os.PathLike):
        raise _refused(name, value, "give the path of a file")
    return Path(value)


def paths(value: object, name: str) -> list[Path]:
    """One path or several."""
    if isinstance(value, str | os.PathLike) or not isinstance(value, Iterable):
        return [a_path(value, name)]
    return [a_path(one, name) for one in value]


def a_recording(value: object, name: str = "recording") -> Recording:
    """A recording that was read."""
    if isinstance(value, Recording):
        return value
    raise _refused(name, value, "give a recording, as invid.read_recording(path) returns it")


def recordings(value: object) -> Sequence[Recording]:
    """One recording or several."""
    if isinstance(value, str | os.PathLike) or not isinstance(value, Iterable):
        return [a_recording(value)]
    return [a_recording(one, f"recording {k + 1}") for k, one in enumerate(value)]


def a_model(value: object, name: str = "model") -> Model:
    """A model that was identified or loaded; of a diagnosis the extended one."""
    if isinstance(value, Model | Diagnosis):
        return model_of(value)
    raise _refused(name, value, "give a model, as invid.load_model(path) or invid.identify(…) returns it")


def mass_counts(value: object, axes: Sequence[str]) -> Any:
    """Masses of each axis; "auto" and ``None`` as they are."""
    if value is None or (isinstance(value, str) and value == "auto"):
        return value
    needed = f"give one whole number ≥ 1 for each axis of {list(axes)}, or 'auto'"
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise _refused("masses", value, needed)
    whole = all(isinstance(n, Integral) and not isinstance(n, bool) and int(n) >= 1 for n in value)
    if not whole or len(value) != len(axes):
        raise _refused("masses", list(value), needed)
    return tuple(int(n) for n in value)


def a_number(value: object, name: str, needed: str, *, above: float = -math.inf) -> None:
    """A real number larger than ``above``."""
    if isinstance(value, bool) or not isinstance(value, Real) or not float(value) > above:
        raise _refused(name, value, needed)


def a_time(value: object, name: str) -> None:
    """An ISO 8601 time, or ``None``."""
    needed = "give an ISO 8601 time such as '2026-01-31T12:00:00Z'"
    if value is None:
        return
    if not isinstance(value, str):
        raise _refused(name, value, needed)
    try:
        datetime.fromisoformat(value)
    except ValueError:
        raise _refused(name, value, needed) from None


def one_of(value: object, name: str, choices: Sequence[str]) -> None:
    """One of a few words."""
    if not isinstance(value, str) or value not in choices:
        raise _refused(name, value, f"give {' or '.join(repr(c) for c in choices)}")


def a_function(value: object, name: str) -> None:
    """Something that can be called, or ``None``."""
    if value is not None and not callable(value):
        raise _refused(name, value, "give a function of one argument, an invid.Progress, or None")


def effect_list(value: object) -> list[Any]:
    """Effects or their files."""
    if isinstance(value, str | os.PathLike) or not isinstance(value, Iterable):
        raise _refused("effects", value, "give a list of invid.effects.Effect objects or of files")
    for one in value:
        if not isinstance(one, Effect | str | os.PathLike):
            raise _refused("effects", one, "each must be an invid.effects.Effect object or a file")
    return list(value)


def a_generator(value: object) -> None:
    """A source of chance, or ``None``."""
    if value is not None and not isinstance(value, np.random.Generator):
        raise _refused("rng", value, "give a generator, as numpy.random.default_rng(seed), or None")


def experiment_keys(value: object, recording: Recording) -> Collection[str] | None:
    """Keys of experiments that the recording has; ``None`` for all."""
    if value is None:
        return None
    there = [e.key for e in recording.experiments]
    if isinstance(value, str) or not isinstance(value, Collection) or set(value) - set(there):
        raise _refused("only", value, f"give a list of keys of the recording's experiments: {there}")
    return value
