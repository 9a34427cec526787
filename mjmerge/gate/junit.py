"""The gate as JUnit XML, in the form that both common schemas agree on: Ant's and that of Jenkins' xUnit."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING
from xml.etree import ElementTree

if TYPE_CHECKING:
    from mjmerge.gate.result import Result

_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def junit(results: Sequence[Result], why: Sequence[str]) -> bytes:
    """A test suite with a case per row: a failure where it fails, an error where its simulation stopped.

    Args:
        results: of the rows.
        why: what to say of each where it fails, in lines.
    """
    failed = [bool(r.problems) and not r.stopped for r in results]
    suite = ElementTree.Element(
        "testsuite",
        name="mjmerge check",
        timestamp=datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S"),
        hostname="localhost",
        tests=str(len(results)),
        failures=str(sum(failed)),
        errors=str(sum(bool(r.stopped) for r in results)),
        skipped="0",
        time=f"{sum(r.wall_s for r in results):.3f}",
    )
    ElementTree.SubElement(suite, "properties")
    for result, text in zip(results, why, strict=True):
        case = ElementTree.SubElement(
            suite,
            "testcase",
            classname=_plain(result.row.file.stem),
            name=_plain(result.row.check.name),
            time=f"{result.wall_s:.3f}",
        )
        if result.problems:
            kind = "error" if result.stopped else "failure"
            message = _plain("; ".join(result.problems))
            ElementTree.SubElement(case, kind, message=message, type=kind).text = _plain(text)
    ElementTree.SubElement(suite, "system-out")
    ElementTree.SubElement(suite, "system-err")
    written: bytes = ElementTree.tostring(suite, encoding="utf-8", xml_declaration=True)
    return written


def _plain(text: str) -> str:
    """Text without the characters that XML cannot hold."""
    return _NOT_XML.sub("?", text)
