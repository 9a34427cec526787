"""Brakes that hold: a car that stands moves only the way it is asked to, on any slope, and does not creep.

A fast car's brakes are dampers (:mod:`mjmerge.plant.mujoco`), and a damper creeps under a load. Those of a
car that is slow or stands are dry friction, ``frictionloss`` of the wheels' joints. MuJoCo's dry friction is
viscous below its limit: it creeps at F R/b under a load F (see :mod:`mjmerge.plant.tyre`). In a joint R can
be made as small as it needs to be. Between tyre and road it cannot, because the road hardens with it until
the wheels hop; there the load is taken over by what real tyres have, :class:`Bristles`.
"""

from __future__ import annotations

import numpy as np
from mujoco.batch import Batch

from mjmerge.plant.tyre import Tyres
from mjmerge.state import Array, Mask
from mjmerge.vehicle.actuation import CRAWL_MPS, UNMOVED_MPS2
from mjmerge.world.model import World

_FIRMER = 1e-3  # R of a held wheel's dry friction over that of MuJoCo's hardest
STILL = 0.999
"""Largest impedance of the tyres of a car whose brakes hold: on the hardest a light car hops."""
_MOST = 0.999  # part of the grip that the bristles can take


class Holding:
    """Which cars hold their brakes.

    A car that stands, or will within the coming control step if it goes on like that, starts only if what its
    motors give, and what the slope adds, moves it the way that the motors push. Otherwise its brakes hold it,
    until it is asked to go and its motors can carry it. So one that starts uphill does not roll back first,
    and one on ice slides with locked wheels.
    """

    def __init__(self, mass_kg: Array, speed_mps: Array) -> None:
        """At t = 0, when those hold that have no speed; what the cars weigh and how fast they are, (N, C)."""
        self._mass_kg, self._before_mps = mass_kg, speed_mps
        self.held: Mask = speed_mps == 0

    def __call__(self, speed_mps: Array, push_n: Array, slope_mps2: Array) -> Mask:
        """Whether they do over the coming control step, (N, C); call it once per step.

        Args:
            speed_mps: of the cars, (N, C).
            push_n: what motors and brakes are to give along them, (N, C).
            slope_mps2: what the slope adds, (N, C).
        """
        still = np.maximum(CRAWL_MPS, np.abs(speed_mps - self._before_mps))
        stands = np.abs(speed_mps) <= still
        self._before_mps = speed_mps
        near = stands | self.held
        if not near.any():
            return near
        asked = push_n / self._mass_kg
        forward = np.sign(asked)
        starts = np.minimum(forward * asked, forward * (asked + slope_mps2)) > UNMOVED_MPS2
        self.held = near & ~starts
        return self.held


class Brakes:
    """The brakes of the cars of one batch, as dry friction."""

    def __init__(self, world: World, batch: Batch, limit_n_m: Array) -> None:
        """With none that holds.

        Args:
            world: the compiled world of C cars.
            batch: its N simulations.
            limit_n_m: largest torque of each brake, (N, C, 4).
        """
        self._batch, self._limit_n_m = batch, limit_n_m
        self._spins = world.model.jnt_dofadr[world.ids("joint", "spin_{}")]
        self.none = np.zeros_like(limit_n_m)
        self._any = False
        self._own: tuple[Array, Array] | None = None

    def __call__(self, held: Mask, torque_n_m: Array) -> None:
        """Brakes these cars, (N, C), with all they have, and the others with a torque, (N, C, 4)."""
        if not (self._any or held.any() or torque_n_m.any()):
            return
        if self._own is None:
            self._friction, self._inverse = map(self._batch.expand, ("dof_frictionloss", "dof_invweight0"))
            self._own = self._friction[:, self._spins].copy(), self._inverse[:, self._spins].copy()
        friction, inverse = self._own
        given = np.where(held[..., None], self._limit_n_m, np.minimum(torque_n_m, self._limit_n_m))
        brakes = given > 0
        self._any = bool(brakes.any())
        self._friction[:, self._spins] = friction + given
        self._inverse[:, self._spins] = np.where(brakes, _FIRMER, 1.0) * inverse


class Bristles:
    """What the tyres of a standing car do beside MuJoCo's contacts: hold against a pull without creeping.

    A tyre's tread is elastic: once bent by the pull of a slope or of the wind, it holds against it. So each
    tyre gets its part of that, by the mass that stands on it, as a force at the road. What the force takes of
    the grip mu N the contact no longer has: the tyre slides when both together are beyond it.
    """

    def __init__(self, world: World, batch: Batch, tyres: Tyres, radius_m: Array) -> None:
        """Without any force.

        Args:
            world: the compiled world of C cars.
            batch: its N simulations.
            tyres: of the cars.
            radius_m: of the wheels, (N, C, 4).
        """
        mass = tyres.wheel_mass_kg
        self._share, self._load_n = mass / mass.sum(axis=-1, keepdims=True), tyres.load_n
        self._radius_m = radius_m
        self._wheels = world.ids("body", "wheel_{}")
        self._applied = batch.bind("xfrc_applied")
        self.bent = False

    def __call__(self, still: Mask, pull_n: Array, friction: Array) -> Array:
        """Bends those of the cars that stand, and gives the friction that is left to all contacts, (N, C, 4).

        Args:
            still: which cars stand with their brakes on, (N, C).
            pull_n: what pulls at the cars along the road's x and y, (N, C, 2).
            friction: mu, (N, C, 4).
        """
        force = np.where(still[..., None, None], -self._share[..., None] * pull_n[..., None, :], 0.0)
        size, most = np.hypot(force[..., 0], force[..., 1]), friction * self._load_n
        given = np.minimum(size, _MOST * most)
        force *= (given / np.maximum(size, 1e-9))[..., None]
        wrench = np.zeros((*force.shape[:-1], 6))
        wrench[..., :2] = force  # at the road, a radius below the wheel's centre
        wrench[..., 3] = self._radius_m * force[..., 1]
        wrench[..., 4] = -self._radius_m * force[..., 0]
        self._applied[:, self._wheels] = wrench
        self.bent = bool(still.any())
        left: Array = friction - given / self._load_n
        return left
