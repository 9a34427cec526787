"""Versions of what a run depends on, and the revision of this checkout."""

from __future__ import annotations

import platform
import subprocess
from collections.abc import Sequence
from functools import cache
from importlib import metadata
from pathlib import Path

_PACKAGES = ("mjmerge", "mujoco", "dm-control", "numpy", "rerun-sdk", "mcap", "foxglove-sdk")


def versions(packages: Sequence[str] = _PACKAGES) -> dict[str, str]:
    """Version of Python and of each package that a recording depends on; those not installed are left out."""
    found = {"python": platform.python_version()}
    known = {package: _version(package) for package in packages}
    return found | {package: version for package, version in known.items() if version is not None}


@cache  # what is installed is read from files, package by package
def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


@cache
def git_revision() -> str | None:
    """Revision of the checkout this file is tracked in, ``-dirty`` if edited; ``None`` outside of one."""
    here = Path(__file__)

    def git(*arguments: str) -> str:
        command = ["git", "-C", str(here.parent), *arguments]
        return subprocess.run(command, check=True, capture_output=True, text=True, timeout=10).stdout.strip()

    try:
        git("ls-files", "--error-unmatch", here.name)
        return git("describe", "--always", "--dirty", "--abbrev=12")
    except (OSError, subprocess.SubprocessError):
        return None
