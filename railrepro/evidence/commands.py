"""The commands of `python -m railrepro` and their arguments, which are checked before anything starts."""

from __future__ import annotations

import argparse
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

from railrepro.data import InputError

PROGRAM = "python -m railrepro"


def report_errors(command: Callable[[], object]) -> int:
    """Run a command; what stops it is reported in one sentence.

    Returns
    -------
    int
        Exit code: the number that the command returned, 0 after anything else, which is printed; 1 after an
        `InputError` or where the system refuses a file, 130 after Ctrl-C.
    """
    try:
        if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:  # of the time of imports, see `railrepro.__main__`
            signal.signal(signal.SIGINT, signal.default_int_handler)
        leader = os.environ.get("RAILREPRO_LEADER", "")
        if leader.isdigit():
            threading.Thread(target=end_with, args=(int(leader),), daemon=True).start()
        result = command()
        if isinstance(result, int):
            return result
        if result is not None:
            print(result)
        return 0
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


def end_with(leader: int) -> None:
    """Wait for the end of another process (that of make), then kill this one and all that it started.

    They may be in a long call and could not end by themselves. What they write is written whole or not at all.
    """
    import psutil

    with suppress(psutil.NoSuchProcess):
        process = psutil.Process(leader)
        while process.is_running() and process.status() != psutil.STATUS_ZOMBIE:
            time.sleep(0.5)
    for process in psutil.Process().children(recursive=True):
        with suppress(psutil.Error):
            process.kill()
    os._exit(1)


class _Parser(argparse.ArgumentParser):
    """Reports wrong arguments in one sentence; takes no abbreviations."""

    def __init__(self, **options):
        super().__init__(**options, allow_abbrev=False)

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"error: {message}; `{self.prog} --help` shows what is allowed\n")


def _whole(low: int, high: int) -> Callable[[str], int]:
    """Reader of a whole number from `low` to `high`."""

    def read(text: str) -> int:
        if not (text.isascii() and text.isdigit() and low <= int(text) <= high):
            raise argparse.ArgumentTypeError(f"{text!r} is no whole number from {low} to {high}")
        return int(text)

    return read


def _add(group, name: str, call: str, words: str) -> argparse.ArgumentParser:
    added = group.add_parser(name, help=words, description=words)
    added.set_defaults(call=f"railrepro.evidence.{call}")
    return added


def parser() -> argparse.ArgumentParser:
    """The commands and their arguments; `call` of what it parses is the function, as "module:name"."""
    top = _Parser(prog=PROGRAM, description="Model predictive control of railway running gears, replicated.")
    commands = top.add_subparsers(required=True, metavar="COMMAND")
    _studies(partial(_add, commands))
    _tools(partial(_add, commands))
    words = "the notebooks and their products"
    chain = commands.add_parser("chain", help=words, description=words).add_subparsers(required=True, metavar="COMMAND")
    _chain(partial(_add, chain))
    return top


def _studies(command: Callable) -> None:
    added = command("tune", "runs.swarm:main", "tune controllers by particle swarm, write data/tuned (long, resumes)")
    added.add_argument("names", nargs="*", metavar="NAME", help="settings and controllers; default all")
    added = command("probe", "report.flips:main", "metrics of the nominal car (long), or verdicts that answers flip")
    added.add_argument(
        "settings",
        nargs="*",
        metavar="SETTING",
        help="paper, equal, loop; default all; or FILE.toml, a filled data/answers.toml",
    )
    added = command("calibrated", "claims.calibrated:main", "judge the calibrated car, data/paper_like.toml (long)")
    added.add_argument("--draws", type=_whole(0, 1000), help="perturbations of each size, default 20")
    added = command(
        "robustness", "uncertainty.robustness:main", "robustness of the verdicts over samples (long, resumes)"
    )
    added.add_argument("--samples", type=_whole(1, 4096), help="samples of the robustness study, default 128")
    command("margins", "uncertainty.margins:main", "stability margins of all tuned sets (long)")
    command(
        "loop", "uncertainty.loop:main", "closed loop with sensors over unseen seeds, and its limit (long, resumes)"
    )
    command("order", "uncertainty.order:main", "sensitivity of the controller ranking (long, resumes)")
    added = command("bench", "bench.speed:main", "measure speed, write data/results")
    added.add_argument("names", nargs="*", metavar="TABLE", help="tables; default all")
    added = command("report", "report.page:main", "judge the statements, write REPLICATION.md, numbers of README.md")
    added.add_argument("--accept", action="store_true", help="write verdicts that changed, too")


def _tools(command: Callable) -> None:
    added = command("score", "benchmark:main", "score a controller on the benchmark, write build/score")
    added.add_argument("controller", nargs="?", help="a Python file with one controller class, or a registered name")
    added.add_argument("--describe", action="store_true", help="only print what a law may use, with unit and meaning")
    added.add_argument("--seed", type=_whole(0, 2**31), help="a different random seed of noise, rails and cars")
    added.add_argument("--small", action="store_true", help="only the quick runs of the published draw, no margins")
    command("leaderboard", "benchmark:leaderboard", "score registered controllers and examples/ (long)")
    command("release", "release:main", "an archive with the runs of Figs. 6 to 9 as data for other programs")
    added = command("live", "", "the page in build/live that drives the car in a browser")
    added.set_defaults(call="railrepro.export.live:main")


def _chain(command: Callable) -> None:
    added = command("run", "chain.chain:figures", "run what is stale")
    added.add_argument("names", nargs="*", metavar="NAME", help="notebooks or figures, as fig06; default all")
    added.add_argument("--jobs", type=_whole(1, 64), default=0, help="notebooks at a time; default one per processor")
    added = command("one", "chain.chain:refresh", "run one notebook if it is stale, alone")
    added.add_argument("name")
    added = command("drive", "chain.chain:drive", "run the chapters 00 to 09 with a car of one's own")
    added.add_argument("vehicle", type=Path, help="a file like data/vehicle.toml")
    command("html", "chain.book:html", "executed notebooks as a book in build/html")
    command("verify", "chain.verify:verify", "rerun everything and compare with the committed products")
