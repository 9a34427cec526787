"""Nothing is without effect in silence: what a key says of where it acts is what it does, on every plant."""

from __future__ import annotations

import json
import shlex
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest

import mjmerge
from mjmerge.cli import main
from mjmerge.config import shipped
from mjmerge.config.acts import EVERY, listed
from mjmerge.errors import MjmergeError, ScenarioError
from mjmerge.gate import gate
from mjmerge.plant import PLANTS
from mjmerge.scenario.effect import acting, declared, told, without
from mjmerge.scenario.levels import LEVELS
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.search import breaking, ladder
from mjmerge.sweep import campaign
from mjmerge.sweep.plan import Batches
from mjmerge.sweep.workers import Workers

AXES = tuple(Mismatch.model_fields)
WORLDS = [*((plant, False) for plant in EVERY), ("double_integrator", True), ("bicycle", True)]
# hard enough that every limit is met within half a second, with a leader that is told to slow down
HARD = mjmerge.load(
    "charge",
    [
        "duration_s=0.6", "control_step_s=0.02", "law.k_p=60", "law.k_v=12", "law.eps_v_mps=3.0",
        "initial.ego.front_m=[-1.3, 0.9]", "initial.z=1.0", "drivers.vehicle_1.speed_mps=1.0",
    ],
).settled()  # fmt: skip
PATCH = {"patch_friction": 0.1, "patch_start_m": -2.0, "patch_length_m": 9.0}
LOAD = {"load_kg": 1.5}
WITH = {  # with what, and without it, of axes that LEVELS has not by themselves
    "patch_friction": (PATCH, {}),
    "patch_start_m": (PATCH | {"patch_start_m": 1.0}, PATCH),
    "patch_length_m": (PATCH, PATCH | {"patch_length_m": 1.0}),
    "load_ahead_m": (LOAD | {"load_ahead_m": -0.1}, LOAD),
    "load_above_m": (LOAD | {"load_above_m": 0.1}, LOAD),
    "tyres": ({"tyres": "ideal"}, {}),
}


def severe(axis):
    """A mismatch with an axis at its worst, and the same without it."""
    level = LEVELS["rc"].get(axis, (None,) * 3)[2]
    keys, rest = WITH.get(axis) or (dict(level), {k: v for k, v in level.items() if k != axis})
    without_it = HARD.model_copy(update={"mismatch": Mismatch(**rest)})
    return Mismatch(**keys), acting(without_it, "mujoco").mismatch


def motion(trace, run=0):
    """Every bit of how the cars move, and of what the ego is told of them."""
    names = ("front_m", "velocity_mps", "heading_rad", "speed_mps", "sensed_distance_m", "u_mps2", "opinion")
    return [getattr(trace, name)[run].tobytes() for name in names]


def alone(scenario, plant, continuous=False):
    """The motion of a scenario in whose own file everything stands."""
    return motion(mjmerge.simulate(scenario, plant, continuous=continuous))


@cache
def base(variant, delay_s):
    """The scenario under a variant of the law and a dead time, and its motion everywhere."""
    update = {
        "law": HARD.law.model_copy(update={"variant": variant}),
        "initial": HARD.initial.model_copy(update={"z": 0.5}),
        "mismatch": HARD.mismatch.model_copy(update={"command_delay_s": delay_s}),
    }
    scenario = HARD.model_copy(update=update)
    return scenario, {world: alone(scenario, *world) for world in WORLDS}


@pytest.fixture(scope="module")
def on_cars():
    """On mujoco, all in one batch: the motion with each axis, and without it."""
    cases = [(3, m) for axis in AXES for m in severe(axis)]
    trace = mjmerge.simulate(HARD, "mujoco", cases=cases)
    found = [motion(trace, i) for i in range(len(cases))]
    return dict(zip(AXES, zip(found[::2], found[1::2], strict=True), strict=True))


def test_every_axis_of_mismatch_and_every_belief_says_where_it_acts():
    claims = {f"mismatch.{axis}" for axis in AXES} | {
        f"belief.{key}" for key in type(HARD.belief).model_fields
    }
    assert claims <= declared().keys()
    assert set(EVERY) == set(PLANTS)


@pytest.mark.parametrize("axis", AXES)
def test_an_axis_changes_the_motion_exactly_where_it_says(axis, on_cars):
    there, away = severe(axis)
    for plant, continuous in WORLDS:
        here = HARD.model_copy(update={"mismatch": there})
        says = f"mismatch.{axis}" not in without(here, plant, continuous=continuous)
        if plant == "mujoco":
            with_, rest = on_cars[axis]
        elif continuous and axis not in ("command_delay_s", "neighbour_dropout", "heading_noise_rad"):
            continue  # one of each way in is as good as all, and a differential equation takes its time
        else:
            with_, rest = (
                alone(HARD.model_copy(update={"mismatch": m}), plant, continuous) for m in (there, away)
            )
        assert (with_ != rest) == says, f"{plant}, continuous: {continuous}"


KEYS = {
    "actuation.inverse": "commanded",
    "actuation.dead_time_s": 0.05,
    "belief.wheelbase_m": 0.5,
    "belief.mass_kg": 9.0,
    "belief.wheel_radius_m": 0.08,
    "law.eps_v_mps": 5.0,
    "law.d_cap_m": 3.0,
    "law.z_floor": 0.9,
    "physics_step_s": 0.002,
}


@pytest.mark.parametrize(
    ("key", "variant"),
    [(key, "literal") for key in KEYS] + [("law.d_cap_m", "capped"), ("law.z_floor", "z_floor")],
)
def test_another_key_changes_the_motion_exactly_where_it_says(key, variant):
    others = ("mismatch.", "gate", "search", "law.choice")  # the last among many cars, in tests/law
    assert set(KEYS) == {k for k in declared() if not k.startswith(others)}
    scenario, before = base(variant, 0.05 if key == "actuation.inverse" else 0.0)
    section, _, name = key.rpartition(".")
    value = KEYS[key] if not section else getattr(scenario, section).model_copy(update={name: KEYS[key]})
    other = scenario.model_copy(update={section or name: value})
    for world in WORLDS:
        plant, continuous = world
        says = key not in without(other, plant, continuous=continuous)
        assert (alone(other, plant, continuous) != before[world]) == says, world


LONELY = [
    ({"patch_friction": 0.2}, "patch_friction"),
    ({"patch_friction": 1.0, "patch_length_m": 9.0, "patch_start_m": -2.0}, "patch_length_m"),
    ({"patch_start_m": 1.0, "patch_length_m": 2.0}, "patch_start_m"),
    ({"left_friction": 1.0}, "left_friction"),
    ({"load_ahead_m": 0.1}, "load_ahead_m"),
    ({"load_above_m": 0.1}, "load_above_m"),
    ({"tyres": "ideal", "front_stiffness": 0.5}, "front_stiffness"),
    ({"tyres": "ideal", "rear_stiffness": 0.5}, "rear_stiffness"),
    ({"leader_acceleration": "unknown", "leader_acceleration_delay_s": 0.1}, "leader_acceleration_delay_s"),
]


def test_an_axis_without_what_gives_it_a_meaning_changes_nothing_and_says_so(monkeypatch):
    cases = []
    for keys, lonely in LONELY:
        mismatch = Mismatch(**keys)
        scenario = HARD.model_copy(update={"mismatch": mismatch})
        assert f"mismatch.{lonely}" in told(scenario, "mujoco")
        with pytest.raises(ScenarioError, match=rf"cases\[0\]: mismatch\.{lonely}: acts only "):
            mjmerge.simulate(HARD, "mujoco", cases=[(0, mismatch)])
        cases += [mismatch, acting(scenario, "mujoco").mismatch]
        assert cases[-1] != cases[-2]
    monkeypatch.setattr(import_module("mjmerge.simulation.loop"), "check_effect", lambda *_, **__: None)
    trace = mjmerge.simulate(HARD, "mujoco", cases=[(0, m) for m in cases])
    for i in range(0, len(cases), 2):
        assert motion(trace, i) == motion(trace, i + 1), cases[i]


def test_the_documentation_says_where_every_key_acts():
    text = (Path(__file__).parents[2] / "docs/mismatch.md").read_text("utf-8")
    lines = text.partition("\n### Where they act\n")[2].partition("\n### ")[0].splitlines()
    cells = [line.strip("|").split("|") for line in lines if line.startswith("| `")]
    said = {key.strip(" `"): where.strip() for keys, where in cells for key in keys.split(",")}
    names = {
        key.removeprefix("mismatch."): acts
        for key, acts in declared().items()
        if key not in ("gate", "search")
    }
    assert said.keys() == names.keys()
    for key, acts in names.items():
        where = "every plant" if acts.on == EVERY else listed(acts.on)
        if not acts.beside:
            assert (
                said[key]
                == ", ".join([where] + [acts.only] * bool(acts.only))
                + "; in continuous time too" * acts.continuous
            )


# who is told, and how


def ended(*arguments, capsys):
    """Exit code, standard output and standard error of a command."""
    with pytest.raises(SystemExit) as end:
        main([*map(str, arguments)])
    return end.value.code, *capsys.readouterr()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (
            "charge --plant bicycle --set mismatch.friction=0.2",
            "mismatch.friction: acts on mujoco only, not on bicycle",
        ),
        (
            "charge --plant double_integrator --set mismatch.steer_noise_rad=0.2",
            "acts on bicycle, bicycle_limited and",
        ),
        ("charge --plant bicycle --set 'mismatch={friction: 0.2}'", "mismatch.friction: acts on mujoco only"),
        (
            "charge --plant bicycle --continuous --set mismatch.command_delay_s=0.1",
            "acts on every plant, but not in continuous time",
        ),
        (
            "charge --plant bicycle --set belief.mass_kg=9",
            "acts on bicycle_limited and mujoco only, not on bicycle",
        ),
        (
            "charge --set mismatch.patch_friction=0.2",
            "acts only with mismatch.patch_friction and mismatch.patch_length_m",
        ),
        ("charge --plant bicycle --set physics_step_s=0.0005", "physics_step_s: acts on mujoco only"),
        ("charge --set law.d_cap_m=0.1", "under the law variants capped and guarded"),
        ("charge --set law.variant=no_u1 --set mismatch.leader_acceleration=unknown", "without no_u1"),
        ("charge --set gate.0.at_least_m=1", "`mjmerge check` alone"),
        ("charge --set search.level=mild", "`mjmerge falsify`"),
    ],
)  # fmt: skip
def test_a_run_refuses_what_it_was_given_in_vain_and_names_who_has_it(words, says, capsys):
    code, out, err = ended("run", *shlex.split(words), "--no-record", "--json", capsys=capsys)
    assert (code, out) == (2, "")
    assert says in err
    assert "--set " in err


def test_nothing_is_left_behind_by_a_run_that_is_refused(tmp_path, capsys):
    out = tmp_path / "out"
    words = ["charge", "--plant", "bicycle", "--set", "mismatch.friction=0.2", "--out", out]
    assert ended("run", *words, capsys=capsys)[0] == 2
    assert not out.exists()


@pytest.mark.parametrize(
    "given",
    [
        "mismatch.friction=1.0",  # no claim: as it is
        "road.lane_width_m=2",  # the picture
        "expect.min_distance_m.at_least=0.0",  # the floor
        "models.ego=sedan",  # the picture too
    ],
)
def test_what_claims_nothing_or_changes_the_picture_is_accepted(given):
    start = ["initial.vehicle_1.front_m=[40, 0]", "initial.vehicle_2.front_m=[-40, 0]", "law.r_rho_m=-20"]
    gaps = ["drivers.vehicle_2={kind: gap, gap_m: 80}", "road.lane_width_m=9", "initial.ego.front_m=[0, 9]"]
    mjmerge.simulate(mjmerge.load("charge", ["duration_s=0.1", *start, *gaps, given]), "bicycle")


def test_the_physics_step_may_be_what_the_control_step_needs_on_a_plant_without_physics():
    given = ["control_step_s=0.0025", "physics_step_s=0.0005", "duration_s=0.1"]
    mjmerge.simulate(mjmerge.load("charge", given), "double_integrator")


def test_what_stands_in_the_file_is_told_beside_the_verdict(capsys):
    words = ["wet", "--plant", "bicycle", "--duration", "0.1", "--no-record"]
    code, out, _ = ended("run", *words, "--json", capsys=capsys)
    found = json.loads(out)
    assert (code, found["no_effect"]) == (0, ["mismatch.friction"])
    (doubt,) = found["verdict_doubts"]
    assert (
        doubt == "the scenario's mismatch.friction is without effect: it acts on mujoco only, not on bicycle"
    )
    _, out, _ = ended("run", *words, capsys=capsys)
    assert "no effect" in out
    _, out, _ = ended("run", *words, "--set", "mismatch.friction=1.0", "--json", capsys=capsys)
    assert json.loads(out)["no_effect"] == []
    assert ended("run", *words, "--set", "mismatch.friction=0.4", capsys=capsys)[0] == 2


def test_python_refuses_as_the_command_line_does_and_compares_with_another_plant_if_told():
    scenario = mjmerge.load("charge", ["mismatch.friction=0.4", "duration_s=0.1"])
    with pytest.raises(MjmergeError, match=r"mismatch\.friction=0\.4: .*acts on mujoco only, not on bicycle"):
        mjmerge.simulate(scenario, "bicycle")
    assert mjmerge.simulate(scenario.settled(), "bicycle").plant == "bicycle"
    with pytest.raises(MjmergeError, match=r"cases\[1\]: mismatch\.friction: acts on mujoco only"):
        mjmerge.simulate(HARD, "bicycle", cases=[(0, Mismatch()), (0, Mismatch(friction=0.5))])
    assert mjmerge.simulate(mjmerge.load("paper", ["duration_s=0.1"])).plant == "mujoco"


def test_the_trace_of_a_run_can_be_run_on_any_plant():
    """As a judge or a comparison does: what was given is part of the scenario by then."""
    trace = mjmerge.simulate(mjmerge.load("charge", ["mismatch.friction=0.4", "duration_s=0.1"]))
    assert mjmerge.simulate(trace.scenario, "double_integrator").plant == "double_integrator"


# campaigns, gates, searches, ladders


def planned(**keys):
    return campaign.plan({"blocks": [{"scenarios": ["charge"], "set": {"duration_s": 1}, **keys}]})


@pytest.mark.parametrize(
    ("block", "line", "says"),
    [
        ("mismatches: {wet: {mismatch.friction: 0.5}}", 3, "acts on mujoco only, not on bicycle"),
        ("grid: {mismatch.friction: [1.0, 0.5]}", 3, "acts on mujoco only, not on bicycle"),
        ("random: {draws: 3, axes: {mismatch.friction: {uniform: [0.1, 1]}}}", 3, "acts on mujoco only"),
        ("set: {belief.mass_kg: 5}", 3, "acts on bicycle_limited and mujoco only, not on bicycle"),
        ("grid: {law.d_cap_m: [0.1, 0.2]}", 3, "acts only under the law variants capped and guarded"),
        ("set: {mismatch: {friction: 0.5}}", 3, "mismatch.friction"),
    ],
)
def test_a_campaign_names_file_and_line_of_every_axis_that_acts_nowhere(tmp_path, block, line, says):
    file = tmp_path / "c.yaml"
    file.write_text(f"blocks:\n  - scenarios: [charge]\n    {block}\n    plants: [mujoco, bicycle]\n")
    with pytest.raises(ScenarioError) as error:
        campaign.plan(file)
    assert {p.line for p in error.value.problems} == {line}
    assert says in str(error.value)


def test_an_axis_of_a_grid_that_acts_somewhere_is_left_out_of_the_runs_in_which_it_cannot():
    plan = planned(grid={"mismatch.load_kg": [0, 1], "mismatch.load_ahead_m": [-0.1, 0.1]})
    assert [case.overrides[1:] for case in plan.cases] == [
        ("mismatch.load_kg=0",),
        ("mismatch.load_kg=0",),
        ("mismatch.load_kg=1", "mismatch.load_ahead_m=-0.1"),
        ("mismatch.load_kg=1", "mismatch.load_ahead_m=0.1"),
    ]
    both = planned(variants=["literal", "capped"], grid={"law.d_cap_m": [0.1, 0.2]}, plants=["bicycle"])
    assert len({id(case.batch) for case in both.cases}) == 3


def test_levels_leave_out_the_axes_that_a_plant_has_not_and_say_which():
    plan = planned(plants=["double_integrator", "mujoco"], levels=["mild", "severe"])
    by_plant = {p: {c.point.split()[0] for c in plan.cases if c.batch.plant == p} for p in EVERY}
    assert by_plant["mujoco"] == set(LEVELS["rc"])
    assert by_plant["double_integrator"] == {
        axis
        for axis in LEVELS["rc"]
        if declared()[f"mismatch.{axis}"].why_not(HARD, EVERY[0], continuous=False) is None
    }
    left = {axis for axes in plan.left_out.values() for axis in axes}
    assert left == set(LEVELS["rc"]) - by_plant["double_integrator"]
    assert "acts on mujoco only, not on double_integrator" in plan.left_out


def test_a_row_of_the_gate_names_file_and_line(tmp_path):
    text = shipped.scenarios()["charge"].read_text(encoding="utf-8").partition("\ngate:")[0]
    rows = [
        "{name: a, plant: bicycle, at_least_m: 0, set: [law.k_o=1.0, mismatch.friction=0.5]}",
        "{name: b, plant: bicycle, at_least_m: 0, needs: [grip]}",
        "{name: c, at_least_m: 0, set: [expect.min_distance_m.at_least=0.3]}",
    ]
    file = tmp_path / "mine.yaml"
    file.write_text(text + "\ngate:\n" + "".join(f"  - {row}\n" for row in rows), encoding="utf-8")
    first = text.count("\n") + 3
    with pytest.raises(ScenarioError) as error:
        gate.rows([file])
    assert [p.line for p in error.value.problems] == [first, first + 1, first + 2]
    said = str(error.value)
    for words in ("mismatch.friction acts on mujoco only, not on bicycle", "needs grip", "its at_least_m"):
        assert words in said


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (
            "--break mismatch.friction charge --plant bicycle",
            "--break mismatch.friction: acts on mujoco only",
        ),
        (
            "--break mismatch.load_ahead_m=0:0.2 charge",
            "--break mismatch.load_ahead_m: acts only with mismatch.load_kg",
        ),
        (
            "--break mismatch.command_delay_s charge --plant bicycle --set mismatch.friction=0.5",
            "--set mismatch.friction",
        ),
        (
            "--break mismatch.command_delay_s,mismatch.friction charge --plant bicycle",
            "--break mismatch.friction",
        ),
        ("--break expect.min_distance_m.at_least=0:1 charge", "--until floor"),
        ("--ladder charge --set law.d_cap_m=0.2", "on no rung"),
        ("--ladder charge --set mismatch.patch_start_m=3", "on no rung"),
    ],
)  # fmt: skip
def test_a_search_or_a_ladder_along_what_acts_nowhere_is_refused_and_leaves_nothing(
    words, says, tmp_path, capsys
):
    out = tmp_path / "out"
    code, _, err = ended("sweep", *shlex.split(words), "--out", out, "--workers", 1, capsys=capsys)
    assert code == 2
    assert says in err
    assert not out.exists()


def test_a_search_goes_through_the_point_at_which_an_axis_is_nothing():
    keys = {"duration_s": 0.2, "mismatch.load_ahead_m": -0.1}
    breaking.check("charge", "mujoco", [breaking.Range("mismatch.load_kg", 0.0, 2.0)], keys)
    case = Batches().case("charge", "mujoco", {**keys, "mismatch.load_kg": 0.0}, lenient=True)
    assert case.differs == ("mismatch.load_kg=0.0",)


def test_a_ladder_says_on_which_rungs_a_key_is_without_effect(capsys):
    keys = {"duration_s": 0.1, "belief.mass_kg": 5.0, "mismatch.friction": 0.5}
    found = ladder.climb("charge", keys, Workers(1))
    idle = {rung.name: set(rung.idle) for rung in found.rungs}
    assert {name for name, names in idle.items() if names} == {"ideal", "held", "delayed", "bicycle"}
    assert ladder.idle_lines(found) == ["belief.mass_kg is without effect on: ideal, held, delayed, bicycle."]
    rungs = ladder.as_json(found)["rungs"]
    assert rungs[0]["no_effect"] == ["belief.mass_kg"]
    late, slippery = "mismatch.command_delay_s", "mismatch.friction"
    held_back = [[slippery, late], [slippery, late], *[[slippery]] * 5, []]
    assert [rung["held_back"] for rung in rungs] == held_back
    for rung in found.rungs[1:-1:2]:  # and its command is one that `run` accepts
        code, out, _ = ended(*shlex.split(rung.command)[1:], "--no-record", "--json", capsys=capsys)
        assert code in (0, 1)
        assert json.loads(out)["min_distance_m"]["vehicle_1"] == rung.row["min_d_1_m"]
