"""One name, one thing: what an option of one command is called and takes, it is and takes in all others."""

from __future__ import annotations

import re
from collections import defaultdict
from itertools import pairwise

import pytest

from mjmerge.cli import COMMANDS, command, main
from mjmerge.cli.taken import options

OWN = {"--method"}
"""Options that choose among what only their command has."""
PLACES = {"DIR", "FILE"}
"""What --out is: a folder where a command leaves several files, and else a file."""


FEW = [(name, option) for name in COMMANDS for option in options(command(name)) if option.values]
"""Everything that is one of a few words, with its command."""


def taken():
    """What every option takes, by its name and command."""
    found = defaultdict(dict)
    for name in COMMANDS:
        for option in options(command(name)):
            for flag in option.flags:
                found[flag][name] = (option.takes, option.values, option.flags)
    return found


@pytest.mark.parametrize("flag", sorted(taken().keys() - OWN - {"--out"}))
def test_an_option_takes_the_same_in_every_command(flag):
    by_command = taken()[flag]
    assert len({*by_command.values()}) == 1, by_command


def test_what_comes_out_goes_to_a_folder_or_a_file_that_is_called_out():
    assert {takes for takes, _, _ in taken()["--out"].values()} == PLACES
    for flag, by_command in taken().items():
        said = {takes for takes, _, _ in by_command.values()}
        assert flag in ("--out", "--junit", "--baselines", "--from") or not said & PLACES


def test_what_is_recorded_and_what_is_simulated_is_called_so_everywhere():
    alone = {name: [o.takes for o in options(command(name)) if not o.flags] for name in COMMANDS}
    recorded = ["verify", "replay", "video", "recover", "convert", "view"]
    assert [alone[name] for name in (*recorded, "compare")] == [["RUN"]] * len(recorded) + [["RUN", "RUN"]]
    for name in ("run", "falsify", "probability", "harden", "export"):
        assert alone[name] == ["SCENARIO"]


@pytest.mark.parametrize("name", COMMANDS)
def test_what_is_said_of_an_option_fits_on_a_line(name, capsys, monkeypatch):
    """In a wide window; tyro would keep the breaks of a docstring's lines in a narrow one."""
    monkeypatch.setenv("COLUMNS", "200")
    with pytest.raises(SystemExit):
        main([name, "--help"])
    lines = capsys.readouterr().out.splitlines()
    boxed = [line.strip("│ ") if line[1:].startswith("     ") else "" for line in lines]
    assert [line for line, after in pairwise(boxed) if line and after] == []


def test_no_command_is_bad_input_and_answered_by_a_line_for_each(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "140")
    with pytest.raises(SystemExit) as end:
        main([])
    said = capsys.readouterr().out
    assert end.value.code == 2
    lines = re.findall(r"^[│ ]   • (\w+) +(\S.*?\S) *│?$", said, re.MULTILINE)
    assert tuple(name for name, _ in lines) == COMMANDS
    assert all(line.endswith(".") and "Exit code" not in line for _, line in lines)


@pytest.mark.parametrize(("name", "option"), FEW)
def test_one_of_a_few_words_is_told_with_the_nearest_in_a_line(name, option, capsys):
    alone = [one for one in options(command(name)) if not one.flags]
    place = "".join(option.flags) or name
    for word in option.values:
        wrong = f"{word[:-1]}{2 * word[-1]}"
        words = [wrong if one == option else "x" for one in alone]
        with pytest.raises(SystemExit) as end:
            main([name, *words, *((*option.flags, wrong) if option.flags else ())])
        out, err = capsys.readouterr()
        assert (end.value.code, out) == (2, "")
        assert err == f"mjmerge: {place} takes no {wrong!r}: did you mean {word!r}?\n"


def test_what_is_like_none_of_the_words_is_told_with_all_of_them(capsys):
    assert len(FEW) > 8
    with pytest.raises(SystemExit):
        main(["completion", "fi"])
    assert capsys.readouterr().err == "mjmerge: completion takes no 'fi': valid names: bash, zsh\n"


def test_a_word_that_is_right_is_taken(capsys):
    with pytest.raises(SystemExit) as end:
        main(["schema", "campaign"])
    assert end.value.code == 0
    assert '"title": "Campaign"' in capsys.readouterr().out
