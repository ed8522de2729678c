"""Model predictive control of railway running gears with driven independently rotating wheels, replicated."""

import signal
import sys

__version__ = "0.2.0.dev0"

_COMMAND = sys.argv[:1] == ["-m"] and any(
    part.removeprefix("-m").partition(".")[0] == __name__ for part in sys.orig_argv
)
# A command of this package imports for seconds: Ctrl-C ends it without a traceback until `errors.told` takes over.
if _COMMAND and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, signal.SIG_DFL)
