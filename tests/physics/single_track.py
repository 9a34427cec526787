"""The single-track model of the ``commonroad-vehicle-models`` package, driven by a trace of ours.

M. Althoff, G. Würsching, *CommonRoad: Vehicle Models*, Sect. 7: linear tyres whose stiffness is proportional
to the axle's load, load transfer under braking, small angles. It has one coefficient for both axles, so its
car is neutral at any parameters; ours is matched to it by giving our tyres stiffnesses in that proportion.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp
from vehiclemodels.parameters_vehicle2 import parameters_vehicle2
from vehiclemodels.vehicle_dynamics_st import vehicle_dynamics_st


@dataclass(frozen=True)
class SingleTrack:
    """Parameters of the model.

    Attributes:
        mass_kg: m.
        yaw_inertia_kg_m2: I_z.
        front_m: from the centre of mass to the front axle, l_f.
        rear_m: to the rear axle, l_r.
        height_m: of the centre of mass; 0 leaves the load transfer out.
        stiffness_per_load: C_f/W_f = C_r/W_r, 1/rad.
    """

    mass_kg: float
    yaw_inertia_kg_m2: float
    front_m: float
    rear_m: float
    height_m: float
    stiffness_per_load: float

    def follow(self, time_s, steer_rad, speed_mps):
        """Yaw rate and lateral acceleration under a steering angle and a speed, (T,) each.

        It starts straight ahead. Steering rate and acceleration, its two inputs, are the derivatives of what
        is given; both are taken as linear between samples.
        """
        p = copy.deepcopy(parameters_vehicle2())
        p.m, p.I_z, p.a, p.b, p.h_s = (
            self.mass_kg,
            self.yaw_inertia_kg_m2,
            self.front_m,
            self.rear_m,
            self.height_m,
        )
        p.tire.p_ky1 = -self.stiffness_per_load
        p.steering.min, p.steering.max, p.steering.v_min, p.steering.v_max = -1.5, 1.5, -50.0, 50.0
        p.longitudinal.v_min, p.longitudinal.v_max, p.longitudinal.v_switch = -100.0, 100.0, 100.0
        p.longitudinal.a_max = 100.0
        rates = np.diff([steer_rad, speed_mps], axis=1) / np.diff(time_s)

        def derivative(t, x):
            i = min(np.searchsorted(time_s, t, side="right") - 1, len(time_s) - 2)
            return vehicle_dynamics_st(list(x), list(rates[:, i]), p)

        start = [0.0, 0.0, steer_rad[0], speed_mps[0], 0.0, 0.0, 0.0]
        step = time_s[1] - time_s[0]
        done = solve_ivp(
            derivative, (time_s[0], time_s[-1]), start, t_eval=time_s, max_step=step, rtol=1e-6, atol=1e-9
        )
        assert done.success, done.message
        slip, speed, yaw_rate = done.y[6], done.y[3], done.y[5]
        slip_rate, gain = np.gradient(slip, time_s), np.gradient(speed, time_s)
        return yaw_rate, gain * np.sin(slip) + speed * np.cos(slip) * (slip_rate + yaw_rate)
