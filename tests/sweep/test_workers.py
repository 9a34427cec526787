"""Workers: whatever dies, every row is there but those of runs that kill, and these are named."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from concurrent.futures import BrokenExecutor, Future, ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjmerge.cli import main
from mjmerge.config import doors
from mjmerge.errors import MjmergeError, WorkerError
from mjmerge.sweep import campaign, elsewhere, losses
from mjmerge.sweep.elsewhere import unlike
from mjmerge.sweep.folder import TABLE, computing
from mjmerge.sweep.shards import Shard
from mjmerge.sweep.sweep import measured, sweep
from mjmerge.sweep.workers import AGAIN, Workers, at_work

PAGE = Path(__file__).parents[2] / "docs" / "scale.md"
SMALL = {
    "scenarios": ["paper"],
    "plants": ["double_integrator"],
    "set": {"duration_s": 0.2, "control_step_s": 0.02},
    "grid": {"law.k_o": [0.5, 0.8, 1]},
    "seeds": 2,
}


TWO = {"blocks": [SMALL | {"grid": {}, "seeds": 4}, SMALL | {"grid": {}, "seeds": 2, "variants": ["gated"]}]}
"""Two shards, the first of which has a run with seed 3."""


class Death(BaseException):
    """Of whoever works: no task catches it."""


class Threads:
    """A crew like a pool of processes: who dies takes all that is under way with them."""

    shared = True

    def __init__(self, _: int = 2) -> None:
        self.renewed, self.most, self.log = 0, 0, []
        self._begin()

    def _begin(self) -> None:
        self._dead, self._under_way, self._lock = False, [], threading.Lock()

    def submit(self, task, *given):
        if self.shared and self._dead:
            raise BrokenExecutor
        future = Future()
        with self._lock:
            self._under_way.append(future)
            self.most = max(self.most, sum(not one.done() for one in self._under_way))
        threading.Thread(target=self._do, args=(future, task, given)).start()
        return future

    def _do(self, future, task, given) -> None:
        try:
            made = task(*given)
        except Death:
            with self._lock:
                self._dead = True
                for one in self._under_way if self.shared else [future]:
                    with suppress(Exception):
                        one.set_exception(BrokenExecutor() if self.shared else RuntimeError("node lost"))
        else:
            with suppress(Exception):
                future.set_result(made)

    def part(self, _):
        return 0.5

    def renew(self):
        self.renewed += 1
        self._begin()

    def close(self):
        """Nothing."""

    def stop(self):
        """Nothing."""


class Run(int):
    """A run of a plan, as far as dealing goes."""

    batch = SimpleNamespace(scenario=SimpleNamespace(ticks=10))


class Nodes(Threads):
    """A crew like a cluster: who dies is known."""

    shared = False


def swept(crew, sizes, deadly):
    """Rows, runs without one, and how often each was tried, of shards of runs some of which kill."""
    tries = dict.fromkeys(range(sum(sizes)), 0)

    def measure(cases, threads, progress):
        for case in cases:
            tries[case] += 1
        if any(deadly.get(case, 0) >= tries[case] for case in cases):
            raise Death
        return [{"is": case} for case in cases]

    shards, first = [], 0
    for number, size in enumerate(sizes):
        at = tuple(range(first, first + size))
        shards.append(Shard(number, at, tuple(map(Run, at))))
        first += size
    rows, lost, kept, seen = {}, {}, [], []

    def keep(shard, found, without):
        kept.append(shard.number)
        assert {*found, *without} == {*shard.at}
        rows.update(found)
        lost.update(without)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mjmerge.sweep.workers.measure", measure)
        team = Workers(2, crew)
        team.map(shards, keep, seen.append)
    assert sorted(kept) == list(range(len(sizes)))  # each once
    assert not seen or seen[-1] == sum(sizes)
    return rows, lost, tries, team


@given(
    st.lists(st.integers(1, 4), min_size=1, max_size=4),
    st.dictionaries(st.integers(0, 15), st.sampled_from([1, 2, 1000]), max_size=3),
    st.sampled_from([Threads, Nodes]),
)
def test_whoever_dies_of_whatever_only_the_runs_that_always_kill_have_no_row(sizes, deadly, kind):
    rows, lost, _, _ = swept(kind(), sizes, deadly)
    always = {run for run, times in deadly.items() if times == 1000 and run < sum(sizes)}
    assert {*lost} == always
    assert rows == {run: {"is": run} for run in range(sum(sizes)) if run not in always}


@pytest.mark.parametrize("kind", [Threads, Nodes])
def test_what_is_lost_is_tried_again_three_times_before_it_is_taken_apart(kind):
    _, lost, tries, team = swept(kind(), [2], {1: 1000})
    assert tries == {0: 1 + AGAIN + 1, 1: 2 * (1 + AGAIN)}
    assert lost.keys() == {1}
    assert "4 times of 4" in lost[1]
    assert ("node lost" in lost[1]) == (kind is Nodes)
    assert team.losses == 2 * (1 + AGAIN)


class Slow(Threads):
    """Who dies does so at once, while all others are still at work."""

    def _do(self, future, task, given) -> None:
        super()._do(future, lambda *of: (task(*of), time.sleep(0.02))[0], given)


def test_after_a_death_in_company_each_is_tried_alone_so_that_nobody_is_blamed_for_another():
    crew = Slow()
    _, _, tries, _ = swept(crew, [1] * 9, {4: 1000})
    assert max(times for run, times in tries.items() if run not in (4, 5)) <= 2  # 5 is simulated with it
    assert crew.renewed == 2 * (1 + AGAIN)  # both together, then it alone


def doubled(items, threads):
    if 13 in items:
        raise Death
    return [2 * item for item in items]


@pytest.mark.parametrize("kind", [Threads, Nodes])
def test_an_item_that_kills_is_an_error_that_names_it_and_others_are_made_in_their_order(kind):
    team = Workers(2, kind())
    assert team.each(doubled, range(10), str) == [2 * item for item in range(10)]
    with pytest.raises(WorkerError, match=r"4 times of 4.*: number 13"):
        team.each(doubled, range(8, 20), "number {}".format)


class OddError(Exception):
    """No pickle brings it back."""

    def __init__(self, one, other) -> None:
        super().__init__(one)
        self.other = threading.Lock() if other else None


def refuses(kind, items, threads):
    raise (OddError(f"{kind} way", kind == "this") if kind != "that" else KeyError("that way"))


@pytest.mark.parametrize(
    ("kind", "comes"), [("that", KeyError), ("this", RuntimeError), ("no", RuntimeError)]
)
def test_what_a_task_raises_is_no_loss_and_brings_the_place_where_it_was_raised(kind, comes):
    team = Workers(2, Threads())
    with pytest.raises(comes, match=f"{kind} way") as raised:
        team.each(partial(refuses, kind), range(10))
    assert type(raised.value) is comes
    assert "in refuses" in raised.value.__notes__[0]
    assert team.losses == 0


def test_any_executor_gives_the_table_of_one_process_and_stays_its_owners(tmp_path):
    plan = campaign.plan({"blocks": [SMALL]})
    alone = sweep(plan, tmp_path / "a")
    with ThreadPoolExecutor(2) as executor:
        with at_work(Workers.on(executor, 2)) as team:
            sweep(plan, tmp_path / "b", team=team)
            assert measured(plan, team).equals(alone)
        assert executor.submit(int).result() == 0
    assert (tmp_path / "b" / TABLE).read_bytes() == (tmp_path / "a" / TABLE).read_bytes()


def test_an_executor_that_breaks_ends_the_work_with_a_word_on_what_is_kept():
    class Broken(ThreadPoolExecutor):
        def submit(self, *_):
            raise BrokenExecutor

    with Broken(1) as executor, pytest.raises(WorkerError, match="what is finished is kept"):
        Workers.on(executor, 2).each(print, [1, 2])


def test_the_page_s_example_gives_the_table_of_one_process(tmp_path):
    (example,) = PAGE.read_text().split("```python\n")[1:]
    example = example.partition("```")[0].replace("mismatch_core", "c.yaml").replace("8)", "2)")
    (tmp_path / "c.yaml").write_text(json.dumps(TWO))
    (tmp_path / "mine.py").write_text(example)
    subprocess.run([sys.executable, "mine.py"], cwd=tmp_path, check=True)
    sweep(campaign.plan(tmp_path / "c.yaml"), tmp_path / "alone")
    assert (tmp_path / "core" / TABLE).read_bytes() == (tmp_path / "alone" / TABLE).read_bytes()


class Later:
    """What a job scheduler's executor gives: it can be asked, and that is all."""

    def __init__(self, made) -> None:
        self._made, self._asked = made, 0

    def done(self) -> bool:
        self._asked += 1
        return self._asked > 2

    def result(self):
        assert self._asked > 2
        return self._made


def test_an_executor_may_give_anything_that_can_be_asked_whether_it_is_done():
    class Jobs:
        def submit(self, task, *given):
            return Later(task(*given))

    team = Workers.on(Jobs(), 2)
    assert team.each(doubled, range(5)) == [0, 2, 4, 6, 8]


class Backwards:
    """Nothing is done before so many tasks are there, and then the last one first."""

    def __init__(self, many: int) -> None:
        self._many, self._tasks = many, []

    def submit(self, task, *given):
        future = Future()
        self._tasks.append((future, task, given))
        if len(self._tasks) == self._many:
            for one, other, of in reversed(self._tasks):
                one.set_result(other(*of))
            self._tasks, self._many = [], 1
        return future


@pytest.mark.parametrize("count", [1, 2, 5])
def test_in_whatever_order_results_come_each_is_that_of_its_item(count):
    items = range(14, 14 + 128)
    team = Workers.on(Backwards(min(count + 1, 2)), count)
    assert team.each(doubled, items) == [2 * item for item in items]


def test_a_campaign_of_one_run_and_no_work_at_all_need_no_second_worker(tmp_path):
    one = campaign.plan({"blocks": [SMALL | {"grid": {}, "seeds": 1}]})
    alone = sweep(one, tmp_path / "a")
    with ThreadPoolExecutor(1) as executor:
        team = Workers.on(executor, 1)
        assert measured(one, team).equals(alone)
        assert measured(one, Workers(9)).equals(alone)
        assert team.each(doubled, []) == []
    team.map([], None, print)


def test_futures_that_somebody_cancels_are_work_that_is_lost_and_is_done_again():
    class Cancels(ThreadPoolExecutor):
        left = 3

        def submit(self, task, *given):
            if not self.left:
                return super().submit(task, *given)
            self.left -= 1
            future = Future()
            future.cancel()
            future.set_running_or_notify_cancel()
            return future

    with Cancels(1) as executor:
        team = Workers.on(executor, 2)
        assert team.each(doubled, range(6)) == [0, 2, 4, 6, 8, 10]
        assert team.losses == 3
        executor.left = 1000
        with pytest.raises(WorkerError, match=r"4 times of 4 \(CancelledError\): 0$"):
            team.each(doubled, [0])


def test_what_an_executor_itself_raises_ends_the_work():
    with ThreadPoolExecutor(1) as executor:
        executor.shutdown()
        with pytest.raises(RuntimeError, match="after shutdown"):
            Workers.on(executor, 2).each(doubled, range(6))
    with pytest.raises(MjmergeError, match="there are 0 workers; there must be at least 1"):
        Workers.on(executor, 0)


@pytest.mark.parametrize("other", ["mjmerge's code", "versions"])
def test_where_the_code_or_a_version_is_another_nothing_is_done(other, monkeypatch):
    here = computing()
    there = here | {other: "edited" if other != "versions" else here["versions"] | {"numpy": "1.0"}}
    sent = elsewhere.sent
    monkeypatch.setattr("mjmerge.sweep.workers.sent", lambda *task: (there, *sent(*task)[1:]))
    with ThreadPoolExecutor(1) as executor:
        for team in (Workers(2, Threads()), Workers.on(executor, 2)):
            with pytest.raises(MjmergeError, match=r"node \S+ would compute other rows: ") as raised:
                team.each(doubled, [13] * 10)  # which would kill
            assert ("numpy" if other == "versions" else "another mjmerge's code") in str(raised.value)
            assert team.losses == 0


def test_code_from_outside_is_what_the_command_read_whatever_became_of_the_file(tmp_path, monkeypatch):
    monkeypatch.setattr(doors, "_carried", {})
    (tmp_path / "mine.py").write_text("def made():\n    return 1\n")
    made = doors.resolve(f"{tmp_path / 'mine.py'}:made")
    sent = elsewhere.sent(made)
    (tmp_path / "mine.py").unlink()
    assert doors.let_in()[str(tmp_path / "mine.py")] == "def made():\n    return 1\n"
    del sys.modules[made.__module__]  # as in another process
    assert elsewhere.do(*sent) == 1


def test_a_task_that_cannot_be_read_there_is_told():
    found = elsewhere.do(computing(), {}, b"no pickle")
    assert "a worker cannot read its task: UnpicklingError" in str(found.error)


def test_a_node_that_computes_with_something_else_is_named_with_all_that_differs():
    here = computing()
    assert unlike("a", here, here) == []
    other = {**here["versions"], "numpy": "1.0"}
    other.pop("mujoco")
    (said,) = unlike(
        "10.0.0.2", here, here | {"versions": other, "mjmerge's code": "0", "kind of machine": "z80"}
    )
    assert said.startswith("node 10.0.0.2 would compute other rows: ")
    assert f"numpy 1.0 (here {here['versions']['numpy']})" in said
    assert "mujoco is missing" in said
    assert "another mjmerge's code, another kind of machine" in said
    assert "scipy" not in said


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--engine", "ray"), "the engine ray needs Ray: pip install 'mjmerge[ray]'"),
        (("--address", "auto"), "--address and --cpus are for --engine ray"),
        (("--cpus", "2"), "--address and --cpus are for --engine ray"),
        (("--engine", "ray", "--cpus", "0"), "--cpus is 0; it must be at least 1"),
    ],
)
@pytest.mark.parametrize("command", ["sweep c.yaml", "falsify paper", "probability paper", "harden paper"])
def test_an_engine_that_is_not_there_or_not_asked_for_is_told_in_a_line(
    command, words, said, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    Path("c.yaml").write_text(json.dumps(TWO))
    monkeypatch.setitem(sys.modules, "ray", None)  # what an import of something absent comes to
    with pytest.raises(SystemExit) as stop:
        main([*command.split(), *words])
    out, err = capsys.readouterr()
    assert (stop.value.code, out, err) == (2, "", f"mjmerge: {said}\n")
    assert [path.name for path in tmp_path.iterdir()] == ["c.yaml"]


def killing(monkeypatch, run):
    """From now on a run kills whoever works on it, in a crew of threads in place of processes."""
    from mjmerge.sweep import workers

    measure = workers.measure

    def deadly(cases, threads, progress=None):
        if run in [case.seed for case in cases]:
            raise Death
        return measure(cases, threads, progress)

    monkeypatch.setattr(workers, "measure", deadly)
    monkeypatch.setattr(workers, "Processes", Threads)


def test_a_run_that_kills_is_named_its_row_is_missing_and_it_is_tried_again_later(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    Path("c.yaml").write_text(json.dumps(TWO))
    plan = campaign.plan("c.yaml")
    with monkeypatch.context() as patch:
        killing(patch, 3)
        with pytest.raises(SystemExit) as stop:
            main(["sweep", "c.yaml", "--workers", "2", "--out", "out", "--json"])
        with pytest.raises(WorkerError, match=r"no row of run 3 .*seed 3"):
            measured(plan, Workers(2))
    out, err = capsys.readouterr()
    assert stop.value.code == 3
    (lost,) = json.loads(out)["lost"]
    assert lost["run"] == lost["seed"] == 3
    assert lost["command"].startswith("mjmerge run paper --plant double_integrator --seed 3 --set ")
    assert "1 of 6 runs kill the worker" in err
    table = pq.read_table("out/table.parquet")
    assert table["run"].to_pylist() == [0, 1, 2, 4, 5]
    assert losses.lost_of(table).keys() == {3}
    assert "no row of run 3 (paper on double_integrator" in Path("out/report.md").read_text()

    found = sweep(plan, tmp_path / "out", team=Workers(2, Threads()))
    assert losses.lost_of(found) == {}
    sweep(plan, tmp_path / "undisturbed")
    assert Path("out/table.parquet").read_bytes() == Path("undisturbed/table.parquet").read_bytes()


def test_only_what_killed_is_tried_again_and_never_by_the_command_itself(tmp_path, monkeypatch):
    plan = campaign.plan(TWO)
    with monkeypatch.context() as patch:
        killing(patch, 3)
        sweep(plan, tmp_path / "out", processes=2)
        done = []
        patch.setattr("mjmerge.sweep.workers.measure", lambda cases, *_: done.append(cases) or [])
        patch.setattr(Threads, "_do", lambda _, future, *__: future.set_exception(OSError("gone")))
        found = sweep(plan, tmp_path / "out", processes=1)
    assert done == []
    assert losses.lost_of(found) == {3: "4 times of 4 (OSError: gone)"}
    assert found["run"].to_pylist() == [0, 1, 2, 4, 5]


def test_where_every_run_kills_there_is_no_table(tmp_path, monkeypatch):
    killing(monkeypatch, 0)
    plan = campaign.plan({"blocks": [SMALL | {"seeds": 1}]})
    with pytest.raises(WorkerError, match=r"no row of run 0(.*\n)*.*no row of run 2"):
        sweep(plan, tmp_path / "out", processes=2)
    assert not (tmp_path / "out" / TABLE).exists()


DEADLY = """
import os, pathlib, signal
def deadly_m(trace):
    "Kills its process with seed 3, at the first time or always, m."
    if 3 in trace.seeds and not pathlib.Path("died").exists():
        pathlib.Path("DIED").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return trace.distance_m[:, 0, 0]
"""


def test_a_process_that_is_killed_costs_nothing_but_time(tmp_path, monkeypatch, long):
    monkeypatch.chdir(tmp_path)
    (first, second) = TWO["blocks"]
    plan = {"blocks": [first | {"set": first["set"] | {"metrics": ["mine.py:deadly_m"]}}, second]}
    Path("mine.py").write_text(DEADLY.replace("DIED", "died"))
    with at_work(Workers(2)) as team:
        sweep(campaign.plan(plan), tmp_path / "killed", team=team)
    assert Path("died").exists()
    assert 1 <= team.losses <= 2
    sweep(campaign.plan(plan), tmp_path / "undisturbed")
    assert (tmp_path / "killed" / TABLE).read_bytes() == (tmp_path / "undisturbed" / TABLE).read_bytes()
    if long:
        Path("died").unlink()
        Path("mine.py").write_text(DEADLY.replace("DIED", "dying"))
        found = sweep(campaign.plan(plan), tmp_path / "always", processes=2)
        assert losses.lost_of(found) == {3: "4 times of 4"}
        assert found["run"].to_pylist() == [0, 1, 2, 4, 5]
