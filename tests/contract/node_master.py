"""A bare master for tests of the simulated nodes: frames by hand, no code of the drivers."""

import struct
from pathlib import Path
from typing import Any

import can
import yaml

import invid_drivers.simulated as simulated
from invid.config import CellConfig
from invid_drivers.simulated import VirtualTimeBus, open_virtual_bus

LIMITS = {"torque_Nm": 25, "position_window_rad": 1.0, "velocity_rad_per_s": 10}


def cell(simulation: dict[str, Any] | None = None, axes: int = 1, **bus: Any) -> CellConfig:
    """A cell of single masses (1 kg·m²) with ``simulation`` laid over."""
    names = [f"A{i + 1}" for i in range(axes)]
    section: dict[str, Any] = {
        "plant": {"branches": [{"axis": n, "masses": [1.0]} for n in names]},
        "defaults": {"rated_torque_Nm": 100, "encoder_counts_per_rev": 524288},
    }
    section.update(simulation or {})
    return CellConfig.model_validate(
        {
            "format": "invid-config",
            "robot": "test cell",
            "bus": {"interface": "invid-virtual", "channel": "test", **bus},
            "axes": [{"name": n, "node_id": i + 1, "limits": LIMITS} for i, n in enumerate(names)],
            "simulation": section,
        }
    )


def case_study_cell(**simulation: Any) -> CellConfig:
    """The cell that ships with the package, with top-level keys of its simulation replaced."""
    path = Path(simulated.__file__).parent / "case_study.yaml"
    data = yaml.safe_load(path.read_text(encoding="utf-8"))
    data["simulation"].update(simulation)
    return CellConfig.model_validate(data)


class Master:
    """SDO, NMT and cyclic PDOs by hand on a virtual-time bus."""

    def __init__(self, config: CellConfig) -> None:
        self.bus: VirtualTimeBus = open_virtual_bus(config)
        self.nodes = [axis.node_id for axis in config.axes]
        self.other: list[tuple[float, int, bytes]] = []
        self.bus.clock.sleep_until(0.01)

    def close(self) -> None:
        self.bus.shutdown()

    def put(self, can_id: int, data: bytes) -> None:
        self.bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def get(self, timeout: float) -> tuple[float, int, bytes] | None:
        frame = self.bus.recv(timeout)
        return None if frame is None else (frame.timestamp, frame.arbitration_id, bytes(frame.data))

    def wait(self, seconds: float) -> list[tuple[float, int, bytes]]:
        """All frames of the next ``seconds``."""
        end = self.bus.clock.now() + seconds
        frames = self.other
        self.other = []
        while (left := end - self.bus.clock.now()) > 0:
            frame = self.get(left)
            if frame is not None:
                frames.append(frame)
        return frames

    def answer(self, node: int, request: bytes) -> bytes:
        """The SDO response to a request."""
        self.put(0x600 + node, request)
        end = self.bus.clock.now() + 0.5
        while self.bus.clock.now() < end:
            frame = self.get(0.05)
            if frame is not None and frame[1] == 0x580 + node:
                return frame[2]
            if frame is not None:
                self.other.append(frame)
        raise TimeoutError(f"node {node} does not answer {request.hex()}")

    def write(self, node: int, index: int, sub: int, code: str, value: int) -> int:
        """Expedited download; 0 or the abort code."""
        data = struct.pack("<" + code, value)
        head = struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, index, sub)
        response = self.answer(node, head + data.ljust(4, b"\0"))
        return 0 if response[0] == 0x60 else int(struct.unpack_from("<I", response, 4)[0])

    def read(self, node: int, index: int, sub: int = 0, code: str = "I") -> int:
        """Expedited upload."""
        response = self.answer(node, struct.pack("<BHB4x", 0x40, index, sub))
        if response[0] == 0x80:
            raise LookupError(f"{struct.unpack_from('<I', response, 4)[0]:#010x}")
        return int(struct.unpack_from("<" + code, response, 4)[0])

    def map_pdo(self, node: int, way: str, number: int, objects: list[int], kind: int = 1) -> None:
        """CiA 301's procedure; fails the test where the node refuses a step."""
        communication, mapping = (0x1400, 0x1600) if way == "r" else (0x1800, 0x1A00)
        communication, mapping = communication + number - 1, mapping + number - 1
        cob = (0x100 if way == "r" else 0x80) + 0x100 * number + node
        steps = [
            self.write(node, communication, 1, "I", 0x80000000 | cob),
            self.write(node, mapping, 0, "B", 0),
            *[self.write(node, mapping, i + 1, "I", value) for i, value in enumerate(objects)],
            self.write(node, mapping, 0, "B", len(objects)),
            self.write(node, communication, 2, "B", kind),
            self.write(node, communication, 1, "I", cob),
        ]
        assert not any(steps), [hex(s) for s in steps]

    def prepare(self, mode: int = 10) -> None:
        """Torque and controlword out, position, torque and statusword in; operational."""
        for node in self.nodes:
            target = 0x607A0020 if mode == 8 else 0x60710010
            self.map_pdo(node, "r", 1, [target, 0x60400010])
            self.map_pdo(node, "t", 1, [0x60640020, 0x60770010, 0x60410010])
            assert self.write(node, 0x6060, 0, "b", mode) == 0
        self.put(0, b"\x01\x00")
        self.next_sync = round(self.bus.clock.now() + 0.002, 3)
        self.mode = mode

    def cycle(self, targets: list[int], word: int, period: float = 0.001) -> dict[int, tuple[int, int, int]]:
        """One SYNC with targets behind it; node -> position, torque, statusword."""
        self.bus.clock.sleep_until(self.next_sync)
        self.next_sync += period
        self.put(0x80, b"")
        for node, target in zip(self.nodes, targets, strict=True):
            code = "<iH" if self.mode == 8 else "<hH"
            self.put(0x200 + node, struct.pack(code, target, word))
        answers: dict[int, tuple[int, int, int]] = {}
        while (left := self.next_sync - 0.0001 - self.bus.clock.now()) > 0:
            frame = self.get(left)
            if frame is None:
                break
            if 0x181 <= frame[1] <= 0x1FF:
                answers[frame[1] - 0x180] = struct.unpack("<ihH", frame[2])
            else:
                self.other.append(frame)
        return answers

    def enable(self, targets: list[int] | None = None) -> None:
        """Walk to operation enabled."""
        targets = targets or [0] * len(self.nodes)
        for word in (0x06, 0x06, 0x07, 0x07, 0x0F, 0x0F, 0x0F):
            answers = self.cycle(targets, word)
        assert all(status & 0x6F == 0x27 for _, _, status in answers.values()), answers
        assert len(answers) == len(self.nodes)
