"""Command line of the chain: `python -m railrepro.evidence.chain COMMAND`; make calls it.

Modules that take long to import are imported by the command that needs them; an interrupt then finds one to tell it.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from railrepro.errors import told


def parser() -> argparse.ArgumentParser:
    """The commands and their arguments."""
    top = argparse.ArgumentParser(
        prog="python -m railrepro.evidence.chain", description="The notebooks and their products."
    )
    commands = top.add_subparsers(dest="command", required=True)
    commands.add_parser("rules", help="print the make rules of notebooks/chain.toml")
    commands.add_parser("fresh", help="succeed if no notebook is stale, tell what is")
    commands.add_parser("run", help="run one notebook if it is stale").add_argument("name")
    commands.add_parser("html", help="executed notebooks as a book in build/html")
    commands.add_parser("strip", help="remove outputs from the notebooks")
    rerun = commands.add_parser("verify", help="rerun everything and compare with the committed products")
    rerun.add_argument("--quick", action="store_true", help="only the notebooks that take about a minute")
    rerun.add_argument("--into", type=Path, help="folder for the products of the rerun, emptied first")
    others = commands.add_parser("variants", help="rerun the quick notebooks with other compilers and processors")
    others.add_argument("names", nargs="*", metavar="NAME")
    return top


def _fresh() -> int:
    from railrepro.evidence.chain import graph, manifest

    notebooks = graph.chain()
    stale = [notebook for notebook in notebooks if not manifest.is_fresh(notebook)]
    if stale:
        minutes = max(1, round(sum(notebook.minutes for notebook in stale)))
        names = ", ".join(notebook.name for notebook in stale)
        print(f"{len(stale)} of {len(notebooks)} notebooks are stale and run first, about {minutes} min: {names}",
              file=sys.stderr)  # fmt: skip
    return int(bool(stale) or not all(map(manifest.is_entered, notebooks)))


def _do(chosen: argparse.Namespace) -> int:
    if chosen.command == "rules":
        from railrepro.evidence.chain import graph

        print(graph.rules())
    elif chosen.command == "fresh":
        return _fresh()
    elif chosen.command == "run":
        from railrepro.evidence.chain.runner import refresh

        refresh(chosen.name)
    elif chosen.command == "html":
        from railrepro.evidence.chain.book import html

        print(html())
    elif chosen.command == "strip":
        from railrepro.evidence.chain.cleaning import strip_all

        strip_all()
    else:
        from railrepro.evidence.chain.verify import variants, verify

        return verify(chosen.quick, chosen.into) if chosen.command == "verify" else variants(chosen.names)
    return 0


def main(arguments: list[str] | None = None) -> int:
    """Run one command; returns 1 after an error of the user, which is told in one sentence."""
    return told(lambda: _do(parser().parse_args(arguments)))


if __name__ == "__main__":
    sys.exit(main())
