"""Gains and parameters of the paper's law."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal

from mjmerge.config.acts import Acts
from mjmerge.config.frozen import NonNegative, Positive
from mjmerge.config.units import Unit
from mjmerge.law.base import Law


def _has(*parts: str) -> Callable[[Any], bool]:
    """Whether a scenario's law has one of these parts in its variant."""
    return lambda scenario: not set(parts).isdisjoint(getattr(scenario.law, "variant", "").split("+"))


_CAPPED = Acts(
    continuous=True, when=_has("capped", "guarded"), only="under the law variants capped and guarded"
)


_FLOORED = Acts(continuous=True, when=_has("z_floor"), only="under the law variant z_floor")


class Parameters(Law):
    """Gains and parameters of the paper's law, in the paper's letters; defaults are its Section 4."""

    kind: Literal["opinion_dynamics"] = "opinion_dynamics"
    variant: str = "literal"
    """Which reading of the equations to run, such as gated+one_sided; ``mjmerge list laws`` shows them."""
    k_p: Annotated[NonNegative, Unit(0, -2)] = 0.7
    """Position gain, 1/s^2 (the paper's eq. for u^n writes k_d once; it is k_p)."""
    k_v: Annotated[NonNegative, Unit(0, -1)] = 2.0
    """Velocity gain, 1/s."""
    k_o: Annotated[NonNegative, Unit(1, -1)] = 1.0
    """Barrier gain, m/s; 0 switches the barrier off."""
    k_w: Positive = 40.0
    """Slope of the opinion's weight w = tanh(k_w z)."""
    k_mu: Annotated[Positive, Unit(0, -1)] = 5.0
    """Decay rate of mu, 1/s."""
    k: Annotated[Positive, Unit(-1, 1)] = 20.0
    """Slope of the tanh in the mu-law, s/m."""
    k_s: Annotated[Positive, Unit(0, -1)] = 1.0
    """Gain of that tanh, 1/s; the paper writes it as a bare 1."""
    eps: Annotated[Positive, Unit(0, 1)] = 0.05
    """Time scale of the opinion, s."""
    eps_1: Annotated[NonNegative, Unit(0, -1)] = 0.5
    """Fastest divergent flow of the gap that still counts as staying open, 1/s."""
    r_rho_m: float
    """Offset r^rho of the target behind Vehicle 1, m; negative, because rho points forward."""
    r_eta_m: float
    """Lateral offset r^eta of the target while w = 0, m: where the ego's own lane is."""
    d_cap_m: Annotated[Positive, _CAPPED] = 0.05
    """Distance below which the variants ``capped`` and ``guarded`` let the barrier grow no further, m.

    At 0.05 its gain k_o/d stays below 20/s: stable under a hold of up to 0.1 s or a delay of up to 0.08 s.
    """
    z_floor: Annotated[Positive, _FLOORED] = 1e-3
    """Smallest opinion under the variant ``z_floor``, 1; at 1e-3 the target moves by 4 % of r_eta for it."""
