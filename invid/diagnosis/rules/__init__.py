"""Special rules of the search, one a module, and their list (``catalogue``), loaded when first used.

The search imports none of them: it calls ``invid.diagnosis.context``.
"""

from importlib import import_module
from typing import Any


def __getattr__(name: str) -> Any:
    if name not in ("RULES", "BY_NAME"):
        raise AttributeError(f"module 'invid.diagnosis.rules' has no attribute {name!r}")
    return getattr(import_module("invid.diagnosis.rules.catalogue"), name)
