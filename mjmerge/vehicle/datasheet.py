"""What is known of a car model without driving it: the source of every belief about it."""

from __future__ import annotations

from math import hypot
from typing import Annotated, Literal

from pydantic import Field

from mjmerge.config.frozen import Frozen

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]


class Axles(Frozen):
    """One number per axle."""

    front: Positive
    rear: Positive


_ALONG = ("length_m", "front_overhang_m", "wheelbase_m", "com_behind_front_axle_m")
_ACROSS = ("width_m", "track_m")


class DataSheet(Frozen):
    """``models/<name>/datasheet.yaml``. The law and the actuation believe this, never the MJCF."""

    description: str
    """One line for ``mjmerge list``."""
    length_m: Positive
    """Overall length of the body, m."""
    width_m: Positive
    """Overall width, m."""
    front_overhang_m: Positive
    """From the front axle to the nose, m."""
    wheelbase_m: Positive
    """Between the axles, L, m."""
    track_m: Positive
    """Between left and right wheel centres, m."""
    wheel_radius_m: Positive
    """Rolling radius, m."""
    mass_kg: Positive
    """Whole car, m, kg."""
    rotating_mass_kg: NonNegative
    """What the spinning parts add to the inertia along the road, sum of I/r^2, kg."""
    com_behind_front_axle_m: Positive
    """From the front axle back to the centre of mass, m."""
    com_height_m: Positive
    """Of the centre of mass above the road, m."""
    yaw_inertia_kg_m2: Positive
    """Whole car about the vertical through its centre of mass, kg m^2."""
    cornering_stiffness_n_per_rad: Axles | None = None
    """Lateral force of an axle (both tyres) per slip angle, N/rad; null: tyres that do not slip."""
    drag_area_m2: NonNegative = 0.0
    """Drag coefficient times frontal area, m^2."""
    rolling_resistance: NonNegative = 0.0
    """Rolling resistance over weight, 1."""
    drive: Literal["all", "front", "rear"]
    """Driven wheels; the brakes are on all four."""
    torque_limit_n_m: Positive
    """Largest drive torque of one driven wheel, N m."""
    power_limit_w: Positive
    """Largest drive power of the whole car at its wheels, W."""
    brake_torque_limit_n_m: Positive
    """Largest brake torque of all four wheels together, N m."""
    brake_front_share: Annotated[float, Field(ge=0, le=1)]
    """Part of the brake torque that the front wheels get, 1."""
    steer_limit_rad: Positive
    """Largest steering angle of the equivalent bicycle, rad."""
    steer_rate_limit_radps: Positive
    """Fastest steering, rad/s."""
    steer_lag_s: Positive
    """Time in which the steering does 63 % of a small step, s."""

    def sized(self, size: float) -> DataSheet:
        """The sheet of a car whose lengths are ``size`` times these; masses, torques and rates stay."""
        lengths = [n for n in type(self).model_fields if n.endswith("_m") and not n.endswith("_n_m")]
        return self.model_copy(update={name: size * getattr(self, name) for name in lengths})

    def stretched(self, length_m: float | None, width_m: float | None) -> DataSheet:
        """The sheet of a car of another length or width, with its axles in proportion.

        It turns as hard as a plate of its new sides does over one of its own; all else stays.

        Args:
            length_m: of the body, m; ``None``: its own.
            width_m: of the body, m; likewise.
        """
        update: dict[str, float] = {}
        for names, whole_m in ((_ALONG, length_m), (_ACROSS, width_m)):
            if whole_m is not None:
                own_m = getattr(self, names[0])
                update |= {name: whole_m * (getattr(self, name) / own_m) for name in names}
        sides = hypot(update.get("length_m", self.length_m), update.get("width_m", self.width_m))
        turns = (sides / hypot(self.length_m, self.width_m)) ** 2
        return self.model_copy(update=update | {"yaw_inertia_kg_m2": turns * self.yaw_inertia_kg_m2})

    @property
    def effective_mass_kg(self) -> float:
        """Inertia along the road, kg."""
        return self.mass_kg + self.rotating_mass_kg
