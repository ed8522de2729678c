"""Particle swarm optimisation with a global best, constriction and reflecting bounds. Source: Kennedy and Eberhart
1995; constriction factor after Clerc and Kennedy 2002 (chi = 0.7298, c1 = c2 = 2.05)."""

import math
import numbers
import reprlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from tqdm import tqdm

from railrepro.data import InputError, between, is_number, require

CONSTRICTION, ATTRACTION = 0.7298, 2.05


@dataclass(frozen=True)
class Dimension:
    """Searched parameter with bounds `low` and `high`. InputError for an impossible range. The swarm moves in the value
    on the scale "linear", in its logarithm on "log"; "integer" rounds the value."""

    name: str
    low: float
    high: float
    scale: str = "linear"

    def __post_init__(self):
        bounds = self.low, self.high
        fits = all(map(is_number, bounds)) and self.low < self.high and (self.scale != "log" or self.low > 0)
        whole = self.scale != "integer" or (fits and all(float(bound).is_integer() for bound in bounds))
        if not (fits and whole and self.scale in ("linear", "log", "integer")):
            raise InputError(f"dimension {self.name}: bounds {self.low}..{self.high} do not span a {self.scale} range")

    def value(self, position: float) -> float:
        """Parameter value at a position on the scale: 0 is `low`, 1 is `high`."""
        if self.scale == "log":
            return float(self.low * (self.high / self.low) ** position)
        value = self.low + position * (self.high - self.low)
        return round(value) if self.scale == "integer" else float(value)

    def position(self, value: float) -> float:
        """Position of a parameter value between the bounds, 0 (`low`) to 1 (`high`); InputError for a value outside."""
        if not self.low <= value <= self.high:
            raise InputError(f"dimension {self.name}: start {value!r} is not in {self.low}..{self.high}")
        if self.scale == "log":
            return float(np.log(value / self.low) / np.log(self.high / self.low))
        return float((value - self.low) / (self.high - self.low))


class Swarm:
    """State of a particle swarm: `ask` gives a parameter set per particle, `tell` takes their costs and moves the
    particles. `start` (name -> value) is the parameter set of the first particle; all others begin at random, by
    `seed`. InputError unless `start` has all parameters, within their bounds."""

    def __init__(self, dimensions: list[Dimension], particles: int, seed: int, start: dict[str, float] | None = None):
        self.dimensions, self.seed, self.iteration = dimensions, seed, 0
        self.personal_cost = np.full(particles, np.inf)
        self.rows: list[dict] = []
        self.position = self._random(len(dimensions))
        if start:
            if set(start) != {d.name for d in dimensions}:
                raise InputError(f"start has {sorted(start)}, {sorted(d.name for d in dimensions)} are needed")
            self.position[0] = [d.position(start[d.name]) for d in dimensions]
        self.personal_best, self.velocity = self.position.copy(), np.zeros_like(self.position)

    def _random(self, count: int) -> np.ndarray:
        """Random numbers, `count` per particle; each particle and iteration has a seed of its own."""
        seeds = [(self.seed, self.iteration, particle) for particle in range(len(self.personal_cost))]
        return np.array([np.random.default_rng(seed).random(count) for seed in seeds])

    def ask(self) -> list[dict[str, float]]:
        """Parameter sets to be evaluated, one per particle, each a dict: name -> value."""
        return [self._values(position) for position in self.position]

    def _values(self, position: np.ndarray) -> dict[str, float]:
        return {d.name: d.value(x) for d, x in zip(self.dimensions, position, strict=True)}

    def tell(self, costs: Sequence[float]) -> None:
        """Take the costs of the sets of the last `ask`, in their order, and move the particles. inf and NaN are worst.
        InputError for -inf, for a cost that is not of a numeric type, and unless each particle has a cost."""
        given, n = list(costs) if isinstance(costs, Iterable) else [costs], len(self.dimensions)
        wrong = [cost for cost in given if not isinstance(cost, numbers.Real) or cost == -math.inf]
        if wrong or len(given) != len(self.position):
            found = reprlib.repr(wrong[0]) if wrong else f"{len(given)} costs"
            needed = f"{len(self.position)} numbers above -inf are needed"
            raise InputError(f"swarm: the cost function gave {found}, {needed}")
        checked = np.where(np.isfinite(given), given, np.inf)
        for i, (values, cost) in enumerate(zip(self.ask(), checked, strict=True)):
            self.rows.append({"iteration": self.iteration, "particle": i, "cost": float(cost), **values})
        better = checked < self.personal_cost
        self.personal_cost = np.where(better, checked, self.personal_cost)
        self.personal_best[better] = self.position[better]
        self.iteration += 1
        leader, draw = self.personal_best[np.argmin(self.personal_cost)], self._random(2 * n)
        pull = ATTRACTION * draw[:, :n] * (self.personal_best - self.position)
        pull += ATTRACTION * draw[:, n:] * (leader - self.position)
        self.velocity = np.clip(CONSTRICTION * (self.velocity + pull), -0.5, 0.5)
        moved = self.position + self.velocity
        low, high = moved < 0, moved > 1
        moved = np.where(low, -moved, np.where(high, 2 - moved, moved))
        self.velocity = np.where(low | high, -0.5 * self.velocity, self.velocity)
        self.position = np.clip(moved, 0, 1)

    @property
    def best(self) -> dict[str, float]:
        """Parameter set with the lowest cost so far: name -> value."""
        return self._values(self.personal_best[np.argmin(self.personal_cost)])

    @property
    def cost(self) -> float:
        """Lowest cost so far; inf before the first `tell`."""
        return float(self.personal_cost.min())

    @property
    def history(self) -> pd.DataFrame:
        """One row per evaluated particle, columns iteration, particle (its number), cost (-) and each parameter."""
        return pd.DataFrame(self.rows)

    def stagnant(self, patience: int) -> bool:
        """Whether the lowest cost has fallen by less than 1e-4 of its value over the last `patience` iterations."""
        if self.iteration <= patience:
            return False
        costs = self.history.groupby("iteration")["cost"].min().cummin().to_numpy()
        return costs[-1] > (1 - 1e-4) * costs[-1 - patience]


def minimise(
    evaluate: Callable[[list[dict], list[float]], list[float]],
    dimensions: list[Dimension],
    particles: int,
    iterations: int,
    seed: int,
    patience: int = 1000,
    start: dict[str, float] | None = None,
    title: str = "",
) -> Swarm:
    """Minimise a cost by a particle swarm; returns the `Swarm` with `best`, `cost` and `history`. InputError for wrong
    arguments, costs that `Swarm.tell` refuses (-inf, not numeric, not one per particle), and if none is finite.

    Args:
        evaluate (callable): Takes two lists, a parameter set (dict) and a limit per particle, and returns a list of
            costs. The limit is the lowest cost of the particle so far, at first inf. For a cost above its limit any
            other number above the limit will do. inf and NaN are the worst costs.
        dimensions (list of Dimension): Searched parameters.
        particles, iterations (int): Size of the swarm, and largest number of its moves.
        seed (int): Seed of the random numbers.
        patience (int): The swarm stops once the cost has fallen by less than 1e-4 of its value over so many iterations.
        start (dict, optional): Parameter set of the first particle; the others begin at random.
        title (str): Title of the progress bar; empty for none.
    """
    for name, value, least in (("particles", particles, 1), ("iterations", iterations, 1), ("seed", seed, 0)):
        require(f"swarm: {name}", value, between(least, 2**63), whole=True)
    if not dimensions:
        raise InputError("swarm: there are no dimensions, at least one is needed")
    swarm = Swarm(dimensions, particles, seed, start)
    with tqdm(total=iterations, desc=title, unit="iteration", disable=not title, delay=0.1) as bar:
        while swarm.iteration < iterations and not swarm.stagnant(patience):
            swarm.tell(evaluate(swarm.ask(), swarm.personal_cost.tolist()))
            bar.set_postfix_str(f"best cost {swarm.cost:.4f}")
            bar.update()
    if not math.isfinite(swarm.cost):
        raise InputError(f"swarm: none of its {len(swarm.rows)} parameter sets has a finite cost, so that none is best")
    return swarm
