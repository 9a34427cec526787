"""``mjmerge completion``."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from mjmerge.cli import COMMANDS, command
from mjmerge.cli.keys import table
from mjmerge.cli.taken import Option, options
from mjmerge.config import shipped
from mjmerge.roster import PLANTS


@dataclass(frozen=True)
class Completion:
    """Print what completes commands, options, names and keys: `eval "$(mjmerge completion bash)"`."""

    shell: Annotated[Literal["bash", "zsh"], tyro.conf.Positional]
    """Which shell; the line above goes into ~/.bashrc or, with zsh in it, ~/.zshrc after compinit."""

    def __call__(self) -> int:
        """Run the command; return its exit code."""
        if self.shell == "zsh":
            print("autoload -U +X bashcompinit && bashcompinit")
        print(script(), end="")
        return 0


def script() -> str:
    """Functions for bash that offer what may come next; where nothing is known, files."""
    cases = []
    for name in COMMANDS:
        taken = list(options(command(name)))
        after: dict[str, list[str]] = {}  # which options are followed by what
        for option in taken:
            if option.flags and option.takes:
                after.setdefault(_offered(option), []).extend(f"{name}:{flag}" for flag in option.flags)
        cases += [f"      {'|'.join(said)}) {offered} ;;" for offered, said in after.items()]
        flags = " ".join(flag for option in taken for flag in option.flags)
        alone = " ".join(filter(None, (_words(option) for option in taken if not option.flags)))
        cases.append(f'      {name}:*) flags="{flags} --help" offer="{alone}" ;;')
    text = Path(__file__).with_suffix(".sh").read_text(encoding="utf-8")
    for name, put in {
        "scenarios": shlex.quote(str(shipped.folder("scenarios"))),
        "table": table(),
        "commands": " ".join(COMMANDS),
        "cases": "\n".join(cases),
    }.items():
        text = text.replace(f"@{name}@", put)
    return text


def _offered(option: Option) -> str:
    """What the shell sets for what may follow an option: words, keys of a scenario, whether several."""
    if option.takes in _KEYS:
        return f"keys='{_KEYS[option.takes]}'"
    return f'offer="{_words(option)}"' + (" many=1" if option.takes in _SEVERAL else "")


def _words(option: Option) -> str:
    """What an option may be that has a name, each after a space."""
    parts = option.takes.split("|")
    named = [word for part in parts if part in _NAMES for word in _NAMES[part]()]
    return " ".join([*option.values, *named, *(part for part in parts if part in PLANTS)])


def _laws() -> Collection[str]:
    from mjmerge.law import kinds

    return kinds()


def _variants() -> Collection[str]:
    from mjmerge.law import VARIANTS

    return VARIANTS


def _axes() -> Collection[str]:
    from mjmerge.scenario.mismatch import Mismatch, is_number

    return [f"mismatch.{name}" for name in Mismatch.model_fields if is_number(name)]


_NAMES: dict[str, Callable[[], Collection[str]]] = {
    "SCENARIO": shipped.scenarios,
    "CAMPAIGN": shipped.campaigns,
    "MODEL": shipped.models,
    "PLANT": lambda: PLANTS,
    "LAW": _laws,
    "VARIANT": _variants,
    "AXIS": _axes,
}
"""What is known by a name, by the word that the help has for it."""

_KEYS = {"KEY=VALUE": ".", "KEY=VALUES": "law[.]|actuation[.]"}
"""Of which sections of a scenario a key may be, by the word that the help has for it."""
_SEVERAL = ("AXIS",)
"""What may follow each other after commas."""
