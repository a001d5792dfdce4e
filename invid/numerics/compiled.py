"""Numba where it works, plain Python with one warning where it does not.

What is compiled is kept on disk: beside the module where that can be written, else in the user's cache
folder, or in ``NUMBA_CACHE_DIR`` where that is set. The first run after an installation compiles, some
seconds in all, and tells it as progress.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, TypeVar, cast

from invid.numerics import budget

try:
    import numba
    from numba.core import event
except Exception as error:  # numba lags new Python and numpy releases
    _MISSING: Exception | None = error
else:
    _MISSING = None

COMPILING = "compiling, once after an installation"

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


def _tell_of_compiling() -> None:
    """Numba says when it compiles and not when it reads its cache."""

    events: Any = event

    class Told(events.Listener):  # type: ignore[misc]
        def on_start(self, _: Any) -> None:
            budget.tell(COMPILING, 0.0)

        def on_end(self, _: Any) -> None:
            pass

    events.register("numba:compile", Told())


if _MISSING is None:
    _tell_of_compiling()
