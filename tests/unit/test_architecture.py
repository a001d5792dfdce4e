"""The shape of the core: folders that can be overseen, and no module that needs itself to be there first."""

from __future__ import annotations

from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).parents[2]
CORE = ROOT / "invid"
FOLDERS = sorted({p.parent for p in CORE.rglob("*.py")})


def test_no_module_of_the_core_imports_itself_by_way_of_others() -> None:
    graph = grimp.build_graph("invid", cache_dir=None)
    needs = {m: graph.find_modules_directly_imported_by(m) for m in graph.modules}
    try:
        order = list(TopologicalSorter(needs).static_order())
    except CycleError as error:
        pytest.fail(" → ".join(error.args[1]))
    assert len(order) > 200


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda f: str(f.relative_to(ROOT)))
def test_a_folder_of_the_core_can_be_overseen(folder: Path) -> None:
    modules = [p.name for p in folder.glob("*.py") if p.name not in ("__init__.py", "__main__.py")]
    assert len(modules) <= (12 if folder == CORE else 25), modules
