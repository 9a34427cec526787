"""Every way to end is an exit code: 1 is a verdict and nothing else, and nobody ever sees a traceback."""

from __future__ import annotations

import errno
import gc
import os
import pickle
import resource
import signal
import subprocess
import sys
import time
import weakref
from pathlib import Path

import pytest

import mjmerge
from mjmerge.cli import main
from mjmerge.config import shipped
from mjmerge.errors import OutputError, ScenarioError, UnknownNameError

QUICK = ("run", "paper", "--plant", "double_integrator", "--duration", "0.2", "--no-record")
BROKEN = (
    "run",
    "paper",
    "--plant",
    "double_integrator",
    "--duration",
    "7",
    "--no-record",
    "--set",
    "law.k_o=0",
)
PACKAGE = str(Path(mjmerge.__file__).parents[1])
ENVIRONMENT = os.environ | {"PYTHONPATH": os.pathsep.join([PACKAGE, *sys.path])}


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def here(capsys, *args: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as stop:
        main(list(args))
    return int(stop.value.code or 0), *capsys.readouterr()


def shell(line: str, *args: str, **more) -> subprocess.CompletedProcess[str]:
    """A shell line in which $M is the command with these arguments."""
    command = " ".join(f"'{word}'" for word in (sys.executable, "-m", "mjmerge", *args))
    return subprocess.run(
        ["bash", "-c", line.replace("$M", command)],
        capture_output=True,
        text=True,
        timeout=120,
        env=ENVIRONMENT,
        check=False,
        **more,
    )


def test_a_mistake_of_ours_is_one_line_a_file_and_exit_code_3(capsys, tmp_path, monkeypatch):
    def breaks(*_, **__):
        return {}["no such key"]

    monkeypatch.setattr("mjmerge.run.run", breaks)
    code, out, err = here(capsys, *QUICK)
    assert (code, out, err.count("\n")) == (3, "", 1)
    assert err.startswith("mjmerge: a mistake of mjmerge, not of yours: KeyError in mjmerge/cli/run.py:")
    (file,) = tmp_path.iterdir()
    assert file.name in err
    details = file.read_text()
    for part in ("mjmerge run paper --plant double_integrator", "mujoco 3.", "Traceback", "no such key"):
        assert part in details


def test_where_the_details_cannot_be_written_that_is_said(capsys, tmp_path, monkeypatch):
    def breaks(*_, **__):
        raise ZeroDivisionError

    monkeypatch.setattr("mjmerge.run.run", breaks)
    monkeypatch.setattr("tempfile.tempdir", "/proc")
    monkeypatch.chdir("/proc")  # read-only for root, too
    code, _, err = here(capsys, *QUICK)
    assert (code, err.count("\n")) == (3, 1)
    assert "could not be written" in err


def test_running_out_of_memory_is_told_with_advice(capsys, tmp_path, monkeypatch):
    def breaks(*_, **__):
        raise MemoryError

    monkeypatch.setattr("mjmerge.run.run", breaks)
    code, _, err = here(capsys, *QUICK)
    assert code == 3
    assert "not enough memory" in err
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("args", "where"),
    [(QUICK, "/dev/full"), ((*QUICK, "--json"), "&-"), (("schema",), "/dev/full"), (("-h",), "&-")],
)
def test_standard_output_that_is_full_or_closed_is_a_failure_and_no_verdict(args, where):
    done = shell(f"$M >{where}", *args)
    assert done.returncode == 3, (where, done.stderr)
    assert done.stderr.startswith("mjmerge: standard output did not take everything")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("args", "code"), [((*QUICK, "--json"), 0), ((*BROKEN, "--json"), 1), (QUICK, 0), (("--help",), 0)]
)
def test_a_reader_that_goes_away_early_is_no_news_and_the_exit_code_stays_the_verdicts(args, code):
    done = shell("$M | true; exit ${PIPESTATUS[0]}", *args)
    assert (done.returncode, done.stderr) == (code, "")


def test_standard_error_that_is_full_or_closed_changes_nothing(capsys):
    done = shell("$M 2>&-", *QUICK, "--json")
    assert (done.returncode, done.stdout.count("\n")) == (0, 1)
    assert shell("$M 2> /dev/full", "run", "papre").returncode == 2
    done = shell("$M <&- >&- 2>&-", "run", "paper", "--duration", "0.2", "--plant", "bicycle", "--out", "a")
    assert done.returncode == 3
    assert here(capsys, "verify", "a")[0] == 0  # whole, though descriptors 0 to 2 were free to take


def test_what_a_terminal_cannot_spell_is_written_as_an_escape(tmp_path):
    (tmp_path / "東京.yaml").write_text(shipped.scenarios()["paper"].read_text())
    done = shell("PYTHONIOENCODING=ascii $M", "run", "東京.yaml", *QUICK[2:])
    assert done.returncode == 0, done.stderr
    assert "\\u6771\\u4eac" in done.stdout


INTERRUPTED_AT = """
import os, signal, sys

class Finder:
    def find_spec(name, path=None, target=None):
        if name == os.environ["INTERRUPTED_AT"]:
            sys.meta_path.remove(Finder)
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Finder)
"""


@pytest.mark.parametrize("module", ["mjmerge.errors", "tyro", "numpy", "mjmerge.run", "mujoco"])
def test_ctrl_c_ends_with_130_and_without_a_traceback_while_it_is_still_importing(module, tmp_path):
    (tmp_path / "sitecustomize.py").write_text(INTERRUPTED_AT)
    path = os.pathsep.join([str(tmp_path), ENVIRONMENT["PYTHONPATH"]])

    def listens() -> None:  # what starts in the background ignores it
        signal.signal(signal.SIGINT, signal.default_int_handler)

    command = [sys.executable, "-m", "mjmerge", "run", "paper", "--no-record"]
    done = subprocess.run(
        command,
        env=ENVIRONMENT | {"PYTHONPATH": path, "INTERRUPTED_AT": module},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        preexec_fn=listens,
    )
    assert done.returncode == 130, done.stderr
    assert done.stdout == ""
    assert done.stderr.replace("mjmerge: interrupted", "").strip() == ""


def test_an_interrupt_that_a_library_turns_into_its_own_error_is_still_an_interrupt(capsys, monkeypatch):
    def breaks(*_, **__):
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt as error:
            raise RuntimeError("a library's own") from error

    monkeypatch.setattr("mjmerge.run.run", breaks)
    code, _, err = here(capsys, *QUICK)
    assert (code, err) == (130, "mjmerge: interrupted\n")


@pytest.mark.parametrize("limit", [60, 30_000])
def test_a_disk_that_fills_up_ends_with_3_and_a_line_for_each_file_and_leaves_none_in_part(limit):
    def full() -> None:  # a file may grow to this and no further, as on a full disk
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    args = ("run", "paper", "--plant", "double_integrator", "--duration", "1", "--out", "a")
    done = shell("$M", *args, preexec_fn=full)
    assert done.returncode == 3
    assert "Traceback" not in done.stderr
    assert "cannot write a/" in done.stderr
    assert "File too large" in done.stderr
    assert not (Path("a") / "figure.png").exists()
    assert not list(Path("a").glob("*.png*"))


@pytest.mark.parametrize(
    "args",
    [
        ("check", "mine.yaml", "--junit", "out.xml"),
        ("check", "mine.yaml", "--update"),
        ("sweep", "tiny.yaml", "--workers", "1"),
        ("export", "paper", "--out", "out.xml"),
        ("run", "paper", "--plant", "bicycle", "--duration", "0.2"),
    ],
)
def test_whatever_file_the_disk_has_no_room_for_the_exit_code_is_3(args, capsys, monkeypatch):
    paper = shipped.scenarios()["paper"].read_text().partition("\ngate:")[0]
    row = "{name: ideal, plant: double_integrator, at_least_m: 0}"
    Path("mine.yaml").write_text(paper.replace("duration_s: 35", "duration_s: 0.2") + f"\ngate: [{row}]\n")
    block = "{scenarios: [paper], plants: [double_integrator], set: {duration_s: 0.2}}"
    Path("tiny.yaml").write_text(f"blocks: [{block}]")

    def no_room(self, *_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "replace", no_room)
    code, _, err = here(capsys, *args)
    assert code == 3, err
    assert "No space left on device" in err
    assert "mistake" not in err
    assert not list(Path().rglob("*.xml*")) or args[0] == "run"


@pytest.mark.parametrize(
    "error", [UnknownNameError("plant", "x", ["y"]), ScenarioError("file", []), OutputError("no")]
)
def test_errors_cross_from_worker_processes(error):
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again), vars(again)) == (type(error), str(error), vars(error))


def test_what_a_file_says_cannot_move_the_cursor(capsys):
    code, _, err = here(capsys, "run", "\x1b[2Jgone.yaml", *QUICK[2:])
    assert code == 2
    assert "\x1b" not in err
    assert "\\x1b[2Jgone.yaml" in err


@pytest.mark.parametrize(
    ("ends", "says"),
    [
        ("echo 'cannot read it: so' >&2; exit 4", "mjmerge: the video was not made: cannot read it: so"),
        (
            "echo 'No space left on device' >&2; exit 5",
            "mjmerge: cannot write run.mp4: No space left on device",
        ),
        ("kill -9 $$", "mjmerge: the process that draws was ended by signal 9: out of memory?"),
        (
            "echo 'KeyError: 3' >&2; exit 1",
            "mjmerge: a mistake of mjmerge, not of yours: RuntimeError in mjmerge/review/video",
        ),
    ],
)
def test_however_the_process_that_draws_ends_the_command_says_what_that_means(
    capsys, tmp_path, monkeypatch, ends, says
):
    pytest.importorskip("av")
    draws = tmp_path / "draws"
    draws.write_text(f"#!/bin/sh\necho 0.0\n{ends}\n")
    draws.chmod(0o755)
    (tmp_path / "run.mcap").touch()
    monkeypatch.setattr(sys, "executable", str(draws))
    code, _, err = here(capsys, "video", "run.mcap")
    assert err.startswith(says)
    assert (code, err.count("\n")) == (2 if "exit 4" in ends else 3, 1)
    assert not list(tmp_path.glob("*.mp4*"))


def test_the_command_starts_no_process_that_looks_for_a_window():
    environment = {k: v for k, v in os.environ.items() if k != "MUJOCO_GL"} | {
        "PYTHONPATH": os.pathsep.join(sys.path),
    }
    args = ["-m", "mjmerge", "run", "paper", "--duration", "0.02", "--no-record"]
    ended = subprocess.run(
        [sys.executable, "-X", "importtime", *args],
        capture_output=True,
        text=True,
        env=environment,
        timeout=60,
    )
    imported = {line.rpartition("|")[2].strip() for line in ended.stderr.splitlines()}
    assert "mujoco" in imported
    assert "glfw.library" not in imported


@pytest.mark.parametrize(
    "words",
    ["run", "check", "verify", "replay", "recover", "convert --csv --out out", "view --check", "video",
     "sweep", "sweep --ladder", "export", "identify", "run paper --out", "new car mine --out"],
)  # fmt: skip
def test_a_name_that_is_too_long_for_a_file_is_bad_input(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as end:
        main([*words.split(), "a" * 400])
    assert end.value.code == 2
    assert capsys.readouterr().err.startswith("mjmerge: ")
    assert list(tmp_path.iterdir()) == []


def test_what_a_library_makes_of_being_told_to_end_is_still_that(monkeypatch, capsys):
    """dm_control raises what it meets while it reads a car again, with a text in the place of the code."""

    def composes(self):
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(5)
        except SystemExit as error:
            raise type(error)(f"Line 36: error while parsing element <default>: {error}") from error

    monkeypatch.setattr("mjmerge.cli.list.List.__call__", composes)
    with pytest.raises(SystemExit) as end:
        main(["list"])
    assert end.value.code == 128 + signal.SIGTERM
    assert capsys.readouterr().err == ""


def of_any_kind(number):
    """What is run, in which a signal comes, and what Python drops of it."""

    class Deleted:
        def __del__(self):
            signal.raise_signal(number)

    class Referred:
        pass

    def deleting():
        Deleted()

    def calling_back():
        referred = Referred()
        kept = weakref.ref(referred, lambda _: signal.raise_signal(number))
        del referred
        assert kept() is None

    def collecting():
        loop = Deleted()
        loop.own = loop
        del loop
        gc.collect()

    return {"deleted": deleting, "a callback": calling_back, "collected": collecting}


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
@pytest.mark.parametrize("moment", ["deleted", "a callback", "collected"])
def test_a_signal_comes_through_wherever_python_would_drop_it(number, code, moment, monkeypatch, capsys):
    """What is raised in a destructor is printed and forgotten: the command would go on."""

    def goes_on(self):
        of_any_kind(number)[moment]()
        time.sleep(5)
        return 0

    before = sys.unraisablehook
    monkeypatch.setattr("mjmerge.cli.list.List.__call__", goes_on)
    with pytest.raises(SystemExit) as end:
        main(["list"])
    assert end.value.code == code
    assert capsys.readouterr().err == ("" if number == signal.SIGTERM else "mjmerge: interrupted\n")
    assert sys.unraisablehook is before


def test_what_else_a_destructor_raises_is_told_as_ever(monkeypatch, capsys):
    class Deleted:
        def __del__(self):
            raise ValueError("its own")

    told = []
    monkeypatch.setattr(sys, "unraisablehook", told.append)
    monkeypatch.setattr("mjmerge.cli.list.List.__call__", lambda _: 0 if Deleted() else 1)
    with pytest.raises(SystemExit) as end:
        main(["list"])
    assert end.value.code == 0
    assert [str(what.exc_value) for what in told] == ["its own"]


def test_being_told_to_end_is_that_whatever_error_a_library_makes_of_it(monkeypatch, capsys):
    def breaks(self):
        try:
            signal.raise_signal(signal.SIGTERM)
        except SystemExit as error:
            raise RuntimeError("a library's own") from error

    monkeypatch.setattr("mjmerge.cli.list.List.__call__", breaks)
    with pytest.raises(SystemExit) as end:
        main(["list"])
    assert (end.value.code, capsys.readouterr().err) == (143, "")
