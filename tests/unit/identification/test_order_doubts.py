"""The number of masses: what the motors cannot tell is said."""

from __future__ import annotations

from invid.identification.model_facts import _doubts_of_order
from invid.identification.model_order import OrderSearch, OrderTrial, _add_masses, _equivalent_structures


def test_structures_with_as_many_masses_that_fit_alike_are_named() -> None:
    costs = {(2, 2): 9e5, (3, 3): 995.0, (3, 2): 1000.0, (2, 3): 1000.4, (4, 1): 1300.0}
    trials = {sizes: OrderTrial(cost, 1000) for sizes, cost in costs.items()}
    assert _equivalent_structures((3, 2), trials) == [(2, 3)]
    (doubt,) = _doubts_of_order({"chosen": [3, 2], "alike": [[2, 3]]})
    assert "3,2 and 2,3" in doubt.text
    assert _doubts_of_order({"chosen": [3, 3], "alike": []}) == []


def test_a_mass_is_added_to_one_branch_where_more_on_all_did_not_pay() -> None:
    costs = {(2, 2): 9e5, (3, 2): 8e5, (2, 3): 1000.0, (3, 3): 999.0, (2, 4): 999.5}

    class Counted(OrderSearch):
        """A search whose structures have these costs."""

        most = 6

        def __init__(self) -> None:
            pass

        def cost(self, sizes: tuple[int, ...]) -> float:
            return costs.get(sizes, 1e9)

        def is_needed(self, small: tuple[int, ...], large: tuple[int, ...]) -> bool:
            return costs[small] > 2000 and costs[small] > 1.3 * costs.get(large, 1e9)

    assert _add_masses((2, 2), Counted()) == (2, 3)
