"""A cheap stand-in for runs of the car: linear trend and Gaussian process on the inputs that matter, with its error.

Source: Rasmussen and Williams 2006, chapters 2 and 5 (regression); Bastos and O'Hagan 2009 (checks on runs left out).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, stats

LENGTHS, NOISES = (0.3, 0.6, 1.2, 2.4), (0.03, 0.1, 0.3, 0.7)
"""Length scales, relative to the weight of an input, and shares of the variance that inputs left out explain."""
MOST_ACTIVE = 10
"""Inputs that an emulator has at most."""
CHANCE = 2.0
"""Rank correlation, in standard deviations of what chance gives, from which an input is taken to matter."""
FOLDS = 8
"""Parts of the runs that are left out in turn."""


@dataclass(frozen=True)
class Emulator:
    """What `fit` found.

    Attributes
    ----------
    active : ndarray of int
        Inputs that matter.
    weights : ndarray
        Their importance, 1 for the first.
    design : ndarray, shape (n, len(active))
        Weighted inputs of the runs.
    trend : ndarray, shape (1 + len(active),)
        Constant and slopes.
    factor : ndarray, shape (n, n)
        Lower Cholesky factor of the correlation of the runs.
    residual : ndarray, shape (n,)
        Correlation inverse times what the trend leaves.
    deviation : float
        Standard deviation of the process, raised to what runs show that were left out.
    length, noise : float
    error : float
        Root mean squared error of predicting runs that were left out, over the standard deviation of the runs.
    """

    active: np.ndarray
    weights: np.ndarray
    design: np.ndarray
    trend: np.ndarray
    factor: np.ndarray
    residual: np.ndarray
    deviation: float
    length: float
    noise: float
    error: float

    def __call__(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation, shape (m,), at points of the unit cube, shape (m, d)."""
        points = x[:, self.active] * self.weights
        correlation = _correlation(points, self.design, self.length) * (1 - self.noise)
        mean = _with_constant(x[:, self.active]) @ self.trend + correlation @ self.residual
        solved = linalg.solve_triangular(self.factor, correlation.T, lower=True, check_finite=False)
        variance = np.clip(1 - (solved**2).sum(axis=0), self.noise, 1.0)
        return mean, self.deviation * np.sqrt(variance)


def fit(x: np.ndarray, y: np.ndarray) -> Emulator:
    """Emulator of a quantity y, shape (n,), of runs with inputs x in the unit cube, shape (n, d).

    Its error and deviation are those that runs show which it has not seen, neither when it was fitted nor when its
    inputs were chosen: with more inputs than runs some seem to matter by chance.
    """
    found, spread = _fitted(x, y), max(float(y.std()), 1e-12)
    missed, report_errors = np.zeros(len(y)), np.ones(len(y))
    folds = np.random.default_rng(len(y)).permutation(len(y)) % FOLDS  # every eighth of a Sobol sequence is a slab
    for fold in range(FOLDS):
        out = folds == fold
        mean, deviation = _fitted(x[~out], y[~out])(x[out])
        missed[out], report_errors[out] = y[out] - mean, np.maximum(deviation, 1e-12)
    error = float(np.sqrt(np.mean(missed**2)))
    inflation = max(1.0, float(np.sqrt(np.mean((missed / report_errors) ** 2))))
    return replace(found, deviation=found.deviation * inflation, error=error / spread)


def _fitted(x: np.ndarray, y: np.ndarray) -> Emulator:
    """Length scale and noise are those of the largest likelihood on a grid."""
    active, weights = _active(x, y)
    design, base = x[:, active] * weights, _with_constant(x[:, active])
    ridge = 1e-3 * len(y) * np.diag([0.0, *np.ones(len(active))])
    trend = np.linalg.solve(base.T @ base + ridge, base.T @ y)
    rest = y - base @ trend
    best = None
    for length in LENGTHS:
        smooth = _correlation(design, design, length)
        for noise in NOISES:
            factor = linalg.cholesky((1 - noise) * smooth + noise * np.eye(len(y)), lower=True)
            residual = linalg.cho_solve((factor, True), rest)
            scale = max(float(rest @ residual) / len(y), 1e-18)
            likelihood = -0.5 * len(y) * np.log(scale) - np.log(np.diag(factor)).sum()
            if best is None or likelihood > best[0]:
                best = likelihood, length, noise, factor, residual, scale
    assert best is not None
    _, length, noise, factor, residual, scale = best
    return Emulator(active, weights, design, trend, factor, residual, float(np.sqrt(scale)), length, noise, np.nan)


def _active(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inputs by the strength of their rank correlation with the output, linear or about the middle; at least one."""
    ranks = stats.rankdata(y)
    if np.ptp(ranks) == 0:
        return np.array([0]), np.array([1.0])
    columns = np.hstack([x, np.abs(x - 0.5)])
    centred = np.apply_along_axis(stats.rankdata, 0, columns)
    centred = centred - centred.mean(axis=0)
    size = np.sqrt((centred**2).sum(axis=0) * ((ranks - ranks.mean()) ** 2).sum())
    strength = np.abs((ranks - ranks.mean()) @ centred) / np.maximum(size, 1e-12)
    strength = np.maximum(*np.split(strength, 2))
    order = np.argsort(-strength, kind="stable")[:MOST_ACTIVE]
    stored = order[strength[order] > CHANCE / np.sqrt(len(y))]
    active = stored if stored.size else order[:1]
    return active, strength[active] / strength[active].max()


def _correlation(first: np.ndarray, second: np.ndarray, length: float) -> np.ndarray:
    squares = (first**2).sum(axis=1)[:, None] + (second**2).sum(axis=1)[None, :] - 2 * first @ second.T
    return np.exp(-np.maximum(squares, 0) / (2 * length**2))


def _with_constant(x: np.ndarray) -> np.ndarray:
    return np.hstack([np.ones((len(x), 1)), x])
