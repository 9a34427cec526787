"""The law put together: from what the ego senses to the front-axle acceleration it asks for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mjmerge.law.opinion_dynamics.barrier import barrier
from mjmerge.law.opinion_dynamics.opinion import bifurcation_input
from mjmerge.law.opinion_dynamics.parameters import Law
from mjmerge.law.opinion_dynamics.tracking import target, track, weight
from mjmerge.law.opinion_dynamics.variants import reading
from mjmerge.state import Array, Cars, dot, norm


@dataclass(frozen=True)
class Sensed:
    """All the law ever sees of the world, of an ego and C - 1 neighbours.

    Attributes:
        p: the ego's front axle, m, (N, 2).
        v: its velocity, m/s, (N, 2).
        p_j: the neighbours' front axles, m, (N, C-1, 2), neighbour before component.
        v_j: their velocities, m/s, (N, C-1, 2).
        u_1: acceleration that the leader intends, as if it told the ego, m/s^2, (N, 2).
    """

    p: Array
    v: Array
    p_j: Array
    v_j: Array
    u_1: Array

    @classmethod
    def of(cls, cars: Cars, u_1: Array) -> Sensed:
        """From the motion of all cars and what the leader intends, m/s^2, (N, 2)."""
        p, v = cars.front_m, cars.velocity_mps
        return cls(p=p[:, 0], v=v[:, 0], p_j=p[:, 1:], v_j=v[:, 1:], u_1=u_1)


@dataclass(frozen=True)
class Geometry:
    """Distances and gap, in the paper's letters.

    Attributes:
        g: unit vectors from the neighbours to the ego, (N, C-1, 2).
        d: distances d_j, m, (N, C-1).
        d_dot: their rates, m/s, (N, C-1).
        dbar: gap between the leader and the follower less r, m, (N,).
        dbar_dot: its rate, m/s, (N,).
    """

    g: Array
    d: Array
    d_dot: Array
    dbar: Array
    dbar_dot: Array


@dataclass(frozen=True)
class Decision:
    """What the law made of it, in the paper's letters.

    Attributes:
        u: command, u_n + u_c, m/s^2, (N, 2).
        u_n: nominal part, m/s^2, (N, 2).
        u_c: barrier part, m/s^2, (N, 2).
        geometry: distances and gap as sensed.
        w: weight of the merge, (N,).
        e_1_star: target as seen from the leader, m, (N, 2).
        target: p_1 + e_1*, the same in the road frame, m, (N, 2).
        mu_input: input of the mu-law, 1/s, (N,).
    """

    u: Array
    u_n: Array
    u_c: Array
    geometry: Geometry
    w: Array
    e_1_star: Array
    target: Array
    mu_input: Array


def _unit(a: Array, length: Array) -> Array:
    """a/length, and zero where the length is."""
    return a / np.where(length == 0, 1.0, length)[..., None]


def geometry(law: Law, sensed: Sensed) -> Geometry:
    """Distances to every neighbour, and the gap between the two that the law names, with its margin r."""
    e = sensed.p[:, None] - sensed.p_j
    distance = norm(e)
    g = _unit(e, distance)  # from the neighbour to the ego; the paper's text has it the other way round
    p_21 = sensed.p_j[:, law.j_2] - sensed.p_j[:, law.j_1]
    gap = norm(p_21)
    return Geometry(
        g=g,
        d=distance - law.r_m,
        d_dot=dot(g, sensed.v[:, None] - sensed.v_j),
        dbar=gap - law.r_m,
        dbar_dot=dot(_unit(p_21, gap), sensed.v_j[:, law.j_2] - sensed.v_j[:, law.j_1]),
    )


def decide(law: Law, sensed: Sensed, z: Array) -> Decision:
    """The law, for N simulations at once.

    Args:
        law: gains and variant.
        sensed: what the ego senses.
        z: opinion, (N,).
    """
    j_1, j_2 = law.j_1, law.j_2
    e_1, nu_1 = sensed.p - sensed.p_j[:, j_1], sensed.v - sensed.v_j[:, j_1]
    seen = geometry(law, sensed)
    w = weight(law, z)
    e_1_star = target(law, w)
    u_1 = sensed.u_1
    for part in reading(law.variant).leader:
        u_1 = part(u_1)
    u_n = track(law, e_1, e_1_star, nu_1, u_1)
    u_c = barrier(law, seen.g, seen.d, seen.d_dot)
    return Decision(
        u=u_n + u_c,
        u_n=u_n,
        u_c=u_c,
        geometry=seen,
        w=w,
        e_1_star=e_1_star,
        target=sensed.p_j[:, j_1] + e_1_star,
        mu_input=bifurcation_input(law, seen.g[:, [j_1, j_2], 0], seen.dbar, seen.dbar_dot),  # rho.g_j: its x
    )
