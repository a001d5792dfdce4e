"""Why a cell is not ready: one answer for ``invid check`` and for the service."""

from __future__ import annotations

from collections.abc import Sequence

from invid.config import CellConfig
from invid.errors import InvidError
from invid_drivers.cia402.hold_memory import HoldMemory
from invid_drivers.cia402.holding import Reason, remembered, to_support
from invid_drivers.cia402.journal import journal_path
from invid_drivers.connect import connect, is_virtual


def loads_to_support(config: CellConfig) -> tuple[str, ...]:
    """Axes whose hold after a stop the next measurement tries: what they carry must not be able to fall far.

    None where no hardware stands behind the config.
    """
    if config.simulated:
        return ()
    return to_support(config, HoldMemory.beside(journal_path(config.bus.interface, config.bus.channel)))


def support_sentence(axes: Sequence[str]) -> str:
    """What a person does about these axes before anything moves."""
    return (
        f"how {', '.join(axes)} is held after a stop was not seen yet; where it carries a load, that is "
        "tried first, at rest. Support it so that it cannot fall far and still hangs on its drive"
    )


def not_ready(config: CellConfig) -> tuple[Reason, ...]:
    """Axes that an earlier run left energised, or ended at; empty: none.

    The bus is opened only where there was one: then the drives say whether they still are, as in ``check``.
    """
    if is_virtual(config):
        return ()
    said = remembered(config, HoldMemory.beside(journal_path(config.bus.interface, config.bus.channel)))
    if not said:
        return ()
    try:
        cell = connect(config)
    except InvidError:
        return said
    try:
        cell.check()
        return cell.not_ready
    except InvidError:
        return said
    finally:
        cell.close()
