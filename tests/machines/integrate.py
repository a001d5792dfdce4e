"""Semi-implicit steps with friction that sticks; one axis (also on springs), two links, two masses."""

from __future__ import annotations

import numba
import numpy as np

# Columns of the law of one axis.
UP, DOWN, WET_UP, WET_DOWN, EXCESS, SLOW, OFFSET, SINE, COSINE, LOADED, DRAG, RIPPLE, CYCLES = range(13)
SPRING1, SPRING2, SPRING3, HUM, HUM_HZ = range(13, 18)
LAW = 18


@numba.njit(cache=True)
def dry_level(law, load, v, up):
    level = law[UP] if up else law[DOWN]
    if law[SLOW] > 0:
        level += law[EXCESS] * np.exp(-((v / law[SLOW]) ** 2))
    return level + law[LOADED] * abs(load)


@numba.njit(cache=True)
def one_axis(reference, speed, drive, sub, dt, mass, kp, kd, limit, law):
    """(n, 3) position, velocity and command at the samples; ``drive`` is added to the loop's command."""
    count = reference.size // sub
    out = np.zeros((count, 3))
    q, v, command = reference[0], 0.0, 0.0
    for k in range(count * sub):
        if k % sub == 0:
            command = kp * (reference[k] - q) + kd * (speed[k] - v) + drive[k // sub]
            command = min(max(command, -limit), limit)
            out[k // sub] = q, v, command
        load = law[SINE] * np.sin(q) + law[COSINE] * np.cos(q)
        smooth = load + law[OFFSET] + law[DRAG] * abs(v) * v + law[RIPPLE] * np.sin(law[CYCLES] * q)
        smooth += law[HUM] * np.sin(2 * np.pi * law[HUM_HZ] * k * dt)
        smooth += q * (law[SPRING1] + q * (law[SPRING2] + q * law[SPRING3]))
        smooth += (law[WET_UP] if v > 0 else law[WET_DOWN]) * v
        free = v + dt * (command - smooth) / mass
        grip = dt * dry_level(law, load, v, free > 0) / mass
        v = 0.0 if abs(free) <= grip else free - np.sign(free) * grip
        q += dt * v
    return out


@numba.njit(cache=True)
def two_links(reference, speed, sub, dt, inertia, gravity, kp, kd, dry, wet):
    """(n, 6) positions, velocities, commands of two links in series.

    ``inertia`` = (a, b, d): M11 = a + 2b cos q2, M12 = d + b cos q2, M22 = d;
    ``gravity`` = (g1, g2): g1 sin q1 + g2 sin(q1 + q2) and g2 sin(q1 + q2), angles from hanging.
    """
    count = reference.shape[0] // sub
    out = np.zeros((count, 6))
    q, v, u = reference[0].copy(), np.zeros(2), np.zeros(2)
    a, b, d = inertia
    for k in range(count * sub):
        if k % sub == 0:
            for i in range(2):
                u[i] = kp[i] * (reference[k, i] - q[i]) + kd[i] * (speed[k, i] - v[i])
                out[k // sub, i], out[k // sub, 2 + i], out[k // sub, 4 + i] = q[i], v[i], u[i]
        c, s = np.cos(q[1]), np.sin(q[1])
        m11, m12, m22 = a + 2 * b * c, d + b * c, d
        far = gravity[1] * np.sin(q[0] + q[1])
        f1 = u[0] + b * s * (2 * v[0] * v[1] + v[1] ** 2) - gravity[0] * np.sin(q[0]) - far - wet[0] * v[0]
        f2 = u[1] - b * s * v[0] ** 2 - far - wet[1] * v[1]
        det = m11 * m22 - m12 * m12
        i11, i12, i22 = m22 / det, -m12 / det, m11 / det
        w1, w2 = v[0] + dt * (i11 * f1 + i12 * f2), v[1] + dt * (i12 * f1 + i22 * f2)
        p1 = p2 = 0.0
        for _ in range(20):
            wanted = min(max(p1 + w1 / i11, -dt * dry[0]), dt * dry[0])
            w1, w2, p1 = w1 - i11 * (wanted - p1), w2 - i12 * (wanted - p1), wanted
            wanted = min(max(p2 + w2 / i22, -dt * dry[1]), dt * dry[1])
            w1, w2, p2 = w1 - i12 * (wanted - p2), w2 - i22 * (wanted - p2), wanted
        v[0], v[1] = w1, w2
        q[0] += dt * w1
        q[1] += dt * w2
    return out


@numba.njit(cache=True)
def two_masses(torque, sub, dt, motor, load, spring, damper, dry, wet_motor, wet_load):
    """(n, 2) motor position and held torque of a motor and a load on a spring, from rest."""
    count = torque.size
    out = np.zeros((count, 2))
    q, v, p, w = 0.0, 0.0, 0.0, 0.0
    for k in range(count):
        out[k] = q, torque[k]
        for _ in range(sub):
            pull = spring * (q - p) + damper * (v - w)
            free = v + dt * (torque[k] - pull - wet_motor * v) / motor
            grip = dt * dry / motor
            v = 0.0 if abs(free) <= grip else free - np.sign(free) * grip
            w += dt * (pull - wet_load * w) / load
            q += dt * v
            p += dt * w
    return out
