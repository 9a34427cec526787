"""What a failure needs is named, and nothing else: each part taken back by itself, and what is enough."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mjmerge import load
from mjmerge.cli import main
from mjmerge.errors import MjmergeError, ScenarioError
from mjmerge.scenario.load import dump
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.scenario.schema import Scenario
from mjmerge.search.explain import Explanation, as_json, explain, parts_of, sentences
from mjmerge.search.falsify import search
from mjmerge.search.findings import differing
from mjmerge.search.parts import Parts, said
from mjmerge.search.shrink import shrink
from mjmerge.search.space import Ground
from mjmerge.simulation.loop import simulate
from mjmerge.verdict.judge import judge

COARSE = "control_step_s=0.02"
BARE = (COARSE, "duration_s=5.2", "law.k_o=0")
"""Of `charge`: Vehicle 2 comes into an ego without a barrier, at 4.86 s."""
CHARGES = "Vehicle 2 goes to a gap of 1.645 m at 3.939 s, in 1.181 s"
LATE = (COARSE, "duration_s=4", "mismatch.command_delay_s=0.2")
"""Of `charge` on bicycles: a dead time that the printed inverse does not stand."""
PATCH = ("mismatch.patch_friction=0.05", "mismatch.patch_start_m=7", "mismatch.patch_length_m=2")
LOAD = ("mismatch.load_kg=0.1", "mismatch.load_ahead_m=-0.05")
SLIPS = (COARSE, "duration_s=5", "physics_step_s=0.002")
"""Of `charge` on cars: what it takes to come onto a patch that begins 7 m along the road."""
PATCHED = "patch_friction 0.05, patch_start_m 7, patch_length_m 2"
LOADED = "load_kg 0.1, load_ahead_m -0.05"


def words(of: Parts) -> list[str]:
    return [said(of, name) for name in of.names]


def parts(name: str, *keys: str, plant: str = "mujoco") -> Parts:
    return parts_of(load(name, keys), plant)


def rows(found: Explanation) -> dict[str, str]:
    return {row.what: row.then for row in found.table}


def says(capsys, *arguments: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as end:
        main(["explain", *arguments])
    said_ = capsys.readouterr()
    assert isinstance(end.value.code, int)
    return end.value.code, said_.out, said_.err


def test_a_safe_run_has_nothing_to_explain():
    why = explain(load("charge", ["duration_s=5", COARSE]), "double_integrator")
    assert not why.unsafe
    assert (why.needs, why.enough, why.table, why.runs) == ((), (), (), 1)
    assert list(sentences(why)) == ["it is safe: there is nothing to explain"]
    short = explain(load("charge", ["duration_s=5", COARSE, "expect.min_distance_m.at_least=9"]), "bicycle")
    assert not short.unsafe
    assert "below its safety floor" in next(sentences(short))


def test_a_driver_that_closes_in_at_one_moment_among_harmless_moves_is_named():
    moves = (
        "{start_s: 0.5, duration_s: 1, gap_m: 3.5}, {start_s: 2, duration_s: 1, gap_m: 3.436}, "
        "{start_s: 3.939, duration_s: 1.181, gap_m: 1.645}, {start_s: 5.12, duration_s: 1, gap_m: 1.7}"
    )
    why = explain(load("charge", [*BARE, f"drivers.vehicle_2.moves=[{moves}]"]), "double_integrator")
    assert why.needs == (CHARGES,)
    assert why.enough == ((CHARGES,),)
    assert why.complete
    assert len(why.table) == 4
    moved = {row.what: row.moves_m for row in why.table}
    assert moved.pop(CHARGES) > 0.1
    assert max(map(abs, moved.values())) < 0.05


def test_a_leader_that_brakes_at_one_moment_among_harmless_changes_is_named():
    changes = (
        "{start_s: 0.5, rate_mps2: 1, speed_mps: 2.05}, {start_s: 1.5, rate_mps2: 1, speed_mps: 2}, "
        "{start_s: 3.5, rate_mps2: 4, speed_mps: 0.5}"
    )
    keys = [COARSE, "duration_s=5.2", "law.k_o=0", f"drivers.vehicle_1.changes=[{changes}]"]
    why = explain(load("leader_brakes", keys), "double_integrator")
    mine = ("Vehicle 1 goes to 0.5 m/s at 3.5 s, at 4 m/s^2", "Vehicle 2 drives as idm does")
    assert why.needs == mine  # who closes up when the leader brakes is needed as a whole
    assert why.enough == (mine,)


def test_hypotheses_that_broke_have_their_times_in_order_and_are_the_judges():
    scenario = load("charge", LATE)
    why = explain(scenario, "bicycle")
    (verdict,) = judge(simulate(scenario, "bicycle"))
    assert why.margin.broken == verdict.breaches
    assert why.margin.unsafe_at_s == verdict.unsafe_at_s
    first = why.margin.broken[0]
    assert f"'{first.hypothesis}' at {first.time_s:.2f} s" in list(sentences(why))[1]
    assert as_json(why)["broken"][0] == {"hypothesis": first.hypothesis, "time_s": first.time_s}
    assert why.needs == ("command_delay_s 0.2", "bicycle, for double_integrator")
    assert why.enough == (("command_delay_s 0.2",),)


def test_what_fails_whatever_is_taken_back_is_said_so():
    fast = "initial.ego={front_m: [-1.2, 0.2], speed_mps: 6}"  # and no barrier
    keys = [COARSE, "duration_s=1", "law.k_o=0", fast]
    for plant in ("double_integrator", "bicycle"):
        why = explain(load("charge", [*keys, "mismatch.position_noise_m=0.001"]), plant)
        assert why.unsafe
        assert why.needs == ()
        assert why.enough == ((),)
        text = "\n".join(sentences(why))
        assert "no single thing: it fails whatever is taken back alone" in text
        assert f"enough on {plant}:  nothing more than the law, its gains and where the cars start" in text
    bare = explain(
        load("charge", [*keys, "drivers.vehicle_2={kind: gap, gap_m: 3.436}"]), "double_integrator"
    )
    assert bare.table == ()
    assert "there is nothing in it that could be taken back" in "\n".join(sentences(bare))


def test_in_continuous_time_there_are_moves_and_plants_and_no_mismatch():
    scenario = load("charge", [*BARE, "duration_s=5"])
    noisy = scenario.model_copy(update={"mismatch": Mismatch(position_noise_m=0.01)})
    why = explain(noisy, "double_integrator", continuous=True)
    assert why.continuous
    assert list(rows(why)) == [CHARGES]
    assert why.enough == ((CHARGES,),)
    with pytest.raises(MjmergeError, match="continuous"):
        explain(scenario, "mujoco", continuous=True)


def test_what_is_given_and_without_effect_is_refused():
    with pytest.raises(ScenarioError, match="friction"):
        explain(load("charge", ["mismatch.friction=0.5"]), "bicycle")


def test_keys_that_act_only_together_are_one_part():
    found = parts("charge", *PATCH, *LOAD, "mismatch.steer_lag=2", "duration_s=1")
    assert words(found) == [PATCHED, LOADED, "steer_lag 2"]
    without = found.without({("axis", "mismatch.patch_friction")})
    assert without.scenario().mismatch == load("charge", [*LOAD, "mismatch.steer_lag=2"]).mismatch
    only = found.without({name for name in found.names if "patch" not in name[1]})
    assert only.scenario().mismatch == load("charge", PATCH).mismatch


def test_of_what_acts_together_only_the_amount_is_made_less():
    found = parts("charge", *PATCH, *LOAD, "duration_s=1").nearer(0.5).axes
    assert found["mismatch.patch_start_m"] == 7.0
    assert found["mismatch.patch_length_m"] == 1.0
    assert found["mismatch.load_ahead_m"] == -0.05
    assert found["mismatch.load_kg"] == 0.05


def test_what_acts_by_itself_is_a_part_by_itself():
    noise = ("mismatch.neighbour_velocity_window_s=0.1", "mismatch.neighbour_position_noise_m=0.01")
    assert len(words(parts("charge", *noise, "duration_s=1"))) == 2
    sides = ("mismatch.friction=0.3", "mismatch.left_friction=1.0", "duration_s=1")
    assert words(parts("charge", *sides)) == ["friction 0.3, left_friction 1"]
    assert words(parts("charge", *sides, plant="bicycle")) == []


def test_what_the_ego_believes_wrongly_of_itself_is_a_part():
    assert words(parts("charge", "belief.mass_kg=9", "duration_s=1")) == ["belief.mass_kg 9"]
    assert parts("charge", "belief.mass_kg=9").without({("axis", "belief.mass_kg")}).scenario().belief == (
        load("charge").belief
    )


SWAYS = "sway: {amplitude_m: 0.2, period_s: 3}"


@pytest.mark.parametrize(
    ("driver", "expected"),
    [
        ("{kind: gap, gap_m: 3.436}", []),
        (f"{{kind: gap, gap_m: 3.436, {SWAYS}}}", ["Vehicle 2 sways by 0.2 m, every 3 s"]),
        (
            f"{{kind: gap, gap_m: 2, {SWAYS}, moves: [{{start_s: 1, duration_s: 1, gap_m: 3}}]}}",
            [
                "Vehicle 2 goes to a gap of 3 m at 1 s, in 1 s",
                "Vehicle 2 goes to a gap of 2 m at the start",
                "Vehicle 2 sways by 0.2 m, every 3 s",
            ],
        ),
        (
            "{kind: flips, closed_gap_m: 3.4, open_gap_m: 4}",
            ["Vehicle 2 flips between gaps of 3.4 m and 4 m"],
        ),
        ("{kind: flips, closed_gap_m: 3.4, open_gap_m: 3.4}", []),
        ("{kind: steady, speed_mps: 2}", []),
        ("{kind: steady, speed_mps: 3}", ["Vehicle 2 goes to 3 m/s at the start"]),
        ("{kind: speeds, speed_mps: 3}", ["Vehicle 2 goes to 3 m/s at the start"]),
        (
            "{kind: idm, desired_speed_mps: 2, time_gap_s: 1, standstill_gap_m: 1}",
            ["Vehicle 2 drives as idm does"],
        ),
    ],
)
def test_whatever_a_neighbour_does_can_be_taken_back_and_all_of_it_is_the_scenario(driver, expected):
    scenario = load("charge", [f"drivers.vehicle_2={driver}", "duration_s=4"])
    found = parts_of(scenario, "bicycle")
    assert words(found) == expected
    assert found.scenario().drivers == scenario.drivers
    calm = found.without(set(found.names)).scenario()
    trace = simulate(calm.model_copy(update={"duration_s": 1.0}), "double_integrator")
    assert np.abs(trace.u_mps2[:, :, 2]).max() < 0.6  # nothing but its way to a gap that is within 1 % of it
    for name in found.names:
        assert found.without({name}).names == [other for other in found.names if other != name]


def test_neighbours_beyond_two_have_parts_and_a_change_that_cannot_be_left_out_is_said_so():
    third = (
        "initial.vehicle_3={front_m: [6.0, 0.0], speed_mps: 2.0}",
        "drivers.vehicle_3={kind: speeds, speed_mps: 2, changes: [{start_s: 1, rate_mps2: 1, speed_mps: 1}, "
        "{start_s: 3, rate_mps2: 1, speed_mps: 0.5}, {start_s: 3.6, rate_mps2: 1, speed_mps: 0.6}]}",
    )
    why = explain(load("charge", [*BARE, *third]), "double_integrator")
    assert why.needs == (CHARGES,)
    assert why.enough == ((CHARGES,),)
    table = rows(why)
    assert table["Vehicle 3 goes to 0.5 m/s at 3 s, at 1 m/s^2"] == "d_j falls to 0"
    assert table["Vehicle 3 goes to 1 m/s at 1 s, at 1 m/s^2"] == "cannot be run without"  # then two overlap


MINE = """
from mjmerge.drivers import Driver
class Mine(Driver):
    kind: str
    speed_mps: float
    def acceleration_mps2(self, time_s, own, leader, drawn, hold_s=0.0):
        pushes = 6.0 if 4.0 < time_s < 5.0 else 0.0
        return 2 * (self.speed_mps - own.speed_mps) + pushes
"""


@pytest.fixture
def outside(tmp_path: Path) -> Path:
    """A scenario with a driver from a file beside it, that fails."""
    folder = tmp_path / "there"
    folder.mkdir()
    (folder / "mine.py").write_text(MINE)
    text = dump(load("charge", [*BARE, "drivers.vehicle_2={kind: steady, speed_mps: 2.0}"]))
    old = "    kind: steady\n    speed_mps: 2.0\n    gain_per_s: 2.0\nmodels"
    assert old in text
    text = text.replace(old, '    kind: "mine.py:Mine"\n    speed_mps: 2.0\nmodels')
    (folder / "own.yaml").write_text(text)
    return folder / "own.yaml"


def test_a_driver_from_outside_is_taken_back_as_a_whole(outside, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words_ = (str(outside), "--plant", "double_integrator", "--json", "--workers", "1")
    code, out, _ = says(capsys, *words_)
    assert code == 1
    assert json.loads(out)["needs"] == ["Vehicle 2 drives as mine.py:Mine does"]


def planted(*keys: str) -> Scenario:
    return load("charge", [*SLIPS, *keys])


def test_a_patch_of_ice_among_harmless_mismatch_is_named_as_one():
    why = explain(planted(*PATCH, *LOAD), "mujoco")
    assert why.margin.kind == "touch"
    below = [f"mujoco, for {plant}" for plant in ("bicycle_limited", "bicycle", "double_integrator")]
    assert list(rows(why)) == [PATCHED, LOADED, CHARGES, *below]
    assert why.needs == (PATCHED, CHARGES, *below)
    assert why.enough == ((PATCHED, CHARGES),)


def test_a_patch_of_ice_that_is_planted_is_found_and_shrunk_to_itself(long: bool):
    """Long: on cars, among other mismatch, in a space over the length of the road."""
    space = (
        "search={axes: {mismatch.patch_start_m: {uniform: [0, 20]}, mismatch.load_kg: {uniform: [0, 0.2]}, "
        "mismatch.steer_lag: {uniform: [1, 1.2]}}, neighbours: {}}"
    )
    ice = ("mismatch.patch_friction=0.05", "mismatch.patch_length_m=2")
    ground = Ground.around(planted(*ice, space), "mujoco")
    assert ground.size == 3
    if not long:
        return
    small = shrink(Parts.of(planted().settled(), planted(*PATCH, *LOAD), {}), 0, "mujoco")
    assert small is not None
    assert list(small.parts.sentence()) == [PATCHED]
    found = search(ground, 64, seed=1)
    assert found.first_failure_at_run is not None
    (finding,) = differing(found, 1)
    assert set(finding.shrunk.parts.axes) == {"mismatch.patch_start_m"}
    assert 5 < finding.shrunk.parts.axes["mismatch.patch_start_m"] < 8.5
