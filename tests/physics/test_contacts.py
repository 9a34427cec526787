"""When bodies touch, what is recorded is the momentum that they exchange, whatever the tick."""

import mujoco
import numpy as np
import pytest

from mjmerge.plant import make
from mjmerge.roster import roster
from mjmerge.scenario.cars import data_sheet
from mjmerge.scenario.load import load
from mjmerge.simulation.loop import simulate
from mjmerge.state import Controls
from mjmerge.verdict.metrics import clear_ticks_without_margin, events, touching_ticks_in_margin
from mjmerge.world.compose import build

CARS = roster().cars

SHEET = data_sheet("rc")
APART = 0.05


def scenario(step_s=0.01, offset_m=0.0, friction=0.001):
    """The ego runs into Vehicle 1 at 2 m/s; Vehicle 2 is far behind. The road is ice, brakes off."""
    return load(
        "paper",
        [
            f"control_step_s={step_s}",
            "duration_s=1",
            f"mismatch.friction={friction}",
            f"initial.vehicle_1.front_m=[{SHEET.length_m + APART}, {1.2 + offset_m}]",
            "initial.vehicle_1.speed_mps=1.0",
            "initial.ego.front_m=[0, 1.2]",
            "initial.ego.speed_mps=3.0",
            "initial.vehicle_2.front_m=[-20, 1.2]",
            "initial.vehicle_2.speed_mps=1.0",
        ],
    )


def coasting(runs):
    cars = (runs, len(CARS))
    return Controls(
        u_mps2=np.zeros((*cars, 2)),
        a_mps2=np.zeros(cars),
        omega_radps=np.zeros(cars),
        steer_rad=np.zeros(cars),
        wheel_steer_rad=np.zeros((*cars, 2)),
        torque_n_m=np.zeros((*cars, 4)),
        torque_clipped_n_m=np.zeros(cars),
        steer_clipped_rad=np.zeros(cars),
    )


def crash(s, ticks):
    """Impulses and speeds of every tick, (T, P), and the cars' momenta before and after, (T + 1, C, 2)."""
    world = build(s)
    plant = make("mujoco", [s], world, 1)
    model = world.model
    chassis = [model.body(f"{car}/chassis").id for car in CARS]

    def momentum():
        data = plant.batch.get_data(0)
        mujoco.mj_forward(model, data)
        mujoco.mj_subtreeVel(model, data)
        return np.array([model.body_subtreemass[i] * data.subtree_linvel[i][:2] for i in chassis])

    found, carried = [], [momentum()]
    for _ in range(ticks):
        plant.step(coasting(1), np.ones(1, dtype=bool))
        found.append([x[0].copy() for x in plant.contacts()])
        carried.append(momentum())
    impulse, speed = np.moveaxis(np.array(found), 1, 0)
    return impulse, speed, np.array(carried)


@pytest.mark.parametrize("step_s", [0.001, 0.01, 0.05])
@pytest.mark.parametrize("offset_m", [0.0, 0.15])
def test_the_impulse_is_the_momentum_that_the_cars_exchange(step_s, offset_m):
    """On ice only air and rolling resistance push them besides."""
    impulse, speed, carried = crash(scenario(step_s, offset_m), round(0.2 / step_s))
    v = carried[:-1, :2, 0] / SHEET.mass_kg
    resistance_n = 0.02 * SHEET.mass_kg * 9.81 + 0.6 * SHEET.drag_area_m2 * v**2
    gained = carried[-1] - carried[0]
    gained[:2, 0] += resistance_n.sum(axis=0) * step_s
    assert gained[1, 0] > 2.0
    assert np.hypot(*gained[1]) == pytest.approx(impulse[:, 0].sum(), rel=0.01)
    assert np.hypot(*gained[0]) == pytest.approx(impulse[:, 0].sum(), rel=0.01)
    assert not impulse[:, 1:].any()
    first = np.argmax(impulse[:, 0] > 0)
    assert speed[first, 0] == pytest.approx(2.0, rel=0.02)
    assert not speed[impulse == 0].any()


def test_the_impulse_does_not_depend_on_the_tick():
    totals = [crash(scenario(step_s), round(0.2 / step_s))[0].sum() for step_s in (0.001, 0.01, 0.05)]
    assert np.ptp(totals) < 0.01 * np.mean(totals)


def test_a_crash_is_in_the_trace_and_in_the_events():
    s = scenario(friction=1.0)
    trace = simulate(s, "mujoco")
    hit = trace.contact_impulse_n_s[0, :, 0]
    assert hit.sum() > 1.0
    ticks = np.flatnonzero(hit > 0)
    assert trace.touching[0, ticks, 0].all()
    assert trace.contact_speed_mps[0, ticks[0], 0] == pytest.approx(2.0, abs=0.5)
    texts = [e.text for e in events(trace) if "touches vehicle_1" in e.text]
    assert "m/s" in texts[0]
    assert "N s" in texts[0]
    inside, clear = touching_ticks_in_margin(trace)[0], clear_ticks_without_margin(trace)[0]
    d, touch = trace.distance_m[0], trace.touching[0, :, :2]
    assert inside.tolist() == ((d > 0) & touch).sum(axis=0).tolist()
    assert clear.tolist() == ((d <= 0) & ~touch).sum(axis=0).tolist()


def test_without_bodies_nothing_touches_and_nothing_is_known_of_contact():
    trace = simulate(load("charge", ["duration_s=0.1"]), "bicycle")
    assert np.isnan(trace.contact_impulse_n_s).all()
    assert not trace.touching.any()
    assert touching_ticks_in_margin(trace).tolist() == clear_ticks_without_margin(trace).tolist() == [[0, 0]]
