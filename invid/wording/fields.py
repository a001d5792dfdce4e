"""The type of a field that holds a text for people."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import WrapValidator

from invid.wording.sentence import Sentence


def _keep(value: Any, check: Any) -> str:
    return value if isinstance(value, Sentence) else str(check(value))


Text = Annotated[str, WrapValidator(_keep)]
"""A ``str`` of a pydantic model or dataclass that stays the ``Sentence`` it is."""
