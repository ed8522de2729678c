"""The one exception for wrong input, and how a command reports it: a single plain sentence."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable

from railrepro import parent_death


class InputError(ValueError):
    """Input that is refused; the message names file, row or key, what was found and what is allowed, in one line."""

    def __init__(self, message: str):
        super().__init__(" ".join(message.splitlines()))


def report_errors(command: Callable[[], int | None]) -> int:
    """Run a command; what stops it is reported in one sentence.

    Returns
    -------
    int
        Exit code: what the command returned (None is 0), 1 after an `InputError` or where the system refuses a file,
        130 after Ctrl-C or the end of make.
    """
    try:
        if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:  # of the time of imports, see the package
            signal.signal(signal.SIGINT, signal.default_int_handler)
        parent_death.follow_make()
        return command() or 0
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        where = error.filename2 or error.filename or "the system"
        print(f"error: {where}: {error.strerror or error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted; nothing half-written, run again to resume", file=sys.stderr)
        return 130
