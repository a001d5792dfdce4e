"""A store with one finished run, made once a worker: who only looks at a result opens a copy of it."""

import shutil
from pathlib import Path

import pytest
from service_process import STIFF_CELL, serving


@pytest.fixture(scope="session")
def measured(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Data folder of ``STIFF_CELL`` and the address of a run that awaits its decision."""
    folder = tmp_path_factory.mktemp("measured")
    with serving(folder, cell=STIFF_CELL) as service:
        location = service.run_to_result()
    return folder / "data", location


@pytest.fixture
def finished(measured: tuple[Path, str], tmp_path: Path) -> str:
    """Address of the run in a copy of its own, where ``serving(tmp_path, cell=STIFF_CELL)`` finds it."""
    shutil.copytree(measured[0], tmp_path / "data")
    return measured[1]
