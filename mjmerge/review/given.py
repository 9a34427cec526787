"""Whether what a recording says was given beside its scenario's file is in the scenario."""

from __future__ import annotations

from collections.abc import Iterator

from mjmerge.config.document import parse
from mjmerge.errors import MjmergeError
from mjmerge.record.read import Recorded
from mjmerge.scenario.load import load

_PLACES = frozenset("./\\:")
"""In what may name a file or code, which a scenario holds under another name."""


def otherwise(found: Recorded) -> Iterator[str]:
    """What is said to have been set, and is not so in the scenario.

    Setting it again must change nothing. What names a file, and whole sections, are not looked at.
    """
    document, sheets = parse(found.scenario_yaml).value, found.sheets()
    recorded = load(document, sheets=sheets, code=False)
    for text in found.manifest.get("set", ()):
        value = parse(text.partition("=")[2]).value
        if isinstance(value, dict) or (isinstance(value, str) and _PLACES & {*value}):
            continue
        try:
            same = load(document, [text], sheets=sheets, code=False) == recorded
        except MjmergeError:
            same = False
        if not same:
            yield f"it says that {text} was set, and its scenario says otherwise"
