"""Tables and figures of tuning by particle swarm: costs, convergence, sensitivity to parameters and to bounds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from railrepro.evidence.report import figures
from railrepro.evidence.runs import swarm, tuning
from railrepro.evidence.runs.executor import executor, ordered_map

Sets = Mapping[tuple[str, str], dict]
"""(setting, controller) -> tuned set, as `tuning.load` gives it."""
_PAIR = ["setting", "controller"]
_SYMBOLS = {
    "q_psi_TrAx": r"$q_\psi$ (1/rad$^2$)", "q_psidot_Ax": r"$q_{\dot\psi}$ (s$^2$/rad$^2$)", "r": "$R$ (1/(N m)$^2$)",
    "q_terminal": "$q$ (-)", "period_ms": "$T$ (ms)", "horizon_s": "$H$ (s)", "pole": "pole (rad/s)",
    "frequency": "pair (rad/s)", "damping": "damping (-)",
}  # fmt: skip


def runs(tasks: Mapping[str, swarm.Task]) -> pd.DataFrame:
    """Table of the runs in the tuning cost: index (run, "km/h", "m" of length), a column per setting (key of `tasks`).

    Entries are "perfect" or "estimated" (measurements of the controllers), or "-" where the setting lacks the run.
    """
    given = [
        {"run": name, "km/h": run.scenario.speed_kmh, "m": run.scenario.end_m, "setting": setting,
         "given": "estimated" if run.sensors and "perfect" not in run.sensors else "perfect"}
        for setting, task in tasks.items() for name, run in task.runs.items()
    ]  # fmt: skip
    return pd.DataFrame(given).pivot(index=["run", "km/h", "m"], columns="setting", values="given").fillna("-")


def tuned_sets(tasks: Mapping[str, swarm.Task], names: Sequence[str]) -> dict[tuple[str, str], dict]:
    """(setting, controller of `names`) -> tuned set (`tuning.load`), where a swarm tuned it in the setting."""
    return {(setting, name): tuning.load(name, setting, searched=True) for setting, task in tasks.items()
            for name in names if name in task.searched}  # fmt: skip


def _by_pair(rows: Mapping[tuple[str, str], Mapping]) -> pd.DataFrame:
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis(_PAIR)


def costs(sets: Sets) -> pd.DataFrame:
    """Table by setting and controller: cost (-) of the tuned set and of the worst swarm (worst_seed), evaluations."""
    return _by_pair({
        pair: {"cost": found["cost"], "worst_seed": max(one["cost"] for one in found["swarms"]),
               "evaluations": len(tuning.particles(pair[1], pair[0]))}
        for pair, found in sets.items()
    })  # fmt: skip


def draw_courses(sets: Sets, settings: Sequence[str]) -> tuple[Figure, pd.DataFrame]:
    """Draw each swarm's lowest cost (-) by iteration; returns figure and iteration, seed, cost, setting, controller."""
    lines = []
    for setting, name in sets:
        lowest = tuning.particles(name, setting).pivot_table(
            index="iteration", columns="seed", values="cost", aggfunc="min"
        )
        lowest = lowest.cummin().melt(ignore_index=False, var_name="seed", value_name="cost").reset_index()
        lines.append(lowest.assign(setting=setting, controller=name))
    history = pd.concat(lines).dropna()
    used = {pair: min(found["swarms"], key=lambda one: one["cost"])["seed"] for pair, found in sets.items()}
    figure, axes = figures.new_figure(len(settings), 1, height=1.5, sharex=True, sharey=True)
    for axis, setting in zip(axes, settings, strict=True):
        for (name, seed), rows in history[history["setting"] == setting].groupby(["controller", "seed"], sort=False):
            look = figures.LOOKS[name].line
            marks = {"linewidth": 1.2, "marker": figures.LOOKS[name].marker, "markersize": 4}
            marks["markevery"] = list(figures.LOOKS).index(name) % 3, 3
            look |= marks if seed == used[setting, name] else {"linewidth": 0.4, "label": None}
            axis.semilogy(rows["iteration"], rows["cost"], **look)
        axis.set_ylabel(f"best cost, {setting} (-)")
        axis.set_yticks([0.1, 0.3, 1, 3], ["0.1", "0.3", "1", "3"])
        axis.yaxis.set_minor_locator(NullLocator())
    axes[-1].set_xlabel("iteration (-); thick: swarm that is used, thin: the two others")
    handles = figures.handles(axes)
    figure.legend(handles.values(), handles.keys(), ncols=2, loc="outside upper center")
    return figure, history


def draw_sensitivity(sets: Sets, task: swarm.Task, names: Sequence[str]) -> tuple[Figure, pd.DataFrame]:
    """Draw costs (-) of particles in the setting `equal`, up to 4 times the chosen one, over each parameter of `task`.

    `names` are controllers. Returns also the drawn data: controller, parameter, value, cost.
    """
    shown = [(name, dimension) for name in names for dimension in task.dimensions[name]]
    size = {"height": 1.35, "width": figures.WIDTH / 3, "sharey": "row", "squeeze": False}
    figure, axes = figures.new_figure(-(-len(shown) // 3), 3, **size)
    rows = []
    for i, (axis, (name, d)) in enumerate(zip(axes.flat, shown, strict=False)):
        table, chosen, log = tuning.particles(name, tuning.EQUAL), sets[tuning.EQUAL, name], d.scale == "log"
        good = table[table["cost"] < 4 * chosen["cost"]]
        axis.plot(good[d.name], good["cost"], ".", color="0.65", markersize=1.5, label="particle")
        axis.plot(*_lowest_in_tenths(good[d.name], good["cost"], log), color="black", label="least cost in a tenth")
        axis.axvline(chosen["parameters"][d.name], color=figures.PURPLE, linestyle="--", label="chosen value")
        axis.set(xlabel=_SYMBOLS.get(d.name, d.name), ylim=(0, 4 * chosen["cost"]), xscale="log" if log else "linear")
        if log:
            axis.xaxis.set(major_locator=LogLocator(numticks=4), minor_locator=NullLocator())
        if i % 3 == 0:
            axis.set_ylabel(f"cost (-), {figures.LOOKS[name].label}")
        rows.append(good[[d.name, "cost"]].rename(columns={d.name: "value"}).assign(controller=name, parameter=d.name))
    figure.legend(*axes.flat[0].get_legend_handles_labels(), ncols=3, loc="outside upper center", markerscale=3)
    return figure, pd.concat(rows)[["controller", "parameter", "value", "cost"]]


def _lowest_in_tenths(values: pd.Series, cost: pd.Series, log: bool) -> tuple[np.ndarray, np.ndarray]:
    """Middles of ten equal parts of the range of values, and the lowest cost in each."""
    lowest = cost.groupby(pd.cut(np.log10(values) if log else values, 10), observed=True).min()
    middles = np.array([part.mid for part in lowest.index])
    return 10**middles if log else middles, lowest.to_numpy()


def _evaluated(cases: Sequence[tuple[str, str, dict]], tasks: Mapping[str, swarm.Task], name: str) -> list[float]:
    """Costs of (setting, controller, parameters)."""

    def cost(case: tuple[str, str, dict]) -> float:
        setting, controller, parameters = case
        return swarm.evaluate(controller, tasks[setting], parameters)[0]

    with executor() as pool:
        return ordered_map(pool, cost, cases, name, quiet=True)


def beyond_bounds(sets: Sets, tasks: Mapping[str, swarm.Task]) -> pd.DataFrame:
    """Costs with a parameter moved beyond its bound, one row for each tuned parameter within 2 % of a bound.

    It is moved to 0.75 times the lower or 1.25 times the upper bound. Columns setting, controller, parameter, best
    (tuned value), beyond (moved value), cost, cost_beyond, gain (relative fall of the cost, -).
    """
    rows, cases = [], []
    for pair, found in sets.items():
        for d in tasks[pair[0]].dimensions[pair[1]]:
            best = found["parameters"][d.name]
            for bound, factor in ((d.low, 0.75), (d.high, 1.25)):
                if np.isclose(best, bound, rtol=0.02, atol=0):
                    beyond = round(factor * bound) if d.scale == "integer" else factor * bound
                    rows.append((*pair, d.name, best, beyond, found["cost"]))
                    cases.append((*pair, found["parameters"] | {d.name: beyond}))
    table = pd.DataFrame(rows, columns=[*_PAIR, "parameter", "best", "beyond", "cost"])
    table["cost_beyond"] = _evaluated(cases, tasks, "beyond")
    return table.assign(gain=1 - table["cost_beyond"] / table["cost"])


def recomputed(sets: Sets, tasks: Mapping[str, swarm.Task], names: Sequence[str]) -> pd.DataFrame:
    """Table by setting and controller (of `names`): cost (-) of the tuned set as `stored`, and as `recomputed`."""
    pairs = [pair for pair in sets if pair[1] in names]
    again = _evaluated([(*pair, sets[pair]["parameters"]) for pair in pairs], tasks, "recomputed")
    return _by_pair(
        {pair: {"stored": sets[pair]["cost"], "recomputed": cost} for pair, cost in zip(pairs, again, strict=True)}
    )
