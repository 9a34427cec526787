"""Nothing that a user can write or type is answered by a traceback, by waiting, or by taking all the memory.

The cases run in a process of their own, so that what they take is theirs. ``--long`` tries 5,000.
"""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
from pathlib import Path

import pytest

import mjmerge
from mjmerge.cli import main

from . import code
from .cases import KINDS, MOST_BYTES, MOST_S, trouble

ROOTS = (Path(mjmerge.__file__).parents[1], Path(__file__).parents[2])
SHORT, LONG = 10, 834  # of each of seven kinds


@pytest.mark.parametrize("kind", KINDS)
def test_no_input_is_answered_by_a_traceback_by_waiting_or_by_taking_all_memory(kind, tmp_path, long):
    place, answer = tmp_path / "place", tmp_path / "answer.json"
    place.mkdir()
    count = LONG if long else SHORT
    ended = subprocess.run(
        [sys.executable, "-W", "default", "-m", "tests.fuzz.cases", kind, "0", str(count), str(answer)],
        cwd=place,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([*map(str, ROOTS), *sys.path])},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=60 + count * MOST_S,
    )
    assert ended.returncode == 0, ended.stderr
    bad = json.loads(answer.read_text())
    assert not bad, "\n\n".join(bad)


@pytest.mark.parametrize("what", code.KINDS)
def test_code_that_nobody_changed_is_let_in(what, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    text, words = code.begun(what, random.Random(0))
    Path("mine.py").write_text(text)
    with pytest.raises(SystemExit) as end:
        main(["run", "charge", *words, "--plant", "bicycle", "--duration", "0.05", "--no-record"])
    assert end.value.code in (0, 1), capsys.readouterr().err


def takes(n_bytes: int) -> None:
    """Has memory for a moment, and ends well."""
    assert len(b"x" * n_bytes) == n_bytes
    raise SystemExit(0)


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="needs a peak that can be forgotten")
def test_what_a_command_takes_is_its_own_and_too_much_is_found_whatever_ran_before():
    too_much = MOST_BYTES + MOST_BYTES // 8
    with pytest.raises(SystemExit):
        takes(too_much)
    assert not trouble([], lambda _: takes(MOST_BYTES // 2))
    assert trouble([], lambda _: takes(too_much)) == "took 1.2 GB"
    assert not trouble([], lambda _: takes(MOST_BYTES // 2))
