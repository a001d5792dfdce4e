"""What installed packages offer by entry points: effects, kinds of files, exports, forms of drives."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.metadata import entry_points
from typing import Any

from invid.errors import InputError, InvidError


def extension_names(group: str) -> list[str]:
    """The names that packages offer in a group of entry points, sorted."""
    return sorted({p.name for p in entry_points(group=group)})


def load_extensions(group: str, name: str | None = None) -> Iterator[tuple[str, Any]]:
    """Who offers it, in words, and what packages offer in a group, by one name or all in their order.

    Raises
    ------
    InputError
        One that cannot be loaded.
    """
    for entry in sorted(entry_points(group=group), key=lambda e: e.name):
        if name not in (None, entry.name):
            continue
        package = "a package" if entry.dist is None else f"package {entry.dist.name}"
        where = f"{package}, entry point {entry.name!r} of {group}"
        try:
            held = entry.load()
        except Exception as error:  # whatever a stranger's package raises
            raise InputError(f"{where}: {error_text(error)}; mend or uninstall the package") from None
        yield where, held


def load_extension(group: str, name: str) -> Any:
    """What a package offers by a name; ``None`` where none does."""
    return next((held for _, held in load_extensions(group, name)), None)


def error_text(error: Exception) -> str:
    """What an exception of a stranger's code says in one line, with its kind where invid did not raise it."""
    text = " ".join(str(error.msg if isinstance(error, SyntaxError) else error).split())
    return text if isinstance(error, InvidError) else f"{type(error).__name__}: {text}"
