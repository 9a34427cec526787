"""What Ctrl-C does to the command while it is imported and once it is over: it ends at once, without a word.

Python's own answer is a traceback and the exit code 1, which reads like a verdict. Importing takes a second,
in which nothing has been written yet.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from pathlib import Path
from types import FrameType

INTERRUPTED = 130
"""Exit code of what was interrupted, as shells have it."""


def is_command() -> bool:
    """Whether this process is ``mjmerge`` or ``python -m mjmerge``, and not a program that imports it."""
    if sys.argv[:1] == ["-m"]:  # its module is still being looked for
        return any(word.split(".")[0] == "mjmerge" for word in sys.orig_argv)
    started = Path(sys.argv[0]) if sys.argv and sys.argv[0] else Path()
    return started.stem == "mjmerge" or started.parent.name == "mjmerge"


def leave(signum: int, frame: FrameType | None) -> None:
    """Ends the process without a word."""
    del signum, frame
    os._exit(INTERRUPTED)


def leave_quietly() -> None:
    """From now on, an interrupt ends the command at once; one that is ignored stays so."""
    in_main = threading.current_thread() is threading.main_thread()
    if in_main and signal.getsignal(signal.SIGINT) is signal.default_int_handler and is_command():
        signal.signal(signal.SIGINT, leave)


def without_window() -> None:
    """The command opens no window of MuJoCo's, whose import would start a process to look for a library.

    Half-started, that process says a traceback when the command ends. Videos are drawn by another process.
    """
    if is_command():
        os.environ.setdefault("MUJOCO_GL", "disable")


leave_quietly()
without_window()
