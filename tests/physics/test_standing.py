"""Every car stands where it is told to, on flat and slope, whatever its role, and starts when told."""

from __future__ import annotations

import numpy as np
import pytest

from mjmerge.plant import make
from mjmerge.proving.ground import TICK_S, drive
from mjmerge.roster import roster
from mjmerge.scenario.cars import data_sheet
from mjmerge.scenario.load import load
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.simulation.loop import simulate
from mjmerge.state import G_MPS2
from mjmerge.vehicle.actuation import CRAWL_MPS, BelievedCars, command
from mjmerge.world.compose import build, single

CARS = roster().cars

GRADES = np.array([0, 0.1, -0.1, 0.2, -0.2, 0, 0, 0.15])
BANKS = np.array([0, 0, 0, 0, 0, 0.2, -0.2, 0.15])
SLOPES = [Mismatch(grade_rad=grade, bank_rad=bank) for grade, bank in zip(GRADES, BANKS, strict=True)]
STANDS_M, FOR_S = 1e-3, 300.0


def gravity(grade, bank):
    down = np.stack([np.sin(grade), np.cos(grade) * np.sin(bank), np.cos(grade) * np.cos(bank)], axis=-1)
    return -G_MPS2 * down


def way_m(position_m):
    """Farthest that it gets from where it is at first, of (..., T, 2)."""
    return np.hypot(*np.moveaxis(position_m - position_m[..., :1, :], -1, 0)).max(axis=-1)


def in_300_s(position_m, step_s):
    """The same, carried on to 300 s at the speed of the second half of what was seen."""
    half = position_m.shape[-2] // 2
    creep = np.hypot(*np.moveaxis(position_m[..., -1, :] - position_m[..., half, :], -1, 0))
    left_s = max(FOR_S - position_m.shape[-2] * step_s, 0.0)
    return way_m(position_m) + creep * left_s / (half * step_s)


def parked(time_s, cars):
    still = np.zeros(len(cars.speed_mps))
    return still, still


@pytest.mark.parametrize(("tyres", "step_s"), [("slip", 0.001), ("ideal", 0.002)])
def test_a_parked_car_stays_where_it_is_and_does_not_swing(car, tyres, step_s, long):
    world = single(car, tyres=tyres, physics_step_s=step_s)
    duration = FOR_S if long else 1.0
    log = drive(world, parked, duration, np.zeros(len(GRADES)), gravity_mps2=gravity(GRADES, BANKS))
    assert in_300_s(np.stack([log.x_m, log.y_m], axis=-1), TICK_S).max() < STANDS_M
    assert np.ptp(log.z_m, axis=1).max() < 1e-5
    turned_m = np.ptp(log.heading_rad, axis=1) * world.sheets[0].wheelbase_m
    assert turned_m[:-1].max() < STANDS_M
    assert turned_m[-1] < 2 * STANDS_M  # on a grade and a bank at once it yaws: the van by 1.2 mm in 300 s


def test_a_car_that_is_braked_to_a_stand_stays_there(car, long):
    """As the ego is: by an acceleration, from 1 m/s at 2 m/s^2 on any slope, and then by nothing."""
    world = single(car)
    sheet = world.sheets[0]
    slope = gravity(GRADES, BANKS)[:, 0] * sheet.mass_kg / sheet.effective_mass_kg

    def driver(time_s, cars):
        moves = cars.speed_mps[:, 0] > CRAWL_MPS
        return np.where(moves, -2.0 - slope, 0.0), np.zeros(len(GRADES))

    log = drive(
        world, driver, FOR_S if long else 6.0, np.ones(len(GRADES)), gravity_mps2=gravity(GRADES, BANKS)
    )
    after = log.between(4.0, log.time_s[-1])  # when it has stopped rocking on its springs
    assert in_300_s(np.stack([after.x_m, after.y_m], axis=-1), TICK_S)[:-1].max() < STANDS_M


def test_the_ego_comes_to_rest_behind_a_leader_that_stands_and_is_not_moved_by_a_slope(long):
    """Its law goes on asking for what its distance wants; where that is less than the slope, it stands."""
    stops = "{kind: speeds, speed_mps: 1.5, changes: [{start_s: 9, rate_mps2: 2, speed_mps: 0}]}"
    scenario = load("stop_and_go", [f"drivers.vehicle_1={stops}", f"duration_s={FOR_S if long else 20}"])
    slopes = [Mismatch(grade_rad=grade) for grade in (0.1, -0.1, 0.2, -0.2)]
    trace = simulate(scenario, "mujoco", cases=[(0, m) for m in slopes])
    assert not trace.stops
    at = np.moveaxis(trace.front_m[:, trace.time_s > 18.0], 2, 1)
    assert in_300_s(at, scenario.control_step_s).max() < STANDS_M


def test_a_queue_that_stops_on_a_hill_goes_on_when_it_is_told_and_nobody_is_left_standing():
    scenario = load("stop_and_go")
    slopes = [Mismatch(grade_rad=grade) for grade in (0.1, 0.2, -0.2)]
    trace = simulate(scenario, "mujoco", cases=[(0, m) for m in slopes])
    assert not trace.stops
    t, speed = trace.time_s, trace.speed_mps
    stood = (t > 13.0) & (t < 14.0)
    assert way_m(trace.front_m[:, stood, 1]).max() < STANDS_M
    assert speed[:, -1] == pytest.approx(1.5, abs=0.2)
    starts = (t > 13.9) & (t < 18.0)
    assert speed[:, starts, 1:].min() > -0.01
    changes = np.diff(speed[:, starts, 1:], axis=1) / scenario.control_step_s
    asks, slope = scenario.drivers.vehicle_2.max_acceleration_mps2, G_MPS2 * np.sin(0.2)
    assert np.abs(changes[:2]).max() < asks
    assert np.abs(changes[2]).max() < asks + slope  # downhill: the tick in which the brakes let go


def test_neighbours_told_to_stand_come_to_rest_and_stay_on_any_slope(car, long):
    """A leader and a follower, braking by -2 v from 1 m/s; the ego is far off, and drawn to nothing."""
    scenario = load(
        "charge",
        [f"models.{role}={car}" for role in CARS]
        + [f"initial.vehicle_{j}.speed_mps=1" for j in (1, 2)]
        + [f"drivers.vehicle_{j}={{kind: steady, speed_mps: 0}}" for j in (1, 2)]
        + ["initial.vehicle_2.front_m=[-20.0, 0.0]", "initial.ego.front_m=[-10000.0, 3.0]"]
        + ["initial.ego.speed_mps=1", "law.k_p=0", "law.k_v=0", "law.k_o=0"]
        + [f"duration_s={FOR_S + 4 if long else 5}"],
    )
    slopes = SLOPES if long else [SLOPES[i] for i in (3, 4, 5)]
    trace = simulate(scenario, "mujoco", cases=[(0, m) for m in slopes])
    assert not trace.stops
    stands = trace.time_s > 4.0
    at = np.moveaxis(trace.front_m[:, stands, 1:], 2, 1)
    assert in_300_s(at, scenario.control_step_s).max() < STANDS_M
    assert np.ptp(trace.steer_command_rad[:, stands, 1:], axis=1).max() == 0


def test_all_three_cars_of_a_world_stand_the_ego_with_late_commands_too(car):
    """Ego, leader and follower, each told nothing but a = 0."""
    late = {"command_delay_s": 0.1, "drive_lag_s": 0.1}
    slopes = [SLOPES[i].model_copy(update=late) for i in (0, 3, 4, 5)]
    scenario = load(
        "charge",
        [f"models.{role}={car}" for role in CARS]
        + [f"initial.{role}.speed_mps=0" for role in CARS]
        + ["initial.vehicle_2.front_m=[-20.0, 0.0]", "initial.ego.front_m=[-10.0, 3.0]"],
    )
    world = build(scenario, slopes)
    plant = make("mujoco", [scenario.model_copy(update={"mismatch": m}) for m in slopes], world, 1)
    believed = BelievedCars.of(world.sheets, limited=True)
    running, rows = np.ones(len(slopes), dtype=bool), []
    for _ in range(50):
        cars = plant.observe()
        rows.append(cars.front_m.copy())
        still = np.zeros(cars.speed_mps.shape)
        plant.step(command(cars, still, still, believed), running)
    assert in_300_s(np.stack(rows, axis=2), scenario.control_step_s).max() < STANDS_M


@pytest.mark.parametrize("a_mps2", [0.3, 1.0, 3.0])
def test_it_starts_when_told_without_a_jump_and_never_rolls_the_other_way(car, world, a_mps2):
    """Uphill it waits until its motors can carry it: 0.3 m/s^2 is less than the slope takes."""
    grade = np.array([0.0, 0.05, 0.1, -0.1, 0.2, -0.2])
    sheet = world.sheets[0]
    gives = a_mps2 - G_MPS2 * np.sin(grade) * sheet.mass_kg / sheet.effective_mass_kg

    def driver(time_s, cars):
        return np.full(len(grade), a_mps2 * (time_s >= 0.5)), np.zeros(len(grade))

    log = drive(world, driver, 1.5, np.zeros(len(grade)), gravity_mps2=gravity(grade, 0 * grade))
    after = log.between(0.5, 1.5)
    assert (after.x_m[:, 0] - after.x_m.min(axis=1)).max() < 1e-4
    jumps = np.abs(np.diff(after.speed_mps, axis=1)).max(axis=1)
    assert (jumps < 1.3 * np.maximum(gives, 0.3) * TICK_S + 0.002).all()
    goes = gives > 0.1
    assert after.speed_mps[goes, -1] == pytest.approx(gives[goes], rel=0.1, abs=0.1)
    assert np.abs(after.speed_mps[gives < -0.1, -1]).max(initial=0.0) < 1e-3


def test_a_slow_car_is_not_grabbed(world):
    """It keeps 0.05 to 0.3 m/s on the flat."""
    speeds = np.array([0.05, 0.1, 0.3])

    def driver(time_s, cars):
        return 2 * (speeds - cars.speed_mps[:, 0]), np.zeros(3)

    log = drive(world, driver, 3.0, speeds)
    assert log.speed_mps == pytest.approx(np.broadcast_to(speeds[:, None], log.speed_mps.shape), rel=0.1)


def test_beyond_its_grip_a_parked_car_slides_as_coulomb_says(car):
    """mu = 0.1 on slopes of 0.2 rad up and down, with locked wheels."""
    grade = np.array([0.2, -0.2])
    log = drive(single(car, friction=0.1), parked, 2.0, np.zeros(2), gravity_mps2=gravity(grade, 0 * grade))
    rolling = data_sheet(car).rolling_resistance  # a force on the body here, whatever the wheels do
    slides = G_MPS2 * (np.sin(0.2) - (0.1 + rolling) * np.cos(0.2))
    got = (log.speed_mps[:, -1] - log.speed_mps[:, 50]) / (log.time_s[-1] - log.time_s[50])
    assert np.abs(got) == pytest.approx(slides, rel=0.05)
    assert np.abs(log.spin_radps[:, -1]).max() < 0.05 * np.abs(log.speed_mps[:, -1]).min()


@pytest.mark.parametrize(("plant", "rocks_mps"), [("bicycle_limited", 0.0), ("mujoco", 0.05)])
def test_brakes_do_not_start_a_car_backwards(plant, rocks_mps):
    """A driver who brakes harder than a control step can follow, a = -80 v; bodies rock on their springs."""
    steady = "drivers.vehicle_1={kind: steady, speed_mps: 0, gain_per_s: 80}"
    scenario = load("charge", [steady, "control_step_s=0.02", "duration_s=1"])
    speed = simulate(scenario, plant).speed_mps[0, :, 1]
    assert speed.min() >= -rocks_mps
    assert abs(speed[-1]) < 1e-6


def test_a_standing_run_has_the_same_bits_alone_and_among_others():
    scenario = load(
        "charge", ["drivers.vehicle_1.speed_mps=0", "initial.vehicle_1.speed_mps=0", "duration_s=1"]
    )
    cases = [(0, SLOPES[3]), (0, SLOPES[0]), (0, Mismatch(patch_friction=0.5, patch_length_m=3.0))]
    together = simulate(scenario, "mujoco", cases=cases)
    for i, case in enumerate(cases):
        alone = simulate(scenario, "mujoco", cases=[case])
        assert np.array_equal(together.front_m[i], alone.front_m[0])
