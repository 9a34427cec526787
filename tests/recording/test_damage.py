"""Damaged recordings crash no command, take no command long, and are called right only where they are equal.

Equal in all that is shown or judged. ``pytest --long`` does it to a thousand recordings per format, and each
goes through every command.
"""

from __future__ import annotations

import resource
import shutil
import time
from pathlib import Path

import numpy as np
import pytest

from mjmerge.cli import main
from mjmerge.record.read import read
from mjmerge.review.shown import Contents, alike, contents
from mjmerge.review.verify import verify
from mjmerge.run import run
from mjmerge.scenario.load import load
from mjmerge.starts.make import make
from tests.recording.damage import DAMAGES

SHORT, LONG = {"mcap": 8, "rrd": 4}, 1000
"""Recordings per format; an .rrd takes a process more."""
PARTS = 4
"""What they are dealt out to, so that several processes can share them."""
LONGEST_S, MOST_MIB = 10.0, 1024
COMMANDS: dict[str, list[str]] = {
    "replay": ["replay", "{file}"],
    "compare": ["compare", "{file}", "{whole}", "--out", "both"],
    "convert": ["convert", "{file}", "--csv", "--out", "table.csv"],
    "recover": ["recover", "{file}", "--out", "again{suffix}"],
    "view": ["view", "{file}", "--check"],
}


@pytest.fixture(scope="module")
def originals(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Recordings of the paper's law, and of one that somebody brought and that has signals."""
    place = tmp_path_factory.mktemp("originals")
    laws = {"paper": [], "brought": [f"law.kind={make('law', 'mine', place)}:mine"]}
    for name, keys in laws.items():
        run(load("charge", ["duration_s=0.3", *keys]), "mujoco", folder=place / name)
    return [place / name for name in laws]


def busy_s() -> float:
    """What this process and those that it has ended have worked, s: others may want the processors too."""
    who = resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN
    return sum(resource.getrusage(one).ru_utime + resource.getrusage(one).ru_stime for one in who)


def peak_mib() -> float:
    """The most memory that this process, or one that it started, has had, MiB."""
    who = resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN
    return max(resource.getrusage(one).ru_maxrss / 1024 for one in who)


def equal(a: Path, b: Path) -> bool:
    """Whether two recordings are equal in all that is shown or judged."""
    one, other = read(a), read(b)
    same = one.columns.keys() == other.columns.keys() and all(
        one.columns[n].tobytes() == other.columns[n].tobytes() for n in one.columns
    )
    texts = ("scenario_yaml", "world_xml", "verdict", "summary", "said", "states", "manifest")
    return (
        same
        and all(getattr(one, name) == getattr(other, name) for name in texts)
        and _shown_alike(contents(a, one.kind), contents(b, other.kind))
    )


def _shown_alike(a: Contents, b: Contents) -> bool:
    return a.keys() == b.keys() and all(alike(a[name], b[name]) for name in a)


@pytest.mark.parametrize("part", range(PARTS))
@pytest.mark.parametrize("kind", ["mcap", "rrd"])
def test_damage_is_told_or_refused_and_nothing_else(
    originals: list[Path], tmp_path: Path, monkeypatch, capsys, kind: str, part: int, long: bool
) -> None:
    monkeypatch.chdir(tmp_path)
    file = tmp_path / f"damaged.{kind}"
    done: dict[str, int] = {}
    failures = []
    for case in range(part, LONG if long else SHORT[kind], PARTS):
        rng = np.random.default_rng([case, kind == "mcap"])
        name = list(DAMAGES)[case % len(DAMAGES)]
        source = originals[(case + case // len(DAMAGES)) % 2] / f"run.{kind}"
        DAMAGES[name](source, file, rng)
        commands = list(COMMANDS) if long else [list(COMMANDS)[case % len(COMMANDS)]]
        for command in ["verify", *commands]:
            said = COMMANDS.get(command, ["verify", "{file}", "--json"])
            arguments = [word.format(file=file, whole=source, suffix=file.suffix) for word in said]
            began, before_s, before_mib = time.monotonic(), busy_s(), peak_mib()
            with pytest.raises(SystemExit) as end:
                main(arguments)
            took_s, waited_s = busy_s() - before_s, time.monotonic() - began
            printed = capsys.readouterr()
            code = int(end.value.code or 0)
            done[f"{command} {code}"] = done.get(f"{command} {code}", 0) + 1
            where = f"case {case} ({name}), {command}"
            if code not in (0, 1, 2) or "Traceback" in printed.err or "mistake" in printed.err:
                failures.append(f"{where}: code {code}: {printed.err}")
            if code == 2 and printed.err.count("\n") != 1:
                failures.append(f"{where}: more than a line: {printed.err}")
            if took_s > LONGEST_S or waited_s > 10 * LONGEST_S:
                failures.append(f"{where}: {took_s:.1f} s of work in {waited_s:.1f} s")
            if peak_mib() - before_mib > MOST_MIB:
                failures.append(f"{where}: {peak_mib() - before_mib:.0f} MiB")
            if command == "verify" and code == 0 and not equal(source, file):
                failures.append(f"{where}: called right, and is another")
            for left in ("table.csv", f"again{file.suffix}"):
                (tmp_path / left).unlink(missing_ok=True)
            if (tmp_path / "both").exists():
                shutil.rmtree(tmp_path / "both")
    print(kind, part, done)
    assert not failures, "\n".join(failures)


def test_the_whole_ones_are_right_and_equal_to_themselves(originals: list[Path]) -> None:
    for whole in (folder / f"run.{kind}" for folder in originals for kind in ("mcap", "rrd")):
        assert verify(whole).right
        assert equal(whole, whole)
