"""The command line, `python -m railrepro COMMAND …`; the Makefile runs its commands."""

import signal
import sys

if __name__ == "__main__" and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    # The imports of a command take seconds. Until `report_errors` handles Ctrl-C, it ends without a traceback.
    signal.signal(signal.SIGINT, signal.SIG_DFL)

from railrepro.evidence.commands import main  # noqa: E402

if __name__ == "__main__":
    sys.exit(main())
