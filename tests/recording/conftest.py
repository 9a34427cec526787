"""A tiny world and random ticks."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from mjmerge.record import Header, versions
from mjmerge.roster import roster
from mjmerge.scenario.cars import car_sheets
from mjmerge.scenario.schema import Scenario
from mjmerge.simulation.log import TickBlock
from mjmerge.simulation.trace import COLUMNS, the_truth

CARS = roster().cars

_CAR = """
<body name="{car}/" pos="0 {y} 0.05">
  <freejoint name="{car}/free/"/>
  <site name="{car}/front_axle" pos=".16 0 0"/>
  <geom name="{car}/hull" type="box" size=".3 .16 .06" group="3"/>
  <geom type="box" size=".28 .13 .03" group="1" material="{car}/paint"/>
  <body name="{car}/wheel" pos=".16 .13 0">
    <joint type="hinge" axis="0 1 0"/>
    <geom type="cylinder" size=".05 .02" euler="90 0 0" group="1" rgba=".1 .1 .1 1"/>
    <geom type="capsule" size=".01 .05" group="1"/>
    <geom type="sphere" size=".02" group="1"/>
    <geom type="mesh" mesh="tetrahedron" group="1" contype="0" conaffinity="0"/>
  </body>
</body>"""

WORLD_XML = f"""
<mujoco model="tiny">
  <asset>
    {"".join(f'<material name="{car}/paint" rgba=".2 .6 .3 1"/>' for car in CARS)}
    <mesh name="tetrahedron" vertex="0 0 0 .05 0 0 0 .05 0 0 0 .05"/>
  </asset>
  <worldbody>
    <geom name="road" type="plane" size="0 0 1" rgba=".3 .3 .3 1"/>
    <geom name="edge" type="box" size="5 .02 .001" group="2"/>
    {"".join(_CAR.format(car=car, y=y) for y, car in enumerate(CARS))}
  </worldbody>
</mujoco>"""

SCENARIO = Scenario.model_validate(
    {
        "description": "Nothing moves for a reason.",
        "initial": {
            "ego": {"front_m": [-1.5, 1.4], "speed_mps": 2.0},
            "vehicle_1": {"front_m": [0.0, 0.0], "speed_mps": 2.0},
            "vehicle_2": {"front_m": [-1.9, 0.0], "speed_mps": 2.0},
        },
        "law": {"r_rho_m": -1.2, "r_eta_m": 1.4},
        "drivers": {
            "vehicle_1": {"kind": "steady", "speed_mps": 2.0},
            "vehicle_2": {"kind": "steady", "speed_mps": 2.0},
        },
    }
).named("tiny")

MakeBlocks = Callable[..., list[TickBlock]]


@pytest.fixture(scope="session")
def header() -> Header:
    model = mujoco.MjModel.from_xml_string(WORLD_XML)
    return Header(
        SCENARIO,
        "description: tiny\n",
        "mujoco",
        7,
        model,
        WORLD_XML,
        versions(),
        SCENARIO.control_step_s,
        tuple(car_sheets(SCENARIO)),
    )


@pytest.fixture(scope="session")
def make_blocks(header: Header) -> MakeBlocks:
    """Blocks of the given sizes, full of numbers nobody expects; some are NaN, infinite, tiny or -0."""

    def make(*sizes: int, seed: int = 0) -> list[TickBlock]:
        rng = np.random.default_rng(seed)
        count, odd = sum(sizes), [np.nan, np.inf, -0.0, 5e-324, 1e300]
        columns = {}
        for c in COLUMNS:
            values = rng.normal(size=(count, *c.shape(roster())))
            values[rng.random(values.shape) < 0.2] = rng.choice(odd)
            columns[c.name] = values
        for name in ("front_m", "heading_rad", "target_m"):  # these are drawn
            columns[name] = rng.normal(size=columns[name].shape)
        columns |= the_truth(columns, 0)
        qpos = header.model.qpos0 + 0.1 * rng.normal(size=(count, header.model.nq))
        time_s = np.arange(count) * header.control_step_s
        ends = np.cumsum(sizes)
        parts = [slice(end - size, end) for end, size in zip(ends, sizes, strict=True)]
        return [
            TickBlock(np.arange(p.start, p.stop), time_s[p], {k: v[p] for k, v in columns.items()}, qpos[p])
            for p in parts
        ]

    return make
