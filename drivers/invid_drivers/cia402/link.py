"""The one owner of the bus: SDO, NMT, heartbeats, EMCY, without a second thread.

``canopen`` runs the SDO protocol; whoever waits for an answer pumps ``bus.recv()`` itself, so that
nothing else ever touches the bus and virtual time only advances here.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable

import can
import canopen
from canopen.sdo.client import SdoClient
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError, SdoError

from invid.errors import BusError, SafetyStop
from invid.sweep.ports import Clock, Event, Severity
from invid.wording.sentence import sentence
from invid_drivers.cia402.gate import NO_ERROR_BELOW, Gate, Peer
from invid_drivers.cia402.others import LISTEN_BEATS, LISTEN_S, MASTER_ID, Foreign, foreign

SHORTEST_WAIT_S = 1e-6
"""A rest of a wait below a bus's clock tick would never pass in virtual time."""

LATE_ANSWER_S = 0.05
"""How long a request waits for the answer to a question that the cycle asked before it."""
ANSWER_S = 1.0
"""How long a request waits for its answer; a drive answers in milliseconds, a simulated one on a busy
computer may need longer."""
MOST_ECHOES = 1000
"""Frames whose echo is waited for; one that an adapter lost is forgotten with all others beyond that."""
HEARD_S = 0.1
"""A request to stop is heard within this time, whatever is waited for."""
UNANSWERED_S = 1.0
"""A question of the cycle that stayed unanswered so long may be asked again."""

NMT_START, NMT_STOP, NMT_PRE_OPERATIONAL = 0x01, 0x02, 0x80
GENERIC_ERROR = 0x1000
"""What a message too short for a code counts as (CiA 301)."""

_EMCY = {
    0x1000: "generic",
    0x2000: "current",
    0x2300: "output current",
    0x3000: "voltage",
    0x4000: "temperature",
    0x5000: "drive hardware",
    0x6000: "drive software",
    0x7000: "sensor or brake",
    0x8000: "monitoring",
    0x8100: "communication",
    0x8300: "torque control",
    0x8400: "speed control: too fast, or its speed limit is too low",
    0x8500: "position control",
    0x8600: "positioning: following error or a limit of position",
    0x9000: "external",
    0xF000: "vendor's own",
}
"""Classes of EMCY codes (CiA 301, 402): of the first two digits, else of the first."""


def never() -> bool:
    """Nobody asks for a stop."""
    return False


class RealClock:
    """Monotonic time; sleeps most of the way and spins the rest."""

    def __init__(self, spin_s: float = 0.0002) -> None:
        self._spin = spin_s

    def now(self) -> float:
        """Seconds since some fixed instant."""
        return time.monotonic()

    def sleep_until(self, instant: float) -> None:
        """Return not before ``instant``."""
        rest = instant - time.monotonic() - self._spin
        if rest > 0:
            time.sleep(rest)
        while time.monotonic() < instant:
            pass


class Link:
    """A python-can bus, its clock, and the nodes heard on it."""

    def __init__(self, bus: can.BusABC, *, heartbeat_s: float) -> None:
        self.bus = bus
        self.gate = Gate()
        self.clock: Clock = getattr(bus, "clock", None) or RealClock()
        self.network = canopen.Network(bus)
        self.peers = self.gate.nodes
        self.events: list[Event] = []
        self._sdo: dict[int, _PumpedSdo] = {}
        self._asked: dict[int, float] = {}
        self.heartbeat_s = heartbeat_s
        self._next_heartbeat = 0.0
        self._heartbeat = can.Message(
            arbitration_id=0x700 + MASTER_ID, data=b"\x05", is_extended_id=False, check=False
        )
        self.beating = False
        self.others: dict[str, Foreign] = {}
        """What was heard of others on the bus, by its words."""
        self._echoing: bool | None = None
        self._echoes: Counter[tuple[int, bytes]] = Counter()
        self.answer_s = ANSWER_S
        """How long a request waits for its answer, twice."""
        self.until = math.inf
        """No answer is waited for beyond this instant; requests leave all the same."""
        self.attend: Callable[[], object] | None = None
        """Makes one cycle: whoever waits while axes are held goes on attending to them."""
        self.cancelled: Callable[[], bool] = never
        """Asked in every wait but those of the way out, which a stop does not end."""

    # --- frames --------------------------------------------------------------------------------
    def send(self, cob_id: int, data: bytes) -> None:
        """One frame; BusError where the bus does not take it."""
        self.put(can.Message(arbitration_id=cob_id, data=data, is_extended_id=False))

    def put(self, message: can.Message) -> None:
        """One frame; BusError where the bus does not take it, or the gate keeps it back."""
        self.gate.pass_out(message)
        if self._echoing is not False:
            self._expect_echo(message)
        try:
            self.bus.send(message)
        except can.CanError as error:
            raise BusError(
                sentence(
                    "bus {channel_info}: frame 0x{arbitration_id:03X} was not taken ({error}); check "
                    "cable, termination and bit rate",
                    channel_info=self.bus.channel_info,
                    arbitration_id=message.arbitration_id,
                    error=error,
                )
            ) from None
        except (OSError, ValueError) as error:
            raise BusError(f"bus {self.bus.channel_info}: {error}") from None

    def get(self, timeout: float) -> can.Message | None:
        """Next frame, or ``None`` after ``timeout`` seconds; BusError where the bus is gone."""
        if 0.0 < timeout < SHORTEST_WAIT_S:
            timeout = SHORTEST_WAIT_S
        try:
            return self.bus.recv(timeout)
        except (can.CanError, OSError, ValueError) as error:
            raise BusError(f"bus {self.bus.channel_info}: {error}") from None

    def beat(self, now: float) -> None:
        """Send the master's heartbeat when it is due."""
        if self.beating and now >= self._next_heartbeat:
            self._next_heartbeat = now + self.heartbeat_s
            self.put(self._heartbeat)

    def pump(self, timeout: float) -> None:
        """Take and sort frames for ``timeout`` seconds at most, or until one was taken.

        SafetyStop where a stop was asked for, within ``HEARD_S``.
        """
        if self.cancelled():
            raise SafetyStop(sentence("stopped on request; nothing was recorded yet"), code="asked")
        if self.attend is not None:
            self.attend()
            return
        self.beat(self.clock.now())
        message = self.get(min(timeout, HEARD_S, self.heartbeat_s / 2 if self.beating else HEARD_S))
        if message is not None:
            self.sort(message)

    def wait(self, seconds: float) -> None:
        """Pump for a while."""
        end = self.clock.now() + seconds
        while (rest := end - self.clock.now()) > 0:
            self.pump(rest)

    def sort(self, message: can.Message) -> None:
        """Heartbeat, boot-up, EMCY of any length, SDO answers, error frames; the rest is ignored."""
        if message.is_error_frame:
            if message.arbitration_id & 0x40:  # Linux error class bit 6: controller went bus-off
                text = "the CAN controller went bus-off; check cable and bit rate"
                self.events.append(Event(Severity.BUS, text))
            return
        if message.is_remote_frame or message.is_extended_id:
            self._look_for_others(message)
            return
        cob, data = message.arbitration_id, bytes(message.data)
        if self._echoing is not False and self._is_echo(cob, data):
            return
        self._look_for_others(message)
        node = self.peers.get(cob & 0x7F)
        if cob & 0x780 in (0x580, 0x700):
            self.gate.heard(cob, data)
        if cob & 0x780 == 0x580:
            self.answered(cob & 0x7F)
            self.network.notify(cob, bytearray(data), message.timestamp)
        elif node is None:
            return
        elif cob & 0x780 == 0x700 and data:
            self._heard(node)
        elif cob & 0x780 == 0x080:
            self._emergency(node, data)

    def listen(self) -> None:
        """Send nothing, and hear who is there; then the gate opens."""
        self.wait(max(LISTEN_S, LISTEN_BEATS * self.heartbeat_s))
        self.gate.listened = True

    def refuse_others(self) -> None:
        """BusError where another master was heard; what was sent until then is said from the gate's log."""
        heard = [f.text for f in self.others.values() if f.master]
        if heard:
            raise BusError(_another(", ".join(heard[:5]), self.gate.said))

    def _look_for_others(self, message: can.Message) -> None:
        found = foreign(message, self.peers)
        if found is None or found.text in self.others:
            return
        self.others[found.text] = found
        if found.master:
            self.gate.disputed = True
            self.events.append(Event(Severity.BUS, _another(found.text, self.gate.said)))

    def _expect_echo(self, message: can.Message) -> None:
        if len(self._echoes) > MOST_ECHOES:
            self._echoes.clear()
        self._echoes[message.arbitration_id, bytes(message.data)] += 1

    def _is_echo(self, cob: int, data: bytes) -> bool:
        """Whether a frame is our own, given back by the adapter: one for each that was sent, no more.

        An adapter gives it back when it is on the wire, so before the answer to it: one that gave back
        nothing by the first answer to an SDO request gives back nothing.
        """
        waited = self._echoes.pop((cob, data), 0)
        if waited > 0:
            if waited > 1:
                self._echoes[cob, data] = waited - 1
            self._echoing = True
            return True
        if (
            self._echoing is None
            and cob & 0x780 == 0x580
            and any(c & 0x780 == 0x600 for c, _ in self._echoes)
        ):
            self._echoing = False
            self._echoes.clear()
        return False

    def _heard(self, node: Peer) -> None:
        node.last_heartbeat = self.clock.now()
        if node.nmt_state == 0:
            text = f"axis {node.name} (node {node.node_id}) has restarted"
            self.events.append(Event(Severity.DRIVE, text, node.name))

    def _emergency(self, node: Peer, data: bytes) -> None:
        code = int.from_bytes(data[:2], "little") if len(data) >= 2 else GENERIC_ERROR
        node.emcy.append((self.clock.now(), code))
        if code < NO_ERROR_BELOW:
            return  # 00xx: an error has gone
        what = f"error 0x{code:04X}" if len(data) >= 2 else f"an emergency message of {len(data)} bytes"
        self.events.append(
            Event(
                Severity.DRIVE,
                f"axis {node.name} (node {node.node_id}) reports {what} ({_emcy_words(code)})",
                node.name,
            )
        )

    def require_bus(self) -> None:
        """BusError where the controller reports bus-off."""
        state = getattr(self.bus, "state", None)
        if state is can.BusState.ERROR:
            raise BusError(sentence("the CAN controller is bus-off; check cable, termination and bit rate"))

    # --- services ------------------------------------------------------------------------------
    def add_peer(self, node_id: int, name: str) -> Peer:
        """Listen to a node; ``name`` of an axis of it."""
        peer = self.peers.setdefault(node_id, Peer(node_id, name))
        if name not in peer.name.split(", "):
            peer.name += f", {name}"
        return peer

    def nmt(self, command: int, node_id: int) -> None:
        """NMT command to one of our nodes; never to all, who may be others'."""
        if node_id not in self.peers:
            raise BusError(
                sentence("node {node_id} is not in the config: it gets no NMT command", node_id=node_id)
            )
        self.send(0x000, bytes((command, node_id)))

    def sdo(self, node_id: int) -> SdoClient:
        """The SDO client of a node."""
        client = self._sdo.get(node_id)
        if client is None:
            client = self._sdo[node_id] = _PumpedSdo(self, node_id)
        return client

    def ask(self, node_id: int, request: bytes) -> bool:
        """An SDO request whose answer nobody waits for; none while an earlier one is unanswered.

        Whether it was sent. A drive has one buffer for SDO: what comes while it works on a request is lost.
        """
        now = self.clock.now()
        since = self._asked.get(node_id)
        if since is None or now - since > UNANSWERED_S:
            self._asked[node_id] = now
            self.send(0x600 + node_id, request)
            return True
        return False

    def occupy(self, node_id: int) -> None:
        """A node is asked something, and asked nothing else until it has answered."""
        self._asked[node_id] = self.clock.now()

    def answered(self, node_id: int) -> None:
        """An SDO answer of the node was seen."""
        self._asked.pop(node_id, None)

    def await_unasked(self, node_id: int) -> None:
        """Give a node the time to answer what was asked without waiting."""
        end = self.clock.now() + LATE_ANSWER_S
        while node_id in self._asked and (rest := end - self.clock.now()) > 0:
            self.pump(rest)
        self._asked.pop(node_id, None)

    def close(self) -> None:
        """Close the bus; safe to call twice."""
        try:
            self.bus.shutdown()
        except Exception as error:  # a driver that fails to close must not hide the error before it
            self.events.append(Event(Severity.NOTE, f"the bus did not close cleanly: {error}"))


class _PumpedSdo(SdoClient):
    """``canopen``'s SDO client that takes its answers from the link instead of a second thread."""

    def __init__(self, link: Link, node_id: int) -> None:
        super().__init__(  # type: ignore[no-untyped-call]
            0x600 + node_id,
            0x580 + node_id,
            canopen.ObjectDictionary(),  # type: ignore[no-untyped-call]
        )
        self.network = link.network
        self._link = link
        self._answers: list[bytes] = []
        link.network.subscribe(0x580 + node_id, self.on_response)

    def on_response(self, can_id: int, data: bytearray, timestamp: float) -> None:
        """An SDO answer came."""
        if len(data) == 8:
            self._answers.append(bytes(data))

    def request_response(self, sdo_request: bytes) -> bytes:
        """Send a request and pump until its answer is there; one retry, because a frame may be lost."""
        # Initiate download and upload (command 1, 2) name an object, and so does their answer. The cycle asks
        # for 0x6061 without waiting: its answer may come late and is not the answer to this request.
        self._link.await_unasked(self.rx_cobid - 0x600)
        named = bytes(sdo_request[1:4]) if sdo_request[0] >> 5 in (1, 2) else None
        for attempt in (1, 2):
            self._answers.clear()
            self.send_request(sdo_request)
            try:
                return self._answer_for(named)
            except SdoCommunicationError:
                if attempt == 2 or self._link.clock.now() >= self._link.until:
                    raise
        raise SdoCommunicationError("No SDO response received")

    def abort(self, abort_code: int = 0x08000000) -> None:
        """Tell the server that the transfer is over; quietly, the error that follows speaks."""
        self.send_request(b"\x80\0\0\0" + abort_code.to_bytes(4, "little"))

    def send_request(self, request: bytes) -> None:
        """One SDO frame."""
        self._link.occupy(self.rx_cobid - 0x600)
        self._link.send(self.rx_cobid, bytes(request))

    def read_response(self) -> bytes:
        """Pump until an answer is there."""
        return self._answer_for(None)

    def _answer_for(self, named: bytes | None) -> bytes:
        """The next answer, or the next about the object ``named`` (index and subindex as sent)."""
        clock = self._link.clock
        end = min(clock.now() + self._link.answer_s, self._link.until)
        while True:
            while not self._answers:
                rest = end - clock.now()
                if rest <= 0:
                    raise SdoCommunicationError("No SDO response received")
                self._link.pump(rest)
            answer = self._answers.pop(0)
            if named is None or answer[1:4] == named or (answer[0] == 0x80 and not any(answer[1:4])):
                break  # some drives abort without naming the object
        if answer[0] == 0x80:
            raise SdoAbortedError(int.from_bytes(answer[4:8], "little"))
        return answer


def _another(heard: str, done: str) -> str:
    return (
        f"another master is on this bus: {heard} was heard; {done}. End the program or switch off the device "
        "that sends it, or measure on a bus of its own"
    )


def _emcy_words(code: int) -> str:
    return _EMCY.get(code & 0xFF00) or _EMCY.get(code & 0xF000, "see the drive's manual")


__all__ = [
    "MASTER_ID",
    "NMT_PRE_OPERATIONAL",
    "NMT_START",
    "NMT_STOP",
    "Link",
    "Peer",
    "RealClock",
    "SdoAbortedError",
    "SdoCommunicationError",
    "SdoError",
]
