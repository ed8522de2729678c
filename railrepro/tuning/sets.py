"""Tuned sets of data/tuned: the parameters that the swarms found, with all particles that they evaluated."""

import json
from pathlib import Path

import pandas as pd

from railrepro import data, paths
from railrepro.control.registry import PAPER, TUNED, tuned_set

load = tuned_set
"""Load the parameters of a controller tuned in a setting, "paper" (exact measurements) or "loop" (sensors): a dict with
the keys "controller", "setting", "parameters" and others (`registry.tuned_set`)."""


def save(result: dict, folder: Path) -> None:
    """Write a `result` of `tune` or `by_rule`, a dict with the tuned parameters, to CONTROLLER.json in a folder, and
    its table of evaluated particles, which only a swarm has, to CONTROLLER_particles.csv."""
    content, name = dict(result), result["controller"]
    history = content.pop("history", None)
    if history is not None:
        data.write(folder / f"{name}_particles.csv", history.to_csv(index=False, float_format="%.6g"))
    data.write(folder / f"{name}.json", json.dumps(content, indent=2) + "\n")


def particles(controller: str, setting: str = PAPER) -> pd.DataFrame:
    """Read all parameter sets that the swarms of a controller evaluated, a row each: seed (of the swarm), iteration,
    particle, cost (-), each parameter. `setting`: "paper" (exact measurements) or "loop" (sensors)."""
    return pd.read_csv(paths.source(f"{TUNED}/{setting}/{controller}_particles.csv"))
