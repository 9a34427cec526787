"""The Rerun viewer as we start it: only this machine can reach it, and it talks to nobody."""

from __future__ import annotations

import os
import sys

HOST = "127.0.0.1"
_NOWHERE = f"http://{HOST}:9"  # the discard port, on which nobody listens
_SWITCHES = {
    "CI": "1",  # no analytics, whatever the user's configuration says
    **dict.fromkeys(("HTTPS_PROXY", "https_proxy", "HTTP_PROXY", "http_proxy", "ALL_PROXY"), _NOWHERE),
    **dict.fromkeys(("NO_PROXY", "no_proxy"), f"{HOST},localhost"),  # its own port
}
"""Rerun 0.41 sends usage data to its makers unless it is on CI, and asks GitHub for a newer version."""


def command(*arguments: str) -> list[str]:
    """The command line of a viewer that only this machine can reach."""
    return [sys.executable, "-m", "rerun", "--bind", HOST, *arguments]


def environment() -> dict[str, str]:
    """The environment in which Rerun's programs send nothing to anybody."""
    inherited = {name: value for name, value in os.environ.items() if name != "FORCE_RERUN_ANALYTICS"}
    return inherited | _SWITCHES
