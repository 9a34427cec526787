"""What the shell completes is what there is, command by command."""

from __future__ import annotations

import re
import shutil
import subprocess

import pytest

from mjmerge.cli import COMMANDS, command, main
from mjmerge.cli.completion import options, script
from mjmerge.config import shipped
from mjmerge.law import kinds
from mjmerge.roster import PLANTS

ASK = """
COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); _mjmerge; printf '%s\\n' "${COMPREPLY[@]}"
"""


def offered(folder, *words):
    """What bash offers for the last of these words."""
    asked = ["bash", "--norc", "-c", script() + ASK, "bash", "mjmerge", *words]
    done = subprocess.run(asked, cwd=folder, capture_output=True, text=True, timeout=20, check=True)
    assert done.stderr == ""
    return done.stdout.split()


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
def test_bash_offers_what_may_come_next(words, names, tmp_path):
    assert sorted(offered(tmp_path, *words)) == sorted(names)


def test_where_nothing_is_known_it_offers_files():
    assert script().splitlines()[-1] == "complete -o default -F _mjmerge mjmerge"


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
def test_zsh_takes_it_too(capsys):
    with pytest.raises(SystemExit):
        main(["completion", "zsh"])
    script = "autoload -Uz compinit && compinit -u -D\n" + capsys.readouterr().out
    ask = "words=(mjmerge run --plant bi); CURRENT=4; _bash_complete -o default -F _mjmerge"
    code = f"{script}compadd() {{ print -l -- $@ }}\n{ask}"
    done = subprocess.run(["zsh", "-f", "-c", code], capture_output=True, text=True, timeout=20, check=False)
    assert {"bicycle", "bicycle_limited"} <= {*done.stdout.split()}, done.stderr
