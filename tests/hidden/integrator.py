"""Implicit midpoint with set-valued friction: the hidden plant's own time integration.

M (v⁺ − v) = h [−K q_mid − C v_mid + F],  q⁺ = q + h v_mid,  v_mid = (v + v⁺)/2. Dry friction is a
projection on its set of admissible forces so that v⁺ = 0 while it holds (stick is exact, no
smoothing); everything else acts at the midpoint predicted from the last two steps.

Shares nothing with ``invid``: no exact discretisation, no effect modules.
"""

from enum import IntEnum

import numpy as np
from numba import njit


class Law(IntEnum):
    """What acts in the plant, by number for the compiled kernel; ``par`` in brackets."""

    DRY = 0  # [force moving up, force moving down, viscous up, viscous down] on mass a
    STRIBECK = 1  # [static, coulomb, velocity]
    BRISTLE = 2  # [stiffness, force] spring-slider on mass a (elastoplastic, Jenkins)
    DAHL = 3  # [stiffness, force] Dahl's smooth presliding
    CONSTANT = 4  # [force] (adds to the resistance: acts as −force)
    RIPPLE = 5  # [force, cycles, phase] sinusoid of position on mass a
    CUBIC_SPRING = 6  # [coefficient] between a and b
    BACKLASH = 7  # [gap, stiffness, damping] of the spring between a and b
    SPRING_SLIDER = 8  # [stiffness, force] parallel to the spring between a and b
    TRANSMISSION_ERROR = 9  # [amplitude, cycles, phase, stiffness]
    ADDED_MASS = 10  # [mass, time] on a from that time on
    STIFFNESS_DRIFT = 11  # [rate] of the spring between a and b
    MASS_DRIFT = 12  # [rate] on a
    SATURATION = 13  # [limit] motor a (motor number)
    GAIN = 14  # [gain] motor a
    DELAY = 15  # [seconds] motor a
    LAG = 16  # [time constant] motor a
    ECCENTRICITY = 17  # [amplitude, phase] encoder of motor a
    # outside invid's catalogue
    POWER_DRAG = 30  # [coefficient, power] −c |v|^p sign v on a
    CROSS_DRAG = 31  # [coefficient] −c v_b |v_b| on a
    TIME_PERIODIC = 32  # [force, hertz, phase, force 3rd harmonic] on a
    TURNING_INERTIA = 33  # [inertia, phase] J cos(q + phase) on a, with its Coriolis force
    POSITION_DAMPING = 34  # [coefficient] −c q_b v_a on a
    SATURATING_SPRING = 35  # [stiffness, force] F tanh(k (q_a − q_b)/F)
    IMPACT = 36  # [impulse, position, duration] a knock whenever mass a passes a position upward
    END_STOP = 37  # [stiffness, position] contact above a position on a
    GYROSCOPIC = 38  # [coefficient] −g v_b on a, +g v_a on b
    SQUARE_SPRING = 39  # [coefficient] −c d² between a and b
    DEFLECTION_DAMPING = 40  # [coefficient] −c d² ḋ between a and b
    WORN_PLACE = 41  # [coefficient, position, width] −c exp(−((q − position)/width)²) v on a


@njit(cache=True)
def integrate(
    steps,
    sub,
    h,
    inverse,
    mass2,
    stiffness,
    motors,
    excitation,
    reference,
    reference_rate,
    kp,
    kd,
    hold_sampled,
    q,
    v,
    laws,
    place_a,
    place_b,
    par,
    start_time,
    log_from,
    log_rows,
):
    """March ``steps`` sub-steps; sampled readings (n, M) and sub-step logs of the last period."""
    dofs, count, effects = q.size, motors.size, laws.size
    length = excitation.shape[0]
    ref_length = reference.shape[0]
    n = steps // sub
    position, torque = np.zeros((n, count)), np.zeros((n, count))
    log_position, log_torque = np.zeros((log_rows, count)), np.zeros((log_rows, count))
    previous = v.copy()
    hold, command, applied = np.zeros(count), np.zeros(count), np.zeros(count)
    reading, reading_rate = np.zeros(count), np.zeros(count)
    lagged = np.zeros(count)
    ring_length = 1
    for e in range(effects):
        if laws[e] == 15:
            ring_length = max(ring_length, int(par[e, 0] / h) + 2)
    ring = np.zeros((ring_length, count))
    state = np.zeros((effects, 3))
    for e in range(effects):
        if laws[e] == 8 or laws[e] == 2 or laws[e] == 3:
            state[e, 1] = q[place_a[e]]
            if laws[e] == 8:
                state[e, 1] -= q[place_b[e]]
        if laws[e] == 36:
            state[e, 0] = 1e9
            state[e, 1] = q[place_a[e]]
    force, rhs, mid = np.zeros(dofs), np.zeros(dofs), np.zeros(dofs)
    impulse = np.zeros(effects)
    for step in range(steps):
        t = start_time + step * h
        for d in range(dofs):
            force[d] = 0.0
        for i in range(count):
            reading[i] = q[motors[i]]
            reading_rate[i] = v[motors[i]]
        for e in range(effects):
            if laws[e] == 17:
                i = place_a[e]
                true = q[motors[i]]
                reading[i] = true + par[e, 0] * np.sin(true + par[e, 1])
                reading_rate[i] = v[motors[i]] * (1.0 + par[e, 0] * np.cos(true + par[e, 1]))
        if (not hold_sampled) or step % sub == 0:
            r = step % ref_length
            for i in range(count):
                hold[i] = kp[i] * (reference[r, i] - reading[i]) + kd[i] * (
                    reference_rate[r, i] - reading_rate[i]
                )
        for i in range(count):
            command[i] = excitation[step % length, i] + hold[i]
            applied[i] = command[i]
            ring[step % ring_length, i] = command[i]
        if step % sub == 0:
            for i in range(count):
                position[step // sub, i] = reading[i]
                torque[step // sub, i] = command[i]
        if step >= log_from and step - log_from < log_rows:
            for i in range(count):
                log_position[step - log_from, i] = reading[i]
                log_torque[step - log_from, i] = command[i]
        # forces at the predicted midpoint
        added, added_at = 0.0, -1
        for e in range(effects):
            a, b, law = place_a[e], place_b[e], laws[e]
            if law >= 13 and law <= 16:
                if law == 13:
                    applied[a] = min(max(applied[a], -par[e, 0]), par[e, 0])
                elif law == 14:
                    applied[a] *= par[e, 0]
                elif law == 15:
                    back = par[e, 0] / h
                    whole = int(back)
                    part = back - whole
                    if step - whole - 1 >= 0:
                        applied[a] = (1 - part) * ring[(step - whole) % ring_length, a] + part * ring[
                            (step - whole - 1) % ring_length, a
                        ]
                elif law == 16:
                    if step == 0:
                        lagged[a] = applied[a]
                    lagged[a] += (applied[a] - lagged[a]) * (1.0 - np.exp(-h / par[e, 0]))
                    applied[a] = lagged[a]
                continue
            if law == 17:
                continue
            qa = q[a] + 0.5 * h * v[a]
            va = 1.5 * v[a] - 0.5 * previous[a]
            qb, vb = 0.0, 0.0
            if b >= 0:
                qb = q[b] + 0.5 * h * v[b]
                vb = 1.5 * v[b] - 0.5 * previous[b]
            f = 0.0
            pair = False
            if law == 0:
                f = -(par[e, 2] if va > 0 else par[e, 3]) * va
            elif law == 2 or law == 8:
                x = qa - qb if law == 8 else qa
                z = state[e, 0] + x - state[e, 1]
                most = par[e, 1] / par[e, 0]
                z = min(max(z, -most), most)
                state[e, 0], state[e, 1] = z, x
                f, pair = -par[e, 0] * z, law == 8
            elif law == 3:
                dx = qa - state[e, 1]
                most = par[e, 1] / par[e, 0]
                z = state[e, 0]
                # exact along one direction: z relaxes towards ±most over the distance ``most``
                goal = most if dx > 0 else -most
                z = goal + (z - goal) * np.exp(-abs(dx) / most)
                state[e, 0], state[e, 1] = z, qa
                f = -par[e, 0] * z
            elif law == 4:
                f = -par[e, 0]
            elif law == 5:
                f = -par[e, 0] * np.sin(par[e, 1] * qa + par[e, 2])
            elif law == 6:
                d = qa - qb
                f, pair = -par[e, 0] * d * d * d, True
            elif law == 7:
                d, half = qa - qb, 0.5 * par[e, 0]
                if abs(d) < half:
                    f = par[e, 1] * d + par[e, 2] * (va - vb)
                else:
                    f = par[e, 1] * (half if d > 0 else -half)
                pair = True
            elif law == 9:
                d = qa - qb
                err = par[e, 0] * np.sin(par[e, 1] * qa + par[e, 2])
                slope = par[e, 0] * par[e, 1] * np.cos(par[e, 1] * qa + par[e, 2])
                force[a] += par[e, 3] * (d - (d - err) * (1.0 - slope))
                force[b] -= par[e, 3] * err
            elif law == 10:
                if t >= par[e, 1]:
                    added, added_at = par[e, 0], a
            elif law == 11:
                f, pair = -par[e, 0] * t * (qa - qb), True
            elif law == 12:
                added, added_at = par[e, 0] * t, a
            elif law == 30:
                f = -par[e, 0] * abs(va) ** par[e, 1] * np.sign(va)
            elif law == 31:
                f = -par[e, 0] * vb * abs(vb)
            elif law == 32:
                w = 2 * np.pi * par[e, 1] * (t + 0.5 * h)
                f = par[e, 0] * np.sin(w + par[e, 2]) + par[e, 3] * np.sin(3 * w)
            elif law == 33:
                added, added_at = par[e, 0] * np.cos(qa + par[e, 1]), a
                f = 0.5 * par[e, 0] * np.sin(qa + par[e, 1]) * va * va
            elif law == 34:
                f = -par[e, 0] * qb * va
            elif law == 35:
                f, pair = -par[e, 1] * np.tanh(par[e, 0] * (qa - qb) / par[e, 1]), True
            elif law == 36:
                if qa > par[e, 1] and state[e, 1] <= par[e, 1]:
                    state[e, 0] = 0.0
                state[e, 1] = qa
                if state[e, 0] < par[e, 2]:
                    f = -par[e, 0] * 0.5 * np.pi / par[e, 2] * np.sin(np.pi * state[e, 0] / par[e, 2])
                state[e, 0] += h
            elif law == 37:
                if qa > par[e, 1]:
                    f = -par[e, 0] * (qa - par[e, 1])
            elif law == 38:
                force[a] -= par[e, 0] * vb
                force[b] += par[e, 0] * va
            elif law == 39:
                d = qa - qb
                f, pair = -par[e, 0] * d * d, True
            elif law == 40:
                d = qa - qb
                f, pair = -par[e, 0] * d * d * (va - vb), True
            elif law == 41:
                away = (qa - par[e, 1]) / par[e, 2]
                f = -par[e, 0] * np.exp(-away * away) * va
            force[a] += f
            if pair:
                force[b] -= f
        for i in range(count):
            force[motors[i]] += applied[i]
        for d in range(dofs):
            total = h * force[d]
            for c in range(dofs):
                total += mass2[d, c] * v[c] - h * stiffness[d, c] * q[c]
            rhs[d] = total
        if added_at >= 0:
            rhs[added_at] += 2.0 * added * v[added_at]
        for d in range(dofs):
            total = 0.0
            for c in range(dofs):
                total += inverse[d, c] * rhs[c]
            mid[d] = total
        if added_at >= 0:  # Sherman–Morrison: the mass matrix carries ``added`` at one place
            own = 2.0 * added * mid[added_at] / (1.0 + 2.0 * added * inverse[added_at, added_at])
            for d in range(dofs):
                mid[d] -= inverse[d, added_at] * own
        # set-valued friction: the force that would stop the mass, or the largest there is
        dry = 0
        for e in range(effects):
            impulse[e] = 0.0
            if laws[e] <= 1:
                dry += 1
        rounds = 0 if dry == 0 else (1 if dry == 1 else 8)
        for _ in range(rounds):
            for e in range(effects):
                if laws[e] > 1:
                    continue
                a = place_a[e]
                up, down = par[e, 0], par[e, 1]
                if laws[e] == 1:
                    ratio = v[a] / par[e, 2]
                    up = par[e, 1] + (par[e, 0] - par[e, 1]) * np.exp(-ratio * ratio)
                    down = up
                stop = impulse[e] - (2.0 * mid[a] - v[a]) / (2.0 * h * inverse[a, a])
                wanted = min(max(stop, -up), down)
                change = wanted - impulse[e]
                impulse[e] = wanted
                for d in range(dofs):
                    mid[d] += h * inverse[d, a] * change
        for d in range(dofs):
            previous[d] = v[d]
            q[d] += h * mid[d]
            v[d] = 2.0 * mid[d] - v[d]
    return position, torque, log_position, log_torque
