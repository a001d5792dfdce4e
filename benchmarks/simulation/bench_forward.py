"""Ratios in one run: forward FRF against a full solve per line; plant steps against other simulators.

`solve_ivp` runs once over the whole time, never restarted. MuJoCo and python-control are optional
(`pip install invid[bench]`) and named where they are missing.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp

from invid.model.chains import CoupledChains, case_study
from invid.model.forward import dynamic_stiffness
from invid.simulation.kernel import march
from invid.simulation.laws import Laws
from invid.simulation.plant import discretise, matrices


def best(task: Callable[[], object], repeats: int = 5) -> float:
    """Least processor time of some runs [s]; the first, which compiles, is not counted."""
    task()
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        task()
        times.append(time.process_time() - begin)
    return min(times)


def chain(branches: int, masses: int) -> CoupledChains:
    """Random chains of this size."""
    rng = np.random.default_rng(0)
    ends = rng.uniform(1, 4, (branches, masses))
    off = np.triu(rng.uniform(-0.2, 0.2, (branches, branches)), 1) / branches
    return CoupledChains.build(
        list(ends),
        list(rng.uniform(1e3, 4e3, (branches, masses - 1))),
        list(rng.uniform(0.5, 2, (branches, masses - 1))),
        off + off.T,
    )


def full_solve(chains: CoupledChains, omega: np.ndarray) -> np.ndarray:
    """Receptance by one dense solve a line, as one would without the recursion."""
    motors = np.eye(chains.dofs)[:, chains.motor_dofs]
    stiffness, damping, mass = chains.stiffness_matrix, chains.damping_matrix, chains.mass_matrix
    out = np.empty((omega.size, chains.branches, chains.branches), dtype=complex)
    for f, w in enumerate(omega):
        full = stiffness + 1j * w * damping - w * w * mass
        out[f] = np.linalg.solve(full, motors)[chains.motor_dofs]
    return out


def forward() -> None:
    """Chain recursion and M×M inverse against the dense solve."""
    omega = np.linspace(3, 70, 1000)
    for branches, masses in ((3, 3), (8, 3), (8, 10)):
        chains = chain(branches, masses)
        fast = best(lambda c=chains: np.linalg.inv(dynamic_stiffness(c, omega)))  # type: ignore[misc]
        slow = best(lambda c=chains: full_solve(c, omega), 2)  # type: ignore[misc]
        error = np.max(
            np.abs(np.linalg.inv(dynamic_stiffness(chains, omega)) / full_solve(chains, omega) - 1)
        )
        print(
            f"forward FRF, M={branches} N={masses}, 1000 lines: recursion {1e3 * fast:.2f} ms, full solve "
            f"{1e3 * slow:.1f} ms, ratio {slow / fast:.1f}; largest difference {error:.1e}"
        )


def plant() -> None:
    """Compiled exact steps of 0.25 ms against solve_ivp at rtol 1e-6, case study, 10 s."""
    chains = case_study(damping_ratio=0.01)
    h, duration = 2.5e-4, 10.0
    steps = round(duration / h)
    n = chains.dofs
    inputs = np.eye(n)[:, chains.motor_dofs]
    step = discretise(matrices(chains, Laws()), inputs, h)
    fine = np.arange(steps + 1) * h
    torque = np.sin(2 * np.pi * np.array([2.0, 3.0, 5.0]) * fine[:, None])
    out = np.zeros((steps + 1, 3, 2))

    def compiled() -> None:
        march(
            np.zeros(2 * n),
            step.transition,
            step.now,
            step.next,
            step.force,
            torque,
            np.zeros((0, 3)),
            np.zeros((0, 4)),
            np.zeros((1, 2)),
            np.zeros((0, 2)),
            h,
            1,
            out,
            chains.motor_dofs.astype(np.int64),
        )

    inverse = np.linalg.inv(chains.mass_matrix)
    a, b = -inverse @ chains.stiffness_matrix, -inverse @ chains.damping_matrix
    push = inverse @ inputs
    calls = 0

    def slope(t: float, x: np.ndarray) -> np.ndarray:
        nonlocal calls
        calls += 1
        u = np.sin(2 * np.pi * np.array([2.0, 3.0, 5.0]) * t)
        return np.concatenate((x[n:], a @ x[:n] + b @ x[n:] + push @ u))

    fast = best(compiled)
    begin = time.process_time()
    answer = solve_ivp(slope, (0, duration), np.zeros(2 * n), rtol=1e-6, atol=1e-9, t_eval=fine[::4])
    slow = time.process_time() - begin
    accepted = calls / 6  # RK45: six evaluations a step
    error = np.max(np.abs(out[::4, :, 0] - answer.y[chains.motor_dofs].T)) / np.max(np.abs(out[:, :, 0]))
    print(
        f"plant, case study, 10 s: compiled {steps / fast:.3g} steps/s, solve_ivp {accepted / slow:.3g} "
        f"steps/s, ratio {steps / fast / (accepted / slow):.0f}; whole run {slow / fast:.0f} times faster; "
        f"largest difference {error:.1e}"
    )
    exact = out[::4, :, 0].copy()
    for name, simulate in (("MuJoCo", by_mujoco), ("python-control", by_control)):
        try:
            positions, took = simulate(chains, torque, h)
        except ImportError as missing:
            print(f"plant, case study, 10 s: {name} NOT RUN: {missing} (pip install invid[bench])")
            continue
        error = np.max(np.abs(exact - positions[::4])) / np.max(np.abs(exact))
        print(
            f"plant, case study, 10 s: {name} {steps / took:.3g} steps/s, ratio {took / fast:.0f}; "
            f"largest difference {error:.1e} at the same step of {1e3 * h:g} ms"
        )


def by_mujoco(chains: CoupledChains, torque: np.ndarray, h: float) -> tuple[np.ndarray, float]:
    """Motor positions at every step and the processor time, by MuJoCo with Runge-Kutta steps.

    Every mass turns about one axis, each body inside the one before (MuJoCo couples the inertia of one tree
    only), so that an angle is the sum of the joints up to it; springs, dampers and couplings are tendons.
    """
    import mujoco

    tendons: list[str] = []
    inertia = np.diag(chains.mass_matrix).copy()
    motors, ends = chains.motor_dofs, chains.end_dofs
    for i in range(chains.branches):
        for j in range(i + 1, chains.branches):
            # Armature of √r·θᵢ ± θⱼ/√r adds |c|·r, |c|/r and c; r keeps what is left of both masses positive.
            c = float(chains.couplings[i, j])
            r = float(np.sqrt(chains.masses[i][-1] / chains.masses[j][-1]))
            inertia[ends[i]] -= abs(c) * r
            inertia[ends[j]] -= abs(c) / r
            shares = {int(ends[i]): np.sqrt(r), int(ends[j]): np.sign(c) / np.sqrt(r)}
            tendons.append(_tendon(shares, f'armature="{abs(c)}"'))
    for start, springs, dampers in zip(motors, chains.springs, chains.dampers, strict=True):
        for s, (k, d) in enumerate(zip(springs, dampers, strict=True)):
            stretch = f'stiffness="{k}" damping="{d}" springlength="0 0"'
            tendons.append(_tendon({int(start) + s: 1.0, int(start) + s + 1: -1.0}, stretch))
    bodies = "".join(
        f'<body><inertial pos="0 0 0" mass="1" diaginertia="{m} {m} {m}"/>'
        f'<joint name="j{q}" type="hinge" axis="0 0 1"/>'
        for q, m in enumerate(inertia)
    )
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{h}" gravity="0 0 0" integrator="RK4"/>'
        f"<worldbody>{bodies}{'</body>' * inertia.size}</worldbody>"
        f"<tendon>{''.join(tendons)}</tendon></mujoco>"
    )
    data = mujoco.MjData(model)
    pushed = np.tril(np.ones((inertia.size, inertia.size)))[motors]
    out = np.zeros((torque.shape[0], motors.size))
    begin = time.process_time()
    for k in range(torque.shape[0] - 1):
        data.qfrc_applied[:] = 0.5 * (torque[k] + torque[k + 1]) @ pushed
        mujoco.mj_step(model, data)
        out[k + 1] = pushed @ data.qpos
    return out, time.process_time() - begin


def _tendon(shares: dict[int, float], attributes: str) -> str:
    """A tendon whose length is a weighted sum of angles, each the sum of the joints up to it."""
    weights = [sum(w for q, w in shares.items() if joint <= q) for joint in range(max(shares) + 1)]
    joints = "".join(f'<joint joint="j{q}" coef="{w}"/>' for q, w in enumerate(weights) if w != 0.0)
    return f"<fixed {attributes}>{joints}</fixed>"


def by_control(chains: CoupledChains, torque: np.ndarray, h: float) -> tuple[np.ndarray, float]:
    """Motor positions at every step and the processor time, by python-control's ``forced_response``."""
    import control

    n, motors = chains.dofs, chains.motor_dofs
    inverse = np.linalg.inv(chains.mass_matrix)
    a = np.block(
        [
            [np.zeros((n, n)), np.eye(n)],
            [-inverse @ chains.stiffness_matrix, -inverse @ chains.damping_matrix],
        ]
    )
    b = np.concatenate((np.zeros((n, motors.size)), inverse[:, motors]))
    c = np.eye(2 * n)[motors]
    begin = time.process_time()
    answer = control.forced_response(
        control.ss(a, b, c, np.zeros((motors.size, motors.size))), np.arange(torque.shape[0]) * h, torque.T
    )
    return np.asarray(answer.outputs).T, time.process_time() - begin


if __name__ == "__main__":
    forward()
    plant()
