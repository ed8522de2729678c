"""The commands of `python -m railrepro` and their arguments; modules that a command needs are imported when it runs."""

from __future__ import annotations

import argparse
import importlib
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import NoReturn

from railrepro import numerics
from railrepro.data import InputError


def main(arguments: list[str] | None = None) -> int:
    """Run a command, as ["tune", "nmpc"] (default `sys.argv`); returns its exit code. Wrong arguments exit with 2."""
    try:
        if sys.stdout is None:
            raise InputError("standard output is closed")  # another file that is opened would take its place
        chosen = vars(parser().parse_args(arguments))
        numerics.fix()  # before a command imports NumPy
        module, _, name = chosen.pop("call").partition(":")
        # outside of `report_errors`: libraries that are interrupted while they are imported fail in ways of their own
        call = getattr(importlib.import_module(module), name)
    except (InputError, ModuleNotFoundError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return report_errors(partial(call, **chosen))


def report_errors(command: Callable[[], object]) -> int:
    """Call `command` and return the exit code of the process.

    An integer that `command` returns is the code; any other result gives 0 and is printed unless it is None. An
    InputError or OSError is printed to stderr in one sentence and gives 1. Ctrl-C ends this process and all processes
    that it started with the code 130.
    """
    try:
        if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:  # of the time of imports, see `railrepro.__main__`
            signal.signal(signal.SIGINT, signal.default_int_handler)
        leader = os.environ.get("RAILREPRO_LEADER", "")
        if leader.isdigit():
            threading.Thread(target=end_with, args=(int(leader),), daemon=True).start()
        result = command()
        code = result if isinstance(result, int) else 0
        _print("" if result is None or isinstance(result, int) else f"{result}\n")
        return code
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        where = error.filename2 or error.filename or "the system"
        print(f"error: {where}: {error.strerror or error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted; nothing half-written, run again to resume", file=sys.stderr, flush=True)
        end(130)


def _print(text: str) -> None:
    """Print to stdout, with all that was printed before, at once; InputError when that fails."""
    try:
        print(text, end="", flush=True)
    except OSError as error:
        sys.stdout = None  # what it holds back is lost, Python need not try again
        raise InputError(f"standard output cannot be written ({error.strerror})") from error


def end(code: int) -> NoReturn:
    """Kill all child processes of this process, and end this process at once with the exit code `code`."""
    import psutil

    for process in psutil.Process().children(recursive=True):
        with suppress(psutil.Error):
            process.kill()
    sys.stdout.flush()
    os._exit(code)


def end_with(leader: int) -> None:
    """Wait until the process with the id `leader` (make) has ended, then `end` this one with the exit code 1."""
    import psutil

    with suppress(psutil.NoSuchProcess):
        process = psutil.Process(leader)
        while process.is_running() and process.status() != psutil.STATUS_ZOMBIE:
            time.sleep(0.5)
    end(1)


class _Parser(argparse.ArgumentParser):
    """Reports wrong arguments, and help that cannot be printed, in one sentence."""

    def print_help(self, file=None) -> None:
        _print(self.format_help())

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"error: {message}; `{self.prog} --help` shows what is allowed\n")


def _file(text: str) -> Path:
    """Argument that names a file."""
    if not Path(text).is_file():
        raise argparse.ArgumentTypeError(f"there is no file {text!r}")
    return Path(text)


_CALLS = {
    "figures": ("evidence.chain.chain:figures", "run the notebooks that are stale"),
    "drive": ("evidence.chain.chain:drive", "run the chapters 00 to 09 with a car of one's own"),
    "verify": ("evidence.chain.chain:verify", "rerun all notebooks and compare with the committed products"),
    "html": ("evidence.chain.book:html", "executed notebooks as a book in build/html"),
    "tune": ("tuning.tune:main", "tune controllers by particle swarm, write data/tuned (long, resumes)"),
    "probe": ("evidence.report.flips:main", "metrics of the nominal car (long), or verdicts that answers flip"),
    "calibrated": ("evidence.claims.calibrated:main", "judge the calibrated car, data/paper_like.toml (long)"),
    "robustness": ("evidence.uncertainty.robustness:main", "robustness of the verdicts over samples (long, resumes)"),
    "margins": ("evidence.uncertainty.margins:main", "stability margins of all tuned sets (long)"),
    "loop": ("evidence.uncertainty.loop:main", "closed loop over unseen seeds, and its limit (long, resumes)"),
    "bench": ("evidence.bench.speed:main", "measure speed, write data/results"),
    "report": ("evidence.report.page:main", "judge the statements, write REPLICATION.md, numbers of README.md"),
    "score": ("evidence.benchmark:main", "score a controller on the benchmark, write build/score"),
    "leaderboard": ("evidence.benchmark:leaderboard", "score registered controllers and examples/ (long)"),
    "release": ("evidence.release:main", "an archive with the runs of Figs. 6 to 9 as data for other programs"),
    "live": ("export.live:main", "the page in build/live that drives the car in a browser"),
}
"""Commands with the function that each calls, as "module:name", and what it does."""
_ARGUMENTS: list[tuple[str, str, dict]] = [
    ("figures", "names", {"nargs": "*", "metavar": "NAME", "help": "notebooks or figures, as fig06; default all"}),
    ("drive", "vehicle", {"type": _file, "help": "a file like data/vehicle.toml"}),
    ("tune", "names", {"nargs": "*", "metavar": "NAME", "help": "settings and controllers; default all"}),
    ("probe", "settings", {"nargs": "*", "metavar": "SETTING", "help": "paper, swarm, loop; default all; or FILE.toml, "
                           "a filled data/answers.toml"}),
    ("score", "controller", {"help": "a Python file with one controller class, or a registered name"}),
    ("score", "--seed", {"type": int, "help": "a different random seed of noise, rails and cars"}),
    ("score", "--ranked", {"action": "store_true", "help": "the five seeds that follow from the content of the file"}),
]  # fmt: skip
"""Command, name of an argument, options of `add_argument`."""


def parser() -> argparse.ArgumentParser:
    """Parser of the command line; the parsed argument `call` is the function of the command as "module:name"."""
    top = _Parser(
        prog="python -m railrepro", description="Model predictive control of railway running gears, replicated."
    )
    commands = top.add_subparsers(required=True, metavar="COMMAND")
    added = {name: commands.add_parser(name, help=words, description=words) for name, (_, words) in _CALLS.items()}
    for name, (call, _) in _CALLS.items():
        added[name].set_defaults(call=f"railrepro.{call}")
    for name, argument, options in _ARGUMENTS:
        added[name].add_argument(argument, **options)
    return top
