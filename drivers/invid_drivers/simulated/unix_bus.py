"""CAN frames over an AF_UNIX SOCK_SEQPACKET socket: a bus between processes without kernel CAN.

Each packet is the kernel's ``struct can_frame``. Packets keep their order and are not lost; the
socket cannot leave the host. ``UnixHub`` is the wire (the simulated cell holds it), ``UnixBus`` a port.
No bit rate, no arbitration: use ``socketcan`` and vcan where the kernel has them. The hub's messages bear
the kernel's time of sending, as a CAN controller stamps a frame when it is on the wire: how late the hub's
process woke does not show in them.
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
import stat
import struct
import time
from collections import deque
from typing import Any

import can
from can import BusABC, Message

_FRAME = struct.Struct("=IBxxx8s")
_EXTENDED, _REMOTE, _ERROR = 0x80000000, 0x40000000, 0x20000000
_SEND_TIMEOUT_S = 0.1
_QUEUE_BYTES = 1 << 20
"""Half a second of frames of three axes at 1 kHz, for a peer that the system pauses; how long one may say
nothing is for the config to say."""
_SO_TIMESTAMPNS = 35  # Linux; `socket` has no name for it
_TIMESPEC = struct.Struct("@ll")
_ANCILLARY = socket.CMSG_SPACE(_TIMESPEC.size)


def pack_frame(msg: Message) -> bytes:
    """``struct can_frame`` of a message."""
    if msg.is_fd or len(msg.data) > 8:
        raise can.CanOperationError("invid-unix is a classic CAN bus: at most 8 data bytes")
    flags = (
        (_EXTENDED if msg.is_extended_id else 0)
        | (_REMOTE if msg.is_remote_frame else 0)
        | (_ERROR if msg.is_error_frame else 0)
    )
    return _FRAME.pack(msg.arbitration_id | flags, msg.dlc, bytes(msg.data))


def unpack_frame(packet: bytes, timestamp: float) -> Message | None:
    """Message of a packet; None where the packet is no frame."""
    if len(packet) != _FRAME.size:
        return None
    raw, length, data = _FRAME.unpack(packet)
    if length > 8:
        return None
    extended, remote, error = bool(raw & _EXTENDED), bool(raw & _REMOTE), bool(raw & _ERROR)
    return Message(
        timestamp=timestamp,
        arbitration_id=raw & (0x1FFFFFFF if extended or error else 0x7FF),
        is_extended_id=extended,
        is_remote_frame=remote,
        is_error_frame=error,
        dlc=length,
        data=None if remote else data[:length],
    )


def _stamped(port: socket.socket) -> tuple[bytes, float]:
    """A packet and when it was sent [s since the epoch]; now, where the kernel does not say."""
    packet, ancillary, _, _ = port.recvmsg(_FRAME.size + 1, _ANCILLARY)
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPNS and len(data) == _TIMESPEC.size:
            seconds, nanoseconds = _TIMESPEC.unpack(data)
            return packet, seconds + nanoseconds * 1e-9
    return packet, time.time()


def _send_packet(port: socket.socket, packet: bytes, timeout: float) -> None:
    try:
        port.send(packet)
    except BlockingIOError:
        if not select.select([], [port], [], timeout)[1]:
            raise can.CanOperationError(
                "invid-unix: the other side does not read; its queue is full", errno.ENOBUFS
            ) from None
        port.send(packet)


class UnixBus(BusABC):
    """A port on a hub.

    Parameters
    ----------
    channel
        Path of the hub's socket.

    Raises
    ------
    can.CanInitializationError
        Where nobody listens there.
    can.CanOperationError
        From ``send`` and ``recv`` once the hub is gone.
    """

    def __init__(self, channel: Any, can_filters: Any = None, **_: Any) -> None:
        path = str(channel)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            self._socket.connect(path)
        except OSError as error:
            self._socket.close()
            raise can.CanInitializationError(
                f"invid-unix: nobody listens at {path!r} ({error.strerror or error}); "
                "start 'invid simcell' with this channel first"
            ) from None
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _QUEUE_BYTES)
        self._lost = False
        self.channel_info = f"invid-unix {path}"
        super().__init__(channel=channel, can_filters=can_filters)

    def _peer_lost(self) -> can.CanOperationError:
        self._lost = True
        return can.CanOperationError(f"{self.channel_info}: the other side is gone", errno.EPIPE)

    def send(self, msg: Message, timeout: float | None = None) -> None:
        """Send one frame."""
        try:
            _send_packet(self._socket, pack_frame(msg), _SEND_TIMEOUT_S if timeout is None else timeout)
        except (BrokenPipeError, ConnectionError):
            raise self._peer_lost() from None
        except OSError as error:
            raise can.CanOperationError(f"{self.channel_info}: {error}", error.errno) from None

    def _recv_internal(self, timeout: float | None) -> tuple[Message | None, bool]:
        if self._lost:
            raise self._peer_lost()
        try:
            if not select.select([self._socket], [], [], timeout)[0]:
                return None, False
            packet = self._socket.recv(_FRAME.size + 1)
        except ConnectionError:
            packet = b""
        except OSError as error:
            raise can.CanOperationError(f"{self.channel_info}: {error}", error.errno) from None
        if not packet:
            raise self._peer_lost()
        return unpack_frame(packet, time.time()), False

    def fileno(self) -> int:
        """The socket's number, for select."""
        return self._socket.fileno()

    def shutdown(self) -> None:
        """Close the port."""
        super().shutdown()
        self._socket.close()


class UnixHub(BusABC):
    """The wire: accepts ports, passes each frame to all others, and is a port itself.

    A port that goes away or stops reading is dropped; the others do not notice.

    Raises
    ------
    can.CanInitializationError
        Where the path is taken by a running hub, is no socket, or cannot be made.
    """

    def __init__(self, channel: Any, can_filters: Any = None, **_: Any) -> None:
        self._path = str(channel)
        self._ports: dict[int, socket.socket] = {}
        self._inbox: deque[Message] = deque()
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            self._clear_stale()
            self._listener.bind(self._path)
            os.chmod(self._path, stat.S_IRUSR | stat.S_IWUSR)
        except OSError as error:
            self._listener.close()
            raise can.CanInitializationError(
                f"invid-unix: cannot listen at {self._path!r}: {error.strerror or error}"
            ) from None
        self._listener.listen(8)
        self._listener.setblocking(False)
        self._poll = select.poll()
        self._poll.register(self._listener, select.POLLIN)
        self.channel_info = f"invid-unix hub {self._path}"
        super().__init__(channel=channel, can_filters=can_filters)

    def _clear_stale(self) -> None:
        """Remove the socket that a hub which was killed left behind."""
        try:
            mode = os.stat(self._path).st_mode
        except FileNotFoundError:
            return
        if not stat.S_ISSOCK(mode):
            raise OSError(errno.EEXIST, "a file that is no socket is in the way")
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as probe:
            try:
                probe.connect(self._path)
            except OSError:
                os.unlink(self._path)
                return
        raise OSError(errno.EADDRINUSE, "a running cell listens there already")

    def _drop(self, number: int) -> None:
        port = self._ports.pop(number)
        with contextlib.suppress(KeyError):
            self._poll.unregister(number)
        port.close()

    def _pass_on(self, packet: bytes, sender: int) -> None:
        for number, port in list(self._ports.items()):
            if number != sender:
                try:
                    port.send(packet)
                except OSError:  # gone, or has not read some hundred frames
                    self._drop(number)

    def send(self, msg: Message, timeout: float | None = None) -> None:
        """Send one frame to every port; without ports it goes nowhere, as on a wire."""
        self._pass_on(pack_frame(msg), -1)

    def _recv_internal(self, timeout: float | None) -> tuple[Message | None, bool]:
        inbox = self._inbox
        if not inbox:
            self._service(None if timeout is None else timeout * 1000.0)
        return (inbox.popleft() if inbox else None), False

    def _service(self, timeout_ms: float | None) -> None:
        for number, _ in self._poll.poll(timeout_ms):
            if number == self._listener.fileno():
                with contextlib.suppress(OSError):
                    port, _address = self._listener.accept()
                    port.setblocking(False)
                    with contextlib.suppress(OSError):  # another system than Linux
                        port.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
                    self._ports[port.fileno()] = port
                    self._poll.register(port, select.POLLIN)
                continue
            while number in self._ports:
                sent = 0.0
                try:
                    packet, sent = _stamped(self._ports[number])
                except BlockingIOError:
                    break
                except OSError:
                    packet = b""
                if not packet:
                    self._drop(number)
                    break
                message = unpack_frame(packet, sent)
                if message is not None:
                    self._inbox.append(message)
                    self._pass_on(packet, number)

    def shutdown(self) -> None:
        """Close all ports and remove the socket."""
        if self._is_shutdown:
            return
        super().shutdown()
        for number in list(self._ports):
            self._drop(number)
        self._listener.close()
        with contextlib.suppress(OSError):
            os.unlink(self._path)
