"""Results that nobody can change by accident: mappings, lists and arrays made read-only, in depth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any, NoReturn, TypeVar

import numpy as np

_Value = TypeVar("_Value")


class FrozenDict(dict[Any, Any]):
    """A dict that refuses to be changed; JSON and pickle take it as what it is."""

    def _refuse(self, *_: Any, **__: Any) -> NoReturn:
        raise TypeError("results are immutable; work on a copy: dict(…)")

    __setitem__ = __delitem__ = __ior__ = _refuse
    clear = pop = popitem = setdefault = update = _refuse

    def __reduce__(self) -> tuple[Any, ...]:
        return FrozenDict, (dict(self),)


def immutable(value: _Value) -> _Value:
    """``value`` with its mappings refusing changes, its lists as tuples, its arrays as read-only views.

    Frozen dataclasses are gone through field by field. What is handed in stays as it was.
    """
    result: Any = value
    if is_dataclass(value) and not isinstance(value, type):
        changed = {}
        for f in fields(value):
            old = getattr(value, f.name)
            new = immutable(old)
            if f.init and new is not old:
                changed[f.name] = new
        result = replace(value, **changed) if changed else value
    elif isinstance(value, np.ndarray):
        if value.flags.writeable:
            result = value.view()
            result.setflags(write=False)
    elif isinstance(value, FrozenDict):
        pass
    elif isinstance(value, Mapping):
        result = FrozenDict((k, immutable(v)) for k, v in value.items())
    elif isinstance(value, list):
        result = tuple(immutable(v) for v in value)
    elif isinstance(value, tuple) and type(value) is tuple:
        inside = tuple(immutable(v) for v in value)
        result = value if all(a is b for a, b in zip(value, inside, strict=True)) else inside
    return result  # type: ignore[no-any-return]
