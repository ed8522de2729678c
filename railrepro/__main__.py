"""The command line: `python -m railrepro COMMAND …`; make calls it. What a command needs is imported when it runs."""

from __future__ import annotations

import importlib
import signal
import sys
from functools import partial

if __name__ == "__main__" and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    # A command imports for seconds: Ctrl-C ends it without a traceback until `report_errors` takes over.
    signal.signal(signal.SIGINT, signal.SIG_DFL)

from railrepro import numerics  # noqa: E402
from railrepro.data import InputError  # noqa: E402
from railrepro.evidence.commands import parser, report_errors  # noqa: E402


def main(arguments: list[str] | None = None) -> int:
    """Run one command.

    Returns
    -------
    int
        Exit code, see `evidence.commands.report_errors`; 2 after wrong arguments.
    """
    chosen = vars(parser().parse_args(arguments))
    numerics.fix()  # before a command imports NumPy
    module, _, name = chosen.pop("call").partition(":")
    try:
        # outside of `report_errors`: libraries that are interrupted while they are imported fail in ways of their own
        call = getattr(importlib.import_module(module), name)
    except (InputError, ModuleNotFoundError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return report_errors(partial(call, **chosen))


if __name__ == "__main__":
    sys.exit(main())
