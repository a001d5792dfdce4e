"""What installed packages offer by entry points: kinds of files, exports, forms of drives."""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Any


def extension_names(group: str) -> list[str]:
    """The names that packages offer in a group of entry points, sorted."""
    return sorted({p.name for p in entry_points(group=group)})


def load_extension(group: str, name: str) -> Any:
    """What a package offers by a name; ``None`` where none does."""
    return next((p.load() for p in entry_points(group=group, name=name)), None)
