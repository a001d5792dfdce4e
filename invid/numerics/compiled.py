"""Compile functions with Numba where it works; plain Python with one warning where it does not.

What is compiled is kept on disk: beside the module where that can be written, else in the user's cache
folder, or in ``NUMBA_CACHE_DIR`` where that is set. The first run after an installation compiles, some
seconds in all, and tells it as progress. Numba is loaded when the first compiled function is called: a
command that calls none does not pay for it.
"""

from __future__ import annotations

import functools
import importlib
import warnings
from collections.abc import Callable
from typing import Any, TypeVar, cast

from invid.numerics import budget

COMPILING = "compiling, once after an installation"

_Function = TypeVar("_Function", bound=Callable[..., Any])


class _Deferred:
    """A function that is compiled, or read from the cache on disk, when it is called first."""

    def __init__(self, function: Callable[..., Any], inline: bool) -> None:
        functools.update_wrapper(self, function)
        self.py_func, self._inline = function, inline
        self._ready: Any = None

    def __call__(self, *given: Any) -> Any:
        return (self._ready or self.ready())(*given)

    def ready(self) -> Any:
        """The compiled function; those that it calls take their places in its module, where numba looks."""
        if self._ready is None:
            names = self.py_func.__globals__
            for name in self.py_func.__code__.co_names:
                if isinstance(names.get(name), _Deferred):
                    names[name] = names[name].ready()
            self._ready = _fast(self.py_func, self._inline)
        return self._ready


def compiled(function: _Function) -> _Function:
    """``numba.njit`` with its cache on disk, without the cache where that cannot be written."""
    return cast("_Function", _Deferred(function, inline=False))


def inlined(function: _Function) -> _Function:
    """A piece of compiled functions, put where it is called: a call costs as much as such a piece does."""
    return cast("_Function", _Deferred(function, inline=True))


@functools.cache
def _numba() -> Any:
    """Numba, which then tells when it compiles; ``None``, with a warning, where it cannot be used."""
    try:
        numba = importlib.import_module("numba")
        event: Any = importlib.import_module("numba.core.event")
    except Exception as error:  # numba lags new Python and numpy releases
        warnings.warn(
            f"numba cannot be used here ({error}); simulation runs uncompiled, about a hundred times slower",
            RuntimeWarning,
            stacklevel=4,
        )
        return None

    class Told(event.Listener):  # type: ignore[misc]
        def on_start(self, _: Any) -> None:
            budget.tell(COMPILING, 0.0)

        def on_end(self, _: Any) -> None:
            pass

    event.register("numba:compile", Told())
    return numba


def _fast(function: Callable[..., Any], inline: bool) -> Any:
    numba = _numba()
    if numba is None:
        return function
    if inline:
        return numba.njit(inline="always")(function)
    try:
        return numba.njit(cache=True, nogil=True)(function)
    except RuntimeError:  # "cannot cache function: no locator available": read-only installation
        return numba.njit(nogil=True)(function)


__all__ = ["COMPILING", "compiled", "inlined"]
