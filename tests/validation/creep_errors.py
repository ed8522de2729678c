"""Errors of the creep law against half spaces in steady rolling (`rolling_contact`), by spin. As a script (4 minutes)
it writes data/results/creep_errors.csv, which `02_contact` shows. Serves eq. (4) of the paper."""

from itertools import product

import numpy as np
import pandas as pd
from rolling_contact import rolling
from tqdm import tqdm

from railrepro import paths
from railrepro.contact import creep
from railrepro.data import write

LOAD, SHEAR, FRICTION, ROOT = 78.5e3, 8.2e10, 0.3, 5.75e-3
"""Normal force (N), shear modulus (Pa), friction (-), square root of the product of the semi-axes (m)."""
RATIOS = (0.7, 1.33, 2.0)  # of the semi-axes
SPINS = {0.0: "none", 0.02: "of a cone", 0.08: "of S1002 on dry rail", 0.2: "2.5 times that of S1002"}
"""Kalker's linear force by spin over three times the friction force, and an example."""
_CASES = list(product((0.1, 0.4, 1.0), np.pi / 4 * np.array([-1, 0, 1, 2])))
"""Size of the creepages, as their linear force over three times the friction force, and their direction."""


def errors(ratio: float, spin: float) -> np.ndarray:
    """Compute errors of force and moment over the friction force (and `ROOT`) in all `_CASES`, shape (12, 2)."""
    a, b = ROOT * np.sqrt(ratio), ROOT / np.sqrt(ratio)
    kalker = creep.kalker_coefficients(ratio)
    unit, found = 3 * FRICTION * LOAD / (SHEAR * a * b), []
    for size, angle in _CASES:
        creepage = unit * size * np.array([np.cos(angle), np.sin(angle)]) / kalker[:2]
        creepage = (*creepage, unit * spin / kalker[2] / ROOT)
        arguments = (*creepage, LOAD, a, b, *kalker, SHEAR, 1.0, 1.0, FRICTION, 1.0, 0.0, 0.0)
        along, across, turning = np.subtract(creep.polach(*arguments), rolling(creepage, LOAD, a, b, FRICTION))
        found.append(np.array([np.hypot(along, across), abs(turning) / ROOT]) / (FRICTION * LOAD))
    return np.array(found)


if __name__ == "__main__":
    rows = []
    for spin, name in tqdm(SPINS.items()):
        force = np.concatenate([errors(ratio, spin)[:, 0] for ratio in RATIOS])
        rows.append({"spin": name, "spin_share": spin, "mean_error": force.mean(), "largest_error": force.max()})
    table = pd.DataFrame(rows)
    write(paths.product("data/results/creep_errors.csv"), table.to_csv(index=False, float_format="%.4g"))
