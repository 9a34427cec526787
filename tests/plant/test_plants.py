"""What every plant promises, over every plant there is."""

from importlib import import_module
from pkgutil import iter_modules

import numpy as np
import pytest

from mjmerge import plant as plants
from mjmerge.errors import UnknownNameError
from mjmerge.roster import roster
from mjmerge.scenario.load import load
from mjmerge.simulation.loop import simulate
from mjmerge.simulation.trace import COLUMNS
from mjmerge.state import Controls
from mjmerge.world.compose import build

CARS = roster().cars
PAIRS = roster().pairs

every_plant = pytest.mark.parametrize("name", sorted(plants.PLANTS))
# restless, so that half a second holds several flips
FLIPS = load(
    "flips", ["duration_s=0.6", "drivers.vehicle_2.hold_min_s=0.1", "drivers.vehicle_2.hold_max_s=0.3"]
)


@pytest.fixture(scope="module")
def world():
    return build(FLIPS)


def made(name, world, runs=1, threads=1):
    return plants.make(name, [FLIPS] * runs, world, threads)


def controls(runs, u=(0.0, 0.0)):
    """The same for all cars: nothing, or an acceleration in each plant's own terms."""
    cars = (runs, len(CARS))
    return Controls(
        u_mps2=np.full((*cars, 2), u),
        a_mps2=np.full(cars, u[0]),
        omega_radps=np.full(cars, u[1]),
        steer_rad=np.zeros(cars),
        wheel_steer_rad=np.zeros((*cars, 2)),
        torque_n_m=np.full((*cars, 4), 0.05 * u[0]),
        torque_clipped_n_m=np.zeros(cars),
        steer_clipped_rad=np.zeros(cars),
    )


def test_plants_are_the_modules_that_make_one():
    modules = (import_module(f"mjmerge.plant.{m.name}") for m in iter_modules(plants.__path__))
    assert {m.__name__.rpartition(".")[2] for m in modules if hasattr(m, "make")} == set(plants.PLANTS)


def test_an_unknown_plant_is_refused_with_the_nearest(world):
    with pytest.raises(UnknownNameError, match="did you mean 'mujoco'"):
        made("mujocco", world)


@every_plant
def test_at_first_the_cars_are_where_the_scenario_puts_them(name, world):
    within = 1e-6 if name == "mujoco" else 1e-9
    cars = made(name, world, 2).observe()
    for c, car in enumerate(CARS):
        start = getattr(FLIPS.initial, car)
        for run in range(2):
            assert cars.front_m[run, c] == pytest.approx(start.front_m, abs=within)
            assert cars.velocity_mps[run, c] == pytest.approx([start.speed_mps, 0], abs=within)
            assert cars.speed_mps[run, c] == pytest.approx(start.speed_mps, abs=within)
    assert np.abs(cars.heading_rad).max() <= within


@every_plant
@pytest.mark.parametrize("runs", [1, 4])
def test_what_is_observed_has_the_shapes_that_are_declared(name, world, runs):
    plant = made(name, world, runs)
    plant.step(controls(runs), np.ones(runs, dtype=bool))
    cars = plant.observe()
    for vector in (cars.front_m, cars.velocity_mps):
        assert vector.shape == (runs, len(CARS), 2)
    for scalar in (cars.heading_rad, cars.speed_mps, cars.steer_rad, cars.steer_command_rad):
        assert scalar.shape == (runs, len(CARS))
    assert cars.clearance_m.shape == (runs, len(PAIRS))
    assert plant.qpos().shape == (runs, world.model.nq)
    assert plant.faults() == []


@every_plant
def test_without_a_command_the_cars_keep_their_velocity_but_for_what_air_and_tyres_take(name, world):
    """Physical cars lose another 0.1 % while they settle on their tyres."""
    plant, running = made(name, world), np.ones(1, dtype=bool)
    before = plant.observe()
    for _ in range(50):
        plant.step(controls(1), running)
    after = plant.observe()
    lost, within = np.zeros(2), 2e-3 if name == "mujoco" else 1e-4 if plant.limited else 1e-12
    if plant.limited:
        sheet = world.sheets[0]
        force = sheet.rolling_resistance * sheet.mass_kg * 9.81 + 0.6 * sheet.drag_area_m2 * 1.95**2
        lost[0] = 0.5 * force / sheet.effective_mass_kg
    assert after.velocity_mps == pytest.approx(before.velocity_mps - lost, abs=within)
    travelled = after.front_m - before.front_m
    assert travelled == pytest.approx(0.5 * (before.velocity_mps - lost / 2), abs=within)


@every_plant
def test_a_forward_command_speeds_the_cars_up(name, world):
    plant, running = made(name, world), np.ones(1, dtype=bool)
    before = plant.observe().speed_mps
    for _ in range(10):
        plant.step(controls(1, (1.0, 0.0)), running)
    assert (plant.observe().speed_mps > before + 0.05).all()


@every_plant
def test_a_stopped_simulation_stays_where_it_is_and_the_others_go_on(name, world):
    plant, alone = made(name, world, 3), made(name, world, 1)
    for _ in range(3):
        plant.step(controls(3, (1.0, 0.0)), np.ones(3, dtype=bool))
        alone.step(controls(1, (1.0, 0.0)), np.ones(1, dtype=bool))
    before = plant.observe()
    for _ in range(5):
        plant.step(controls(3, (1.0, 0.0)), np.array([True, False, True]))
        alone.step(controls(1, (1.0, 0.0)), np.ones(1, dtype=bool))
    after, single = plant.observe(), alone.observe()
    for field in ("front_m", "velocity_mps", "heading_rad", "speed_mps"):
        was, now, other = (getattr(x, field) for x in (before, after, single))
        assert np.array_equal(was[1], now[1]), field
        for run in (0, 2):
            assert np.array_equal(now[run], other[0]), field
    assert (after.front_m[0, :, 0] > before.front_m[0, :, 0]).all()


@every_plant
def test_observing_changes_nothing_and_what_was_observed_stays(name, world):
    plant = made(name, world)
    first = plant.observe()
    kept = {field: value.copy() for field, value in vars(first).items()}
    again = plant.observe()
    plant.step(controls(1, (1.0, 0.0)), np.ones(1, dtype=bool))
    plant.observe()
    for field, value in kept.items():
        for seen in (first, again):
            assert np.array_equal(getattr(seen, field), value, equal_nan=True), field


def columns(trace, run=0):
    return {c.name: getattr(trace, c.name)[run].tobytes() for c in COLUMNS}


@pytest.fixture(scope="module")
def alone(world):
    """Each of eight seeds run alone, on each plant."""
    return {
        name: [columns(simulate(FLIPS, name, seed=7 + i, threads=1, world=world)) for i in range(8)]
        for name in plants.PLANTS
    }


def test_seeds_make_a_difference(alone):
    for name in plants.PLANTS:
        assert len({run["front_m"] for run in alone[name]}) == 8


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("runs", [1, 3, 8])
@every_plant
def test_a_run_in_a_batch_is_the_run_alone_to_the_last_bit(name, runs, threads, world, alone):
    trace = simulate(FLIPS, name, runs=runs, seed=7, threads=threads, world=world)
    assert trace.seeds.tolist() == list(range(7, 7 + runs))
    for i in range(runs):
        for column, bits in columns(trace, i).items():
            assert bits == alone[name][i][column], f"run {i}: {column}"
