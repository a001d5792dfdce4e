"""The drives in real time, commanded by the ``canopen`` library as a master."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import can
import canopen
import pytest
import yaml
from node_master import case_study_cell

from invid.config import CellConfig
from invid.errors import InvidError
from invid_drivers.simulated import CASE_STUDY
from invid_drivers.simulated.simcell import run_simcell

PATIENCE_S = 60.0
"""How long a machine that is busy with other things may take for anything."""


def until(reached: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE_S
    while not reached() and time.monotonic() < end:
        time.sleep(0.01)


def on(interface: str, channel: str, **simulation: object) -> CellConfig:
    config = case_study_cell(**simulation)
    bus = config.bus.model_copy(update={"interface": interface, "channel": channel})
    return config.model_copy(update={"bus": bus})


class Running:
    """A simulated cell in a thread of this process."""

    def __init__(self, config: CellConfig, bus: can.BusABC | None = None) -> None:
        self.stop, self.ready = threading.Event(), threading.Event()
        self.result: list[object] = []
        self._thread = threading.Thread(target=self._run, args=(config, bus))
        self._thread.start()
        assert self.ready.wait(PATIENCE_S), self.result

    def _run(self, config: CellConfig, bus: can.BusABC | None) -> None:
        try:
            self.result.append(run_simcell(config, self.stop, bus=bus, ready=self.ready.set))
        except BaseException as error:
            self.result.append(error)

    def end(self) -> object:
        self.stop.set()
        self._thread.join(PATIENCE_S)
        assert not self._thread.is_alive()
        return self.result[0]


@pytest.fixture(params=["invid-unix", "virtual"])
def network(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[canopen.Network]:
    channel = str(tmp_path / "cell.sock") if request.param == "invid-unix" else f"cell-{os.getpid()}"
    config = on(request.param, channel)
    bus = can.Bus(interface="virtual", channel=channel) if request.param == "virtual" else None
    running = Running(config, bus)
    made = canopen.Network()
    made.connect(interface=request.param, channel=channel)
    yield made
    made.disconnect()
    statistics = running.end()
    if bus is not None:
        bus.shutdown()
    assert not isinstance(statistics, BaseException), statistics


def test_a_canopen_master_configures_enables_and_moves_an_axis(network: canopen.Network) -> None:
    node = network.add_node(1, canopen.ObjectDictionary())
    sdo = node.sdo
    sdo.RESPONSE_TIMEOUT = PATIENCE_S

    def write(index: int, sub: int, value: int, size: int) -> None:
        sdo.download(index, sub, value.to_bytes(size, "little", signed=value < 0))

    def status() -> int:
        return int.from_bytes(sdo.upload(0x6041, 0), "little") & 0x6F

    assert sdo.upload(0x100A, 0) == b"invid simulated drive"  # segmented
    with pytest.raises(canopen.SdoAbortedError) as refused:
        sdo.upload(0x5FFF, 0)
    assert refused.value.code == 0x06020000
    write(0x6060, 0, 4, 1)  # profile torque: no SYNC needed
    write(0x6087, 0, 5000, 4)
    network.send_message(0, b"\x01\x01")
    for word, state in ((6, 0x21), (7, 0x23), (15, 0x27)):
        write(0x6040, 0, word, 2)
        assert status() == state
    write(0x6071, 0, 200, 2)  # 10 N·m

    def moved() -> bool:
        return int.from_bytes(sdo.upload(0x6064, 0), "little", signed=True) > 1000

    until(moved)
    assert moved()
    write(0x6071, 0, 0, 2)
    write(0x6040, 0, 0, 2)
    assert status() == 0x40


def test_the_command_runs_in_its_own_process_and_ends_cleanly(tmp_path: Path) -> None:
    data = yaml.safe_load(CASE_STUDY.read_text(encoding="utf-8"))
    data["bus"].update(interface="invid-unix", channel=str(tmp_path / "cell.sock"))
    path = tmp_path / "cell.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    code = "from invid.cli import main; main()"
    command = [sys.executable, "-c", code, "simcell", str(path), "--json"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        line = process.stderr.readline() if process.stderr else ""
        assert "ready on invid-unix" in line
        with can.Bus(interface="invid-unix", channel=data["bus"]["channel"]) as bus:
            bus.send(
                can.Message(
                    arbitration_id=0x601, is_extended_id=False, data=bytes.fromhex("4000100000000000")
                )
            )
            answer = bus.recv(PATIENCE_S)
            assert answer is not None
            assert answer.arbitration_id == 0x581
            bus.set_filters([{"can_id": 0x7FF, "can_mask": 0x7FF}])
            process.send_signal(signal.SIGTERM)
            out, _ = process.communicate(timeout=PATIENCE_S)
            with pytest.raises(can.CanOperationError, match="gone"):
                bus.recv(None)  # what is still in the queue is filtered out
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 0
    document = json.loads(out)
    assert document["format"] == "invid-simcell"
    assert document["simulated"] is True
    assert document["frames_received"] == 1
    assert not (tmp_path / "cell.sock").exists()


def test_a_second_cell_on_the_same_socket_is_refused_and_a_stale_one_replaced(tmp_path: Path) -> None:
    channel = str(tmp_path / "cell.sock")
    running = Running(on("invid-unix", channel))
    with pytest.raises(InvidError, match="listens there already"):
        run_simcell(on("invid-unix", channel), threading.Event())
    running.end()
    Path(channel).write_text("a file", encoding="utf-8")
    with pytest.raises(InvidError, match="no socket is in the way"):
        run_simcell(on("invid-unix", channel), threading.Event())
    assert Path(channel).read_text(encoding="utf-8") == "a file"
