"""Bodies that hold sentences carry what other languages need to say them."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, computed_field

from invid.wording.sentence import wording_of


class Spoken(BaseModel):
    """A body with sentences."""

    @computed_field  # type: ignore[prop-decorator]
    @property
    def wording(self) -> dict[str, Any]:
        """Template and values of each of its sentences, by its English text."""
        return wording_of(vars(self))
