"""The command line: ``mjmerge run paper``. A command is a file: what it takes, prints and exits with."""

from __future__ import annotations

import gc
import logging
import os
import signal
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from errno import ENAMETOOLONG
from importlib import import_module
from threading import Event, Timer, current_thread, main_thread
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any, Union

import tyro

from mjmerge.cli.crash import report
from mjmerge.cli.streams import standard
from mjmerge.cli.taken import given
from mjmerge.errors import MjmergeError, nearest
from mjmerge.interrupts import INTERRUPTED, is_command, leave, leave_quietly
from mjmerge.outputs import no_room
from mjmerge.versions import versions

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

COMMANDS = (
    "run",
    "reproduce",
    "sweep",
    "falsify",
    "explain",
    "probability",
    "harden",
    "traffic",
    "check",
    "theorem",
    "survey",
    "identify",
    "list",
    "new",
    "view",
    "verify",
    "replay",
    "compare",
    "video",
    "recover",
    "convert",
    "export",
    "schema",
    "completion",
)
"""In the order of the help: each a file, and in it a class of that name."""
_BAD_INPUT, _FAILED, _TERMINATED = 2, 3, 128 + signal.SIGTERM
_AGAIN_S = 0.005
_GARBAGE = 50_000
"""New objects after which Python looks for garbage: what a command imports makes 200,000, and no garbage."""


def main(argv: list[str] | None = None) -> None:
    """Entry point of the ``mjmerge`` command: every way to end is an exit code, none of them a traceback.

    Exit code 1 is a verdict, and only ever comes from a command. What it raises is bad input (2) if it says
    so itself, and else a failure (3): a disk or an output that is full, or a mistake of ours, which leaves a
    file with the details.
    """
    arguments = sys.argv[1:] if argv is None else [*argv]
    if is_command():
        _hush_libraries()
        gc.set_threshold(_GARBAGE)
    with standard() as streams, _signals() as (interrupted, terminated):
        code = _answer(arguments, interrupted, terminated)
        lost = streams.lost
        if lost:
            _say(f"standard output did not take everything: {lost}")
            code = _FAILED
    sys.exit(code)


def _hush_libraries() -> None:
    """What libraries tell their programmers is not for users; ``-W`` and ``RUST_LOG`` bring it back."""
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
        logging.disable()
    os.environ.setdefault("RUST_LOG", "off")


def _answer(arguments: Sequence[str], interrupted: Event, terminated: Event) -> int:
    """Runs the command that the arguments ask for; returns its exit code."""
    asked: Any = None
    try:
        asked = _parsed(arguments)
        return int(asked())
    except SystemExit as ended:  # help, a misspelt option, SIGTERM
        if terminated.is_set():  # some libraries turn the exception into one with a code of their own
            return _TERMINATED
        return ended.code if isinstance(ended.code, int) else _BAD_INPUT if ended.code else 0
    except BaseException as error:  # a panic in what is made of Rust is no Exception
        leave_quietly()
        if terminated.is_set():
            return _TERMINATED
        if interrupted.is_set() or isinstance(error, KeyboardInterrupt):
            kept = getattr(asked, "kept", "")
            _say(f"interrupted{'; ' if kept else ''}{kept}")
            return INTERRUPTED
        if isinstance(error, MjmergeError):
            _say(str(error))
            return _FAILED if error.failed or no_room(error) else _BAD_INPUT
        if isinstance(error, OSError) and error.errno == ENAMETOOLONG:
            _say(f"the name {str(error.filename)[:60]}... is too long for a file")
            return _BAD_INPUT
        if isinstance(error, MemoryError):
            _say("there is not enough memory for this: ask for fewer runs at a time, or a shorter one")
        elif no_room(error):
            _say("the disk is full, or failing; what was written before is kept")
        else:
            _say(report(error, arguments))
        return _FAILED


def _parsed(arguments: Sequence[str]) -> Any:
    """The command with its options; of the others, only the help of them all reads the files.

    Raises:
        MjmergeError: there is no such command, or a word is none of the few that it takes there.
    """
    first = arguments[0] if arguments else ""
    if first in COMMANDS:
        return given(command(first), first, arguments[1:])
    if first and not first.startswith("-"):
        raise MjmergeError(f"no command called {first!r}: {nearest(first, COMMANDS)}")
    if first == "--version":
        return _version
    if not first:
        with suppress(SystemExit):
            _parsed(["--help"])
        raise SystemExit(_BAD_INPUT)
    every = ((name, command(name)) for name in COMMANDS)
    named = (Annotated[c, tyro.conf.subcommand(n, description=_in_a_line(c))] for n, c in every)
    one_of: Any = Union[tuple(named)]  # noqa: UP007
    return tyro.cli(
        one_of,
        prog="mjmerge",
        description="Does the merge that a paper proves safe survive real cars? `mjmerge run paper` runs it, "
        "`mjmerge COMMAND --help` says what a command takes, `mjmerge --version` which this is.",
        args=arguments,
    )


def _in_a_line(made_by: Any) -> str:
    """What a command does: the first sentence of its help."""
    first: str = made_by.__doc__.split("\n\n")[0]
    return first.partition(". Exit code")[0].rstrip(".") + "."


def _version() -> int:
    print(f"mjmerge {versions()['mjmerge']}")
    return 0


def command(name: str) -> Any:
    """What a command is made by, from its options."""
    return getattr(import_module(f"{__name__}.{name}"), name.capitalize())


@contextmanager
def _signals() -> Iterator[tuple[Event, Event]]:
    """SIGTERM and SIGINT as exceptions, so that recordings are closed; yields whether either came.

    Python drops what is raised while an object is being deleted, or in a library's callback: a signal that
    comes at such a moment comes again a little later.
    """
    interrupted, terminated = Event(), Event()

    def terminate(signum: int, frame: FrameType | None) -> None:
        del signum, frame
        terminated.set()
        raise SystemExit(_TERMINATED)

    def interrupt(signum: int, frame: FrameType | None) -> None:
        del signum, frame
        interrupted.set()  # some libraries turn the exception into one of their own
        raise KeyboardInterrupt

    def dropped(what: UnraisableHookArgs) -> None:
        if isinstance(what.exc_value, SystemExit) and terminated.is_set():
            number = signal.SIGTERM
        elif isinstance(what.exc_value, KeyboardInterrupt):
            number = signal.SIGINT
        else:
            told(what)
            return
        again = Timer(_AGAIN_S, signal.pthread_kill, (main_thread().ident, number))
        again.daemon = True
        again.start()

    if current_thread() is not main_thread():
        yield interrupted, terminated
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    signal.signal(signal.SIGTERM, terminate)
    if before[signal.SIGINT] in (signal.default_int_handler, leave):
        signal.signal(signal.SIGINT, interrupt)
    told, sys.unraisablehook = sys.unraisablehook, dropped
    try:
        yield interrupted, terminated
    finally:
        sys.unraisablehook = told
        for number, handler in before.items():
            signal.signal(number, handler)


def _say(text: str) -> None:
    """A line on standard error; what a file smuggled into it cannot move the cursor."""
    plain = "".join(c if c.isprintable() or c == "\n" else f"\\x{ord(c):02x}" for c in text)
    print(f"mjmerge: {plain}", file=sys.stderr)
