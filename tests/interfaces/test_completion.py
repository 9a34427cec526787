"""What the shell completes is what there is, command by command and key by key."""

from __future__ import annotations

import os
import re
import shutil
import subprocess

import pytest

from mjmerge.cli import COMMANDS, command, main
from mjmerge.cli.completion import script
from mjmerge.cli.keys import table
from mjmerge.cli.taken import options
from mjmerge.config import shipped
from mjmerge.config.document import parse
from mjmerge.drivers import kinds as drivers
from mjmerge.errors import ScenarioError
from mjmerge.law import VARIANTS, kinds
from mjmerge.roster import PLANTS
from mjmerge.scenario.load import dump, load
from mjmerge.scenario.mismatch import Mismatch

ASK = """
COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); _mjmerge; printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.fixture(scope="module")
def offered(tmp_path_factory):
    """What bash offers for the last of these words, with nothing at hand but awk."""
    folder = tmp_path_factory.mktemp("shell")
    (folder / "bin").mkdir()
    (folder / "bin" / "awk").symlink_to(shutil.which("awk"))
    (folder / "script").write_text(script() + ASK)

    def ask(*words, at=folder):
        asked = [shutil.which("bash"), "--norc", str(folder / "script"), "mjmerge", *words]
        env = {**os.environ, "PATH": str(folder / "bin")}
        done = subprocess.run(asked, cwd=at, env=env, capture_output=True, text=True, timeout=20, check=True)
        assert done.stderr == ""
        return done.stdout.split()

    return ask


@pytest.mark.parametrize(
    ("words", "names"),
    [
        ([""], COMMANDS),
        (["re"], ["recover", "replay", "reproduce"]),
        (["--v"], ["--version"]),
        (["run", ""], shipped.scenarios()),
        (["run", "highway_b"], ["highway_brakes"]),
        (["run", "paper", "--plant", ""], PLANTS),
        (["run", "paper", "--seed", ""], []),
        (["run", "--live"], ["--live", "--live-at", "--live-fast"]),
        (["run", "--no"], ["--no-record"]),
        (["sweep", ""], [*shipped.campaigns(), *shipped.scenarios()]),
        (["sweep", "charge", "--break", "mismatch.fri"], ["mismatch.friction"]),
        (["sweep", "charge", "--engine", "r"], ["ray"]),
        (["falsify", "charge", "--against", ""], [*PLANTS, *kinds()]),
        (["identify", ""], shipped.models()),
        (["new", "m"], ["metric"]),
        (["list", "a"], ["all", "axes"]),
        (["verify", ""], []),
        (["verify", "--j"], ["--json"]),
        (["schema", "d"], ["datasheet"]),
        (["completion", ""], ["bash", "zsh"]),
    ],
)
def test_bash_offers_what_may_come_next(words, names, offered):
    assert sorted(offered(*words)) == sorted(names)


def test_where_nothing_is_known_it_offers_files():
    assert script().splitlines()[-1] == "complete -o default -o nospace -F _mjmerge mjmerge"


CHARGE = ("run", "charge", "--set")
MPC = ("--set", "law.kind", "=", "mpc")


@pytest.mark.parametrize(
    ("words", "names"),
    [
        ((*CHARGE, "mis"), ["mismatch."]),
        ((*CHARGE, "sea"), ["search."]),
        (("run", "charge", *MPC, "--set", "law.guarded", "="), ["true", "false"]),
        ((*CHARGE, "mismatch.fr"), ["mismatch.friction=", "mismatch.front_stiffness="]),
        ((*CHARGE, "mismatch."), [f"mismatch.{name}=" for name in Mismatch.model_fields]),
        ((*CHARGE, "initial.vehicle_"), ["initial.vehicle_1.", "initial.vehicle_2."]),
        ((*CHARGE, "drivers.vehicle_2.g"), ["drivers.vehicle_2.gap_m="]),
        ((*CHARGE, "drivers.vehicle_1.g"), ["drivers.vehicle_1.gain_per_s="]),
        ((*CHARGE, "law.k_"), [f"law.k_{name}=" for name in ("p", "v", "o", "w", "mu", "s")]),
        (("run", "charge", *MPC, "--set", "law.k_"), ["law.k_p=", "law.k_v="]),
        (("run", "charge", "--set", "law.kind=mpc", "--set", "law.h"), ["law.horizon_s="]),
        (("run", "platoon_8", "--set", "drivers.vehicle_8.ch"), ["drivers.vehicle_8.changes="]),
        (("run", "--set", "law.q_"), ["law.q_p=", "law.q_v=", "law.q_c="]),
        (("falsify", "charge", "--set", "search.l"), ["search.level=", "search.leave_out="]),
        (("harden", "charge", "--key", ""), ["law.", "actuation."]),
        (("harden", "charge", "--key", "law.variant", "=", "gated,gu"), ["gated,guarded"]),
        (
            ("sweep", "charge", "--break", "mismatch.friction,mismatch.bra"),
            ["mismatch.friction,mismatch.brake_limit"],
        ),
        (("sweep", "charge", "--break", "mismatch.ty"), []),
        ((*CHARGE, "mismatch.tyres", "="), ["slip", "ideal"]),
        ((*CHARGE, "mismatch.tyres", "=", "i"), ["ideal"]),
        ((*CHARGE, "mismatch.tyres=i"), ["mismatch.tyres=ideal"]),
        ((*CHARGE, "mismatch.friction", "="), []),
        ((*CHARGE, "law.kind", "="), kinds()),
        ((*CHARGE, "law.variant", "="), VARIANTS),
        ((*CHARGE, "law.variant", "=", "gated+o"), ["gated+one_sided"]),
        ((*CHARGE, "law.leader", "="), ["vehicle_1", "vehicle_2"]),
        ((*CHARGE, "models.vehicle_1", "="), shipped.models()),
        ((*CHARGE, "drivers.vehicle_2.kind", "="), drivers()),
        ((*CHARGE, "law.k_o", "=", "0", "--set", "road.t"), ["road.taper_m=", "road.told="]),
        (("run", "charge", "--plant", "=", "bicycle_"), ["bicycle_limited"]),
    ],
)
def test_bash_offers_keys_and_what_they_may_be(words, names, offered):
    assert sorted(offered(*words)) == sorted(names)


MINE = """
initial: {vehicle_1: {speed_mps: 2}, vehicle_2: {speed_mps: 2}, vehicle_3: {speed_mps: 2}}  # vehicle_4 is not
law: {kind: "rss"}
drivers:
  vehicle_1: {kind: steady}
  vehicle_3:   # kind: steady
    kind: idm
"""


@pytest.mark.parametrize("where", ["mine.yaml", "a run/scenario.yaml", "at=once.yaml"])
def test_a_file_and_a_run_say_which_keys_they_have(where, offered, tmp_path):
    (tmp_path / where).parent.mkdir(exist_ok=True)
    (tmp_path / where).write_text(MINE)
    asked = ("explain", where.removesuffix("/scenario.yaml"), "--set")
    assert sorted(offered(*asked, "initial.v", at=tmp_path)) == [f"initial.vehicle_{j}." for j in (1, 2, 3)]
    assert offered(*asked, "drivers.vehicle_3.e", at=tmp_path) == ["drivers.vehicle_3.exponent="]
    assert offered(*asked, "law.res", at=tmp_path) == ["law.response_time_s="]
    assert offered(*asked, "law.va", at=tmp_path) == []


@pytest.mark.parametrize("name", ["charge", "platoon_8_small"])
def test_the_keys_of_a_scenario_are_offered_and_no_other(name, offered):
    found, parts = [], [""]
    while parts:
        more = offered("run", name, "--set", parts.pop())
        found += [word[:-1] for word in more if word.endswith("=")]
        parts += [word for word in more if word.endswith(".")]
    with pytest.raises(ScenarioError) as refused:
        load(name, [f"{key}=[{{}}]" for key in found])
    assert "unknown key" not in str(refused.value)

    def keys(value, at=""):
        inside = value.items() if isinstance(value, dict) else ()
        return [key for k, v in inside for key in keys(v, f"{at}.{k}")] or [at[1:]]

    written = {key for key in keys(parse(dump(load(name))).value) if not key.startswith("search.axes.")}
    assert {key for key in written if not any(f"{one}.".startswith(f"{key}.") for one in found)} == set()


def test_what_a_key_may_be_is_taken():
    rows = [line.split() for line in table().splitlines()]
    for _, key, *choices in rows:
        for choice in choices if key.startswith(("mismatch", "actuation", "road", "models.ego")) else ():
            load("ramp", [f"{key}={choice}"])
    assert sum(bool(choices) for _, _, *choices in rows) > 20


@pytest.mark.parametrize("name", COMMANDS)
def test_the_options_of_a_command_are_those_of_its_help(name, capsys):
    with pytest.raises(SystemExit):
        main([name, "--help"])
    begins = re.compile(r"^(?:│ |  )(?:-h, )?(--[\w-]+(?:, --[\w-]+)*)", re.MULTILINE)
    out = capsys.readouterr().out
    shown = begins.findall(out)
    flags = {flag for line in shown for flag in line.split(", ")}
    taken = list(options(command(name)))
    assert flags - {"--help"} == {flag for option in taken for flag in option.flags}
    assert all(f"{o.flags[0]} {o.takes}" in out for o in taken if o.flags and o.takes not in ("", "VALUE"))


@pytest.mark.skipif(shutil.which("zsh") is None, reason="there is no zsh here")
@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["run", "--plant", "bi"], ["bicycle", "bicycle_limited"]),
        (["run", "charge", "--set", "mismatch.fr"], ["mismatch.friction=", "mismatch.front_stiffness="]),
        (["run", "charge", "--set", "mismatch.tyres="], ["mismatch.tyres=slip", "mismatch.tyres=ideal"]),
        (["run", "platoon_8", "--set", "drivers.vehicle_8.k"], ["drivers.vehicle_8.kind="]),
    ],
)
def test_zsh_takes_it_too(words, names, capsys):
    with pytest.raises(SystemExit):
        main(["completion", "zsh"])
    script = "autoload -Uz compinit && compinit -u -D\n" + capsys.readouterr().out
    ask = f"words=(mjmerge {' '.join(words)}); CURRENT={len(words) + 1}"
    ask += "; _bash_complete -o default -o nospace -F _mjmerge"
    code = f"{script}compadd() {{ print -l -- $@ }}\n{ask}"
    done = subprocess.run(["zsh", "-f", "-c", code], capture_output=True, text=True, timeout=20, check=False)
    said = [word for word in done.stdout.split() if word[0] != "-" and word.startswith(words[-1])]
    assert sorted(said) == sorted(names), done.stderr
