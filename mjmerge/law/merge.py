"""The law put together: from what the ego senses to the front-axle acceleration it asks for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mjmerge.law.barrier import barrier
from mjmerge.law.opinion import bifurcation_input
from mjmerge.law.tracking import target, track, weight
from mjmerge.law.variants import reading
from mjmerge.scenario import Law
from mjmerge.state import Array, Cars, dot, norm


@dataclass(frozen=True)
class Sensed:
    """All the law ever sees of the world; neighbours are Vehicle 1 and Vehicle 2, in this order.

    Attributes:
        p: the ego's front axle, m, (N, 2).
        v: its velocity, m/s, (N, 2).
        p_j: the neighbours' front axles, m, (N, 2, 2), neighbour before component.
        v_j: their velocities, m/s, (N, 2, 2).
        u_1: acceleration Vehicle 1 intends, as if it told the ego, m/s^2, (N, 2).
    """

    p: Array
    v: Array
    p_j: Array
    v_j: Array
    u_1: Array

    @classmethod
    def of(cls, cars: Cars, u_j: Array) -> Sensed:
        """From the motion of all cars and what the neighbours intend, m/s^2, (N, 2, 2)."""
        p, v = cars.front_m, cars.velocity_mps
        return cls(p=p[:, 0], v=v[:, 0], p_j=p[:, 1:], v_j=v[:, 1:], u_1=u_j[:, 0])


@dataclass(frozen=True)
class Decision:
    """What the law made of it, in the paper's letters.

    Attributes:
        u: command, u_n + u_c, m/s^2, (N, 2).
        u_n: nominal part, m/s^2, (N, 2).
        u_c: barrier part, m/s^2, (N, 2).
        d: distances d_j, m, (N, 2).
        d_dot: their rates, m/s, (N, 2).
        dbar: gap between the neighbours less r, m, (N,).
        dbar_dot: its rate, m/s, (N,).
        w: weight of the merge, (N,).
        e_1_star: target as seen from Vehicle 1, m, (N, 2).
        mu_input: input of the mu-law, 1/s, (N,).
    """

    u: Array
    u_n: Array
    u_c: Array
    d: Array
    d_dot: Array
    dbar: Array
    dbar_dot: Array
    w: Array
    e_1_star: Array
    mu_input: Array


def _unit(a: Array, length: Array) -> Array:
    """a/length, and zero where the length is."""
    return a / np.where(length == 0, 1.0, length)[..., None]


def decide(law: Law, sensed: Sensed, z: Array) -> Decision:
    """The law, for N simulations at once.

    Args:
        law: gains and variant.
        sensed: what the ego senses.
        z: opinion, (N,).
    """
    e = sensed.p[:, None] - sensed.p_j
    nu = sensed.v[:, None] - sensed.v_j
    distance = norm(e)
    g = _unit(e, distance)  # from the neighbour to the ego; the paper's text has it the other way round
    d = distance - law.r_m
    d_dot = dot(g, nu)

    p_21 = sensed.p_j[:, 1] - sensed.p_j[:, 0]
    gap = norm(p_21)
    dbar = gap - law.r_m
    dbar_dot = dot(_unit(p_21, gap), sensed.v_j[:, 1] - sensed.v_j[:, 0])

    w = weight(law, z)
    e_1_star = target(law, w)
    u_1 = sensed.u_1
    for part in reading(law.variant).leader:
        u_1 = part(u_1)
    u_n = track(law, e[:, 0], e_1_star, nu[:, 0], u_1)
    u_c = barrier(law, g, d, d_dot)
    return Decision(
        u=u_n + u_c,
        u_n=u_n,
        u_c=u_c,
        d=d,
        d_dot=d_dot,
        dbar=dbar,
        dbar_dot=dbar_dot,
        w=w,
        e_1_star=e_1_star,
        mu_input=bifurcation_input(law, g[..., 0], dbar, dbar_dot),  # rho.g_j is g_j's x
    )
