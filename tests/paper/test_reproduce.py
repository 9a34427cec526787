"""The paper's Section 4 over again: every fact can fail, and every file says what the traces say."""

from __future__ import annotations

import csv
import doctest
import io
import re
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mjmerge.cli import main
from mjmerge.figures.animation import EVERY_S, SHOWN_S, animate, ticks
from mjmerge.figures.runs import distances
from mjmerge.law import VARIANTS, OpinionDynamics
from mjmerge.law.opinion_dynamics import law
from mjmerge.paper import facts, reproduce
from mjmerge.paper.bifurcation import branches, converging
from mjmerge.scenario.load import load
from mjmerge.simulation.loop import simulate
from mjmerge.simulation.trace import Stop

CLAIMS = [fact.claim for fact in facts.FACTS]
STEP_S = 0.1
PAGE = Path(__file__).parents[2] / "docs" / "paper.md"


@pytest.fixture(scope="module")
def published():
    """The published run in full, ideal and on MuJoCo, each with and without the barrier."""
    return reproduce.runs(load("paper"), lambda _: None)


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """The start of it reproduced through the command line: its folder, exit code, and what it printed."""
    folder, out, err = tmp_path_factory.mktemp("short"), io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(reproduce, "load", lambda name: load(name, ["duration_s=1.5"]))
        with pytest.raises(SystemExit) as stop:
            main(["reproduce", "--out", str(folder)])
    return folder, stop.value.code, out.getvalue(), err.getvalue()


@pytest.fixture
def folder(short):
    return short[0]


def call(capsys, *args):
    with pytest.raises(SystemExit) as stop:
        main(["reproduce", *map(str, args)])
    out, err = capsys.readouterr()
    return stop.value.code, out, err


def table(path):
    """A CSV's columns."""
    with path.open(newline="") as file:
        header, *rows = csv.reader(file)
    return dict(zip(header, np.array(rows, dtype=float).T, strict=True))


@pytest.fixture
def pair(make_trace):
    """A hand-made pair of which every fact holds; any column of either run may be changed."""
    t = np.arange(351) * STEP_S
    z = np.interp(t, [0, 8, 15, 18], [0.15, 1e-4, 1e-4, 0.19])
    y = np.interp(t, [0, 5, 15, 30], [1.4, 0.6, 1.1, 0.0])
    front = np.zeros((len(t), 3, 2))
    front[:, :, 0] = -1.2, 0.0, -2.4
    front[:, 0, 1] = y
    velocity = np.zeros_like(front)
    velocity[:, 0, 1] = np.gradient(y, t)
    u = np.zeros_like(front)
    u[:, 2, 0] = 0.1 * np.sin(t)
    d = np.column_stack(
        [np.interp(t, [0, 7, 35], [1.5, 0.5, 0.6]), np.interp(t, [0, 7, 35], [0.9, 0.1, 0.5])]
    )
    given = {
        "opinion": z,
        "weight": np.tanh(40 * z),
        "front_m": front,
        "velocity_mps": velocity,
        "heading_rad": 0.0,
        "u_mps2": u,
        "distance_m": d,
    }

    def build(barrier=None, no_barrier=None, **more):
        def run(changes):
            overrides = [f"control_step_s={STEP_S}", "physics_step_s=0.01"]
            trace = make_trace(ticks=len(t), overrides=overrides, **{**given, **(changes or {})}, **more)
            return replace(trace, time_s=t)

        low = np.column_stack([d[:, 0], np.interp(t, [0, 6, 7, 9, 35], [0.9, 0.05, -0.2, 0.1, 0.5])])
        return facts.Pair(run(barrier), run({"distance_m": low, **(no_barrier or {})}))

    build.time_s, build.given = t, given
    return build


def broken(pair):
    """Claims that a pair does not reproduce."""
    return {c for c, f in zip(CLAIMS, facts.read(pair), strict=True) if f.holds is False}


def changed(values, t, at_s, value):
    values = values.copy()
    values[t >= at_s] = value
    return values


def test_a_pair_that_shows_all_facts_reproduces_all_but_the_axis(pair):
    found = facts.read(pair())
    assert [f.word for f in found] == ["yes"] * 11 + ["axis only"]
    assert "0.100 m" in found[6].number


def mutations(t, given):
    """For each fact a change that breaks it: its claim's start, run, column and new values."""
    z, front, d, u = given["opinion"], given["front_m"], given["distance_m"], given["u_mps2"]
    zigzag = front.copy()
    zigzag[:, 0, 1] += 0.05 * np.sin(3 * t)
    behind = front.copy()
    behind[:, 0, 0] -= 3
    jump = given["velocity_mps"].copy()
    jump[50, 0, 1] += 1.0
    over = front.copy()
    over[:, 0, 1] -= 0.2 * (t > 30)
    early = front.copy()
    early[:, 0, 1] = np.interp(t, [0, 5, 15, 16, 17], [1.4, 0.6, 1.1, 0.5, 0.0])
    deep = np.column_stack([d[:, 0], np.interp(t, [0, 6, 7, 9, 35], [0.9, 0.05, -0.6, 0.1, 0.5])])
    late = np.column_stack([d[:, 0], np.where(t > 12, -0.1, 0.2)])
    wide = d.copy()
    wide[0] = 1.1
    return [
        ("z stays", "barrier", {"opinion": changed(z, t, 30, 0.21)}),
        ("z stays", "barrier", {"opinion": changed(z, t, 9, -1e-9)}),
        ("t < 10 s: z", "barrier", {"opinion": np.maximum(z, 0.01)}),
        ("t < 10 s: z", "barrier", {"opinion": np.where(t < 5, 0.2, 1e-4)}),
        ("t < 10 s: Vehicle 2", "barrier", {"u_mps2": np.abs(u)}),
        ("t < 10 s: Vehicle 2", "barrier", {"u_mps2": 0 * u}),
        ("after t = 20", "barrier", {"front_m": early}),
        ("after t = 20", "barrier", {"front_m": behind}),
        ("the lateral position", "barrier", {"front_m": zigzag}),
        ("the lateral position", "barrier", {"velocity_mps": jump}),
        ("the lateral position", "barrier", {"front_m": over}),
        ("d_1 stays", "barrier", {"distance_m": d - (0.5, 0)}),
        ("d_2 stays", "barrier", {"distance_m": d - (0, 0.1)}),
        ("d_1 goes", "barrier", {"distance_m": d - (-0.1, 0)}),
        ("d_2 stays in", "barrier", {"distance_m": wide}),
        ("k_o = 0: d_2", "no_barrier", {"distance_m": d}),
        ("k_o = 0: d_2", "no_barrier", {"distance_m": late}),
        ("k_o = 0: the lowest", "no_barrier", {"distance_m": deep}),
    ]


def test_every_fact_can_fail(pair):
    cases = mutations(pair.time_s, pair.given)
    for start, run, columns in cases:
        assert any(c.startswith(start) for c in broken(pair(**{run: columns}))), (start, list(columns))
    starts = tuple(start for start, _, _ in cases)
    assert [c for c in CLAIMS if not c.startswith(starts)] == [CLAIMS[-1]]


def test_a_run_without_data_reproduces_nothing(pair):
    given = pair.given
    nothing = {name: np.full_like(values, np.nan) for name, values in given.items()}
    assert broken(pair(barrier=nothing, no_barrier=nothing)) == set(CLAIMS[:-1])


def test_a_run_that_ended_early_reproduces_nothing_and_says_why(pair):
    found = facts.read(pair(stops=[Stop(0, 3.0, "ego", "fell apart")]))
    assert {f.holds for f in found} == {False}
    assert "fell apart" in found[0].number


@pytest.mark.parametrize(
    ("lateral_m", "count"),
    [([0, 1, 2], 0), ([2, 1, 0, 1], 1), ([0, 1, 0, 1, 0], 3), ([0, 1, 0.999, 2], 0), ([1, 1, 1], 0)],
)
def test_turns_counts_swings_and_not_noise(lateral_m, count):
    assert facts.turns(np.array(lateral_m, float)) == count


def test_all_published_facts_are_reproduced_ideal_and_on_mujoco(published):
    for plant, one in published.items():
        assert broken(one) == set(), plant
        assert one.no_barrier.scenario.law == one.barrier.scenario.law.model_copy(update={"k_o": 0.0})
        for key in ("initial", "drivers", "models", "mismatch", "duration_s"):
            assert getattr(one.no_barrier.scenario, key) == getattr(one.barrier.scenario, key)


def test_a_run_without_the_barrier_is_told_from_the_published_one():
    without = simulate(load("paper", ["law.k_o=0", "control_step_s=0.02"]), "double_integrator")
    assert broken(facts.Pair(without, without)) == {"d_2 stays positive", "d_2 stays in 0 to 1"}


def test_a_weak_barrier_is_told_from_none():
    weak = simulate(load("paper", ["law.k_o=0.1", "control_step_s=0.02"]), "double_integrator")
    assert {c for c in broken(facts.Pair(weak, weak)) if "k_o = 0" in c} == set(CLAIMS[9:11])


def test_stability_is_that_of_the_papers_lemma():
    law = load("paper").law
    mu = np.linspace(-0.2, 0.2, 41)
    mu = mu[np.abs(mu) > 1e-9]
    found = branches(law, mu)
    assert np.array_equal(found.stable, np.stack([mu < 0, mu > 0], axis=1))
    assert found.slope_per_s == pytest.approx(np.stack([mu, -mu], axis=1) / law.eps, abs=1e-9)


def test_the_laws_own_steps_converge_on_the_stable_branch():
    law = load("paper").law
    mu, z_0 = np.array([-0.1, 0.05, 0.15]), np.array([0.01, 0.3])
    t = np.linspace(0, 20, 201)
    z = converging(law, mu, z_0, t)
    assert z.shape == (201, 3, 2)
    assert np.array_equal(z[0], np.broadcast_to(z_0, (3, 2)))
    assert z[-1] == pytest.approx(np.maximum(mu, 0)[:, None] * np.ones(2), abs=1e-6)
    closed = mu[1] / (1 + (mu[1] / z_0 - 1) * np.exp(-mu[1] * t[:, None] / law.eps))
    assert z[:, 1] == pytest.approx(closed, rel=1e-9)


def test_the_csvs_are_what_the_figures_draw_to_the_last_bit(published, tmp_path):
    ideal, real = published["ideal"].barrier, published["mujoco"].barrier
    for name, columns, trace in (
        ("opinion", reproduce.opinion_columns, ideal),
        ("distances", reproduce.distance_columns, published["ideal"].no_barrier),
    ):
        path = tmp_path / f"{name}.csv"
        reproduce.save_columns(columns(trace), path)
        for header, values in columns(trace).items():
            assert np.array_equal(table(path)[header], values)
    both = reproduce._beside(reproduce.opinion_columns, real, ideal)
    assert list(both) == ["time_s", "ideal_z", "ideal_ego_lateral_m", "mujoco_z", "mujoco_ego_lateral_m"]
    assert both["mujoco_ego_lateral_m"] is not None
    assert np.array_equal(both["ideal_z"], ideal.opinion[0])
    assert np.array_equal(both["mujoco_z"], real.opinion[0])


def test_a_reproduction_writes_everything_and_ends_with_1_where_a_fact_fails(short):
    folder, code, out, err = short
    assert code == 1  # nobody merges within 1.5 s
    assert not err
    assert {p.name for p in folder.iterdir()} == set(reproduce.FILES)
    assert "published" in out
    assert "not merged" in " ".join(out.split())
    with (folder / "facts.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["published"] for row in rows] == CLAIMS
    assert rows[3]["ideal"] == rows[3]["mujoco"] == "no"
    assert rows[0]["ideal"] == "yes"
    assert rows[-1]["mujoco"] == "axis only"
    assert (folder / "facts.md").read_text().count("\n") == len(CLAIMS) + 2


def test_every_csv_says_its_units(folder):
    pure = {"z", "mu", "z_a", "z_b", "z_start"}
    for path in folder.glob("*.csv"):
        if path.name == "facts.csv":
            continue
        for header in table(path):
            name = header.removeprefix("ideal_").removeprefix("mujoco_")
            assert name in pure or name.endswith(("_s", "_m", "_per_s")), (path.name, header)
    assert table(folder / "opinion.csv")["time_s"][-1] == 1.5


def test_the_film_opens_with_all_its_frames(folder):
    trace = simulate(load("paper", ["duration_s=1.5"]), "double_integrator")
    assert ticks(trace) == [*range(0, 150, round(EVERY_S / 0.01)), 150]
    with Image.open(folder / "merge.gif") as film:
        assert film.n_frames == len(ticks(trace)) == 9
        assert film.info["duration"] == 1e3 * SHOWN_S
        first = np.asarray(film.convert("RGB")).astype(int)
        film.seek(8)
        assert np.abs(np.asarray(film.convert("RGB")) - first).max() > 50


def test_the_same_traces_give_the_same_bytes(folder, tmp_path):
    scenario = load("paper", ["duration_s=1.5"])
    ideal, real = simulate(scenario, "double_integrator", continuous=True), simulate(scenario, "mujoco")
    columns = reproduce._beside(reproduce.distance_columns, real, ideal)
    reproduce._save(tmp_path / "distances_mujoco", distances(real, ideal), columns)
    animate(real, tmp_path / "merge.gif")
    names = ["distances_mujoco.png", "distances_mujoco.pdf", "distances_mujoco.csv", "merge.gif"]
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(names)
    for name in names:
        assert (folder / name).read_bytes() == (tmp_path / name).read_bytes(), name


def test_what_a_folder_holds_is_not_overwritten(capsys, folder, tmp_path, monkeypatch):
    code, out, err = call(capsys, "--out", folder)
    assert (code, out) == (2, "")
    assert "--out" in err
    monkeypatch.chdir(tmp_path)
    (tmp_path / "reproduced").mkdir()
    (tmp_path / "reproduced" / "notes.txt").write_text("keep me")
    code, _, err = call(capsys)
    assert code == 2
    assert "notes.txt" in err


def test_an_earlier_reproduction_in_the_default_folder_makes_way(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "reproduced").mkdir()
    (tmp_path / "reproduced" / "facts.md").write_text("old")

    def nothing(folder, *_):
        assert not list(folder.iterdir())

    monkeypatch.setattr(reproduce, "runs", lambda *_: {})
    monkeypatch.setattr(reproduce, "write", nothing)
    code, out, _ = call(capsys)
    assert code == 0  # nothing was asked, so nothing failed
    assert "replaced" in out


def test_the_commands_are_even_in_g_j(monkeypatch):
    """The text has g_j point from the ego to the neighbour, the formula the other way: it does not matter."""
    given = law.geometry
    scenario = load("paper", ["control_step_s=0.02"])
    one = simulate(scenario, "double_integrator")

    def turned(*of):
        seen = given(*of)
        return replace(seen, g=-seen.g, d_dot=-seen.d_dot)

    monkeypatch.setattr(law, "geometry", turned)
    other = simulate(scenario, "double_integrator")
    assert np.array_equal(one.u_mps2, other.u_mps2)
    assert np.array_equal(one.opinion, other.opinion)
    assert np.array_equal(one.front_m, other.front_m)
    assert np.array_equal(one.sensed_distance_rate_mps, -other.sensed_distance_rate_mps)
    assert np.abs(one.sensed_distance_rate_mps).max() > 0.1


def test_the_page_on_the_paper_leaves_nothing_out_and_shows_what_there_is():
    page = PAGE.read_text()
    for name in VARIANTS:
        assert f"| `{name}` |" in page
    for key in OpinionDynamics.model_fields:
        assert f"`law.{key}`" in page
    for fact in facts.FACTS:
        assert f"| {fact.claim} | yes" in page or f"| {fact.claim} | axis only" in page
    links = re.findall(r"\]\(([^)#]+)\)", page)
    assert [link for link in links if not (PAGE.parent / link).exists()] == []
    shown = {PAGE.parent / link for link in links if link.startswith("figures/")}
    assert shown == set((PAGE.parent / "figures").iterdir())
    for path in shown:
        assert path.stat().st_size < (3e6 if path.suffix == ".gif" else 150e3), path


def test_the_examples_on_that_page_are_true():
    names: dict = {}
    for i, code in enumerate(re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)):
        example = doctest.DocTestParser().get_doctest(code, names, f"example {i}", str(PAGE), 0)
        runner = doctest.DocTestRunner()
        runner.run(example, clear_globs=False)
        names = example.globs
        assert runner.summarize().failed == 0
        assert runner.summarize().attempted > 0
