"""The loader: every mistake is named with its key and line, and nothing else than MjmergeError comes out."""

import json
import os
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mjmerge.config import shipped
from mjmerge.config.document import parse
from mjmerge.errors import MjmergeError, Problem, ScenarioError, UnknownNameError
from mjmerge.scenario.cars import data_sheet
from mjmerge.scenario.load import dump, json_schema, load
from mjmerge.scenario.schema import Scenario

BASE = """\
description: a merge
duration_s: 35
control_step_s: 0.01
physics_step_s: 0.001
initial:
  ego: {front_m: [-1.5, 1.457], speed_mps: 2.0}
  vehicle_1: {front_m: [0.0, 0.0], speed_mps: 2.0}
  vehicle_2: {front_m: [-1.87, 0.0], speed_mps: 2.0}
  z: 0.15
law:
  k_o: 1.0
  k_v: 2.0
  r_m: 0.6
  r_rho_m: -1.206
  r_eta_m: 1.457
drivers:
  vehicle_1: {kind: steady, speed_mps: 2.0}
  vehicle_2:
    kind: gap
    gap_m: 1.868
    moves:
      - {start_s: 5, duration_s: 3, gap_m: 2.3, step: cubic}
      - {start_s: 9, duration_s: 3, gap_m: 1.9}
models:
  ego: rc
expect:
  min_distance_m: {at_least: 0.05}
"""


def base() -> dict:
    """BASE as plain values."""
    return parse(BASE).value


def problems(path: Path, content: str | bytes, overrides: tuple[str, ...] = ()) -> tuple[Problem, ...]:
    """What is wrong with a file of that content; an empty tuple where it loads."""
    path = path / "s.yaml"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    try:
        load(path, overrides)
    except ScenarioError as error:
        return error.problems
    return ()


def line_of(text: str, part: str) -> int:
    """Number of the line that ``part`` starts on."""
    return text[: text.index(part)].count("\n") + 1


MALFORMED = {
    # name: (replace this, by this, key, words of the message, text at whose line it is reported)
    "misspelt key": ("k_o: 1.0", "ko: 1.0", "law.ko", "did you mean 'k_o'?", "ko:"),
    "misspelt section": ("law:", "lau:", "lau", "did you mean 'law'?", "lau:"),
    "missing section": (
        "drivers:",
        "expect_:",
        "drivers",
        "missing; Who drives the neighbours; `mjmerge list drivers` shows the kinds.",
        "description",
    ),
    "missing key": ("  r_rho_m: -1.206\n", "", "law.r_rho_m", "missing; Offset r^rho of the target", "law:"),
    "missing car": (
        "  vehicle_2: {front_m: [-1.87, 0.0], speed_mps: 2.0}\n",
        "",
        "initial.vehicle_2",
        "missing",
        "initial:",
    ),
    "section left empty": (
        "expect:\n  min_distance_m: {at_least: 0.05}",
        "expect:",
        "expect",
        "mapping",
        "expect:",
    ),
    "section as a list": (
        "models:\n  ego: rc",
        "models:\n  - rc",
        "models",
        "must be a mapping of keys, got a list of 1",
        "models:",
    ),
    "text for a number": ("k_o: 1.0", "k_o: fast", "law.k_o", "must be a number, got the text 'fast'", "k_o"),
    "no for a number": (
        "k_o: 1.0",
        "k_o: no",
        "law.k_o",
        "the text 'no'; YAML 1.2 reads that as text",
        "k_o",
    ),
    "quoted number": ("k_o: 1.0", 'k_o: "1.0"', "law.k_o", "drop the quotes", "k_o"),
    "true for a number": ("k_o: 1.0", "k_o: true", "law.k_o", "must be a number, got true", "k_o"),
    "nothing for a number": ("k_o: 1.0", "k_o:", "law.k_o", "got nothing", "k_o"),
    "number for text": (
        "a merge",
        "3",
        "description",
        "must be text, got 3; put it in quotes",
        "description",
    ),
    "date for a number": ("k_o: 1.0", "k_o: 2024-01-01", "law.k_o", "got the text '2024-01-01'", "k_o"),
    "underscores in a number": ("k_o: 1.0", "k_o: 1_0", "law.k_o", "got the text '1_0'", "k_o"),
    "nan": ("k_o: 1.0", "k_o: .nan", "law.k_o", "must be a finite number, got nan", "k_o"),
    "infinity": ("k_o: 1.0", "k_o: -.inf", "law.k_o", "must be a finite number, got -inf", "k_o"),
    "overflowing number": ("k_o: 1.0", "k_o: 1e999", "law.k_o", "must be a finite number", "k_o"),
    "overlong number": ("k_o: 1.0", f"k_o: {'9' * 5000}", "law.k_o", "must be a finite number", "k_o"),
    "too small": ("r_m: 0.6", "r_m: -0.5", "law.r_m", "must be greater than 0, got -0.5", "r_m"),
    "too large": ("duration_s: 35", "duration_s: 4000", "duration_s", "at most 3600, got 4000", "duration_s"),
    "missing driver": (
        "  vehicle_1: {kind: steady, speed_mps: 2.0}\n",
        "",
        "drivers.vehicle_1",
        "missing",
        "drivers:",
    ),
    "short point": ("[0.0, 0.0]", "[0.0]", "initial.vehicle_1.front_m.1", "missing", "[0.0]"),
    "long point": ("[0.0, 0.0]", "[0, 0, 0]", "initial.vehicle_1.front_m", "must have 2 items", "[0, 0, 0]"),
    "text in a point": (
        "[0.0, 0.0]",
        '["0.0", 0]',
        "initial.vehicle_1.front_m.0",
        "drop the quotes",
        '["0.0"',
    ),
    "key given twice": ("k_v: 2.0", "k_v: 2.0\n  k_v: 3.0", "law.k_v", "on lines 12 and 13", "k_v: 3.0"),
    "key that is a number": ("k_v: 2.0", "1: 2", "law", "a key must be text, got 1", "1: 2"),
    "key that is a list": ("k_v: 2.0", "[a, b]: 2", "law", "a key must be text, got a list of 2", "[a, b]"),
    "hidden name": ("a merge", "a merge\nname: x", "name", "unknown key", "name:"),
    "unknown driver": (
        "kind: gap",
        "kind: gapp",
        "drivers.vehicle_2.kind",
        "did you mean 'gap'?",
        "kind: gapp",
    ),
    "no driver kind": (
        "    kind: gap\n",
        "",
        "drivers.vehicle_2.kind",
        "missing; one of flips, gap, idm, recorded, speeds, steady",
        "  vehicle_2:\n",
    ),
    "driver as text": (
        "{kind: steady, speed_mps: 2.0}",
        "steady",
        "drivers.vehicle_1",
        "must be a mapping of keys, got the text 'steady'",
        "vehicle_1: steady",
    ),
    "misspelt key of a driver": (
        "gap_m: 1.868",
        "gap_m: 1.868\n    sways: 1",
        "drivers.vehicle_2.sways",
        "did you mean 'sway'?",
        "sways",
    ),
    "misspelt key in a list": (
        "gap_m: 1.9}",
        "gap: 1.9}",
        "drivers.vehicle_2.moves.1.gap",
        "did you mean 'gap_m'?",
        "gap: 1.9}",
    ),
    "wrong choice": (
        "step: cubic",
        "step: cubik",
        "drivers.vehicle_2.moves.0.step",
        "must be 'cubic' or 'quintic', got the text 'cubik'",
        "cubik",
    ),
    "merge key": ("k_v: 2.0", "<<: {k_v: 2.0}", "law", "the merge key << is not supported", "<<"),
    "anchor": ("k_v: 2.0", "k_v: &gain 2.0", "law.k_v", "the anchor &gain is not supported", "&gain"),
    "alias": ("k_v: 2.0", "k_v: *gain", "law.k_v", "the alias *gain is not supported", "*gain"),
    "tag": ("k_v: 2.0", "k_v: !!float 2", "law.k_v", "is not supported", "!!float"),
    "tag that runs code": (
        "a merge",
        "!!python/object:os.system x",
        "description",
        "not supported",
        "!!python",
    ),
    "half a surrogate pair": ("a merge", '"\\ud800"', "description", "surrogate", "description"),
    "second document": ("law:", "---\nlaw:", "", "a second document starts here", "law:"),
    "tab": ("  k_v: 2.0", "\tk_v: 2.0", "", "use spaces, not tabs", "\tk_v"),
    "unclosed bracket": ("[0.0, 0.0]", "[0.0, 0.0", "", "not valid YAML", "  vehicle_1"),
    "bad escape": ("a merge", '"\\U99999999"', "", "not valid YAML", None),
    "control character": ("law:", "law\0:", "", "U+0000", "law"),
    # what is well formed and cannot be run
    "steps that do not divide": (
        "control_step_s: 0.01\nphysics_step_s: 0.001",
        "control_step_s: 0.0035\nphysics_step_s: 0.002",
        "control_step_s",
        "control step (0.0035 s) must be a whole multiple of the physics step (0.002 s)",
        "control_step_s",
    ),
    "physics slower than control": (
        "0.01\n",
        "0.0001\n",
        "control_step_s",
        "whole multiple",
        "control_step_s",
    ),
    "shorter than a step": (
        "duration_s: 35",
        "duration_s: 0.005",
        "duration_s",
        "at least one control",
        "duration_s",
    ),
    "unknown variant": ("k_v: 2.0", "variant: litteral", "law.variant", "did you mean 'literal'?", "variant"),
    "unknown model": ("ego: rc", "ego: rcc", "models.ego", "did you mean 'rc'?", "ego: rcc"),
    "ego within r": (
        "[-1.5, 1.457]",
        "[-0.3, 0.4]",
        "initial.ego.front_m",
        "0.5 m from vehicle_1, front axle to front axle; it must be more than r_m = 0.6 m",
        "[-0.3, 0.4]",
    ),
    "overlapping bodies": (
        "[-1.87, 0.0]",
        "[-0.5, 0.1]",
        "initial.vehicle_2.front_m",
        "vehicle_1 and vehicle_2 overlap at the start, by 0.08 m along the road and 0.21 m across it",
        "[-0.5, 0.1]",
    ),
    "follower ahead": (
        "[-1.87, 0.0]",
        "[3.0, 0.0]",
        "initial.vehicle_2.front_m",
        "its x is 3.0 m",
        "[3.0, 0.0]",
    ),
    "target ahead": ("-1.206", "1.206", "law.r_rho_m", "must be negative, got 1.206", "r_rho_m"),
    "target too close": ("-1.206", "-0.5", "law.r_rho_m", "choose between -1.27 and -0.6", "r_rho_m"),
    "target too far": ("-1.206", "-1.3", "law.r_rho_m", "the gap is 1.87 m", "r_rho_m"),
    "impossible gap": (
        "[-1.87, 0.0]",
        "[-1.1, 0.0]",
        "initial.vehicle_2.front_m",
        "gap behind vehicle_1 is 1.1 m at the start; it must be wider than 2 r_m = 1.2 m",
        "[-1.1, 0.0]",
    ),
    "overlapping moves": (
        "start_s: 9",
        "start_s: 7",
        "drivers.vehicle_2.moves.1.start_s",
        "starts at 7.0 s, before the move above it ends, at 8 s",
        "start_s: 7",
    ),
    "nobody to follow": (
        "{kind: steady, speed_mps: 2.0}",
        "{kind: gap, gap_m: 2}",
        "drivers.vehicle_1.kind",
        "'gap' follows the car ahead, and vehicle_1 has nobody ahead of it; kinds that can lead: idm",
        "{kind: gap, gap_m: 2}",
    ),
    "overlapping changes of speed": (
        "{kind: steady, speed_mps: 2.0}",
        "{kind: speeds, speed_mps: 2, changes: [{start_s: 5, rate_mps2: 4, speed_mps: 0},"
        " {start_s: 5.2, rate_mps2: 1, speed_mps: 2}]}",
        "drivers.vehicle_1.changes.1.start_s",
        "starts at 5.2 s, before the change above it ends, at 5.5 s",
        "start_s: 5.2",
    ),
    "a rate with a sign": (
        "{kind: steady, speed_mps: 2.0}",
        "{kind: speeds, speed_mps: 2, changes: [{start_s: 5, rate_mps2: -4, speed_mps: 0}]}",
        "drivers.vehicle_1.changes.0.rate_mps2",
        "must be greater than 0, got -4",
        "rate_mps2: -4",
    ),
    "a leader told to reverse": (
        "{kind: steady, speed_mps: 2.0}",
        "{kind: speeds, speed_mps: 2, changes: [{start_s: 5, rate_mps2: 4, speed_mps: -1}]}",
        "drivers.vehicle_1.changes.0.speed_mps",
        "must be at least 0, got -1",
        "speed_mps: -1",
    ),
    "a speed beyond all roads": (
        "{kind: steady, speed_mps: 2.0}",
        "{kind: steady, speed_mps: 1e9}",
        "drivers.vehicle_1.speed_mps",
        "must be at most 1000, got 1",
        "1e9",
    ),
    "brakes weaker than comfortable": (
        "{kind: steady, speed_mps: 2.0}",
        "{kind: idm, desired_speed_mps: 2, time_gap_s: 1, standstill_gap_m: 1, limit_mps2: 1}",
        "drivers.vehicle_1.limit_mps2",
        "the hardest braking (1.0 m/s^2) must not be below the comfortable one (1.67 m/s^2)",
        "limit_mps2",
    ),
    "a gap that sways shut": (
        "    gap_m: 1.868\n",
        "    gap_m: 1.868\n    sway: {amplitude_m: -2, period_s: 5}\n",
        "drivers.vehicle_2.sway.amplitude_m",
        "must be less than the gap that sways (1.868 m), got -2.0",
        "sway",
    ),
    "holds out of order": (
        "{kind: steady, speed_mps: 2.0}",
        "{kind: flips, closed_gap_m: 1, open_gap_m: 2, hold_min_s: 5}",
        "drivers.vehicle_1.hold_min_s",
        "(5.0 s) must not exceed the longest (4.0 s)",
        "hold_min_s",
    ),
}


@pytest.mark.parametrize("name", MALFORMED)
def test_a_mistake_is_named_with_its_key_and_line(name, tmp_path):
    old, new, key, words, at = MALFORMED[name]
    text = BASE.replace(old, new, 1)
    assert text != BASE
    found = problems(tmp_path, text)
    line = line_of(text, at) if at else None
    assert any((p.key, p.line) == (key, line) and words in p.message for p in found), found


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "empty"),
        (b"# only a comment\n", "empty"),
        (b"- a\n- b\n", "must be a mapping of keys, got a list of 2"),
        (b"just some words", "must be a mapping of keys, got the text 'just some words'"),
        (b"law: {k_o: 1\xff}", "not text in UTF-8"),
        ("law: 1".encode("utf-16"), "not text"),
        (b"\x89MCAP0\r\n\x00\x01", "not text"),
        (b"[" * 100_000, "nested deeper than 20 levels"),
        (b"a: " * 1000, "not valid YAML"),
        (b"".join(b" " * i + b"a:\n" for i in range(500)), "nested deeper than 20 levels"),
        (b"a: &a [x]\nb: &b [*a, *a]\nc: [*b, *b]\n", "the alias *a is not supported"),
        (b": : :\n  - ? }", "not valid YAML"),
    ],
)
def test_what_is_no_scenario_at_all_is_refused_in_words(content, words, tmp_path):
    assert any(words in p.message for p in problems(tmp_path, content))


def test_a_recording_is_refused_by_its_size(tmp_path):
    path = tmp_path / "run.yaml"
    path.touch()
    os.truncate(path, 100_000_000)
    with pytest.raises(ScenarioError, match=r"few kilobytes; this is 100 MB: is it a recording\?"):
        load(path)


def test_files_that_cannot_be_opened_are_refused(tmp_path, monkeypatch):
    for path in (tmp_path, tmp_path / "none.yaml", "none.yaml", "a/b", "x" * 5000 + ".yaml", "a/\0.yaml"):
        with pytest.raises(ScenarioError, match="cannot be read"):
            load(path)

    def denied(*args, **kwargs):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", denied)
    with pytest.raises(ScenarioError, match="cannot be read: Permission denied"):
        load("paper")


def test_all_mistakes_of_a_file_are_reported_at_once_in_its_order(tmp_path):
    text = (
        BASE.replace("duration_s: 35", "duration_s: '35'")
        .replace("[-1.87, 0.0]", "[-0.5, 0.1]")
        .replace("k_o: 1.0", "ko: 1.0\n  ko: 2.0")
        .replace("  r_rho_m: -1.206\n", "")
        .replace("kind: gap", "kind: yield")
        .replace("ego: rc", "vehicle_x: rc")
        .replace("at_least: 0.05", "at_least: .inf")
    )
    found = problems(tmp_path, text)
    assert [(p.key, p.line) for p in found] == [
        ("duration_s", 2),
        ("law.r_rho_m", 10),
        ("law.ko", 12),  # given twice
        ("law.ko", 12),  # and unknown
        ("drivers.vehicle_2.kind", 19),
        ("models.vehicle_x", 25),
        ("expect.min_distance_m.at_least", 27),
    ]


def test_every_key_given_twice_is_reported(tmp_path):
    text = BASE.replace("k_v: 2.0", "k_v: 2.0\n  k_v: 2.0\n  k_v: 2.0") + "law: {}\n"
    found = [p for p in problems(tmp_path, text) if "given twice" in p.message]
    assert [(p.key, p.line) for p in found] == [("law.k_v", 13), ("law.k_v", 14), ("law", 30)]


def test_physical_checks_run_although_another_section_is_wrong(tmp_path):
    text = BASE.replace("k_o: 1.0", "k_o: fast").replace("[-1.87, 0.0]", "[-0.5, 0.1]")
    text = text.replace("start_s: 9", "start_s: 7").replace("duration_s: 35", "duration_s: 1e-3")
    keys = [p.key for p in problems(tmp_path, text)]
    assert keys == ["duration_s", "initial.vehicle_2.front_m", "law.k_o", "drivers.vehicle_2.moves.1.start_s"]


def test_a_flood_of_mistakes_is_kept_but_not_printed(tmp_path):
    path = tmp_path / "s.yaml"
    path.write_text(BASE + "".join(f"key_{i}: 1\n" for i in range(200)))
    with pytest.raises(ScenarioError, match="and 150 more problems") as caught:
        load(path)
    assert len(caught.value.problems) == 200
    assert len(str(caught.value).splitlines()) == 51


@pytest.mark.parametrize(
    ("written", "means"),
    [("1e-3", 1e-3), ("1E+2", 100.0), (".5", 0.5), ("2.", 2.0), ("+3", 3.0), ("007", 7.0), ("0x10", 16.0)],
)
def test_numbers_are_read_as_yaml_1_2_has_them(written, means, tmp_path):
    (tmp_path / "s.yaml").write_text(BASE.replace("k_o: 1.0", f"k_o: {written}"))
    assert load(tmp_path / "s.yaml").law.k_o == means


@pytest.mark.parametrize("word", ["no", "yes", "on", "off", "12:30", "1_000", "2024-01-01", "0b1", "'3'"])
def test_what_yaml_1_1_took_for_something_else_is_text(word, tmp_path):
    (tmp_path / "s.yaml").write_text(BASE.replace("a merge", word))
    assert load(tmp_path / "s.yaml").description == word.strip("'")


def test_windows_line_ends_and_byte_order_mark_are_read(tmp_path):
    (tmp_path / "s.yaml").write_bytes(b"\xef\xbb\xbf" + BASE.replace("\n", "\r\n").encode())
    assert load(tmp_path / "s.yaml") == load(base())


def test_the_message_starts_with_file_line_and_key(tmp_path):
    (tmp_path / "s.yaml").write_text(BASE.replace("k_o: 1.0", "k_o: fast"))
    with pytest.raises(ScenarioError) as caught:
        load(str(tmp_path / "s.yaml"))
    assert str(caught.value) == f"{tmp_path}/s.yaml:11: law.k_o: must be a number, got the text 'fast'"


# --- sources and names


def test_shipped_scenarios_load_by_name_and_by_path():
    assert len(shipped.scenarios()) > 0
    for name, path in shipped.scenarios().items():
        assert load(name) == load(path) == load(str(path))
        assert load(name).name == load(path).name == name


def test_an_unknown_name_gets_the_nearest_one():
    with pytest.raises(UnknownNameError, match=r"no scenario called 'papr': did you mean 'paper'\?"):
        load("papr")


def test_an_existing_file_needs_no_suffix(tmp_path, monkeypatch):
    (tmp_path / "mine").write_text(BASE)
    monkeypatch.chdir(tmp_path)
    assert load("mine").name == "mine"


def test_a_mapping_is_checked_the_same_way_without_lines():
    values = base()
    values["law"] |= {"ko": 1, "k_v": "2", 3: 4}
    values["initial"]["vehicle_2"]["front_m"] = (-0.5, 0.1)
    with pytest.raises(ScenarioError) as caught:
        load(values)
    found = {(p.key, p.line) for p in caught.value.problems}
    assert found == {("law", None), ("law.ko", None), ("law.k_v", None), ("initial.vehicle_2.front_m", None)}


def test_a_mapping_is_left_as_it_was():
    values = base()
    assert load(values, ["law.k_o=0", "drivers.vehicle_2.moves.0.gap_m=2"]).law.k_o == 0
    assert values == base()
    assert load(values).name == "scenario"


def test_a_mapping_that_contains_itself_is_refused():
    values = base()
    values["law"]["law"] = values["law"]
    with pytest.raises(ScenarioError, match="nested deeper"):
        load(values)


def test_the_name_is_neither_compared_nor_written():
    assert load("paper").named("other") == load("paper")
    assert hash(load("paper").named("other")) == hash(load("paper"))
    assert "name" not in Scenario.model_fields
    assert "\nname:" not in dump(load("paper"))


# --- overrides


def test_overrides_change_any_key():
    scenario = load(
        base(),
        [
            "law.k_o=0",
            "law.k_s=1e-3",  # not in the file
            "belief.mass_kg=4",  # nor its section
            "drivers.vehicle_2.moves.0.gap_m=2.2",
            "drivers.vehicle_1={kind: steady, speed_mps: 1.5}",
            "initial.ego.front_m=[0, 1.457]",
            "initial.vehicle_1.front_m.1=0.01",
            "description=a = b",
        ],
    )
    assert (scenario.law.k_o, scenario.law.k_s, scenario.belief.mass_kg) == (0, 1e-3, 4)
    assert scenario.drivers.vehicle_2.moves[0].gap_m == 2.2
    assert scenario.drivers.vehicle_1.speed_mps == 1.5
    assert scenario.initial.ego.front_m == (0, 1.457)
    assert scenario.initial.vehicle_1.front_m == (0, 0.01)
    assert scenario.description == "a = b"


@pytest.mark.parametrize(
    ("text", "key", "words"),
    [
        ("law.k_x=0", "law.k_x", "did you mean"),
        ("lau.k_o=0", "lau", "did you mean 'law'?"),
        ("law.k_o=fast", "law.k_o", "must be a number, got the text 'fast'"),
        ("law.k_o=", "law.k_o", "got nothing"),
        ("law.k_o.x=1", "law.k_o", "must be a number, got a mapping"),
        ("law={k_o: 1, r_rho_m: -1}", "law.r_eta_m", "missing"),
        ("law.k_o=[1", "law.k_o", "not valid YAML"),
        ("law.k_o=*a", "law.k_o", "alias"),
        ("law.k_o", "", "must be KEY=VALUE"),
        ("=3", "", "must be KEY=VALUE"),
        ("name=x", "name", "unknown key"),
        (
            "drivers.vehicle_2.moves.7.gap_m=1",
            "drivers.vehicle_2.moves.7.gap_m",
            "no item '7' in a list of 2",
        ),
        ("drivers.vehicle_2.moves.last=1", "drivers.vehicle_2.moves.last", "no item 'last'"),
        ("control_step_s=0.0035", "control_step_s", "whole multiple"),
        ("models.ego=rcc", "models.ego", "did you mean 'rc'?"),
    ],
)
def test_a_wrong_override_is_named_as_it_was_typed(text, key, words, tmp_path):
    found = problems(tmp_path, BASE, (text,))
    assert [(p.key, p.line, p.source) for p in found] == [(key, None, f"--set {text}")] * len(found)
    assert any(words in p.message for p in found), found


def test_mistakes_of_file_and_overrides_are_reported_together(tmp_path):
    found = problems(tmp_path, BASE.replace("k_v: 2.0", "k_v: fast"), ("law.k_o=slow",))
    assert [(p.key, p.line, p.source) for p in found] == [
        ("law.k_v", 12, None),
        ("law.k_o", None, "--set law.k_o=slow"),
    ]


def test_an_override_repairs_the_file(tmp_path):
    assert problems(tmp_path, BASE.replace("k_o: 1.0", "k_o: fast"), ("law.k_o=1",)) == ()


# --- models and data sheets


@pytest.fixture
def own_model(tmp_path):
    """A folder beside the scenario with a car model of one's own."""
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "datasheet.yaml").write_text((shipped.model_folder("rc") / "datasheet.yaml").read_text())
    return folder


def test_a_model_beside_the_scenario_is_found_and_made_absolute(own_model, tmp_path, monkeypatch):
    (tmp_path / "s.yaml").write_text(BASE.replace("ego: rc", "ego: ./mine"))
    scenario = load(tmp_path / "s.yaml")
    assert scenario.models.ego == str(own_model.resolve())
    assert scenario.models.vehicle_1 == "rc"
    assert load(parse(dump(scenario)).value) == scenario
    monkeypatch.chdir(tmp_path)
    assert load(base(), ["models.ego=mine"]) == scenario


def test_a_mistake_in_a_data_sheet_is_reported_once_at_the_sheet(own_model, tmp_path):
    sheet = own_model / "datasheet.yaml"
    sheet.write_text(sheet.read_text().replace("mass_kg: 3.74", "mass_kg: heavy"))
    found = problems(tmp_path, BASE.replace("ego: rc", "ego: mine\n  vehicle_1: mine"))
    (problem,) = found
    assert (problem.key, problem.source) == ("mass_kg", str(sheet))
    assert problem.line == line_of(sheet.read_text(), "mass_kg: heavy")
    with pytest.raises(
        ScenarioError, match=r"datasheet\.yaml:\d+: mass_kg: must be a number, got the text 'heavy'"
    ):
        data_sheet(str(own_model))


def test_a_data_sheet_that_has_changed_is_read_again(own_model):
    sheet = own_model / "datasheet.yaml"
    assert data_sheet(str(own_model)).mass_kg == 3.74
    sheet.write_text(sheet.read_text().replace("mass_kg: 3.74", "mass_kg: 4.75"))
    assert data_sheet(str(own_model)).mass_kg == 4.75


def test_every_shipped_model_has_a_data_sheet():
    for name in shipped.models():
        assert data_sheet(name).wheelbase_m > 0
    with pytest.raises(UnknownNameError, match=r"did you mean 'rc'\?"):
        data_sheet("rcc")


# --- writing


def test_dumping_what_was_dumped_gives_the_same_text(tmp_path):
    for name in shipped.scenarios():
        text = dump(load(name))
        (tmp_path / "scenario.yaml").write_text(text)
        again = load(tmp_path / "scenario.yaml")
        assert again == load(name)
        assert dump(again) == text


def test_a_dump_holds_the_defaults_too():
    text = dump(load(base()))
    for line in ("k_s: 1.0", "mass_kg: null", "friction: 1.0", "step: quintic", "front_m: [-1.5, 1.457]"):
        assert line in text


number = st.floats(0, 1e300)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    description=st.text(),
    gains=st.fixed_dictionaries(dict.fromkeys(("k_p", "k_v", "k_o", "eps_1"), number)),
    mu=st.floats(-1e300, 1e300),
    mass=st.none() | st.floats(1e-300, 1e300),
    moves=st.lists(st.sampled_from(["cubic", "quintic"]), max_size=3),
)
def test_loading_a_dump_gives_an_equal_scenario(description, gains, mu, mass, moves, tmp_path):
    values = base()
    values |= {"description": description, "belief": {"mass_kg": mass}}
    values["law"] |= gains
    values["initial"]["mu"] = mu
    values["drivers"]["vehicle_2"]["moves"] = [
        {"start_s": i, "duration_s": 1, "gap_m": 2 + i / 7, "step": step} for i, step in enumerate(moves)
    ]
    scenario = load(values)
    path = tmp_path / "scenario.yaml"
    path.write_text(dump(scenario), encoding="utf-8", newline="")
    assert load(path) == scenario
    assert dump(load(path)) == dump(scenario)


def test_the_committed_schema_is_the_current_one(written):
    written(shipped.folder("scenarios") / "schema.json", json_schema())
    schema = json.loads(json_schema())
    assert "name" not in schema["properties"]
    assert schema["required"] == ["initial", "law", "drivers"]
    assert schema["$defs"]["OpinionDynamics"]["properties"]["k_o"]["description"].startswith("Barrier gain")


# --- fuzz

PAPER = shipped.scenarios()["paper"].read_text(encoding="utf-8").splitlines()
SCRAP = st.one_of(
    st.text(max_size=20),
    st.sampled_from(
        [
            "{",
            "}",
            "[",
            "]",
            ": ",
            "- ",
            "? ",
            "&a ",
            "*a",
            "!!int ",
            "<<: *a",
            "%YAML 1.1",
            "---",
            "...",
            "|",
            ">-",
            "\t",
        ]
    ),
    st.sampled_from(
        [".nan", "1e999", "null", "true", "kind: flips", "models: {ego: ''}", "law: []", "'", '"\\U']
    ),
)


def loads_or_says_why(path: Path, text: str) -> None:
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    with suppress(MjmergeError):
        load(path)


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(text=st.text() | st.lists(SCRAP, max_size=12).map("".join))
def test_no_text_breaks_the_loader(text, tmp_path):
    loads_or_says_why(tmp_path / "s.yaml", text)


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_no_mutation_of_a_scenario_breaks_the_loader(data, tmp_path):
    lines = list(PAPER)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(lines) - 1))
        column = data.draw(st.integers(0, len(lines[at])))
        match data.draw(st.sampled_from(["drop", "repeat", "swap", "insert", "cut", "value"])):
            case "drop" if len(lines) > 1:
                del lines[at]
            case "repeat":
                lines.insert(at, lines[at])
            case "swap":
                lines[at], lines[0] = lines[0], lines[at]
            case "insert":
                lines[at] = lines[at][:column] + data.draw(SCRAP) + lines[at][column:]
            case "cut":
                lines[at] = lines[at][:column]
            case "value":
                lines[at] = lines[at].partition(":")[0] + ": " + data.draw(SCRAP)
    loads_or_says_why(tmp_path / "s.yaml", "\n".join(lines))


@settings(max_examples=40, deadline=None)
@given(
    key=st.sampled_from(
        ["law.k_o", "drivers.vehicle_2.moves.0", "initial.ego.front_m", "models.ego", "a.b", ""]
    )
    | st.text(max_size=10),
    value=SCRAP,
)
def test_no_override_breaks_the_loader(key, value):
    with suppress(MjmergeError):
        load(base(), [f"{key}={value}"])
