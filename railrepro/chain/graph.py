"""The graph of the notebooks: what each reads and writes, and the rules that make works by.

notebooks/chain.toml is its one source.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from pathlib import Path

from railrepro import paths
from railrepro.errors import InputError

SUFFIXES = ("pdf", "svg", "png", "csv")
_FIELDS = {"name", "title", "reads", "writes", "figures", "parameters", "test_parameters", "minutes", "seed"}


@dataclass(frozen=True)
class Notebook:
    """One entry of the chain; see the head of notebooks/chain.toml."""

    name: str
    title: str
    reads: tuple[str, ...] = ()
    writes: tuple[str, ...] = ()
    figures: tuple[str, ...] = ()
    parameters: dict = field(default_factory=dict)
    test_parameters: dict = field(default_factory=dict)
    minutes: float = 1.0
    seed: int | None = None

    @property
    def path(self) -> Path:
        """The notebook file."""
        return paths.NOTEBOOKS / f"{self.name}.ipynb"

    @property
    def products(self) -> tuple[str, ...]:
        """All files that it writes, relative to the checkout."""
        return self.writes + tuple(f"figures/{figure}.{suffix}" for figure in self.figures for suffix in SUFFIXES)


def chain(path: Path | None = None) -> list[Notebook]:
    """Notebooks of the chain in order; refuses unknown fields, double products, reads before making."""
    file = path or paths.NOTEBOOKS / "chain.toml"
    notebooks, made = [], {}
    for entry in tomllib.loads(file.read_text()).get("notebook", []):
        unknown = set(entry) - _FIELDS
        if unknown:
            raise InputError(f"{file.name}: {entry.get('name')} has the unknown field {min(unknown)!r}")
        lists = {key: tuple(value) for key, value in entry.items() if isinstance(value, list)}
        notebook = Notebook(**entry | lists)
        for product in notebook.products:
            if product in made:
                raise InputError(f"{file.name}: {product} is written by {made[product]} and by {notebook.name}")
            made[product] = notebook.name
        notebooks.append(notebook)
    position = {notebook.name: i for i, notebook in enumerate(notebooks)}
    for notebook in notebooks:
        for read in notebook.reads:
            if read in made and position[made[read]] >= position[notebook.name]:
                raise InputError(f"{file.name}: {notebook.name} reads {read} before {made[read]} makes it")
    return notebooks


def find(name: str) -> Notebook:
    """A notebook of the chain by name."""
    known = {notebook.name: notebook for notebook in chain()}
    if name not in known:
        raise InputError(f"notebook {name!r} is not in chain.toml; there are {sorted(known)}")
    return known[name]


def rules() -> str:
    """Make rules of the chain: one stamp per notebook, after the stamps of what it reads.

    The longest come first, so that none of them is left alone at the end when several run at a time.
    """
    notebooks = chain()
    maker = {product: notebook.name for notebook in notebooks for product in notebook.products}
    longest_first = sorted(notebooks, key=lambda notebook: -notebook.minutes)
    lines = ["STAMPS := " + " ".join(f"build/stamps/{n.name}.json" for n in longest_first), ""]
    for notebook in notebooks:
        stamp = f"build/stamps/{notebook.name}.json"
        before = sorted({f"build/stamps/{maker[read]}.json" for read in notebook.reads if read in maker})
        lines += [f"{stamp}: FORCE $(VENV) {' '.join(before)}".rstrip()]
        lines += [f"\t@$(PY) -m railrepro.chain run {notebook.name}"]
        for figure in notebook.figures:
            lines += [f".PHONY: {figure[:5]}", f"{figure[:5]}: {stamp}"]
        lines.append("")
    return "\n".join(lines)


def verify_tolerance() -> dict:
    """Tolerances of a comparison of two runs, the table [verify] of chain.toml."""
    return tomllib.loads((paths.NOTEBOOKS / "chain.toml").read_text())["verify"]
