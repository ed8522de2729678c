"""The commands of `python -m railrepro` and their arguments; the modules of a command are imported when it runs."""

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
    """Call `command` and return the exit code of the process. The code is the integer that `command` returns, or 0 for
    any other result, which is printed unless it is None. It is 1 for an InputError or OSError, which is printed to
    stderr in one sentence. Ctrl-C ends this process and all processes that it started with the code 130."""
    try:
        if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:  # set for the imports, see `railrepro.__main__`
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
    """Print to stdout and flush it; InputError when that fails."""
    try:
        print(text, end="", flush=True)
    except OSError as error:
        sys.stdout = None  # Python would try again at its end to write what is lost
        raise InputError(f"standard output cannot be written ({error.strerror})") from error


def end(code: int) -> NoReturn:
    """Kill all child processes of this process, then end it at once with the exit code `code`, without clean-up."""
    import psutil

    for process in psutil.Process().children(recursive=True):
        with suppress(psutil.Error):
            process.kill()
    sys.stdout.flush()
    os._exit(code)


def end_with(leader: int) -> None:
    """Wait until the process with the id `leader` has ended, then `end` this process with the exit code 1. Thus a
    command that `make` started does not outlive it."""
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


_CALLS = {
    "figures": ("evidence.chain.chain:figures", "run the notebooks that are stale"),
    "drive": ("evidence.chain.chain:drive", "run the chapters 00 to 09 with your own car"),
    "verify": ("evidence.chain.chain:verify", "rerun all notebooks and compare with the committed products"),
    "html": ("evidence.chain.book:html", "make a book of the executed notebooks in build/html"),
    "tune": ("tuning.tune:main", "tune controllers by particle swarm, write data/tuned (long, resumes)"),
    "probe": ("evidence.report.flips:main", "measure the nominal car (long), or list verdicts that answers flip"),
    "calibrated": ("evidence.claims.calibrated:main", "judge the calibrated car, data/paper_like.toml (long)"),
    "robustness": ("evidence.uncertainty.robustness:main", "judge samples of the car for robustness (long, resumes)"),
    "margins": ("evidence.uncertainty.margins:main", "compute the stability margins of all tuned sets (long)"),
    "loop": ("evidence.uncertainty.loop:main", "measure loop over unseen seeds, and its limit (long, resumes)"),
    "bench": ("evidence.bench.speed:main", "measure speed, write data/results"),
    "report": ("evidence.report.page:main", "judge the statements, write REPLICATION.md, numbers of README.md"),
    "score": ("evidence.benchmark:main", "score a controller on the benchmark, write build/score"),
    "leaderboard": ("evidence.benchmark:leaderboard", "score registered controllers and examples/ (long)"),
    "release": ("evidence.release:main", "make an archive with the runs of Figs. 6 to 9 as data for other programs"),
    "live": ("export.live:main", "make the page in build/live that drives the car in a browser"),
}
"""Command -> function that it calls, as "module:name", and help text."""


def parser() -> argparse.ArgumentParser:
    """Make the parser of the command line; its results have the argument `call`, the function as "module:name"."""
    description = "Model predictive control of railway running gears, replicated."
    top = _Parser(prog="python -m railrepro", description=description)
    commands, added = top.add_subparsers(required=True, metavar="COMMAND"), {}
    for name, (call, words) in _CALLS.items():
        added[name] = commands.add_parser(name, help=words, description=words)
        added[name].set_defaults(call=f"railrepro.{call}")
    for name, argument, words in (
        ("figures", "names", "notebooks or figures, as fig06; default all"),
        ("tune", "names", "settings and controllers; default all"),
        ("probe", "settings", "paper, swarm, loop; default all; or FILE.toml, a filled data/answers.toml"),
    ):
        added[name].add_argument(argument, nargs="*", metavar=argument[:-1].upper(), help=words)
    added["drive"].add_argument("vehicle", type=Path, help="a file like data/vehicle.toml")
    added["score"].add_argument("controller", help="a Python file with one controller class, or a registered name")
    seeds = added["score"].add_mutually_exclusive_group()
    seeds.add_argument("--seed", type=int, default=argparse.SUPPRESS, help="a different random seed")
    seeds.add_argument("--ranked", action="store_true", help="the five seeds that follow from the content of the file")
    return top
