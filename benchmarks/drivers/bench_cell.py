"""Ratios of the simulated cell, measured in one run: read the ratios, not the absolute rates.

- cycles/s of the simulated cell (three axes, SYNC + 3 RPDO + 3 TPDO, plant included) against
  ``canopen`` PDO objects on both sides of python-can's ``virtual`` bus, without a plant;
- simulated seconds per second of the plant against scipy's ``solve_ivp`` on the same equations.

Run with ``python benchmarks/drivers/bench_cell.py [--json]``.
"""

from __future__ import annotations

import argparse
import json
import struct
import sys
import threading
import time

import can
import canopen
import numpy as np
from canopen.objectdictionary import ODArray, ODVariable
from scipy.integrate import solve_ivp

from invid.config import load_config
from invid.model.chains import case_study
from invid_drivers.simulated import CASE_STUDY, VirtualTimeBus, kernel, open_virtual_bus
from invid_drivers.simulated.config import AxisSimulation
from invid_drivers.simulated.plant import Plant
from invid_drivers.simulated.structure import build_structure

AXES = 3
PERIOD_S = 0.001


def _write(bus: VirtualTimeBus, node: int, index: int, sub: int, code: str, value: int) -> None:
    data = struct.pack("<" + code, value)
    head = struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, index, sub)
    bus.send_raw(0x600 + node, head + data.ljust(4, b"\0"))
    while (frame := bus.recv_raw(0.1)) is not None and frame[1] != 0x580 + node:
        pass
    if frame is None or frame[2][0] != 0x60:
        raise RuntimeError(f"node {node} refused {index:#x}:{sub}")


def _prepare(bus: VirtualTimeBus) -> None:
    bus.clock.sleep_until(0.01)
    for node in range(1, AXES + 1):
        for communication, mapping, cob, objects in (
            (0x1400, 0x1600, 0x200, (0x60710010, 0x60400010)),
            (0x1800, 0x1A00, 0x180, (0x60640020, 0x60770010)),
        ):
            _write(bus, node, communication, 1, "I", 0x80000000 | cob + node)
            _write(bus, node, mapping, 0, "B", 0)
            for sub, value in enumerate(objects, start=1):
                _write(bus, node, mapping, sub, "I", value)
            _write(bus, node, mapping, 0, "B", len(objects))
            _write(bus, node, communication, 2, "B", 1)
            _write(bus, node, communication, 1, "I", cob + node)
        _write(bus, node, 0x6060, 0, "b", 10)
    bus.send_raw(0, b"\x01\x00")


def simulated_cell(cycles: int, *, friction: bool = True) -> tuple[float, float]:
    """Cycles per second of wall and of processor time, raw frames; dry friction on every axis or none."""
    config = load_config(CASE_STUDY)
    if not friction:
        axes = {name: {} for name in config.simulation["axes"]}
        config = config.model_copy(update={"simulation": {**config.simulation, "axes": axes}})
    command = struct.Struct("<hH").pack
    with open_virtual_bus(config) as bus:
        _prepare(bus)
        start = round(bus.clock.now() + 0.002, 3)
        began = processor = 0.0
        for k in range(-50, cycles):
            if k == 0:
                began, processor = time.perf_counter(), time.process_time()
            bus.clock.sleep_until(start + (k + 50) * PERIOD_S)
            word = (6, 7, 15)[min((k + 50) // 10, 2)]
            bus.send_raw(0x80, b"")
            for node in range(1, AXES + 1):
                bus.send_raw(0x200 + node, command(100 if k % 200 < 100 else -100, word))
            for _ in range(AXES):
                if bus.recv_raw(0.0009) is None:
                    raise RuntimeError("a TPDO is missing")
        elapsed, used = time.perf_counter() - began, time.process_time() - processor
        if not np.any(bus.cell.plant.positions):
            raise RuntimeError("nothing moved: this would be the rate of an idle cell")
    return cycles / elapsed, cycles / used


def _dictionary() -> canopen.ObjectDictionary:
    od = canopen.ObjectDictionary()
    for index, kind in ((0x6071, 0x03), (0x6040, 0x06), (0x6064, 0x04), (0x6077, 0x03)):
        variable = ODVariable(f"object {index:x}", index)
        variable.data_type = kind
        variable.pdo_mappable = True
        variable.default = 0
        od.add_object(variable)
    for base in (0x1400, 0x1800, 0x1600, 0x1A00):
        array = ODArray(f"pdo {base:x}", base)
        for sub in range(9):
            item = ODVariable(f"item {sub}", base, sub)
            item.data_type = 0x05 if sub == 0 or (base in (0x1400, 0x1800) and sub == 2) else 0x07
            item.default = 0
            array.add_member(item)
        od.add_object(array)
    return od


def canopen_objects(cycles: int) -> float:
    """Cycles per second of the ``canopen`` library with its PDO objects and notifier threads."""
    master, slave = canopen.Network(), canopen.Network()
    for network in (master, slave):
        network.connect(interface="virtual", channel="bench-cell", receive_own_messages=False)
    arrived = threading.Semaphore(0)
    commands, answers = [], []
    local_maps = []
    for number in range(1, AXES + 1):
        remote = master.add_node(number, _dictionary())
        local = slave.create_node(number, _dictionary())
        for pdos, objects, cob, kept in (
            (remote.rpdo[1], (0x6071, 0x6040), 0x200, commands),
            (local.rpdo[1], (0x6071, 0x6040), 0x200, None),
            (remote.tpdo[1], (0x6064, 0x6077), 0x180, answers),
            (local.tpdo[1], (0x6064, 0x6077), 0x180, local_maps),
        ):
            pdos.clear()
            for index in objects:
                pdos.add_variable(index)
            pdos.cob_id, pdos.enabled, pdos.trans_type = cob + number, True, 1
            pdos.subscribe()
            if kept is not None:
                kept.append(pdos)
        remote.tpdo[1].add_callback(lambda _pdo: arrived.release())

    def answer(_id: int, _data: bytearray, _time: float) -> None:
        for made in local_maps:
            made[0].raw = 1234
            made[1].raw = 12
            made.transmit()

    slave.subscribe(0x80, answer)
    try:
        began = time.perf_counter()
        for k in range(cycles):
            master.send_message(0x80, b"")
            for made in commands:
                made[0].raw = k % 100
                made[1].raw = 15
                made.transmit()
            for _ in range(AXES):
                if not arrived.acquire(timeout=2.0):
                    raise RuntimeError("a TPDO is missing")
            for made in answers:
                _ = made[0].raw, made[1].raw
        return cycles / (time.perf_counter() - began)
    finally:
        master.disconnect()
        slave.disconnect()


def plant_rate(seconds: float) -> float:
    """Simulated seconds per second of the compiled plant, Coulomb friction included."""
    chains = case_study(damping_ratio=0.01)
    axis = AxisSimulation.model_validate({"friction": {"coulomb_Nm": 1.0}})
    plant = Plant(build_structure(chains, [axis] * AXES, []), 0.00025)
    plant.command[:, kernel.MODE] = kernel.MODE_TORQUE
    plant.advance_to(1_000_000)
    began = time.perf_counter()
    for k in range(round(seconds / PERIOD_S)):
        plant.command[:, kernel.TORQUE] = 20.0 if k % 200 < 100 else -20.0
        plant.advance_to((k + 2) * 1_000_000)
    return seconds / (time.perf_counter() - began)


def reference_rate(seconds: float) -> float:
    """The same by ``solve_ivp`` (RK45, rtol 1e-6), friction regularised at 1 mrad/s."""
    chains = case_study(damping_ratio=0.01)
    inverse = np.linalg.inv(chains.mass_matrix)
    stiffness, damping, motors = chains.stiffness_matrix, chains.damping_matrix, chains.motor_dofs
    state = np.zeros(2 * chains.dofs)

    def slope(_t: float, x: np.ndarray, torque: float) -> np.ndarray:
        q, v = np.split(x, 2)
        force = -stiffness @ q - damping @ v
        force[motors] += torque - np.tanh(v[motors] / 1e-3)
        return np.concatenate((v, inverse @ force))

    began = time.perf_counter()
    # Restarted only where the torque jumps, every tenth of a second: not once a cycle.
    for k in range(round(seconds / 0.1)):
        span = (0.1 * k, 0.1 * (k + 1))
        state = solve_ivp(slope, span, state, args=(20.0 - 40.0 * (k % 2),), rtol=1e-6, atol=1e-9).y[:, -1]
    return seconds / (time.perf_counter() - began)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    as_json = parser.parse_args().json
    simulated_cell(500)  # compiles or loads the kernel
    rounds = [
        {
            **dict(zip(("cell", "cell_cpu"), simulated_cell(10000), strict=True)),
            "cell_cpu_without_friction": simulated_cell(5000, friction=False)[1],
            "canopen": canopen_objects(2000),
            "plant": plant_rate(20.0),
            "solve_ivp": reference_rate(0.3),
        }
        for _ in range(3)
    ]
    best = {key: max(r[key] for r in rounds) for key in rounds[0]}
    result = {
        "cell_cycles_per_s": best["cell"],
        "canopen_virtual_cycles_per_s": best["canopen"],
        "cell_over_canopen": best["cell"] / best["canopen"],
        "cell_over_real_time_at_1kHz": best["cell"] * PERIOD_S,
        "cell_over_real_time_at_1kHz_cpu": best["cell_cpu"] * PERIOD_S,
        "friction_costs": best["cell_cpu_without_friction"] / best["cell_cpu"],
        "plant_s_per_s": best["plant"],
        "solve_ivp_s_per_s": best["solve_ivp"],
        "plant_over_solve_ivp": best["plant"] / best["solve_ivp"],
        "python_can": can.__version__,
    }
    if as_json:
        json.dump(result, sys.stdout, indent=2)
        sys.stdout.write("\n")
        return
    print(f"simulated cell, 3 axes, plant included   {best['cell']:10.0f} cycles/s")
    print(f"canopen PDO objects on python-can virtual {best['canopen']:9.0f} cycles/s")
    print(f"  ratio {result['cell_over_canopen']:.1f}; at 1 kHz {best['cell'] * PERIOD_S:.0f} x real time")
    print(
        f"  by processor time {best['cell_cpu'] * PERIOD_S:.0f} x real time (bar 30) with dry friction on "
        f"three axes, which costs a factor {result['friction_costs']:.2f}"
    )
    print(f"plant, case study with Coulomb friction  {best['plant']:10.0f} simulated s per s")
    print(f"scipy solve_ivp on the same equations    {best['solve_ivp']:10.2f} simulated s per s")
    print(f"  ratio {result['plant_over_solve_ivp']:.0f}")


if __name__ == "__main__":
    main()
