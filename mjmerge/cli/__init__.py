"""The command line: ``mjmerge run paper``. A command is a file: what it takes, prints and exits with."""

from __future__ import annotations

import signal
import sys
from types import FrameType
from typing import Annotated, Any, Union

import tyro

from mjmerge.cli.check import Check
from mjmerge.cli.compare import Compare
from mjmerge.cli.convert import Convert
from mjmerge.cli.export import Export
from mjmerge.cli.identify import Identify
from mjmerge.cli.list import List
from mjmerge.cli.recover import Recover
from mjmerge.cli.replay import Replay
from mjmerge.cli.reproduce import Reproduce
from mjmerge.cli.run import Run
from mjmerge.cli.schema import Schema
from mjmerge.cli.survey import Survey
from mjmerge.cli.sweep import Sweep
from mjmerge.cli.theorem import Theorem
from mjmerge.cli.verify import Verify
from mjmerge.cli.video import Video
from mjmerge.cli.view import View
from mjmerge.errors import MjmergeError

COMMANDS: tuple[Any, ...] = (
    Run,
    Reproduce,
    Sweep,
    Check,
    Theorem,
    Survey,
    Identify,
    List,
    View,
    Verify,
    Replay,
    Compare,
    Video,
    Recover,
    Convert,
    Export,
    Schema,
)
"""In the order of the help."""
_BAD_INPUT, _INTERRUPTED = 2, 130
_KEPT = "what was recorded is kept as *.partial"


def _terminate(signum: int, frame: FrameType | None) -> None:
    """SIGTERM as an exception, so that recordings are closed."""
    del frame
    raise SystemExit(128 + signum)


def main(argv: list[str] | None = None) -> None:
    """Entry point of the ``mjmerge`` command."""
    signal.signal(signal.SIGTERM, _terminate)
    named = (Annotated[c, tyro.conf.subcommand(c.__name__.lower())] for c in COMMANDS)
    one_of: Any = Union[tuple(named)]  # noqa: UP007
    command = tyro.cli(
        one_of,
        prog="mjmerge",
        description="Does the merge that a paper proves safe survive real cars?",
        args=argv,
    )
    try:
        sys.exit(command())
    except MjmergeError as error:
        print(f"mjmerge: {error}", file=sys.stderr)
        sys.exit(_BAD_INPUT)
    except KeyboardInterrupt:
        print(f"mjmerge: interrupted; {getattr(command, 'kept', _KEPT)}", file=sys.stderr)
        sys.exit(_INTERRUPTED)
