"""SDO server of a simulated node: expedited and segmented transfers, CiA 301 abort codes."""

from __future__ import annotations

import struct

from invid_drivers.simulated.object_dictionary import ObjectDictionary, SdoAbort

_ABORT = 0x80
_ADDRESS = struct.Struct("<BHB")


class SdoServer:
    """One server channel; feed it requests, it returns responses."""

    def __init__(self, od: ObjectDictionary) -> None:
        self._od = od
        self._upload: bytes | None = None
        self._download: bytearray | None = None
        self._size = 0
        self._address = (0, 0)
        self._toggle = 0

    def reset(self) -> None:
        """Forget a transfer in progress."""
        self._upload = self._download = None

    def answer(self, request: bytes) -> bytes | None:
        """Response to one request frame; None where none is due."""
        if len(request) != 8:
            return None
        specifier = request[0] >> 5
        try:
            if specifier == 1:
                return self._begin_download(request)
            if specifier == 2:
                return self._begin_upload(request)
            if specifier == 0:
                return self._download_segment(request)
            if specifier == 3:
                return self._upload_segment(request)
            if specifier == 4:  # the client aborts
                self.reset()
                return None
            self._address = (request[1] | request[2] << 8, request[3])
            raise SdoAbort(SdoAbort.COMMAND)
        except SdoAbort as abort:
            self.reset()
            return struct.pack("<BHBI", _ABORT, *self._address, abort.code)

    def _begin_upload(self, request: bytes) -> bytes:
        self.reset()
        _, index, sub = _ADDRESS.unpack_from(request)
        self._address = (index, sub)
        data = self._od.entry(index, sub).read()
        if 0 < len(data) <= 4:
            return _ADDRESS.pack(0x43 | (4 - len(data)) << 2, index, sub) + data.ljust(4, b"\0")
        self._upload, self._toggle = data, 0
        return _ADDRESS.pack(0x41, index, sub) + struct.pack("<I", len(data))

    def _upload_segment(self, request: bytes) -> bytes:
        if self._upload is None:
            raise SdoAbort(SdoAbort.COMMAND)
        toggle = request[0] & 0x10
        if toggle != self._toggle:
            raise SdoAbort(SdoAbort.TOGGLE)
        part, rest = self._upload[:7], self._upload[7:]
        self._upload = rest or None
        self._toggle ^= 0x10
        return bytes([toggle | (7 - len(part)) << 1 | (not rest)]) + part.ljust(7, b"\0")

    def _begin_download(self, request: bytes) -> bytes:
        self.reset()
        command, index, sub = _ADDRESS.unpack_from(request)
        self._address = (index, sub)
        entry = self._od.entry(index, sub)
        if entry.access in ("ro", "const"):
            raise SdoAbort(SdoAbort.READ_ONLY)
        if command & 0x02:
            # without a stated size the server takes what the object needs
            size = 4 - (command >> 2 & 3) if command & 0x01 else min(entry.size, 4)
            entry.write(request[4 : 4 + size])
        else:
            self._size = struct.unpack_from("<I", request, 4)[0] if command & 0x01 else entry.size
            if self._size > entry.size:
                raise SdoAbort(SdoAbort.TOO_LONG)
            self._download, self._toggle = bytearray(), 0
        return _ADDRESS.pack(0x60, index, sub) + bytes(4)

    def _download_segment(self, request: bytes) -> bytes:
        if self._download is None:
            raise SdoAbort(SdoAbort.COMMAND)
        toggle = request[0] & 0x10
        if toggle != self._toggle:
            raise SdoAbort(SdoAbort.TOGGLE)
        self._download += request[1 : 8 - (request[0] >> 1 & 7)]
        if len(self._download) > self._size:
            raise SdoAbort(SdoAbort.TOO_LONG)
        self._toggle ^= 0x10
        if request[0] & 0x01:
            data, self._download = bytes(self._download), None
            self._od.entry(*self._address).write(data)
        return bytes([0x20 | toggle]) + bytes(7)
