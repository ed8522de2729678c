"""Evolution strategy with covariance matrix adaptation in the unit cube, reflected at its faces; seeded.

Source: Hansen 2016, The CMA evolution strategy: a tutorial, arXiv 1604.00772 (equations 5 to 47, default parameters).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np


def minimise(
    cost: Callable[[np.ndarray], np.ndarray], start: np.ndarray, generations: int, sigma: float = 0.1, seed: int = 0,
    size: int | None = None,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Search for a minimum of a cost of points, shape (n, d), in the unit cube.

    Parameters
    ----------
    cost : callable
        Points -> costs, shape (n,).
    start : ndarray, shape (d,)
    generations, seed : int
    sigma : float
        Standard deviation of the first generation.
    size : int, optional
        Points of a generation; default 4 + 3 ln d.

    Returns
    -------
    points, costs : ndarray, shapes (generations * size, d), (generations * size,)
        All that were asked for, in order.
    """
    d, generator = len(start), np.random.default_rng(seed)
    size = size or 4 + int(3 * np.log(d))
    weights = np.log(size / 2 + 0.5) - np.log(np.arange(1, size // 2 + 1))
    weights /= weights.sum()
    mu = 1 / (weights**2).sum()
    c_sigma = (mu + 2) / (d + mu + 5)
    damping = 1 + 2 * max(0.0, np.sqrt((mu - 1) / (d + 1)) - 1) + c_sigma
    c_c = (4 + mu / d) / (d + 4 + 2 * mu / d)
    c_one = 2 / ((d + 1.3) ** 2 + mu)
    c_mu = min(1 - c_one, 2 * (mu - 2 + 1 / mu) / ((d + 2) ** 2 + mu))
    expected = np.sqrt(d) * (1 - 1 / (4 * d) + 1 / (21 * d**2))
    mean, covariance = np.asarray(start, dtype=float), np.eye(d)
    path, sigma_path = np.zeros(d), np.zeros(d)
    points, costs = [], []
    for generation in range(1, generations + 1):
        values, axes = np.linalg.eigh(covariance)
        root = axes * np.sqrt(np.maximum(values, 1e-20))
        steps = generator.standard_normal((size, d)) @ root.T
        asked = reflected(mean + sigma * steps)
        found = cost(asked)
        points.append(asked)
        costs.append(found)
        chosen = steps[np.argsort(found, kind="stable")[: len(weights)]]
        step = weights @ chosen
        mean = reflected(mean + sigma * step)
        whitened = axes @ ((axes.T @ step) / np.sqrt(np.maximum(values, 1e-20)))
        sigma_path = (1 - c_sigma) * sigma_path + np.sqrt(c_sigma * (2 - c_sigma) * mu) * whitened
        length = np.linalg.norm(sigma_path)
        going = length / np.sqrt(1 - (1 - c_sigma) ** (2 * generation)) < (1.4 + 2 / (d + 1)) * expected
        path = (1 - c_c) * path + going * np.sqrt(c_c * (2 - c_c) * mu) * step
        rank_one = np.outer(path, path) + (not going) * c_c * (2 - c_c) * covariance
        covariance = (1 - c_one - c_mu) * covariance + c_one * rank_one + c_mu * (chosen.T * weights) @ chosen
        sigma *= float(np.exp(c_sigma / damping * (length / expected - 1)))
    return np.concatenate(points), np.concatenate(costs)


def reflected(points: np.ndarray) -> np.ndarray:
    """Points folded back into the unit cube at its faces."""
    return 1 - np.abs(1 - np.abs(points) % 2)
