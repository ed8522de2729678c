"""The graph of the notebooks: what each reads and writes, and the rules that make works by.

notebooks/chain.toml is its one source.
"""

from __future__ import annotations

import hashlib
from dataclasses import field
from pathlib import Path
from typing import Annotated, cast

from railrepro import paths, schema
from railrepro.errors import InputError
from railrepro.schema import Number, above, between

SUFFIXES = ("png", "csv")
_SHARE = Annotated[Number, between(0.0, 1.0)]


@schema.table
class Notebook:
    """One entry of the chain; see the head of notebooks/chain.toml."""

    name: str
    title: str
    reads: tuple[str, ...] = ()
    writes: tuple[str, ...] = ()
    figures: tuple[str, ...] = ()
    parameters: dict[str, schema.Free] = field(default_factory=dict)
    test_parameters: dict[str, schema.Free] = field(default_factory=dict)
    minutes: Annotated[Number, above(0.0, 1e4, "min")] = 1.0
    seed: Annotated[int, between(0, 2**63)] | None = None

    @property
    def path(self) -> Path:
        """The notebook file."""
        return paths.NOTEBOOKS / f"{self.name}.ipynb"

    @property
    def products(self) -> tuple[str, ...]:
        """All files that it writes, relative to the checkout."""
        return self.writes + tuple(f"figures/{figure}.{suffix}" for figure in self.figures for suffix in SUFFIXES)


@schema.table
class Own:
    """Entry [[verify.own]] of notebooks/chain.toml: tolerance of a column of a table, in the rows of a query or all."""

    table: str
    column: str
    relative: _SHARE
    why: str
    rows: str = ""


@schema.table
class Tolerance:
    """Table [verify] of notebooks/chain.toml, see there."""

    relative: _SHARE
    image_rms: Annotated[Number, between(0.0, 255.0, "grey levels")]
    not_compared: tuple[str, ...]
    own: tuple[Own, ...] = ()


@schema.table
class Chain:
    """Content of notebooks/chain.toml."""

    notebook: tuple[Notebook, ...] = ()
    verify: Annotated[Tolerance, schema.AS_GIVEN] | None = None

    def __post_init__(self):
        made, position = {}, {}
        for i, notebook in enumerate(self.notebook):
            if position.setdefault(notebook.name, i) != i:
                raise ValueError(f"{notebook.name} is there twice")
            for product in notebook.products:
                if made.setdefault(product, notebook.name) != notebook.name:
                    raise ValueError(f"{product} is written by {made[product]} and by {notebook.name}")
        for notebook in self.notebook:
            for read in notebook.reads:
                if read in made and position[made[read]] >= position[notebook.name]:
                    raise ValueError(f"{notebook.name} reads {read} before {made[read]} makes it")


def _chain(path: Path | None) -> Chain:
    file = path or paths.NOTEBOOKS / "chain.toml"
    return schema.build(Chain, schema.read(file), file.name)


def chain(path: Path | None = None) -> list[Notebook]:
    """Notebooks of the chain in order; refuses wrong entries, double products, reads before making (InputError)."""
    return list(_chain(path).notebook)


def find(name: str) -> Notebook:
    """A notebook of the chain by name."""
    known = {notebook.name: notebook for notebook in chain()}
    if name not in known:
        raise InputError(f"notebook {name!r} is not in chain.toml; there are {sorted(known)}")
    return known[name]


def rules() -> str:
    """Make rules of the chain: one stamp per notebook, after the stamps of what it reads.

    The longest come first, so that none of them is left alone at the end when several run at a time. The last line is
    the hash of the others, which the Makefile checks.
    """
    notebooks = chain()
    maker = {product: notebook.name for notebook in notebooks for product in notebook.products}
    longest_first = sorted(notebooks, key=lambda notebook: -notebook.minutes)
    lines = ["STAMPS := " + " ".join(f"build/stamps/{n.name}.json" for n in longest_first), ""]
    for notebook in notebooks:
        stamp = f"build/stamps/{notebook.name}.json"
        before = sorted({f"build/stamps/{maker[read]}.json" for read in notebook.reads if read in maker})
        lines += [f"{stamp}: FORCE $(VENV) {' '.join(before)}".rstrip()]
        lines += [f"\t@$(PY) -m railrepro chain run {notebook.name}"]
        for figure in notebook.figures:
            lines += [f".PHONY: {figure[:5]}", f"{figure[:5]}: {stamp}"]
        lines.append("")
    text = "\n".join(lines) + "\n"
    return f"{text}RULES_HASH := {hashlib.sha256(text.encode()).hexdigest()}"


def verify_tolerance(path: Path | None = None) -> dict:
    """Tolerances of a comparison of two runs, the table [verify] of chain.toml."""
    tolerance = _chain(path).verify
    if tolerance is None:
        raise InputError("chain.toml: the group [verify] is missing")
    return cast(dict, tolerance)
