"""Mismatch in a batch: every simulation its own, none seen by the law, and the same bits alone."""

from importlib import import_module

import numpy as np
import pytest

from mjmerge.plant import make
from mjmerge.plant.mujoco import MuJoCo
from mjmerge.roster import roster
from mjmerge.scenario.cars import believed_sheets
from mjmerge.scenario.levels import LEVELS
from mjmerge.scenario.load import load
from mjmerge.scenario.mismatch import SENSING, Mismatch
from mjmerge.simulation.loop import simulate
from mjmerge.simulation.trace import COLUMNS
from mjmerge.state import Controls
from mjmerge.vehicle.actuation import Feet
from mjmerge.world.compose import build

CARS = roster().cars

loop, several = (import_module(f"mjmerge.{name}") for name in ("simulation.loop", "law.several"))
NOTHING = Mismatch()
PHYSICS = {name for name in Mismatch.model_fields if name not in SENSING}
HAND_MADE = (
    NOTHING,
    Mismatch(friction=0.4, grade_rad=0.05, torque_limit=0.5),
    Mismatch(left_friction=0.3, side_wind_n=2.0, steer_lag=5.0),
    Mismatch(patch_friction=0.2, patch_start_m=-0.5, patch_length_m=1.0, bank_rad=0.03),
    Mismatch(tyres="ideal", command_delay_s=0.033, brake_limit=0.3),
    Mismatch(load_kg=1.0, load_ahead_m=-0.1, load_above_m=0.05, drive_lag_s=0.05),
    Mismatch(com_raised_m=0.02, yaw_inertia=1.2, wheel_radius=0.95, steer_limit_rad=0.1),
    Mismatch(front_stiffness=0.6, rear_stiffness=0.8, suspension_stiffness=0.6, steer_rate_limit=0.5),
    Mismatch(command_delay_s=0.1, friction=0.6),
)
SHORT = load("charge", ["duration_s=0.25"])


def bits(trace, run=0):
    return {c.name: getattr(trace, c.name)[run].tobytes() for c in COLUMNS}


def differs(mismatch):
    """Keys in which a mismatch is one."""
    return {name for name in Mismatch.model_fields if getattr(mismatch, name) != getattr(NOTHING, name)}


LEFT = PHYSICS - set.union(*map(differs, HAND_MADE))
MIX = (*HAND_MADE, *(Mismatch(**LEVELS["rc"][axis][2]) for axis in sorted(LEFT)))
"""Hand-made mixes, and of what they leave out each axis by itself."""
ALL = Mismatch(
    **{key: value for axis in LEVELS["rc"].keys() & PHYSICS for key, value in LEVELS["rc"][axis][1].items()}
    | {"tyres": "ideal", "patch_start_m": -1.0}
)


def test_the_mixes_leave_no_axis_out():
    assert set.union(*map(differs, MIX)) == PHYSICS
    assert differs(ALL) == PHYSICS


@pytest.fixture(scope="module")
def alone():
    return [bits(simulate(SHORT, "mujoco", cases=[(7, m)], threads=1)) for m in MIX]


def test_every_mix_makes_a_difference(alone):
    assert len({run["front_m"] for run in alone}) == len(MIX)


@pytest.mark.parametrize("threads", [1, 2])
def test_a_run_among_other_mismatches_is_the_run_alone_to_the_last_bit(alone, threads):
    trace = simulate(SHORT, "mujoco", cases=[(7, m) for m in MIX], threads=threads)
    for i in range(len(MIX)):
        for column, value in bits(trace, i).items():
            assert value == alone[i][column], f"{differs(MIX[i])}: {column}"


@pytest.mark.parametrize("plant", ["double_integrator", "bicycle", "bicycle_limited"])
def test_late_commands_of_one_run_do_not_touch_the_others(plant):
    delays = [0.0, 0.03, 0.014, 0.2]
    cases = [(7, Mismatch(command_delay_s=d)) for d in delays]
    trace = simulate(SHORT, plant, cases=cases)
    assert len({trace.front_m[i].tobytes() for i in range(len(cases))}) == len(cases)
    for i, case in enumerate(cases):
        assert bits(trace, i) == bits(simulate(SHORT, plant, cases=[case]))


def test_a_batch_without_mismatch_costs_no_field_of_the_model():
    world = build(SHORT)
    plain, other = (
        MuJoCo(world, np.zeros((3, 3, 2)), np.ones((3, 3)), substeps=SHORT.substeps, mismatch=m)
        for m in (None, (NOTHING,) * 3)
    )
    assert plain.batch._expanded.keys() == other.batch._expanded.keys()
    assert plain.batch.state.shape == other.batch.state.shape


class Heard:
    """Every argument that the law and the actuation get, tick by tick."""

    def __init__(self, monkeypatch):
        self.calls = {"decided": [], "actuate": []}
        for room, (name, calls) in zip((several, loop), self.calls.items(), strict=True):
            monkeypatch.setattr(room, name, self._listening(getattr(room, name), calls))

    def _listening(self, function, calls):
        def heard(*args):
            calls.append(args)
            return function(*args)

        return heard


def same(a, b):
    """Equality of everything that arguments are made of; the truth's own round-off is let through."""
    if isinstance(a, np.ndarray):
        assert np.allclose(a, b, rtol=0, atol=1e-12, equal_nan=True)
    elif isinstance(a, dict):
        assert a.keys() == b.keys()
        for name in a:
            same(a[name], b[name])
    elif hasattr(a, "__dataclass_fields__"):
        for field in a.__dataclass_fields__:
            same(getattr(a, field), getattr(b, field))
    elif isinstance(a, Feet):  # it knows its step, and what it is told here
        assert isinstance(b, Feet)
    else:
        assert a == b


def test_neither_law_nor_actuation_is_told_of_any_physics(monkeypatch):
    heard = []
    for mismatch in (NOTHING, ALL):
        heard.append(Heard(monkeypatch))
        simulate(SHORT.model_copy(update={"mismatch": mismatch}), "mujoco", threads=1)
        monkeypatch.undo()
    for name, calls in heard[0].calls.items():
        others = heard[1].calls[name]
        assert len(calls) == len(others) > 20
        for a, b in zip(calls[0], others[0], strict=True):  # before anything has moved: all is the same
            same(a, b)
        for plain, other in zip(calls, others, strict=True):  # later on: all but the motion
            for a, b in zip(plain, other, strict=True):
                if type(a).__name__ not in ("Cars", "Sensed", "dict", "ndarray"):
                    same(a, b)
    moved = [h.calls["actuate"][-1][0].front_m for h in heard]
    assert np.abs(moved[0] - moved[1]).max() > 1e-4


def test_what_is_believed_does_not_depend_on_any_mismatch():
    assert believed_sheets(SHORT) == believed_sheets(SHORT.model_copy(update={"mismatch": ALL}))


# late commands, and limits, without bodies


def told(runs, u=0.0, a=0.0, omega=0.0, torque=0.0, steer=0.0):
    cars = (runs, len(CARS))
    return Controls(
        u_mps2=np.full((*cars, 2), [u, 0.0]),
        a_mps2=np.full(cars, a),
        omega_radps=np.full(cars, omega),
        steer_rad=np.full(cars, steer),
        wheel_steer_rad=np.zeros((*cars, 2)),
        torque_n_m=np.full((*cars, 4), torque / 4),
        torque_clipped_n_m=np.zeros(cars),
        steer_clipped_rad=np.zeros(cars),
    )


@pytest.mark.parametrize("name", ["double_integrator", "bicycle"])
def test_the_ego_does_what_it_was_told_a_dead_time_ago(name):
    """v(t) = v(0) + U(t - tau), U the integral of the command; also for parts of a control step."""
    delays = np.array([0.0, 0.01, 0.05, 0.013, 0.0275])
    plant = make(
        name, [SHORT.model_copy(update={"mismatch": Mismatch(command_delay_s=d)}) for d in delays], None, 1
    )
    rng, h, ticks = np.random.default_rng(3), SHORT.control_step_s, 12
    commands, running = rng.normal(size=ticks), np.ones(len(delays), dtype=bool)
    integral = np.concatenate([[0.0], np.cumsum(commands) * h])
    start = plant.observe().speed_mps
    for k in range(ticks):
        plant.step(told(len(delays), u=commands[k], a=commands[k]), running)
        since = (k + 1) * h - delays
        expected = np.interp(since, np.arange(ticks + 1) * h, integral, left=0.0)
        gained = plant.observe().speed_mps - start
        assert gained[:, 0] == pytest.approx(expected, abs=1e-12)
        assert gained[:, 1:] == pytest.approx(integral[k + 1], abs=1e-12)


def test_a_limited_bicycle_that_is_asked_for_little_is_the_bicycle():
    plain, limited = (simulate(load("paper", ["duration_s=6"]), p) for p in ("bicycle", "bicycle_limited"))
    assert not np.abs(limited.torque_clipped_n_m).any()
    assert limited.front_m == pytest.approx(plain.front_m, abs=1e-9)
    assert limited.steer_rad == pytest.approx(plain.steer_rad, abs=1e-9)


def test_a_limited_bicycle_does_no_more_than_its_car_can():
    s = load("charge", ["law.k_p=200", "law.k_v=40", "duration_s=2"])
    trace = simulate(s, "bicycle_limited")
    sheet = believed_sheets(s)[0]
    h = s.control_step_s
    assert np.abs(trace.torque_clipped_n_m[0, :, 0]).max() > 0.1
    most = 4 * sheet.torque_limit_n_m / sheet.wheel_radius_m / sheet.effective_mass_kg
    braking = sheet.brake_torque_limit_n_m / sheet.wheel_radius_m / sheet.effective_mass_kg
    a = np.diff(trace.speed_mps[0, :, 0]) / h
    assert a.max() <= most
    assert a.min() >= -braking - 0.5  # what air and tyres add
    assert np.abs(np.diff(trace.steer_rad[0, :, 0])).max() <= sheet.steer_rate_limit_radps * h + 1e-12
    assert np.abs(trace.steer_rad[0, :, 0]).max() <= sheet.steer_limit_rad + 1e-12


def test_a_limited_bicycle_that_thinks_itself_lighter_is_slower():
    s = load("paper", ["duration_s=1", "belief.mass_kg=3.0"]).settled()
    plain, limited = (simulate(s, p) for p in ("bicycle", "bicycle_limited"))
    apart = np.abs(plain.front_m - limited.front_m)[0, :, 0].max()
    assert apart > 1e-3
