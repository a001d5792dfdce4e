"""The compiled step of a rigid (or grounded) machine: leapfrog, dry friction set-valued, PD loop inside.

v⁺ = v + h M⁻¹ (τ − F(q, v)), q⁺ = q + h v⁺, with the velocity half a step behind the position: second order,
and no energy is made. Dry friction takes whatever value within its level stops the axis at the end of the
step, so that sticking is exact.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from invid.numerics.compiled import compiled, inlined
from invid.simulation.kernel import on_table


@inlined
def _add_axis_forces(
    force: Any,
    load: Any,
    effective: Any,
    q: Any,
    v: Any,
    smooth: Any,
    dry: Any,
    static: Any,
    tables: Any,
    step: float,
) -> None:
    """Springs, weight, viscous friction and tables of every axis by itself; ``load`` is set anew."""
    for i in range(q.size):
        viscous = dry[i, 2] if v[i] > 0 else dry[i, 3]
        spring = q[i] * (smooth[i, 0] + q[i] * (smooth[i, 1] + q[i] * smooth[i, 2]))
        weight = smooth[i, 4] * np.sin(q[i]) + smooth[i, 5] * np.cos(q[i])
        force[i] = force[i] - spring - smooth[i, 3] - weight - viscous * v[i]
        load[i] = weight + dry[i, 9] * smooth[i, 3]
        for r in range(static.shape[0]):
            if int(static[r, 0]) == i:
                force[i] -= on_table(tables, r, static[r, 1], static[r, 2], static[r, 3], q[i], v[i])
        # Half of the step's viscous force at its end: second order, and stable for any coefficient.
        effective[i, i] += 0.5 * step * viscous


@inlined
def _add_second_link(q: Any, v: Any, carried: Any, dry: Any, effective: Any, force: Any, load: Any) -> None:
    """What the second of two links in series adds to inertia, force and load of both."""
    c, n = np.cos(q[1]), np.sin(q[1])
    b = carried[0] * c - carried[1] * n
    slope = -carried[0] * n - carried[1] * c
    effective[0, 0] += 2 * b
    effective[0, 1] += b
    effective[1, 0] += b
    force[0] -= slope * (2 * v[0] * v[1] + v[1] * v[1])
    force[1] += slope * v[0] * v[0]
    weight = carried[2] * np.sin(q[0] + q[1]) + carried[3] * np.cos(q[0] + q[1])
    force[0] -= weight
    force[1] -= weight
    load[0] += weight + dry[0, 9] * slope * (2 * v[0] * v[1] + v[1] * v[1])
    load[1] += weight - dry[1, 9] * slope * v[0] * v[0]


@inlined
def _invert(effective: Any, inverse: Any) -> None:
    """Inverse of the inertia matrix, which is left as the unit matrix."""
    axes = effective.shape[0]
    if axes == 1:
        inverse[0, 0] = 1.0 / effective[0, 0]
    else:
        # Gauss–Jordan without pivoting: an inertia matrix is positive definite.
        for i in range(axes):
            for j in range(axes):
                inverse[i, j] = 1.0 if i == j else 0.0
        for p in range(axes):
            pivot = effective[p, p]
            for j in range(axes):
                effective[p, j] /= pivot
                inverse[p, j] /= pivot
            for i in range(axes):
                if i != p:
                    factor = effective[i, p]
                    for j in range(axes):
                        effective[i, j] -= factor * effective[p, j]
                        inverse[i, j] -= factor * inverse[p, j]


@inlined
def _stop_by_dry_friction(
    change: Any, impulse: Any, v: Any, load: Any, dry: Any, inverse: Any, step: float
) -> None:
    """Velocities ``change`` at the end of the step with what dry friction takes from them."""
    axes = change.size
    for _ in range(1 if axes == 1 else 10):
        for i in range(axes):
            excess = 0.0
            if dry[i, 6] > 0:
                excess = np.exp(-((abs(v[i]) / dry[i, 6]) ** dry[i, 7]))
            heavy = dry[i, 8] * abs(load[i])
            up = step * max(dry[i, 0] + excess * dry[i, 4] + heavy, 0.0)
            down = step * max(dry[i, 1] + excess * dry[i, 5] + heavy, 0.0)
            stop = impulse[i] + change[i] / inverse[i, i]
            wanted = min(max(stop, -down), up)
            for j in range(axes):
                change[j] -= inverse[j, i] * (wanted - impulse[i])
            impulse[i] = wanted


@compiled
def march(
    state: Any,
    torque: Any,
    reference: Any,
    law: Any,
    mass: Any,
    carried: Any,
    smooth: Any,
    dry: Any,
    static: Any,
    tables: Any,
    step: float,
    substeps: int,
    out: Any,
    acted: Any,
) -> None:
    """March over all samples; position into ``out`` (n, M), torque that acted into ``acted`` (n, M).

    Parameters
    ----------
    state
        (2, M) position and velocity at the first sample, changed in place.
    torque
        (n·substeps, M) open-loop torque (feedforward where a loop is closed) of every sub-step.
    reference
        (n, M) what the controller is told, at the samples.
    law
        (M, 6) controller: closed (0 or 1), stiffness, damping, limit, samples that its velocity spans, and
        sub-steps that its command takes to act.
    mass
        (M, M) constant part of the inertia.
    carried
        (5,) two links in series: cosine and sine of the inertia that varies with the second angle, sine
        and cosine of the second link's gravity, 1 where there are such.
    smooth
        (M, 6) springs to ground of first, second, third power; constant; sine and cosine of gravity.
    dry
        (M, 10) Coulomb and viscous levels up and down, low-speed excess up and down, its velocity and
        exponent, friction per load and 1 where inertia counts as load (that of the step before).
    static, tables
        (S, 4) axis, 0 of position or 1 of velocity or 2 of both, largest position and velocity in the table;
        (S, P) resistance over even steps from minus to plus that value, √P by √P of both, straight on beyond.
    """
    count, axes = out.shape
    q, v, start = state[0], state[1], state[1].copy()
    command, earlier = np.zeros(axes), np.zeros(axes)
    force, change, effective = np.zeros(axes), np.zeros(axes), np.zeros((axes, axes))
    inverse = np.zeros((axes, axes))
    impulse, load, acceleration = np.zeros(axes), np.zeros(axes), np.zeros(axes)
    for k in range(count):
        for i in range(axes):
            out[k, i] = q[i]
            earlier[i], command[i] = command[i], 0.0
            acted[k, i] = torque[k * substeps, i]
            if law[i, 0] > 0:
                # A digital controller knows the velocity as a difference of its own samples.
                span = int(law[i, 4])
                then = out[k - span, i] if k >= span else out[0, i] + (k - span) * start[i] * step * substeps
                rate = (q[i] - then) / (span * step * substeps)
                command[i] = law[i, 1] * (reference[k, i] - q[i]) - law[i, 2] * rate
                command[i] += torque[k * substeps, i]
                command[i] = min(max(command[i], -law[i, 3]), law[i, 3])
                acted[k, i] = command[i]
            if k == 0:
                earlier[i] = command[i]
        if k == count - 1:
            break
        for s in range(substeps):
            for i in range(axes):
                force[i] = torque[k * substeps + s, i]
                if law[i, 0] > 0:
                    force[i] = earlier[i] if s < law[i, 5] else command[i]
            effective[:] = mass
            _add_axis_forces(force, load, effective, q, v, smooth, dry, static, tables, step)
            if carried[4] > 0:
                _add_second_link(q, v, carried, dry, effective, force, load)
            for i in range(axes):
                for j in range(axes):
                    load[i] += dry[i, 9] * effective[i, j] * acceleration[j]
            _invert(effective, inverse)
            for i in range(axes):
                change[i] = v[i]
                for j in range(axes):
                    change[i] += step * inverse[i, j] * force[j]
                impulse[i] = 0.0
            _stop_by_dry_friction(change, impulse, v, load, dry, inverse, step)
            for i in range(axes):
                acceleration[i] = (change[i] - v[i]) / step
                v[i] = change[i]
                q[i] += step * v[i]
