"""No module of the core needs itself to be there first; one loop owns the bus."""

import re
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import grimp
import pytest

import invid_drivers


def test_no_module_of_the_core_imports_itself_by_way_of_others() -> None:
    graph = grimp.build_graph("invid", cache_dir=None)
    needs = {m: graph.find_modules_directly_imported_by(m) for m in graph.modules}
    try:
        order = list(TopologicalSorter(needs).static_order())
    except CycleError as error:
        pytest.fail(" → ".join(error.args[1]))
    assert len(order) > 200


@pytest.mark.parametrize(
    ("call", "owner"),
    [(r"_cycle\.(exchange|silent_cycle)\(", "supervisor"), (r"\.(tick|enter)\(", "bus|supervis")],
)
def test_no_cycle_is_made_and_no_state_is_set_beside_the_one_loop(call: str, owner: str) -> None:
    modules = (Path(invid_drivers.__path__[0]) / "cia402").rglob("*.py")
    makers = {m.stem for m in modules if re.search(call, m.read_text(encoding="utf-8"))}
    assert makers
    assert all(re.match(owner, m) for m in makers), makers


def test_procedures_command_nothing_by_themselves() -> None:
    graph = grimp.build_graph("invid_drivers", cache_dir=None)
    needs = graph.find_modules_directly_imported_by("invid_drivers.cia402.procedures")
    assert not {n for n in needs if re.search(r"\.(link|cycle|bus|access|axis|objects)$", n)}
