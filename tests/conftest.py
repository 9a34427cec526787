"""What all tests share: no graphics, repeatable properties, and small scenarios and traces."""

import os
import signal
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

if "PYTEST_XDIST_WORKER" in os.environ:  # which is measured by now; what it starts is not
    os.environ.pop("COVERAGE_PROCESS_START", None)
os.environ.setdefault("MUJOCO_GL", "disable")  # before anything imports mujoco
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # or every command that a test starts compiles it all again
in_main = threading.current_thread() is threading.main_thread()
if in_main and signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # started in the background:
    signal.signal(signal.SIGINT, signal.default_int_handler)  # commands would inherit that

settings.register_profile("mjmerge", deadline=None, derandomize=True, max_examples=60)
settings.load_profile("mjmerge")


COUNTED = (
    "config/",
    "drivers/test_outside.py",
    "drivers/test_recorded.py",
    "envs/",
    "figures/",
    "interfaces/test_completion.py",
    "law/test_choice.py",
    "law/test_mpc.py",
    "merges/",
    "notebook/test_looks.py",
    "plant/test_tyre.py",
    "recording/test_folder.py",
    "recording/test_tools.py",
    "scenario/test_axes.py",
    "scenario/test_distinct.py",
    "scenario/test_effect.py",
    "scenario/test_ramp.py",
    "scenario/test_sizes.py",
    "search/test_explain.py",
    "search/test_falsify.py",
    "search/test_harden.py",
    "search/test_ladder.py",
    "search/test_probability.py",
    "search/test_shrink.py",
    "sweep/test_fidelity.py",
    "sweep/test_parts.py",
    "sweep/test_workers.py",
    "world/test_contained.py",
    "world/test_models.py",
)
"""Tests that count the lines that they run, if any do, by the start of their place. Counting makes them 1.4
times as long: these go through almost all that any tests of their rooms do, in half the time of those."""
_counter = sys.modules["coverage"].Coverage.current() if "coverage" in sys.modules else None
_counts = _counter is not None


def pytest_runtest_logstart(nodeid: str) -> None:
    """Stops counting lines, and starts again, from test to test."""
    global _counts
    wanted = nodeid.startswith(tuple(f"tests/{place}" for place in COUNTED))
    if _counter is not None and wanted != _counts:
        (_counter.start if wanted else _counter.stop)()
        _counts = wanted


_OWN = {
    "law": "{kind: 'mine.py:law'}",
    "driver": "{kind: 'mine.py:Mine', speed_mps: 2}",
    "metric": "mine.py:headway_s",
    "car": "./mine",
}


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--long", action="store_true", help="the long versions of tests that have one")
    parser.addoption("--write", action="store_true", help="write what follows from the code")
    for what, example in _OWN.items():
        said = f"run the tests of every {what} over this one, such as {example}"
        parser.addoption(f"--{what}", action="append", default=[], metavar="ONE", help=said)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Tests on a cluster are long ones, and are none where there is no Ray."""
    there = config.getoption("--long") and find_spec("ray") is not None
    return True if collection_path.name == "test_ray.py" and not there else None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Of tests that are ``thinned``, some of their cases; with ``--long`` all."""
    if config.getoption("--long"):
        return
    left, before = [], Counter[str]()
    for item in items:
        thinned, test = item.get_closest_marker("thinned"), item.nodeid.partition("[")[0]
        if thinned is not None and before[test] % thinned.args[0]:
            left.append(item)
        before[test] += 1
    config.hook.pytest_deselected(items=left)
    items[:] = [item for item in items if item not in {*left}]


@pytest.fixture(scope="session", autouse=True)
def _tried_once() -> Iterator[None]:
    """Whether Rerun's reader survives a file is tried, in a process, once for each content."""
    room, known = sys.modules.get("mjmerge.record.read"), {}
    with pytest.MonkeyPatch.context() as patch:
        if room is not None:  # a test imports it
            survives = room.survives

            def once(path: Path) -> bool:
                content = sha256(path.read_bytes()).digest()
                if content not in known:
                    known[content] = survives(path)
                return known[content]

            patch.setattr(room, "survives", once)
        yield


@pytest.fixture
def long(request: pytest.FixtureRequest) -> bool:
    """Whether the long version of a test is asked for, with ``pytest --long``."""
    return bool(request.config.getoption("--long"))


@pytest.fixture
def written(request: pytest.FixtureRequest) -> Callable[[Path, str], None]:
    """Compares a committed file with what the code makes of it; ``pytest --write`` writes it instead."""

    def compare(path: Path, text: str) -> None:
        if request.config.getoption("--write"):
            path.write_text(text, encoding="utf-8", newline="")
        same = path.read_text(encoding="utf-8") == text
        assert same, f"{path.name} is not what the code says: `pytest --write {request.node.nodeid}`"

    return compare


@pytest.fixture
def make_trace() -> Callable:
    """Builds a trace from a few columns, (N, T, ...); the others are NaN."""
    from mjmerge.roster import roster
    from mjmerge.scenario.cars import believed_sheets
    from mjmerge.scenario.load import load
    from mjmerge.simulation.trace import COLUMNS, Trace

    def build(ticks=40, runs=1, overrides=(), plant="mujoco", stops=(), continuous=False, **given):
        scenario = load("paper", ["control_step_s=0.01", *overrides])
        columns = {c.name: np.full((runs, ticks, *c.shape(roster())), np.nan) for c in COLUMNS}
        for name, value in given.items():
            columns[name][:] = value
        return Trace(
            scenario=scenario,
            plant=plant,
            seeds=np.arange(runs),
            sheets=tuple(believed_sheets(scenario)),
            mismatch=(scenario.mismatch,) * runs,
            stops=tuple(stops),
            continuous=continuous,
            time_s=np.arange(ticks) * 0.01,
            **columns,
        )

    return build
