"""Ratios in one run: forward FRF against a full solve per line; plant steps against scipy solve_ivp."""

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
        f"plant, case study, 10 s: compiled {steps / fast:.3g} steps/s, "
        f"solve_ivp {accepted / slow:.3g} steps/s, "
        f"ratio {steps / fast / (accepted / slow):.0f}; whole run {slow / fast:.0f} times faster; "
        f"largest difference {error:.1e}"
    )


if __name__ == "__main__":
    forward()
    plant()
