"""A CANopen node (CiA 301): NMT, SDO, PDO, SYNC, heartbeat, emergency. Knows no drive and no clock.

The node is driven from outside: frames through ``handlers``, time through callbacks that it asks its
``Host`` for. The drive profile is the ``Application``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from enum import IntEnum
from itertools import count, takewhile
from typing import Protocol

from invid_drivers.simulated import pdo
from invid_drivers.simulated.object_dictionary import Entry, ObjectDictionary, SdoAbort
from invid_drivers.simulated.sdo import SdoServer

_MS = 1_000_000
_PDOS = ((0x1400, 0x1600, "w"), (0x1800, 0x1A00, "r"))
"""First communication and mapping object of the received and of the sent PDOs, and which way they go."""
Handler = Callable[[bytes, int], None]


class Nmt(IntEnum):
    """NMT states as in the heartbeat."""

    INITIALISING = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class Host(Protocol):
    """What a node needs from the cell it stands in."""

    def emit(self, node: Node, can_id: int, data: bytes, delay_ns: int = 0) -> None:
        """Put a frame on the bus."""

    def schedule(self, due_ns: int, callback: Callable[[int], None]) -> None:
        """Call back once at a time."""

    def rewire(self) -> None:
        """Learn that the identifiers that a node listens to have changed."""


class Application(Protocol):
    """The device profile on top of the node."""

    def tick(self, now_ns: int) -> None:
        """Act on the values received."""

    def configured(self) -> None:
        """Learn that the object dictionary may have changed other than by a PDO."""

    def connection_lost(self, now_ns: int) -> None:
        """React to a lost heartbeat, to bus-off, or to NMT taking the node out of operation."""

    def reset(self, now_ns: int) -> None:
        """Return to the power-on state."""


class Node:
    """CANopen communication of one device."""

    def __init__(self, node_id: int, od: ObjectDictionary, host: Host, *, sdo_ns: int, boot_ns: int) -> None:
        self.node_id, self.od, self._host = node_id, od, host
        self.application: Application
        self.state = Nmt.INITIALISING
        self.silent = False
        self._sdo = SdoServer(od)
        self._sdo_ns, self._boot_ns = sdo_ns, boot_ns
        self._epoch = 0
        self._rpdos: list[pdo.ReceivePdo] = []
        self._tpdos: list[pdo.TransmitPdo] = []
        self._heard: dict[int, int] = {}
        self._guard_objects()

    # --- start and reset ---------------------------------------------------------------------
    def power_on(self, now_ns: int) -> None:
        """Boot: values as they come, then the boot-up message after the boot time."""
        self._epoch += 1
        epoch = self._epoch
        self.state = Nmt.INITIALISING
        for entry in self.od:
            entry.value = entry.default
        self._clear_communication()
        self.application.reset(now_ns)

        def booted(at_ns: int) -> None:
            if epoch == self._epoch:
                self._booted(at_ns)

        self._host.schedule(now_ns + self._boot_ns, booted)

    def _booted(self, now_ns: int) -> None:
        self.state = Nmt.PRE_OPERATIONAL
        self._host.emit(self, 0x700 + self.node_id, b"\0")
        self._start_heartbeat(now_ns)
        self._host.rewire()

    def _clear_communication(self) -> None:
        self.application.configured()
        self._sdo.reset()
        self._heard.clear()
        self._rpdos, self._tpdos = [], []
        self._host.rewire()

    def _reset_communication(self, now_ns: int) -> None:
        for entry in self.od:
            if 0x1000 <= entry.index <= 0x1FFF:
                entry.value = entry.default
        self._epoch += 1
        self.state = Nmt.INITIALISING
        self._clear_communication()
        self._booted(now_ns)

    def _guard_objects(self) -> None:
        od = self.od
        for communication, mapping, way in _PDOS:
            for n in self._pdo_numbers(communication):
                pdo.guard_configuration(
                    od, communication=communication + n, mapping=mapping + n, way=way, changed=self._rebuild
                )
        od.guard(0x1003, 0, self._clear_history)
        od.guard(0x1005, 0, self._check_sync_id, self._host.rewire)
        od.guard(0x1017, 0, None, self._start_heartbeat)
        for sub in range(1, od.number(0x1016) + 1):
            od.guard(0x1016, sub, self._write_consumer)

    def _clear_history(self, value: int) -> None:
        if value != 0:
            raise SdoAbort(SdoAbort.RANGE)
        for sub in range(1, 9):
            self.od.put(0x1003, sub, 0)

    def _check_sync_id(self, value: int) -> None:
        if value & 0x60000000 or not value & 0x7FF:
            raise SdoAbort(SdoAbort.RANGE)

    # --- heartbeat -----------------------------------------------------------------------------
    def _start_heartbeat(self, now_ns: int | None = None) -> None:
        token = self._heartbeat_token = object()

        def beat(at_ns: int) -> None:
            period = self.od.number(0x1017) * _MS
            if token is not self._heartbeat_token or not period or self.state is Nmt.INITIALISING:
                return
            self._host.emit(self, 0x700 + self.node_id, bytes([self.state]))
            self._host.schedule(at_ns + period, beat)

        period = self.od.number(0x1017) * _MS
        if period:
            self._host.schedule(0 if now_ns is None else now_ns + period, beat)

    def _write_consumer(self, value: int) -> None:
        producer = value >> 16 & 0x7F
        if value & 0xFFFF and not producer:
            raise SdoAbort(SdoAbort.RANGE)
        self._heard.pop(producer, None)
        self._host.rewire()

    def heard_producers(self) -> dict[int, int]:
        """Node ids whose heartbeat is consumed, and their timeout [ns]."""
        consumed: dict[int, int] = {}
        for sub in range(1, self.od.number(0x1016) + 1):
            value = self.od.number(0x1016, sub)
            if value & 0xFFFF and value >> 16 & 0x7F:
                consumed[value >> 16 & 0x7F] = (value & 0xFFFF) * _MS
        return consumed

    def _on_heartbeat(self, producer: int) -> Handler:
        def heard(_data: bytes, now_ns: int) -> None:
            first = producer not in self._heard
            self._heard[producer] = now_ns
            if first:
                self._watch(producer)

        return heard

    def _watch(self, producer: int) -> None:
        epoch = self._epoch

        def due() -> int | None:
            timeout, last = self.heard_producers().get(producer), self._heard.get(producer)
            return None if epoch != self._epoch or timeout is None or last is None else last + timeout

        def lost(at_ns: int) -> None:
            del self._heard[producer]  # watching resumes with the next heartbeat
            self.emergency(0x8130, 0x10, bytes([producer]))
            state = {0: Nmt.PRE_OPERATIONAL, 2: Nmt.STOPPED}.get(self.od.number(0x1029, 1))
            if self.state is Nmt.OPERATIONAL and state is not None:
                self._set_state(state, at_ns)
            else:
                self.application.connection_lost(at_ns)

        self._await(due, lost)

    def _await(self, due: Callable[[], int | None], missed: Callable[[int], None]) -> None:
        """Call ``missed`` once the instant of ``due`` is over; it may move on, ``None`` ends the watch."""

        def look(at_ns: int) -> None:
            instant = due()
            if instant is not None and at_ns >= instant:
                missed(at_ns)
            elif instant is not None:
                self._host.schedule(instant, look)

        look(-1)

    # --- emergency -----------------------------------------------------------------------------
    def emergency(self, code: int, register: int, vendor: bytes = b"", length: int = 8) -> None:
        """Send an EMCY and write the history; ``length`` other than 8 is what some drives do."""
        od = self.od
        od.put(0x1001, 0, register)
        if code:
            for sub in range(8, 1, -1):
                od.put(0x1003, sub, od.number(0x1003, sub - 1))
            od.put(0x1003, 1, code)
            od.put(0x1003, 0, min(od.number(0x1003) + 1, 8))
        cob = od.number(0x1014)
        if not cob & pdo.INVALID and self.state in (Nmt.PRE_OPERATIONAL, Nmt.OPERATIONAL):
            data = bytes([code & 0xFF, code >> 8, register]) + vendor[:5].ljust(5, b"\0")
            self._host.emit(self, cob & 0x7FF, data[:length])

    # --- NMT -----------------------------------------------------------------------------------
    def on_nmt(self, data: bytes, now_ns: int) -> None:
        """Obey an NMT command frame."""
        if len(data) != 2 or data[1] not in (0, self.node_id) or self.state is Nmt.INITIALISING:
            return
        command = data[0]
        state = {1: Nmt.OPERATIONAL, 2: Nmt.STOPPED, 128: Nmt.PRE_OPERATIONAL}.get(command)
        if state is not None:
            self._set_state(state, now_ns)
        elif command == 129:
            self.power_on(now_ns)
        elif command == 130:
            self.application.connection_lost(now_ns)
            self._reset_communication(now_ns)

    def _set_state(self, state: Nmt, now_ns: int) -> None:
        before, self.state = self.state, state
        if before is state:
            return
        self._rebuild()
        if before is Nmt.OPERATIONAL:
            self.application.connection_lost(now_ns)

    # --- PDO -----------------------------------------------------------------------------------
    def _rebuild(self) -> None:
        self._rpdos, self._tpdos = [], []
        if self.state is Nmt.OPERATIONAL:
            self._build_pdos()
        self._host.rewire()

    def _pdo_numbers(self, communication: int) -> Iterator[int]:
        """Numbers 0, 1, … of the PDOs that the drive has."""
        return takewhile(lambda n: self.od.find(communication + n, 1) is not None, count())

    def _valid_pdos(
        self, communication: int, mapping: int, way: str
    ) -> Iterator[tuple[int, int, list[Entry]]]:
        """(index of the communication object, identifier, what is mapped) of every PDO that is in force."""
        for n in self._pdo_numbers(communication):
            cob = self.od.number(communication + n, 1, missing=pdo.INVALID)
            if not cob & pdo.INVALID:
                try:
                    entries = pdo.mapped_entries(self.od, mapping + n, way)
                except SdoAbort:
                    entries = []
                yield communication + n, cob & 0x7FF, entries

    def _build_pdos(self) -> None:
        number = self.od.number
        received, sent = _PDOS
        for at, can_id, entries in self._valid_pdos(*received):
            self._rpdos.append(pdo.ReceivePdo(can_id, number(at, 2), entries, number(at, 5) * _MS))
        for at, can_id, entries in self._valid_pdos(*sent):
            if entries:
                made = pdo.TransmitPdo(
                    can_id, number(at, 2), entries, number(at, 3) * 100_000, number(at, 5) * _MS
                )
                self._tpdos.append(made)
                if made.kind >= 254 and made.event_ns:
                    self._start_event_timer(made)

    def _start_event_timer(self, made: pdo.TransmitPdo) -> None:
        def fire(at_ns: int) -> None:
            if made in self._tpdos:
                if at_ns >= made.sent_ns + made.event_ns:
                    self._transmit(made, made.pack(), at_ns)
                self._host.schedule(max(made.sent_ns + made.event_ns, at_ns + 1), fire)

        self._host.schedule(0, fire)

    def _on_rpdo(self, received: pdo.ReceivePdo) -> Handler:
        size = received.packing.size

        def take(data: bytes, now_ns: int) -> None:
            if received.event_ns:
                self._expect_next(received, now_ns)
            if len(data) < size:
                self.emergency(0x8210, self.od.number(0x1001) | 0x10)
            elif received.synchronous:
                received.pending = data
            else:
                received.apply(data)
                self.application.tick(now_ns)
                self.events(now_ns)

        return take

    def _expect_next(self, received: pdo.ReceivePdo, now_ns: int) -> None:
        """Watch for the next receive PDO within CiA 301's time-out, from the first one on."""
        watched, received.due_ns = received.due_ns is not None, now_ns + received.event_ns

        def lost(at_ns: int) -> None:
            received.due_ns = None
            self.emergency(0x8250, 0x10)
            self.application.connection_lost(at_ns)

        if not watched:
            self._await(lambda: received.due_ns if received in self._rpdos else None, lost)

    def _transmit(self, made: pdo.TransmitPdo, data: bytes, now_ns: int) -> None:
        made.last, made.sent_ns, made.seen = data, now_ns, 0
        self._host.emit(self, made.can_id, data)

    def on_sync(self, now_ns: int) -> None:
        """Take over what was received, act, send what is due."""
        for received in self._rpdos:
            if received.pending is not None:
                received.apply(received.pending)
                received.pending = None
        self.application.tick(now_ns)
        for made in self._tpdos:
            kind = made.kind
            if kind <= 240:
                made.seen += 1
                if made.seen >= kind:
                    data = made.packing.pack(*[e.value for e in made.entries])
                    if kind or data != made.last:
                        made.seen = 0
                        made.last = data
                        self._host.emit(self, made.can_id, data)
            else:
                self._event(made, now_ns)

    def events(self, now_ns: int) -> None:
        """Send event-driven PDOs whose content changed."""
        for made in self._tpdos:
            if made.kind > 240:
                self._event(made, now_ns)

    def _event(self, made: pdo.TransmitPdo, now_ns: int) -> None:
        data = made.pack()
        if data != made.last and now_ns >= made.sent_ns + made.inhibit_ns:
            self._transmit(made, data, now_ns)

    # --- wiring --------------------------------------------------------------------------------
    def _on_sdo(self, data: bytes, now_ns: int) -> None:
        answer = self._sdo.answer(data)
        if answer is not None:
            self._host.emit(self, 0x580 + self.node_id, answer, self._sdo_ns)
        self.application.configured()
        self.application.tick(now_ns)
        self.events(now_ns)

    def handlers(self) -> list[tuple[int, Handler]]:
        """Identifiers that the node listens to now; SYNC apart."""
        if self.silent or self.state is Nmt.INITIALISING:
            return []
        table: list[tuple[int, Handler]] = [(0, self.on_nmt)]
        table += [(0x700 + p, self._on_heartbeat(p)) for p in self.heard_producers()]
        if self.state in (Nmt.PRE_OPERATIONAL, Nmt.OPERATIONAL):
            table.append((0x600 + self.node_id, self._on_sdo))
        if self.state is Nmt.OPERATIONAL:
            table += [(r.can_id, self._on_rpdo(r)) for r in self._rpdos]
        return table

    @property
    def sync_id(self) -> int:
        """Identifier of the SYNC that the node follows; −1 while it follows none."""
        listening = not self.silent and self.state is Nmt.OPERATIONAL
        return self.od.number(0x1005) & 0x7FF if listening else -1
