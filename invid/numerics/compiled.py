"""Numba where it works, plain Python with one warning where it does not."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, TypeVar, cast

try:
    import numba
except Exception as error:  # numba lags new Python and numpy releases
    _MISSING: Exception | None = error
else:
    _MISSING = None

_Function = TypeVar("_Function", bound=Callable[..., Any])


def compiled(function: _Function) -> _Function:
    """``numba.njit`` with its cache on disk, without the cache where that cannot be written."""
    if _MISSING is not None:
        warnings.warn(
            f"numba cannot be used here ({_MISSING}); simulation runs uncompiled, about a hundred times "
            "slower",
            RuntimeWarning,
            stacklevel=2,
        )
        return function
    try:
        fast: Any = numba.njit(cache=True, nogil=True)(function)
    except RuntimeError:  # "cannot cache function: no locator available": read-only installation
        fast = numba.njit(nogil=True)(function)
    return cast("_Function", fast)
