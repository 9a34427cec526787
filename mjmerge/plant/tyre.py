"""Tyres: a wheel-road contact whose lateral force is proportional to the slip angle, at any speed.

MuJoCo's friction is Coulomb with a viscous regime below the limit: on a contact that slips at v_s and
accelerates at a, both along the force, acts F = -(b v_s + a)/R, b being the damping of the friction rows
(1/s) and R their regularisation (1/kg). A tyre's force is C alpha = (C/v) v_s, so with c = C/v, b must
follow the speed v. Both numbers have closed forms (MuJoCo's documentation, "Solver parameters", for an
impedance d that does not depend on depth):

    R = (1 - d)/d A / impratio        b = damping/d

with ``damping`` from the pair's ``solreffriction = (-1, -damping)`` and A the wheel's ``body_invweight0``. In
a steady turn the contact accelerates with what stands on it, a = F/m, so that

    b = c (R + 1/m)

is a tyre of cornering stiffness C, without anything to measure or to fit. R is free, and is spent so that

- 1/R, a mass that joins the car's in transients, is a small part of m: :data:`ADDED_MASS`;
- the slip of a free-rolling wheel, of inertia J = I/r^2, decays no faster than a step of the physics can
  follow: (b/R)/(J + 1/R) <= :data:`FASTEST_PER_S`. Towards standstill c grows, and 1/R grows with it, up to
  the hardest contact there is. That is the floor on the speed, and the whole of the ideal tyre.

Beyond mu N the contact slides by itself. But in MuJoCo's convex contact what a sliding contact asks for in
vain pushes the wheel off the road, and it hops; so a tyre that slides asks for :data:`OUT_OF_REACH` times its
static grip at most.

One pair has one damping and one R for both directions along the road: the longitudinal slip stiffness of a
tyre is its cornering stiffness (N per unit of slip), and combined slip saturates on a circle of radius mu N.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mjmerge.state import Array
from mjmerge.world.model import HARDEST, IMPRATIO

ADDED_MASS = 0.03
"""1/R over the mass on the wheel, while the car moves."""
FASTEST_PER_S = 500.0
"""Bound on the decay rate of a wheel's slip; the step's own rate where that is slower."""
OUT_OF_REACH = 3.0
"""A tyre that slides asks for no more than this many times its static grip."""
_LEAST_MPS = _LEAST = 1e-9


@dataclass(frozen=True)
class Tyres:
    """The tyres of C cars in N simulations, or in 1 that stands for all, each (N, C, 4).

    Wheels are as in ``mjmerge.world.compose.WHEELS``.

    Attributes:
        stiffness_n_per_rad: C of one tyre; infinite: as stiff as the contact can be.
        wheel_mass_kg: m, mass that stands on the wheel.
        spin_mass_kg: J, what the wheel's spin adds to the inertia along the road, I/r^2.
        invweight_per_kg: A.
        load_n: weight of that mass.
        step_s: time step of the physics, s.
    """

    stiffness_n_per_rad: Array
    wheel_mass_kg: Array
    spin_mass_kg: Array
    invweight_per_kg: Array
    load_n: Array
    step_s: float

    def contact(self, speed_mps: Array, slip_mps: Array, friction: Array) -> tuple[Array, Array]:
        """Impedance d and damping (1/s) of each wheel's contact, both (N, C, 4).

        Args:
            speed_mps: of the wheel over the road, v, (N, C, 4).
            slip_mps: of the contact over the road, v_s, (N, C, 4).
            friction: mu there, (N, C, 4).
        """
        fastest, fastest_kg_per_s, least_kg, most_kg, per_m = self._fixed
        spin = self.spin_mass_kg
        c = self.stiffness_n_per_rad / np.maximum(speed_mps, _LEAST_MPS)
        c = np.minimum(c, OUT_OF_REACH * friction * self.load_n / np.maximum(slip_mps, _LEAST_MPS))
        needed = (c / fastest - spin) / np.maximum(1 - c / fastest_kg_per_s, _LEAST)
        per_r = np.minimum(np.maximum(needed, least_kg), most_kg)
        b = np.minimum(c * (1 / per_r + per_m), fastest * (1 + spin / per_r))
        x = per_r * self.invweight_per_kg / IMPRATIO
        d = x / (1 + x)
        return d, b * d

    @cached_property
    def _fixed(self) -> tuple[float, Array, Array, Array, Array]:
        """Fastest decay of slip, 1/s; that times m; least and most 1/R, kg; 1/m."""
        fastest, m = min(FASTEST_PER_S, 1 / self.step_s), self.wheel_mass_kg
        most_kg = IMPRATIO * HARDEST / ((1 - HARDEST) * self.invweight_per_kg)
        return fastest, fastest * m, ADDED_MASS * m, most_kg, 1 / m


def front_stiffness(
    understeer_rad_per_g: float, rear_n_per_rad: float, front_n: float, rear_n: float
) -> float:
    """C_f that gives an understeer gradient K = W_f/C_f - W_r/C_r, N/rad.

    Args:
        understeer_rad_per_g: K, rad per g of lateral acceleration.
        rear_n_per_rad: C_r.
        front_n: static load of the front axle W_f, N.
        rear_n: of the rear axle W_r, N.

    Raises:
        ValueError: no front tyre is stiff enough for that.
    """
    slip = understeer_rad_per_g + rear_n / rear_n_per_rad
    if slip <= 0:
        raise ValueError(
            f"an understeer gradient of {understeer_rad_per_g} rad/g is out of reach of rear tyres of "
            f"{rear_n_per_rad} N/rad; it must be above {-rear_n / rear_n_per_rad:.4f}"
        )
    return front_n / slip
