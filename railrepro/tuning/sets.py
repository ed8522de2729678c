"""Tuned sets of data/tuned: the parameters that swarms found, with all particles that they evaluated."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd

from railrepro import data, paths
from railrepro.control.registry import PAPER, TUNED, tuned_set


def save(found: dict, folder: Path) -> None:
    """Write `found`, a result of `tune` or `by_rule`, to a folder: CONTROLLER.json, and the history of a swarm to
    CONTROLLER_particles.csv."""
    content = {key: value for key, value in found.items() if key != "history"}
    if "history" in found:
        particles = found["history"].to_csv(index=False, float_format="%.6g")
        data.write(folder / f"{found['controller']}_particles.csv", particles)
    data.write(folder / f"{found['controller']}.json", json.dumps(content, indent=2) + "\n")


def particles(controller: str, setting: str = PAPER) -> pd.DataFrame:
    """Evaluated particles of all swarms of a tuning, read from data/tuned: a row each, columns as `tune`'s history."""
    return pd.read_csv(paths.source(f"{TUNED}/{setting}/{controller}_particles.csv"))


def load(controller: str, setting: str = PAPER) -> dict:
    """Tuned set of a controller in a setting of comparison: the dict of `tune` or `by_rule` without history.

    A designed controller has only the keys controller, setting and parameters. InputError when there is none.
    """
    return tuned_set(controller, setting)
