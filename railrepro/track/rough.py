"""Rails as they lie: random or measured irregularities with localised defects, from a table of arguments.

Serves the paper's outlook (known lateral track irregularities).
"""

from __future__ import annotations

import inspect
import reprlib
from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd

from railrepro import paths
from railrepro.data import InputError
from railrepro.track import defects as defects_
from railrepro.track.irregularity import CHANNELS, check, coordinates, faded, irregularities
from railrepro.track.measured import read_irregularities


def rough_track(
    p: np.ndarray, file: str | None = None, defects: Sequence[dict] = (), chainage: float = 0.0, **random
) -> pd.DataFrame:
    """Irregularities of a run.

    Parameters
    ----------
    p : ndarray, shape (n,)
        Track coordinates (m).
    file : str, optional
        Measured irregularities (`measured.read_irregularities`) in place of random ones.
    defects : sequence of dict
        Localised defects added to them: `kind` (a function of `railrepro.track.defects`) and its other arguments.
    chainage : float
        Coordinate in the file at which p = 0 lies (m).
    random
        Arguments of `irregularity.irregularities`: spectrum, seed, shortest, longest.

    Returns
    -------
    DataFrame
        p_m and the columns of `irregularity.CHANNELS`.

    Raises
    ------
    InputError
        An argument that is not known, missing, or not of this kind; more than the flangeway takes.
    """
    p = coordinates(p)
    fit("irregular", random, *([irregularities] if file is None else []))
    if file is None:
        if chainage != 0.0:
            raise InputError(f"irregular: chainage is {chainage!r}, but there is no file that has one")
        frame = irregularities(p, **random)
    else:
        if not isinstance(file, str):
            raise InputError(f"irregular: file is {file!r}, the path of a CSV is needed")
        measured = read_irregularities(paths.source(file), length=float(p[-1]), chainage=chainage)
        channels = {c: np.interp(p, measured["p_m"], measured[c]) for c in CHANNELS.values()}
        frame = faded(pd.DataFrame({"p_m": p} | channels))
    shapes: dict[str, Callable] = {
        "dip": defects_.dip,
        "alignment_fault": defects_.alignment_fault,
        "lateral_offset": defects_.lateral_offset,
    }
    added = []
    if not isinstance(defects, list | tuple):
        raise InputError(f"irregular: defects are {reprlib.repr(defects)}, a list of tables is needed")
    for defect in defects:
        kind = defect.get("kind") if isinstance(defect, dict) else defect
        if kind not in tuple(shapes) or kind is defect:
            raise InputError(f"defect kind {kind!r} is not known; there are {sorted(shapes)}")
        arguments = {key: value for key, value in defect.items() if key != "kind"}
        fit(f"defect {kind}", arguments, shapes[kind])
        added.append(shapes[kind](p, **arguments))
    total = defects_.superpose(frame, *added)
    check(total)
    return total


def fit(what: str, given: dict, *functions: Callable) -> None:
    """Refuse a table of arguments with a name that none of the functions takes, or without one that they need.

    The first parameter of each (coordinates or a frame) is given anyway.
    """
    if not isinstance(given, dict):
        raise InputError(f"{what}: is {reprlib.repr(given)}, a table of arguments is needed")
    takes = [
        parameter for function in functions for parameter in list(inspect.signature(function).parameters.values())[1:]
    ]
    known = {parameter.name: parameter for parameter in takes if parameter.kind is not parameter.VAR_KEYWORD}
    for key in given:
        if key not in known:
            raise InputError(f"{what}: {key!r} is not known; there are {list(known)}")
    for name, parameter in known.items():
        if parameter.default is parameter.empty and name not in given:
            raise InputError(f"{what}: {name!r} is missing; needed are {list(known)}")
