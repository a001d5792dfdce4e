"""The state machine against the standard's transition table, every state and every controlword."""

from __future__ import annotations

import itertools

import pytest

from invid_drivers.simulated.state_machine import State, command_of, transition

# IEC 61800-7-201: transition number, from, to, and the controlwords that cause it as "7 3 2 1 0" bits;
# "u" is the rising edge of bit 7
TABLE = [
    (2, "SWITCH_ON_DISABLED", "READY_TO_SWITCH_ON", "0x110"),
    (3, "READY_TO_SWITCH_ON", "SWITCHED_ON", "00111"),
    (3, "READY_TO_SWITCH_ON", "SWITCHED_ON", "01111"),  # and on to 4 by itself
    (4, "SWITCHED_ON", "OPERATION_ENABLED", "01111"),
    (5, "OPERATION_ENABLED", "SWITCHED_ON", "00111"),
    (6, "SWITCHED_ON", "READY_TO_SWITCH_ON", "0x110"),
    (7, "READY_TO_SWITCH_ON", "SWITCH_ON_DISABLED", "0xx0x"),
    (7, "READY_TO_SWITCH_ON", "SWITCH_ON_DISABLED", "0x01x"),
    (8, "OPERATION_ENABLED", "READY_TO_SWITCH_ON", "0x110"),
    (9, "OPERATION_ENABLED", "SWITCH_ON_DISABLED", "0xx0x"),
    (10, "SWITCHED_ON", "SWITCH_ON_DISABLED", "0xx0x"),
    (10, "SWITCHED_ON", "SWITCH_ON_DISABLED", "0x01x"),
    (11, "OPERATION_ENABLED", "QUICK_STOP_ACTIVE", "0x01x"),
    (12, "QUICK_STOP_ACTIVE", "SWITCH_ON_DISABLED", "0xx0x"),
    (15, "FAULT", "SWITCH_ON_DISABLED", "uxxxx"),
    (16, "QUICK_STOP_ACTIVE", "OPERATION_ENABLED", "01111"),
]


def matches(pattern: str, word: int, previous: int) -> bool:
    for symbol, bit in zip(pattern, (7, 3, 2, 1, 0), strict=True):
        value = word >> bit & 1
        if symbol == "u" and not (value and not previous >> 7 & 1):
            return False
        if symbol in "01" and value != int(symbol):
            return False
    return True


@pytest.mark.parametrize("state", list(State))
def test_every_controlword_in_every_state_does_what_the_table_says(state: State) -> None:
    for word, previous in itertools.product(range(256), (0x00, 0x80)):
        wanted = {
            (number, State[target])
            for number, source, target, pattern in TABLE
            if State[source] is state and matches(pattern, word, previous)
        }
        assert len(wanted) <= 1, "the table itself must be without contradiction"
        found = transition(state, command_of(word, previous))
        assert ({found} if found else set()) == wanted, f"{state.name}, controlword {word:#04x}"


def test_state_bits_are_the_statuswords() -> None:
    assert {s.name: int(s) for s in State} == {
        "NOT_READY_TO_SWITCH_ON": 0x00,
        "SWITCH_ON_DISABLED": 0x40,
        "READY_TO_SWITCH_ON": 0x21,
        "SWITCHED_ON": 0x23,
        "OPERATION_ENABLED": 0x27,
        "QUICK_STOP_ACTIVE": 0x07,
        "FAULT_REACTION_ACTIVE": 0x0F,
        "FAULT": 0x08,
    }
