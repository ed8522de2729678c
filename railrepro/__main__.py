"""The command line: `python -m railrepro COMMAND …`; make calls it."""

import signal
import sys

if __name__ == "__main__" and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    # A command imports for seconds: Ctrl-C ends it without a traceback until `report_errors` takes over.
    signal.signal(signal.SIGINT, signal.SIG_DFL)

from railrepro.evidence.commands import main  # noqa: E402

if __name__ == "__main__":
    sys.exit(main())
