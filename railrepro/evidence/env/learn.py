"""`python -m railrepro.evidence.env.learn` tunes a linear policy by evolution, in about a minute; a recipe to copy.

One row of weights serves both gears: torque over its limit is their product with the 14 numbers of a gear. Beginning
with three equal poles, each generation draws rows around the mean and moves it to the mean of the best.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import numpy as np

from railrepro.clock import EXCHANGE_PERIOD
from railrepro.errors import InputError, report_errors
from railrepro.evidence.env.observation import SIZE
from railrepro.simulation.scenarios import load_scenario

if TYPE_CHECKING:
    import gymnasium

    from railrepro.evidence.env.guidance import GuidanceEnv

NAME = "railrepro.evidence.env.guidance:railrepro/Guidance-v0"
_POLE = 20.0


def first_guess(env: GuidanceEnv) -> np.ndarray:
    """Weights of three equal poles at the initial speed, shape (SIZE,)."""
    vehicle, v = env.vehicle, env.scenario.speed
    gain = vehicle.wheel.radius / vehicle.gear.contact_base * vehicle.effective_yaw_inertia / vehicle.drive.torque_limit
    weights = np.zeros(SIZE)
    weights[:3] = gain * np.array([1e-3 * _POLE**3 / v, 3e-3 * _POLE**2, -3e-2 * _POLE])
    return weights


def returns(envs: gymnasium.vector.VectorEnv, rows: np.ndarray, seed: int) -> np.ndarray:
    """Sum of rewards of one episode per row of weights, shape (n,); all begin with the same seed."""
    observations, _ = envs.reset(seed=[seed] * len(rows))
    total, running = np.zeros(len(rows)), np.ones(len(rows), bool)
    while running.any():
        gears = observations[:, :-1].reshape(len(rows), 2, SIZE)
        actions = np.clip(np.einsum("ngs,ns->ng", gears, rows), -1, 1)
        observations, rewards, ended, truncated, _ = envs.step(actions.astype(np.float32))
        total += rewards * running
        running &= ~(ended | truncated)
    return total


def evolve(
    scenario: str = "curve_entry_T3", end: float = 300.0, population: int = 12, generations: int = 8
) -> np.ndarray:
    """Weights of a policy that follows the set point with perfect measurements, shape (SIZE,)."""
    try:
        import gymnasium
    except ModuleNotFoundError as error:
        raise InputError(f"learn: {error}; the extra `learn` has it") from None
    short = load_scenario(scenario).but(end_m=end)
    envs = gymnasium.make_vec(NAME, num_envs=population, vectorization_mode="sync", scenario=short)
    mean, draw = first_guess(envs.envs[0].unwrapped), np.random.default_rng(1)
    spread = np.maximum(0.3 * np.abs(mean), 0.05 * np.abs(mean).max())
    for generation in range(generations):
        rows = np.vstack([mean, mean + spread * draw.standard_normal((population - 1, SIZE))])
        found = returns(envs, rows, generation)
        best = rows[np.argsort(found, kind="stable")[-population // 4 :]]
        mean, spread = best.mean(axis=0), 0.5 * spread + 0.5 * best.std(axis=0)
        print(f"generation {generation}: return of the mean {found[0]:.3f}, best {found.max():.3f}", flush=True)
    envs.close()
    return mean


def main() -> None:
    """Print the weights that `evolve` finds; there are no arguments."""
    if sys.argv[1:]:
        raise InputError(f"learn: takes no arguments, found {sys.argv[1:]}")
    weights = evolve()
    from railrepro.evidence.env.guidance import EXCHANGES  # needs Gymnasium

    print(f"every {EXCHANGES * EXCHANGE_PERIOD:g} s:", [float(f"{weight:.4g}") for weight in weights])


if __name__ == "__main__":
    sys.exit(report_errors(main))
