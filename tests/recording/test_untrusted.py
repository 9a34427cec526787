"""A recording from a stranger: its world opens no file, runs no code, and takes neither time nor memory."""

from __future__ import annotations

import subprocess
import time
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import mjmerge.run
from mjmerge.cli import main
from mjmerge.errors import UnreadableError
from mjmerge.record import attached
from mjmerge.record.rerun import viewer
from mjmerge.world.compose import build

from .viewer import rerun_cli

TEXTURE = (
    '<mujoco><asset><texture name="t{}" type="2d" builtin="flat" width="{}" height="{}"/></asset></mujoco>'
)


def inside(what: str) -> str:
    return f"<mujoco>{what}</mujoco>"


@pytest.mark.parametrize(
    ("xml", "says"),
    [
        ("", "there is no world in it"),
        ("<robot/>", "is not MJCF"),
        ("<mujoco>", "not well-formed XML, on line 1"),
        ('<!DOCTYPE m [<!ENTITY a "b">]>\n<mujoco model="&a;"/>', "declares a document type"),
        (inside('<include file="/etc/passwd"/>'), "<include>"),
        (inside('<asset><mesh name="m" file="/dev/zero"/></asset>'), "names a file (file of <mesh>)"),
        (inside('<asset><texture name="t" type="cube" fileright="/etc/x.png"/></asset>'), "names a file"),
        (inside('<asset><hfield name="h" nrow="2" ncol="2" size="1 1 1 1"/></asset>'), "<hfield>"),
        (inside('<asset><model name="m" file="x.xml"/></asset>'), "<model>"),
        (inside('<extension><plugin plugin="mujoco.pid"/></extension>'), "<extension>"),
        (inside('<worldbody><replicate count="1000000" euler="0 0 1"/></worldbody>'), "<replicate>"),
        (inside('<worldbody><flexcomp name="f" count="999 999 999"/></worldbody>'), "<flexcomp>"),
        (inside('<worldbody><composite type="grid" count="999 999 1"/></worldbody>'), "<composite>"),
        (inside('<size memory="900G"/>'), "<size>"),
        (inside('<custom><numeric name="n" size="2000000000"/></custom>'), "size='2000000000'"),
        (inside('<visual><quality shadowsize="65536"/></visual>'), "shadowsize='65536'"),
        (inside('<visual><global offwidth="100000"/></visual>'), "offwidth='100000'"),
        (inside('<sensor><clock nsample="1000000000"/></sensor>'), "nsample='1000000000'"),
        (TEXTURE.format("", 9000, 1), "width='9000'"),
        (inside("".join(TEXTURE.format(i, 4000, 4000)[8:-9] for i in range(9))), "megapixels"),
        (inside("<worldbody>" + "<body>" * 100 + "</body>" * 100 + "</worldbody>"), "nested deeper"),
        (inside("<worldbody>" + "<geom/>" * 60_000 + "</worldbody>"), "more than 50000 elements"),
        (inside("<!--" + "x" * 9_000_000 + "-->"), "has 9 MB of text"),
    ],
)  # fmt: skip
def test_a_world_that_would_do_more_than_be_compiled_is_refused_before_it_is(monkeypatch, xml, says):
    monkeypatch.setattr(attached.subprocess, "run", lambda *_, **__: pytest.fail("it was compiled"))
    began = time.monotonic()
    with pytest.raises(UnreadableError) as refused:
        attached.compiled(Path("strange.mcap"), xml)
    assert time.monotonic() - began < 1
    assert says in str(refused.value)
    assert str(refused.value).startswith("cannot read strange.mcap: ")
    assert "\n" not in str(refused.value)


def test_what_mjmerge_records_is_compiled_to_the_very_same_model():
    xml = build(mjmerge.load("charge", ["mismatch.command_delay_s=0.05"])).xml
    here, there = mujoco.MjModel.from_xml_string(xml), attached.compiled(Path("a.mcap"), xml)
    assert here.names == there.names
    arrays = [n for n in dir(here) if isinstance(getattr(here, n), np.ndarray)]
    assert len(arrays) > 200
    for name in arrays:
        assert getattr(here, name).tobytes() == getattr(there, name).tobytes(), name


def test_what_does_not_compile_or_asks_too_much_of_the_compiler_is_one_line(monkeypatch):
    with pytest.raises(UnreadableError, match="its world does not compile: size 0 must be positive"):
        attached.compiled(Path("a.mcap"), inside("<worldbody><geom/></worldbody>"))
    monkeypatch.setattr(attached, "MOST_MEMORY_BYTES", 1)
    with pytest.raises(UnreadableError, match=r"its world (needs more than|does not compile)"):
        attached.compiled(Path("a.mcap"), TEXTURE.format("", 4000, 4000))


@pytest.fixture
def strange(tmp_path, monkeypatch) -> Path:
    """A recording whose world would read a file."""
    evil = inside('<asset><mesh name="m" file="/etc/hostname"/></asset>')

    def made(*given):
        world = replace(mine := build(*given), xml=evil)
        vars(world)["drawn"] = mine.drawn  # what is drawn of it was compiled before
        return world

    monkeypatch.setattr("mjmerge.world.compose.build", made)
    scenario = mjmerge.load("paper", ["duration_s=0.2"])
    mjmerge.run.run(scenario, "double_integrator", folder=tmp_path / "strange")
    monkeypatch.chdir(tmp_path)
    return Path("strange")


@pytest.mark.parametrize("kind", ["mcap", "rrd"])
def test_no_command_compiles_a_world_that_names_files(strange, capsys, kind):
    file = strange / f"run.{kind}"
    whole = file.read_bytes()
    cut = Path(f"cut.{kind}")
    cut.write_bytes(whole[: int(len(whole) * 0.9)])
    commands = [["compare", file, file, "--out", "both"], ["recover", cut]]
    if kind == "mcap":
        commands.append(["view", file, "--check"])
    for command in commands:
        with pytest.raises(SystemExit) as stop:
            main(list(map(str, command)))
        err = capsys.readouterr().err
        assert (stop.value.code, err.count("\n")) == (2, 1), err
        assert "names a file (file of <mesh>)" in err
        assert "/tmp" not in err


def test_view_can_say_without_a_window_whether_a_recording_can_be_shown(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    mjmerge.run.run(mjmerge.load("paper", ["duration_s=0.2"]), "double_integrator", folder=tmp_path / "a")
    for name in ("a", "a/run.mcap", "a/run.rrd"):
        with pytest.raises(SystemExit) as stop:
            main(["view", name, "--check"])
        assert (stop.value.code, capsys.readouterr().out.count("can be shown")) == (0, 1)
    for kind in ("mcap", "rrd"):
        Path(f"none.{kind}").write_bytes(b"what is this?" * 99)
        with pytest.raises(SystemExit) as stop:
            main(["view", f"none.{kind}", "--check"])
        assert (stop.value.code, capsys.readouterr().err.count("\n")) == (2, 1)


def test_rerun_sends_nothing_to_its_makers_from_a_program_that_we_start(tmp_path, monkeypatch):
    monkeypatch.setenv("FORCE_RERUN_ANALYTICS", "1")
    ours = viewer.environment()
    assert "FORCE_RERUN_ANALYTICS" not in ours
    assert ours["HTTPS_PROXY"].startswith("http://127.0.0.1:")  # what it asks for updates goes nowhere
    assert viewer.command("a.rrd")[-3:] == ["--bind", "127.0.0.1", "a.rrd"]
    kept = {}
    for name, environment in (("ours", ours), ("as it is", {**ours, "CI": ""})):
        if name == "as it is":
            del environment["CI"]
        home = tmp_path / name
        home.mkdir()
        clean = {k: v for k, v in environment.items() if not k.startswith("XDG_")}
        subprocess.run(
            [rerun_cli(), "rrd", "stats", str(tmp_path / "none.rrd")],
            env=clean | {"HOME": str(home)},
            capture_output=True,
            timeout=60,
            check=False,
        )
        kept[name] = sorted(p.name for p in home.rglob("*.json"))
    assert kept["ours"] == []
    assert "analytics.json" in kept["as it is"]  # or this test would show nothing
