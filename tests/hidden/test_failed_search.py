"""What is said where a search ends in no number at all."""

from dataclasses import replace

import numpy as np
import pytest

from hidden.generator import make
from invid.diagnosis import diagnose as search
from invid.errors import NotIdentifiableError
from invid.identification import identify as identification


def test_a_search_that_ends_in_no_number_is_a_plain_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(*_: object, **__: object) -> None:
        raise np.linalg.LinAlgError("Eigenvalues did not converge")

    recording, _ = make(None, seed=3, masses=(2,), noise=0.003)
    monkeypatch.setattr(identification, "begin_elastic", lost)
    monkeypatch.setattr(search, "begin_elastic", lost)
    with pytest.raises(NotIdentifiableError, match="no chain of masses and springs"):
        identification.identify(replace(recording, source="cell.h5"))
    with pytest.raises(NotIdentifiableError):
        search.diagnose(recording)
