"""Every axis of physics mismatch against what mechanics says that it does: one RC car in a batch."""

from dataclasses import dataclass

import numpy as np
import pytest

from mjmerge.errors import ModelError
from mjmerge.plant.mujoco import MuJoCo
from mjmerge.plant.truth import altered
from mjmerge.proving.ground import wheel_loads_n
from mjmerge.scenario.cars import data_sheet
from mjmerge.scenario.levels import LEVELS
from mjmerge.scenario.mismatch import SENSING, Mismatch
from mjmerge.vehicle.actuation import BelievedCars, command
from mjmerge.world.checks.parts import DRIVE, STEER
from mjmerge.world.compose import single
from mjmerge.world.model import World

G = 9.81
SHEET = data_sheet("rc")
STEP_S, TICK_S = 0.001, 0.01
NOTHING = Mismatch()


@pytest.fixture(scope="module")
def world():
    return single("rc", delays_s={"ego": 0.2})


@dataclass
class Ride:
    """What happened, (N, T)."""

    time_s: np.ndarray
    x_m: np.ndarray
    y_m: np.ndarray
    heading_rad: np.ndarray
    speed_mps: np.ndarray
    yaw_rate_radps: np.ndarray
    steer_rad: np.ndarray


def ride(world, mismatch, driver, duration_s, speed_mps=3.0, sheet=SHEET):
    """One car per mismatch under the same driver: acceleration and steering angle as a function of time."""
    runs = len(mismatch)
    plant = MuJoCo(
        world,
        np.zeros((runs, 1, 2)),
        np.full((runs, 1), speed_mps),
        substeps=round(TICK_S / STEP_S),
        threads=1,
        mismatch=mismatch,
    )
    believed, running = BelievedCars.of([sheet], limited=True), np.ones(runs, dtype=bool)
    rows, yaw_at = [], world.model.joint("ego/free/").dofadr[0] + 5
    qvel = plant.batch.bind("qvel")
    times = np.arange(round(duration_s / TICK_S) + 1) * TICK_S
    for t in times:
        cars = plant.observe()
        x, y = np.moveaxis(cars.front_m[:, 0], -1, 0)
        rows.append(
            [x, y, cars.heading_rad[:, 0], cars.speed_mps[:, 0], qvel[:, yaw_at].copy(), cars.steer_rad[:, 0]]
        )
        a, steer = driver(t)
        told = np.full((runs, 1), a), np.full((runs, 1), steer)
        plant.step(command(cars, *told, believed), running)
        assert not plant.faults()
    return Ride(times, *np.moveaxis(np.array(rows), (0, 1, 2), (2, 0, 1)))


def accelerates(a):
    return lambda _: (a, 0.0)


def steers(angle):
    return lambda _: (0.0, angle)


ROLLS, BRAKES = accelerates(0.0), accelerates(-3 * G)


def mean_acceleration(r, begin_s, end_s):
    i, k = (round(t / TICK_S) for t in (begin_s, end_s))
    return (r.speed_mps[:, k] - r.speed_mps[:, i]) / (end_s - begin_s)


# the road


def test_braking_distance_is_v_squared_over_two_mu_g(world):
    friction = np.array([0.15, 0.3, 0.5])
    r = ride(world, [Mismatch(friction=mu) for mu in friction], BRAKES, 2.0)
    assert r.speed_mps.min() < 0
    resistance = SHEET.rolling_resistance + 0.6 * SHEET.drag_area_m2 * 2.1**2 / (SHEET.mass_kg * G)
    assert r.x_m.max(axis=1) == pytest.approx(9 / (2 * (friction + resistance) * G), rel=0.04)


@pytest.mark.parametrize("side", ["left", "right"])
def test_braking_on_split_friction_turns_the_car_to_the_side_that_grips(world, side):
    split = {
        "left": Mismatch(friction=0.6, left_friction=0.2),
        "right": Mismatch(friction=0.2, left_friction=0.6),
    }
    r = ride(world, [split[side], Mismatch(friction=0.6)], BRAKES, 0.3)
    assert abs(r.heading_rad[1]).max() < 0.003
    gripping = -1 if side == "left" else 1  # the left wheels grip where the right ones slip
    assert gripping * r.heading_rad[0, -1] > 0.02


def test_a_patch_slips_where_it_is_and_nowhere_else(world):
    patch = {"patch_start_m": 1.0, "patch_length_m": 0.6}
    mismatch = [NOTHING, Mismatch(patch_friction=0.1, **patch), Mismatch(friction=0.1)]
    r = ride(world, mismatch, accelerates(-2.0), 1.2)
    dry, patched, slippery = r.speed_mps
    before = r.x_m[1] < 1.0 - 3 * TICK_S
    assert before.sum() > 20
    assert np.array_equal(patched[before], dry[before])
    front = SHEET.wheelbase_m
    on = (r.x_m[1] - front > 1.03) & (r.x_m[1] < 1.57)  # all four wheels
    a = np.diff(patched) / TICK_S
    resistance = SHEET.rolling_resistance * G + 0.6 * SHEET.drag_area_m2 * 2.1**2 / SHEET.mass_kg
    assert a[on[:-1] & on[1:]].mean() == pytest.approx(-0.1 * G - resistance, rel=0.05)
    beyond = r.x_m[1] - front > 1.7
    assert a[beyond[:-1] & beyond[1:]].mean() == pytest.approx(-2.0, rel=0.05)
    assert dry[-1] < patched[-1] < slippery[-1]


def coasting_loss():
    return SHEET.rolling_resistance * SHEET.mass_kg * G / SHEET.effective_mass_kg


@pytest.mark.parametrize("axis", ["grade_rad", "bank_rad"])
def test_slopes_pull_with_g_sine(world, axis):
    slopes = np.array([-0.1, -0.03, 0.0, 0.05, 0.2])
    r = ride(world, [Mismatch(**{axis: s}) for s in slopes], ROLLS, 1.0)
    lost = mean_acceleration(r, 0.2, 1.0)
    if axis == "grade_rad":
        pull = -G * np.sin(slopes) * SHEET.mass_kg / SHEET.effective_mass_kg
        assert lost - lost[2] == pytest.approx(pull, rel=0.01, abs=2e-3)
    else:
        assert (np.sign(r.y_m[:, -1]) == [1, 1, 0, -1, -1])[[0, 1, 3, 4]].all()  # downhill
        assert abs(r.y_m[2, -1]) < 1e-6


def test_a_bank_and_a_wind_of_the_same_force_push_alike(world):
    """Both act at the centre of mass, or near it."""
    bank = 0.05
    wind_n = -SHEET.mass_kg * G * np.sin(bank)
    r = ride(world, [Mismatch(bank_rad=bank), Mismatch(side_wind_n=wind_n), NOTHING], ROLLS, 1.0, 2.0)
    assert r.y_m[0, -1] < -0.02
    assert r.y_m[1, -1] == pytest.approx(r.y_m[0, -1], rel=0.05)
    assert abs(r.y_m[2, -1]) < 1e-6


def test_ideal_tyres_turn_as_the_bicycle_does_and_real_ones_understeer(world):
    angle, v = 0.12, 3.0
    r = ride(world, [Mismatch(tyres="ideal"), NOTHING], steers(angle), 1.0, v)
    kinematic = r.speed_mps[:, -1] * np.tan(angle) / SHEET.wheelbase_m
    assert r.yaw_rate_radps[0, -1] == pytest.approx(kinematic[0], rel=0.01)
    assert r.yaw_rate_radps[1, -1] < 0.97 * kinematic[1]


# the ego


def model_of(world, mismatch):
    """The world whose model has the mismatch in it."""
    return World(altered(world, mismatch), world.xml, world.cars, world.sheets, world.tyres)


@pytest.mark.parametrize(("load_kg", "ahead_m"), [(1.0, 0.0), (0.5, 0.1), (1.0, -0.12)])
def test_a_load_stands_on_the_wheels_by_the_lever_rule(world, load_kg, ahead_m):
    mismatch = Mismatch(load_kg=load_kg, load_ahead_m=ahead_m, load_above_m=0.05)
    loads = wheel_loads_n(model_of(world, mismatch))
    behind = SHEET.wheelbase_m - SHEET.com_behind_front_axle_m
    front = SHEET.mass_kg * behind + load_kg * (behind + ahead_m)
    assert loads.sum() == pytest.approx((SHEET.mass_kg + load_kg) * G, rel=1e-3)
    assert loads[:2].sum() == pytest.approx(front * G / SHEET.wheelbase_m, rel=0.02)
    assert loads[0] == pytest.approx(loads[1], rel=1e-4)


def test_a_load_nobody_knows_of_makes_the_car_slower_by_its_inertia(world):
    loads = np.array([0.0, 0.5, 1.0, 1.5])
    r = ride(world, [Mismatch(load_kg=m) for m in loads], accelerates(1.0), 1.0, 2.0)
    m = SHEET.effective_mass_kg
    rolling = SHEET.rolling_resistance * loads * G  # that the load adds
    assert mean_acceleration(r, 0.4, 1.0) == pytest.approx((m * 1.0 - rolling) / (m + loads), rel=0.015)


def test_yaw_inertia_slows_the_turn_in_and_not_the_turn(world):
    r = ride(world, [NOTHING, Mismatch(yaw_inertia=3.0)], steers(0.08), 1.5, 2.0)
    early = round(0.05 / TICK_S)
    assert r.yaw_rate_radps[1, early] < 0.8 * r.yaw_rate_radps[0, early]
    assert r.yaw_rate_radps[1, -1] == pytest.approx(r.yaw_rate_radps[0, -1], rel=0.01)


def test_the_chassis_is_as_hard_to_turn_as_told(world):
    model, plain = altered(world, Mismatch(yaw_inertia=2.0)), world.model
    body = plain.body("ego/chassis").id
    assert np.sort(model.body_inertia[body]) == pytest.approx(
        np.sort(plain.body_inertia[body] * [1, 1, 2]), rel=1e-12
    )
    assert model.body_mass[body] == plain.body_mass[body]


def test_a_high_centre_of_mass_moves_load_forward_when_braking_and_outward_in_a_turn(world):
    """Pitch under braking and roll in a turn grow with the height of the centre of mass."""
    heights = [0.0, 0.03]
    mismatch = [Mismatch(com_raised_m=h) for h in heights]
    model = [altered(world, m) for m in mismatch]
    body = world.model.body("ego/chassis").id
    assert model[1].body_ipos[body, 2] - model[0].body_ipos[body, 2] == pytest.approx(0.03)
    plant = MuJoCo(
        world, np.zeros((2, 1, 2)), np.full((2, 1), 3.0), substeps=10, threads=1, mismatch=mismatch
    )
    believed, running = BelievedCars.of([SHEET], limited=True), np.ones(2, dtype=bool)
    for _ in range(60):
        told = command(plant.observe(), np.zeros((2, 1)), np.full((2, 1), 0.1), believed)
        plant.step(told, running)
    lean = np.abs(plant._now["up_axis"][:, 0, :2]).max(axis=-1)
    raised = SHEET.com_height_m + 0.03 * world.model.body_mass[body] / SHEET.mass_kg
    assert lean[1] / lean[0] > 0.9 * raised / SHEET.com_height_m


def test_small_wheels_push_harder_at_the_same_torque_and_turn_faster(world):
    ratios = np.array([0.9, 1.0, 1.1])
    r = ride(world, [Mismatch(wheel_radius=k) for k in ratios], accelerates(1.0), 1.0, 2.0)
    spin_kg = SHEET.rotating_mass_kg / ratios**2  # J/r^2
    v = 2.5
    drag = 0.6 * SHEET.drag_area_m2 * v**2
    rolling = SHEET.rolling_resistance * SHEET.mass_kg * G
    torque_force = (SHEET.effective_mass_kg + drag + rolling) / ratios
    a = (torque_force - drag - rolling) / (SHEET.mass_kg + spin_kg)
    assert mean_acceleration(r, 0.3, 1.0) == pytest.approx(a, rel=0.015)


def test_the_understeer_gradient_follows_the_cornering_stiffnesses(world):
    """K = W_f/C_f - W_r/C_r: yaw rate v delta / (L + K v^2 / g) in a steady turn of a small angle."""
    kinds = [(1.0, 1.0), (0.6, 1.0), (1.0, 1.5), (1.5, 1.0)]
    mismatch = [Mismatch(front_stiffness=f, rear_stiffness=r) for f, r in kinds]
    angle, v = 0.04, 2.5
    r = ride(world, mismatch, steers(angle), 1.5, v)
    weight, share = SHEET.mass_kg * G, SHEET.com_behind_front_axle_m / SHEET.wheelbase_m
    tyres = SHEET.cornering_stiffness_n_per_rad
    for i, (front, rear) in enumerate(kinds):
        k = weight * (1 - share) / (front * tyres.front) - weight * share / (rear * tyres.rear)
        speed = r.speed_mps[i, -1]
        expected = speed * np.tan(angle) / (SHEET.wheelbase_m + k * speed**2 / G)
        assert r.yaw_rate_radps[i, -1] == pytest.approx(expected, rel=0.02), (front, rear)


def test_soft_springs_roll_more_at_the_same_ride_height(world):
    mismatch = [NOTHING, Mismatch(suspension_stiffness=0.5)]
    models = [altered(world, m) for m in mismatch]
    for name in ("front_left", "rear_right"):
        joint = world.model.joint(f"ego/suspension_{name}")
        i, dof, q = joint.id, joint.dofadr[0], joint.qposadr[0]
        preload = [m.jnt_stiffness[i] * m.qpos_spring[q] for m in models]
        assert preload[1] == pytest.approx(preload[0])
        zeta = [m.dof_damping[dof] / np.sqrt(m.jnt_stiffness[i]) for m in models]
        assert zeta[1] == pytest.approx(zeta[0])
        assert models[1].jnt_stiffness[i] == pytest.approx(0.5 * models[0].jnt_stiffness[i])
    plant = MuJoCo(
        world, np.zeros((2, 1, 2)), np.full((2, 1), 3.0), substeps=10, threads=1, mismatch=mismatch
    )
    believed, running = BelievedCars.of([SHEET], limited=True), np.ones(2, dtype=bool)
    for _ in range(60):
        plant.step(command(plant.observe(), np.zeros((2, 1)), np.full((2, 1), 0.1), believed), running)
    lean = np.abs(plant._now["up_axis"][:, 0, 1])
    assert lean[1] > 1.6 * lean[0]


def test_motors_and_brakes_give_the_part_of_their_torque_that_is_told(world):
    ratio = 0.2
    most = 4 * SHEET.torque_limit_n_m / SHEET.wheel_radius_m / SHEET.effective_mass_kg
    r = ride(world, [Mismatch(torque_limit=ratio, friction=2.0)], accelerates(most), 0.4, 1.0)
    resistance = coasting_loss()
    assert mean_acceleration(r, 0.1, 0.4)[0] == pytest.approx(ratio * most - resistance, rel=0.03)
    most = SHEET.brake_torque_limit_n_m / SHEET.wheel_radius_m / SHEET.effective_mass_kg
    r = ride(world, [Mismatch(brake_limit=ratio, friction=2.0)], accelerates(-most), 0.4)
    assert mean_acceleration(r, 0.1, 0.4)[0] == pytest.approx(-ratio * most - resistance, rel=0.05)


def test_the_steering_stops_at_its_limit_and_turns_no_faster_than_its_rate(world):
    limit, rate = 0.2, 0.3
    mismatch = [NOTHING, Mismatch(steer_limit_rad=limit), Mismatch(steer_rate_limit=rate)]
    r = ride(world, mismatch, steers(0.35), 0.6, 0.5)
    assert r.steer_rad[:2, -1] == pytest.approx([0.35, limit], abs=2e-3)
    slope = (r.steer_rad[2, 20] - r.steer_rad[2, 8]) / (12 * TICK_S)
    assert slope == pytest.approx(rate * SHEET.steer_rate_limit_radps, rel=0.03)
    right = ride(world, mismatch[1:2], steers(-0.35), 0.6, 0.5)
    assert right.steer_rad[0, -1] == pytest.approx(-limit, abs=2e-3)


def test_steering_that_is_askew_turns_by_so_much_more_than_it_is_told(world):
    """Told to be askew the other way it goes straight; a slow servo gets there as well; its angle is told."""
    askew = 0.03
    mismatch = [Mismatch(steer_offset_rad=askew, steer_lag=k) for k in (1.0, 4.0)]
    mismatch += [NOTHING, Mismatch(steer_offset_rad=-askew)]
    r = ride(world, mismatch, steers(0.0), 1.5, 2.0)
    assert r.steer_rad[:, -1] == pytest.approx([askew, askew, 0.0, -askew], abs=2e-4)
    told = ride(world, [NOTHING], steers(askew), 1.5, 2.0)
    assert r.yaw_rate_radps[[0, 1], -1] == pytest.approx(told.yaw_rate_radps[0, -1], rel=0.02)
    straight = ride(world, mismatch[:1], steers(-askew), 1.5, 2.0)
    assert abs(straight.yaw_rate_radps[0, -1]) < 2e-3


def crossing_s(r, run, part):
    """When the steering first has done a part of its way, between ticks."""
    done = r.steer_rad[run] / r.steer_rad[run, -1]
    return float(np.interp(part, done[: np.argmax(done > part) + 1], r.time_s[: np.argmax(done > part) + 1]))


def test_a_slow_servo_takes_its_ratio_of_the_time(world):
    """Far below the rate limit; the first order of a position servo is 63 % of its way."""
    ratios = [5.0, 10.0, 20.0]
    r = ride(world, [Mismatch(steer_lag=k) for k in ratios], steers(0.01), 2.5, 0.5)
    t63 = np.array([crossing_s(r, i, 0.632) for i in range(len(ratios))])
    assert t63[1:] / t63[:-1] == pytest.approx([2.0, 2.0], rel=0.12)
    assert r.steer_rad[:, -1] == pytest.approx(0.01, rel=0.03)


def test_torques_lag_by_their_time_constant(world):
    """v(t) = a (t - T (1 - exp(-t/T))), for motors and for brakes; a and what makes up for the resistance."""
    constants = np.array([0.05, 0.2])
    for a in (1.0, -1.5):
        r = ride(world, [NOTHING, *(Mismatch(drive_lag_s=t) for t in constants)], accelerates(a), 0.8)
        behind = r.speed_mps[0] - r.speed_mps[1:]
        t = r.time_s[:, None]
        asked = a + coasting_loss() + 0.6 * SHEET.drag_area_m2 * 9 / SHEET.effective_mass_kg
        expected = asked * (constants * -np.expm1(-t / constants)).T
        assert behind[:, 10:] == pytest.approx(expected[:, 10:], rel=0.05, abs=0.004)


@pytest.mark.parametrize("what", ["motors", "brakes", "steering"])
def test_commands_are_late_by_their_dead_time_and_then_the_same(world, what):
    """Also by parts of a control step."""
    delays = np.array([0.0, 0.02, 0.1, 0.145])
    driver = {"motors": accelerates(1.0), "brakes": accelerates(-1.5), "steering": steers(0.1)}[what]
    r = ride(world, [Mismatch(command_delay_s=d) for d in delays], driver, 0.6)
    for i, delay in enumerate(delays[1:], 1):
        waiting = r.time_s < delay + 1e-9
        if what == "steering":
            assert np.abs(r.steer_rad[i, waiting]).max() < 1e-6
            later = np.interp(r.time_s - delay, r.time_s, r.steer_rad[0])
            assert r.steer_rad[i, ~waiting] == pytest.approx(later[~waiting], abs=2e-3)
        else:
            # nothing at all for that time, not even what compensates the resistance
            assert np.ptp(r.speed_mps[i, waiting]) < 1.1 * (coasting_loss() + 0.06) * delay
            a = [1.0, -1.5][what == "brakes"]
            lost = r.speed_mps[0, -1] - r.speed_mps[i, -1]
            assert lost == pytest.approx((a + coasting_loss()) * delay, rel=0.05, abs=0.003)


def test_the_neighbours_have_nothing_of_the_egos(world):
    from mjmerge.scenario.load import load
    from mjmerge.world.compose import build

    mismatch = Mismatch(
        load_kg=1.0, wheel_radius=0.95, torque_limit=0.5, brake_limit=0.5, steer_limit_rad=0.1, steer_lag=3.0,
        command_delay_s=0.05, suspension_stiffness=0.5, com_raised_m=0.02, yaw_inertia=1.2,
        steer_offset_rad=0.02,
    )  # fmt: skip
    world = build(load("paper"), [mismatch])
    model, plain = altered(world, mismatch), world.model
    for car in ("vehicle_1", "vehicle_2"):
        for kind, fields in {
            "body": ("mass", "inertia", "ipos"),
            "joint": ("stiffness", "damping"),
            "geom": ("size",),
            "actuator": ("ctrlrange", "forcerange", "gainprm", "biasprm"),
        }.items():
            count = {"body": plain.nbody, "joint": plain.njnt, "geom": plain.ngeom, "actuator": plain.nu}[
                kind
            ]
            for i in range(count):
                before, after = getattr(plain, kind)(i), getattr(model, kind)(i)
                if before.name.startswith(car):
                    for field in fields:
                        assert np.array_equal(getattr(before, field), getattr(after, field)), before.name
    late = {model.actuator(i).name for i in np.flatnonzero(model.actuator_delay)}
    assert late == {f"ego/{name}" for name in DRIVE + STEER}


def test_a_world_built_for_shorter_delays_is_refused():
    with pytest.raises(ModelError, match=r"at most 0 s, not 0\.3 s"):
        altered(single("rc"), Mismatch(command_delay_s=0.3))


@pytest.mark.parametrize(("model", "size"), [("rc", "rc"), ("sedan", "full"), ("van", "full")])
def test_every_car_stays_on_its_wheels_under_every_severe_mismatch(model, size):
    """And drives otherwise than without it, be it by little, but for what it is not asked for here."""
    levels = {axis: three[-1] for axis, three in LEVELS[size].items() if axis not in SENSING}
    delay = levels["command_delay_s"]["command_delay_s"]
    cars, sheet = single(model, delays_s={"ego": delay}), data_sheet(model)
    near = {"patch_friction": {"patch_start_m": 0.0}}
    mismatch = [NOTHING, *(Mismatch(**level | near.get(axis, {})) for axis, level in levels.items())]
    v, most = np.sqrt(G * sheet.wheelbase_m), 0.9 * sheet.steer_limit_rad

    def driver(t):
        return (3.0, most) if t < 0.8 else (-6.0, -most)

    r = ride(cars, mismatch, driver, 1.6, 1.5 * v, sheet)
    assert np.isfinite(r.x_m).all()
    apart = np.hypot(r.x_m - r.x_m[0], r.y_m - r.y_m[0]).max(axis=1)
    same = {axis for axis, off in zip(levels, apart[1:], strict=True) if off < 1e-6}
    assert same <= {"torque_limit"}  # a motor that has more than is asked of it
