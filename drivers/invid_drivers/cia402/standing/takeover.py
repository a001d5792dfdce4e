"""A drive found under power: seen before it is sent anything, then taken over or left as it is."""

from __future__ import annotations

from collections.abc import Sequence

from invid.errors import DriveError
from invid.wording.sentence import sentence
from invid_drivers.cia402 import objects as od
from invid_drivers.cia402.axis import Drive, ModeSet
from invid_drivers.cia402.standing.hold_memory import HoldMemory
from invid_drivers.cia402.standing.holding import AxisHolding
from invid_drivers.cia402.states import DriveState, OperationMode, is_energised

NMT_OPERATIONAL, NMT_PRE_OPERATIONAL = 5, 127
"""In a heartbeat (CiA 301): the node answers SDO."""


def state_before_nmt(drive: Drive) -> DriveState | None:
    """The state of a drive that was sent nothing yet; ``None`` where it answers no SDO (NMT stopped).

    DriveError where its heartbeat says that it should answer and it does not: what it is doing is not known.
    """
    state = drive.quiet_state()
    if state is None:
        heard = drive.link.peers[drive.node_id].nmt_state
        if heard in (NMT_OPERATIONAL, NMT_PRE_OPERATIONAL):
            drive.read(od.STATUSWORD)
    return state


def find_powered(drives: Sequence[Drive], memory: HoldMemory) -> tuple[dict[str, DriveState], list[Drive]]:
    """States of the drives to which nothing may be sent, and the drives that do not answer.

    Energised ones, and those at which a run ended beside a load: what they show may not be believed.
    """
    powered, silent = {}, []
    for drive in drives:
        state, seen = state_before_nmt(drive), memory.of_axis(drive.node_id, drive.of_node.number)
        drive.left_alone = seen is not None and bool(seen.suspect)
        drive.link.gate.nodes[drive.node_id].left_alone |= drive.left_alone
        if state is None:
            silent.append(drive)
        elif drive.left_alone or is_energised(state):
            powered[drive.name] = state
    return powered, silent


WAY_OUT = sentence(
    "With its load supported, take its enable or supply away, run `invid check`, and start again"
)


def require_mode(drive: Drive, mode: OperationMode) -> ModeSet:
    """DriveError where a held drive that changes no mode now would go back to operation in another one."""
    shown = drive.read(od.MODE_DISPLAY)
    if shown == int(mode):
        return ModeSet.SHOWN
    raise DriveError(
        sentence(
            "{who}: it is held in quick stop active in mode {shown} (0x6061) and takes no "
            "other there (0x6060): it would go back to operation in that mode, perhaps without "
            "torque. {way_out}",
            who=drive.who,
            shown=shown,
            way_out=WAY_OUT,
        ),
        axis=drive.name,
    )


def require_ours(drive: Drive, holding: AxisHolding) -> None:
    """DriveError unless a drive under power is held as this program leaves it, and can be taken over."""
    state = holding.state
    way_out = sentence("{way_out}; nothing was sent to it", way_out=WAY_OUT)
    if state is not DriveState.QUICK_STOP_ACTIVE:
        raise DriveError(
            sentence(
                "{who}: it is energised, in {words}, and not by this program: end the program that "
                "drives it. Or: {way_out}",
                who=drive.who,
                words=state.words,
                way_out=way_out,
            ),
            axis=drive.name,
        )
    if holding.seen.resumes is False:
        raise DriveError(
            sentence(
                "{who}: it is held in {words}, and does not go back to operation from there "
                "(transition 16, seen in a stop test): it cannot be taken over without letting go. "
                "{way_out}",
                who=drive.who,
                words=state.words,
                way_out=way_out,
            ),
            axis=drive.name,
        )
    require_mapped(drive)


def require_mapped(drive: Drive) -> None:
    """DriveError where an axis of a node that holds a load is not mapped as this program leaves it."""
    if not _is_mapped(drive):
        raise DriveError(
            sentence(
                "{who}: its node holds a load, and its PDOs are not those of this program: they "
                "cannot be changed under power. {way_out}; nothing was sent to it",
                who=drive.who,
                way_out=WAY_OUT,
            ),
            axis=drive.name,
        )


def _is_mapped(drive: Drive) -> bool:
    """Whether PDO 1 both ways is as ``map_pdos`` leaves it."""
    for kind, objects in (
        ("RPDO", od.RPDO_MAP),
        ("TPDO", od.TPDO_MAP),
    ):
        cob = drive.of_node.cob_id(kind, drive.node_id)
        wanted = tuple(map(drive.of_node.at, objects))
        if (drive.find(od.pdo_communication(kind, 1, 1)) or 0) & 0xBFFFFFFF != cob:
            return False
        if drive.find(od.pdo_mapping(kind, 1, 0)) != len(wanted):
            return False
        shown = (drive.find(od.pdo_mapping(kind, 1, n)) for n in range(1, len(wanted) + 1))
        if any(found != what.mapping for found, what in zip(shown, wanted, strict=True)):
            return False
    return True
