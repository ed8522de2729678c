"""Tuned parameters of the controllers, as data/tuned keeps them, one file per setting and controller.

Which setting: `paper` (perfect measurements, inversions with the poles of a designer), `equal` (perfect measurements,
all tuned alike) or `loop` (the same with sensors). `railrepro.evidence.runs.tuning` describes how they were tuned.
"""

from __future__ import annotations

import reprlib
from pathlib import Path
from typing import Annotated, Literal

from railrepro import paths, schema
from railrepro.control.registry import guidance
from railrepro.errors import InputError
from railrepro.schema import Number, between

TUNED = "data/tuned"
SETTINGS = ("paper", "equal", "loop")
"""Settings of comparison, see data/tuning.toml."""
PAPER, EQUAL, LOOP = SETTINGS
COUNT = Annotated[int, between(1, 10**6)]
SEED = Annotated[int, between(0, 2**63)]


@schema.table
class Origin:
    """Where a tuned set comes from: budget of the search, version, and what it was tuned for."""

    particles: COUNT
    iterations: COUNT
    patience: COUNT
    seeds: Annotated[tuple[SEED, ...], schema.NOT_EMPTY]
    data: str
    version: str


@schema.table
class SwarmResult:
    """What one swarm found."""

    seed: SEED
    cost: Annotated[Number, between(0.0, 1e9)]
    evaluations: COUNT
    parameters: dict[str, schema.Plain]


@schema.table
class TunedSet:
    """Content of a file in data/tuned."""

    controller: str
    setting: Literal["paper", "equal", "loop"]
    parameters: dict[str, schema.Plain]
    cost: Annotated[Number, between(0.0, 1e9)]
    runs: tuple[dict[str, schema.Free], ...]
    swarms: Annotated[tuple[SwarmResult, ...], schema.NOT_EMPTY]
    origin: Origin


def read(controller: str, setting: str = PAPER, folder: Path | None = None) -> dict:
    """Tuned set of a controller in some setting, as its file has it.

    Raises
    ------
    InputError
        When there is none, or when the file does not hold a tuned set of this controller in this setting.
    """
    file = (folder or paths.source(f"{TUNED}/{setting}")) / f"{controller}.json"
    if not file.exists():
        where = _elsewhere(controller, setting)
        raise InputError(f"{setting}/{file.name}: there is no tuned set for {controller!r}{where}")
    content = schema.read(file)
    found = schema.build(TunedSet, content, file.name)
    if (found.controller, found.setting) != (controller, setting):
        raise InputError(
            f"{file.name}: holds a tuned set of {found.controller!r} in the setting {found.setting!r}, {controller!r} "
            f"in {setting!r} is needed"
        )
    return content


def _elsewhere(controller: str, setting: str) -> str:
    """Where else there is a tuned set of a controller, as the end of a sentence."""
    known = [name for name in SETTINGS if paths.source(f"{TUNED}/{name}/{controller}.json").exists()]
    others = [name for name in known if name != setting]
    return f", but in the setting {' and '.join(others)}" if others else "; `make tune` makes it"


def parameters(controller: str, setting: str = PAPER) -> dict:
    """Tuned parameters of a controller in some setting, or those that a designer gave it in data/tuning.toml.

    Raises
    ------
    InputError
        When the setting is not known, or there is no tuned set, see `read`.
    """
    schema.require("controller", controller, str)
    if setting not in SETTINGS:
        raise InputError(f"setting {reprlib.repr(setting)} is not known; there are {sorted(SETTINGS)}")
    designed = _designed().get((setting, controller))
    return read(controller, setting)["parameters"] if designed is None else designed


def _designed() -> dict[tuple[str, str], dict]:
    """Parameters that are given, not searched, by setting and controller."""
    file = paths.source("data/tuning.toml")
    try:
        tables = {name: entry.get("designed", {}) for name, entry in schema.read(file)["setting"].items()}
        return {(name, key): given for name, table in tables.items() for key, given in table.items()}
    except (KeyError, AttributeError) as error:
        raise InputError(f"{file.name}: the tables [setting.paper] and so on are needed ({error})") from error


def tuned(controller: str, options: dict | None = None, setting: str = PAPER, **changes):
    """Guidance of a controller with its tuned parameters; `options` and `changes` as in `registry.guidance`."""
    return guidance(controller, parameters(controller, setting), options, **changes)
