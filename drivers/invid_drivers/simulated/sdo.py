"""SDO server of a simulated node: ``canopen``'s, with the dictionary of the drive behind it."""

from __future__ import annotations

import canopen
from canopen.sdo.server import SdoServer as CanopenServer

from invid_drivers.simulated.object_dictionary import ObjectDictionary, SdoAbort

_SEGMENTS, _DOWNLOAD, _BLOCK_UPLOAD = (0, 3), 1, 5
"""Client command specifiers of CiA 301."""
_EXPEDITED, _SIZE_SAID = 0x02, 0x01


class SdoServer(CanopenServer):
    """One server channel; feed it requests, it returns responses.

    Departures from ``canopen``: a segment without a transfer and a block upload are aborted as CiA 301 has
    it, a download is refused with its first frame, and one of no stated size is as long as the object.
    """

    def __init__(self, od: ObjectDictionary) -> None:
        self.object_dictionary = canopen.ObjectDictionary()  # type: ignore[no-untyped-call]
        super().__init__(0, 0, self)  # type: ignore[no-untyped-call]
        self._od, self._response = od, b""
        self.reset()

    def reset(self) -> None:
        """Forget a transfer in progress."""
        self._buffer, self._index, self._subindex = None, 0, 0

    def answer(self, request: bytes) -> bytes | None:
        """Response to one request frame; None where none is due."""
        if len(request) != 8:
            return None
        self._response = b""
        specifier, index, sub = request[0] >> 5, int.from_bytes(request[1:3], "little"), request[3]
        if (specifier in _SEGMENTS and self._buffer is None) or specifier == _BLOCK_UPLOAD:
            self.abort(SdoAbort.COMMAND)
        elif specifier == _DOWNLOAD:
            self._begin_download(bytearray(request), index, sub)
        else:
            self.on_request(0, request, 0.0)  # type: ignore[no-untyped-call]
        return self._response or None

    def _begin_download(self, request: bytearray, index: int, sub: int) -> None:
        self._index, self._subindex = index, sub
        try:
            entry = self._od.entry(index, sub)
            entry.require_writable()
        except SdoAbort as refused:
            self.abort(refused.code)
            return
        if request[0] & _EXPEDITED and not request[0] & _SIZE_SAID:
            request[0] |= _SIZE_SAID | (4 - min(entry.size, 4)) << 2
        self.on_request(0, request, 0.0)  # type: ignore[no-untyped-call]

    def get_data(self, index: int, subindex: int, *, check_readable: bool) -> bytes:
        """Bytes that an upload gets."""
        return self._od.entry(index, subindex).read()

    def set_data(self, index: int, subindex: int, data: bytes, *, check_writable: bool) -> None:
        """Store what a download brought."""
        self._buffer = None
        self._od.entry(index, subindex).write(bytes(data))

    def send_response(self, response: bytes) -> None:
        """Keep a frame of the server for whoever asked."""
        self._response = bytes(response)

    def request_aborted(self, data: bytes) -> None:
        """The client ends its transfer."""
        self.reset()

    def abort(self, abort_code: int = 0x08000000) -> None:
        """End a transfer with a code."""
        super().abort(abort_code)  # type: ignore[no-untyped-call]
        self._buffer = None
