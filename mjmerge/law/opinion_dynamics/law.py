"""The paper's law put together: opinion, tracking and barrier."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from mjmerge.law.base import Decision, Flow, Memory
from mjmerge.law.opinion_dynamics.barrier import barrier, singular
from mjmerge.law.opinion_dynamics.opinion import advance, bifurcation_input, floored, rates
from mjmerge.law.opinion_dynamics.parameters import Parameters
from mjmerge.law.opinion_dynamics.tracking import target, track, weight
from mjmerge.law.opinion_dynamics.variants import complaints, reading
from mjmerge.law.sensed import Geometry, Sensed, geometry
from mjmerge.state import Array


@dataclass(frozen=True)
class Made:
    """What the paper's law made of it, in the paper's letters.

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


def decide(law: Parameters, sensed: Sensed, z: Array) -> Made:
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
    return Made(
        u=u_n + u_c,
        u_n=u_n,
        u_c=u_c,
        geometry=seen,
        w=w,
        e_1_star=e_1_star,
        target=sensed.p_j[:, j_1] + e_1_star,
        mu_input=bifurcation_input(law, seen.g[:, [j_1, j_2], 0], seen.dbar, seen.dbar_dot),  # rho.g_j: its x
    )


class OpinionDynamics(Parameters):
    """The paper's law: an opinion chooses the target, and a dissipative barrier keeps the ego clear."""

    guard: ClassVar[str] = "the barrier"
    remembers: ClassVar[tuple[str, ...]] = ("opinion", "mu")
    gives: ClassVar[tuple[str, ...]] = (
        "weight", "mu_input_per_s", "sensed_distance_m", "sensed_distance_rate_mps", "target_m", "u_n_mps2",
        "u_c_mps2",
    )  # fmt: skip

    @property
    def label(self) -> str:
        """The name of its variant."""
        return self.variant

    def problems(self) -> Iterator[tuple[str, str]]:
        """See :meth:`Law.problems`."""
        yield from (("variant", complaint) for complaint in complaints(self.variant))

    def start(self, runs: int, initial: Mapping[str, float]) -> Memory:
        """Z and mu, each (N,)."""
        return {"opinion": np.full(runs, initial["z"]), "mu": np.full(runs, initial["mu"])}

    def decide(self, seen: Sensed, memory: Memory, step_s: float) -> Decision:
        """See :func:`decide`."""
        del step_s
        made = decide(self, seen, memory["opinion"])
        return Decision(
            made.u,
            {
                "weight": made.w,
                "mu_input_per_s": made.mu_input,
                "sensed_distance_m": made.geometry.d,
                "sensed_distance_rate_mps": made.geometry.d_dot,
                "target_m": made.target,
                "u_n_mps2": made.u_n,
                "u_c_mps2": made.u_c,
            },
        )

    def advance(self, memory: Memory, decision: Decision, step_s: float) -> Memory:
        """See :func:`~mjmerge.law.opinion_dynamics.opinion.advance`."""
        mu_input = decision.signals["mu_input_per_s"]
        z, mu = advance(self, memory["opinion"], memory["mu"], mu_input, step_s)
        return {"opinion": z, "mu": mu}

    def unguarded(self) -> Self:
        """With k_o = 0."""
        return self.model_copy(update={"k_o": 0.0}) if self.k_o > 0 else self

    @property
    def singular(self) -> bool:
        """See :func:`~mjmerge.law.opinion_dynamics.barrier.singular`."""
        return singular(self)

    def flow(self) -> Flow:
        """As ln z and mu.

        With the logarithm z keeps its accuracy while it decays for minutes, never turns negative, and never
        underflows for good; z(0) = 0 stays 0, as in (zi-2).
        """
        return _Opinion(self)


class _Opinion(Flow):
    """ln z and mu as coordinates."""

    size = 2

    def __init__(self, law: Parameters) -> None:
        self._law, self._asleep = law, False

    def start(self, initial: Mapping[str, float]) -> Array:
        """Ln z(0) and mu(0)."""
        z = float(floored(self._law, np.array(initial["z"])))
        self._asleep = z <= 0
        return np.array([0.0 if self._asleep else np.log(z), initial["mu"]])

    def memory(self, coordinates: Array) -> Memory:
        """Z and mu."""
        x = coordinates[..., 0]
        z = np.zeros(x.shape) if self._asleep else floored(self._law, np.exp(x))
        return {"opinion": z, "mu": coordinates[..., 1]}

    def rates(self, coordinates: Array, decision: Decision) -> Array:
        """(zi-2) and (mu)."""
        now = self.memory(coordinates[None])
        ln_z_rate, mu_rate = rates(self._law, now["opinion"], now["mu"], decision.signals["mu_input_per_s"])
        return np.concatenate([ln_z_rate, mu_rate])
