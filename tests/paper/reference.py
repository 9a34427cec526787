"""The paper's equations once more, in plain floats and fixed steps, to hold the package against.

Nothing is shared with the package: the law, the opinion and the neighbours are written out from the paper and
the drivers' documentation, in the frame of a leader that keeps its speed, with z itself as the state.
"""

from __future__ import annotations

from itertools import pairwise
from math import cos, hypot, pi, sin, tanh

import numpy as np


def quintic(s):
    """10s^3 - 15s^4 + 6s^5 and its two derivatives."""
    return s**3 * (10 - 15 * s + 6 * s * s), 30 * s**2 * (1 - s) ** 2, 60 * s * (1 - s) * (1 - 2 * s)


def cubic(s):
    """3s^2 - 2s^3 and its two derivatives."""
    return s * s * (3 - 2 * s), 6 * s * (1 - s), 6 - 12 * s


def gap_profile(driver, t, after):
    """The gap that a ``gap`` driver wants at t, with two derivatives; ``after`` is a time in the stretch."""
    gap, rate, acceleration = driver.gap_m, 0.0, 0.0
    if driver.sway:
        a, w = driver.sway.amplitude_m, 2 * pi / driver.sway.period_s
        angle = w * t + driver.sway.phase_rad
        gap, rate, acceleration = gap + a * sin(angle), a * w * cos(angle), -a * w * w * sin(angle)
    for move in driver.moves:
        if after < move.start_s:
            break
        if after > move.start_s + move.duration_s:
            gap, rate, acceleration = move.gap_m, 0.0, 0.0
            continue
        T = move.duration_s
        s, ds, dds = {"cubic": cubic, "quintic": quintic}[move.step]((t - move.start_s) / T)
        off = move.gap_m - gap
        acceleration = acceleration * (1 - s) - 2 * rate * ds / T + off * dds / T**2
        rate = rate * (1 - s) + off * ds / T
        gap += s * off
    return gap, rate, acceleration


def follower(driver, flips, t, after, x, v):
    """Acceleration of a neighbour at x < 0 behind the leader."""
    w = driver.bandwidth_radps
    if driver.kind == "gap":
        gap, rate, acceleration = gap_profile(driver, t, after)
        return -acceleration + w * w * (-x - gap) + 2 * w * (-v - rate)
    open_now = sum(f <= after for f in flips) % 2
    gap = driver.open_gap_m if open_now else driver.closed_gap_m
    return min(max(w * w * (-x - gap) - 2 * w * v, -driver.limit_mps2), driver.limit_mps2)


def rate(law, second, y, t, after):
    """Right-hand side; y = ego x, y, v_x, v_y, Vehicle 2's x and v, z, mu, all as seen from Vehicle 1."""
    px, py, vx, vy, x2, v2, z, mu = y
    r = law.r_m
    n1, n2 = hypot(px, py), hypot(px - x2, py)
    g1, g2 = (px / n1, py / n1), ((px - x2) / n2, py / n2)
    d1, d2 = n1 - r, n2 - r
    phi1 = (g1[0] * vx + g1[1] * vy) / d1
    phi2 = (g2[0] * (vx - v2) + g2[1] * vy) / d2
    w = tanh(law.k_w * z)
    ax = -law.k_p * (px - law.r_rho_m) - law.k_v * vx - law.k_o * (g1[0] * phi1 + g2[0] * phi2)
    ay = -law.k_p * (py - (1 - w) * law.r_eta_m) - law.k_v * vy - law.k_o * (g1[1] * phi1 + g2[1] * phi2)
    gap = abs(x2) - r
    gap_rate = v2 if x2 > 0 else -v2
    drive = tanh(-law.k * g1[0] * g2[0] * (gap - 2 * r) * (gap_rate / gap + law.eps_1))
    return (
        vx, vy, ax, ay, v2, second(t, after, x2, v2), (mu * z - z * z) / law.eps, -law.k_mu * mu + drive
    )  # fmt: skip


def solve(scenario, flips=(), step_s=1e-3):
    """Ego position and Vehicle 2's x relative to the leader, and z, at every tick: (T, 2), (T,), (T,).

    Classical Runge-Kutta; no step goes across a time at which Vehicle 2 changes its mind.
    """
    law, start, driver = scenario.law, scenario.initial, scenario.drivers.vehicle_2
    lead = start.vehicle_1
    y = (
        start.ego.front_m[0] - lead.front_m[0],
        start.ego.front_m[1] - lead.front_m[1],
        start.ego.speed_mps - lead.speed_mps,
        0.0,
        start.vehicle_2.front_m[0] - lead.front_m[0],
        start.vehicle_2.speed_mps - lead.speed_mps,
        start.z,
        start.mu,
    )
    switches = list(flips) + [
        t for m in getattr(driver, "moves", ()) for t in (m.start_s, m.start_s + m.duration_s)
    ]

    def second(t, after, x, v):
        return follower(driver, flips, t, after, x, v)

    def f(y, k, h, t, middle):
        return rate(law, second, [a + h * b for a, b in zip(y, k, strict=True)], t + h, middle)

    times = np.arange(scenario.ticks) * scenario.control_step_s
    rows = [y]
    for start_s, end_s in pairwise(times.tolist()):
        marks = [start_s, *sorted(t for t in switches if start_s < t < end_s), end_s]
        for a, b in pairwise(marks):
            n = max(1, round((b - a) / step_s))
            h, middle = (b - a) / n, (a + b) / 2
            for i in range(n):
                t = a + i * h
                k_1 = rate(law, second, y, t, middle)
                k_2 = f(y, k_1, h / 2, t, middle)
                k_3 = f(y, k_2, h / 2, t, middle)
                k_4 = f(y, k_3, h, t, middle)
                mean = zip(y, k_1, k_2, k_3, k_4, strict=True)
                y = [x + h / 6 * (p + 2 * q + 2 * r + s) for x, p, q, r, s in mean]
        rows.append(y)
    rows = np.array(rows)
    return rows[:, :2], rows[:, 4], rows[:, 6]
