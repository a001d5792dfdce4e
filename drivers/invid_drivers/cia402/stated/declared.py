"""What a drive's EDS means for its use: refused before it is asked, or a warning."""

from __future__ import annotations

from pathlib import Path

from invid.errors import ConfigError
from invid_drivers.cia402 import objects as od
from invid_drivers.cia402.objects import OFFSET_MAP, RPDO_MAP, TPDO_MAP
from invid_drivers.cia402.states import OperationMode
from invid_drivers.eds import Declared, parse_eds, stated


def declared_of(axis: str, file: str | None, node_id: int) -> tuple[Declared | None, tuple[str, ...]]:
    """The EDS that a config names, and warnings.

    A file that does not parse is a warning: the drive is asked instead. ConfigError where there is none.
    """
    if file is None:
        return None, ()
    try:
        return parse_eds(Path(file), node_id), ()
    except OSError as error:
        raise ConfigError(
            f"axis {axis}: eds {file!r} cannot be read ({error.strerror}); give its path from the config's "
            "folder, or leave eds out: the drive is then asked for everything"
        ) from None
    except ValueError as error:
        return None, (f"axis {axis}: EDS {file} {error}; the drive itself is asked for everything",)


def refusal(declared: Declared, *, by_offset: bool = False) -> str | None:
    """Why a drive like this cannot be shaken; ``None`` where nothing speaks against it.

    ``by_offset``: its torque offset would do in place of its target torque.
    """
    wanted = OFFSET_MAP if by_offset and _has_offset_alone(declared) else RPDO_MAP
    for objects, what_is_lost in ((wanted, "cannot be commanded"), (TPDO_MAP, "cannot be measured")):
        for what in objects:
            entry = declared.find(what.index, what.sub)
            if entry is None:
                return f"has no {what.address} ({what.name}), which therefore {what_is_lost}"
            if not entry.pdo_mappable:
                return (
                    f"does not let {what.address} ({what.name}) into a PDO, which therefore "
                    f"{what_is_lost} in every cycle"
                )
    for kind, count in (("receive", declared.rpdos), ("transmit", declared.tpdos)):
        if count < 1:
            return f"has no {kind} PDO: nothing can be exchanged in every cycle"
    return None


def _has_offset_alone(declared: Declared) -> bool:
    """Cyclic synchronous position and a torque offset, but no target torque."""
    modes = stated(declared.find(od.SUPPORTED_MODES.index, 0))
    found = modes if isinstance(modes, int) else 0
    torque = OperationMode.CYCLIC_TORQUE.supported_bit | OperationMode.PROFILE_TORQUE.supported_bit
    follows = bool(found & OperationMode.CYCLIC_POSITION.supported_bit) and not found & torque
    offset = all(declared.find(o.index, o.sub) is not None for o in (od.TORQUE_OFFSET, od.TORQUE))
    return follows and offset and declared.find(od.TARGET_TORQUE.index, 0) is None
