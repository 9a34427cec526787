"""What is known of a car model without driving it: the source of every belief about it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from mjmerge.frozen import Frozen

Positive = Annotated[float, Field(gt=0)]


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
    rotating_mass_kg: Annotated[float, Field(ge=0)]
    """What the spinning parts add to the inertia along the road, sum of I/r^2, kg."""
    drive: Literal["all", "front", "rear"]
    """Driven (and braked) wheels."""
    torque_limit_n_m: Positive
    """Largest drive or brake torque of one driven wheel, N m."""
    steer_limit_rad: Positive
    """Largest steering angle of the equivalent bicycle, rad."""
    steer_rate_limit_radps: Positive
    """Fastest steering, rad/s."""

    def sized(self, size: float) -> DataSheet:
        """The sheet of a car whose lengths are ``size`` times these; masses, torques and rates stay."""
        lengths = [n for n in type(self).model_fields if n.endswith("_m") and not n.endswith("_n_m")]
        return self.model_copy(update={name: size * getattr(self, name) for name in lengths})

    @property
    def effective_mass_kg(self) -> float:
        """Inertia along the road, kg."""
        return self.mass_kg + self.rotating_mass_kg
