"""Negative controls: evidence that must fail a rule. A rule that its negative control passes is no rule.

Each is a function from evidence to what it would be if the named thing were so; data/claims.toml names one per
statement, and a test holds that it is not reproduced then.

Serves the paper's section Multi-Body Simulation Results.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pandas as pd

from railrepro.control.registry import PAPER_TRIO
from railrepro.evidence.claims.statements import (
    BETWEEN,
    BRAKE,
    CONES,
    FIXED,
    LOSS,
    NDI,
    NO_CREEP,
    NO_LAW,
    NOTHING,
    PREVIEW,
    REGULAR,
    SOFT,
    SOFTEST,
    T3,
    UNINFORMED,
    Evidence,
)

CONTROLS: dict[str, Callable[[Evidence], Evidence]] = {}
_DRIVEN = (*PAPER_TRIO, SOFT, SOFTEST, BETWEEN)
_STANDS_STILL = {"delay": float("inf"), "torque_later": 0.0, "torque_alike": 0.0, "effort_du": 0.0}
_STANDS_STILL |= {"set_point_gain": 0.0, "error_growth": 1.0}


def control(name: str) -> Callable:
    """Register a negative control."""

    def register(function):
        CONTROLS[name] = function
        return function

    return register


def _changed(e: Evidence, change: Callable[[str, str, str, float], float]) -> Evidence:
    return replace(e, metrics={key: change(*key, value) for key, value in e.metrics.items()})


def _tables(e: Evidence, **changes: Callable[[pd.DataFrame], pd.DataFrame]) -> Evidence:
    """Evidence with some of its tables changed."""

    def read(name: str) -> pd.DataFrame:
        table = e.table(name).copy()
        return changes[name](table) if name in changes else table

    return replace(e, tables=read)


@control("y = 0")
def _still(e: Evidence) -> Evidence:
    """No controller leaves the centre line."""

    def change(scenario, controller, metric, value):
        if controller not in _DRIVEN:
            return value
        return _STANDS_STILL.get(metric, e.metrics.get((scenario, NOTHING, metric), value))

    return _changed(e, change)


@control("straight on")
def _straight_on(e: Evidence) -> Evidence:
    """Every gear keeps its heading while the track turns away."""
    return _changed(e, lambda s, c, m, v: 1.0 if m == "path_error" else v)


@control("delay of NDI")
def _late(e: Evidence) -> Evidence:
    """The MPC trail their set point as NDI does."""
    return _changed(e, lambda s, c, m, v: e.metrics[s, NDI, m] if m == "delay" else v)


@control("one controller thrice")
def _thrice(e: Evidence) -> Evidence:
    """LTV-MPC, NDI and all other settings have the data of NMPC."""

    def change(scenario, controller, metric, value):
        if metric == "torque_later":
            return 0.0
        twin = "sweep of R" if controller == "sweep of poles" else "nmpc"
        return e.metrics.get((scenario, twin, metric), value) if controller in (*_DRIVEN, "sweep of poles") else value

    changed = _changed(e, change)
    if any(controller == "sweep of poles" for _, controller, _ in e.metrics):
        sweep = {k: v for k, v in e.metrics.items() if k[1] == "sweep of R"}
        stored = {k: v for k, v in changed.metrics.items() if k[1] != "sweep of poles"}
        return replace(changed, metrics=stored | {(s, "sweep of poles", m): v for (s, _, m), v in sweep.items()})
    return changed


@control("no slip control")
def _slips(e: Evidence) -> Evidence:
    """The base torque follows the demand and nothing else, with the same R."""
    return _changed(e, lambda s, c, m, v: e.metrics.get((s, NO_LAW[c], m), v) if c in NO_LAW else v)


@control("set point ignored")
def _no_traction(e: Evidence) -> Evidence:
    """The wheels roll, whatever adhesion is demanded."""
    changed = _changed(e, lambda s, c, m, v: 1.0 if c in REGULAR.values() else 0.0 if m == "utilisation_late" else v)
    return _tables(changed, adhesion_map=lambda t: t.assign(utilisation=0.0))


@control("straight track")
def _straight(e: Evidence) -> Evidence:
    """T3 without curve and cant: neither drift nor gyroscopic torque."""
    gone = ("mean_error_last_third", "gyroscopic_share")
    return _changed(e, lambda s, c, m, v: 0.0 if s == T3 and m in gone else v)


@control("one track")
def _one_track(e: Evidence) -> Evidence:
    """T1 asks for what T3 asks for."""
    return _changed(e, lambda s, c, m, v: e.metrics.get((T3, c, m), v) if s == "curve_entry_T1" else v)


@control("error alike everywhere")
def _alike(e: Evidence) -> Evidence:
    return _changed(e, lambda s, c, m, v: 1.0 if m == "error_at_crests" else v)


@control("speed without effect")
def _any_speed(e: Evidence) -> Evidence:
    """The sine at every speed gives what it gives at the lowest."""
    lowest = f"sine_tracking {e.speeds()[0]}"
    return _changed(e, lambda s, c, m, v: e.metrics.get((lowest, c, m), v) if s.startswith("sine_tracking") else v)


@control("rail without effect")
def _any_rail(e: Evidence) -> Evidence:
    """Poor rail gives what dry rail gives, relative to y = 0, to whichever controller is judged."""
    idle = e.metrics[LOSS, NOTHING, "rmse_y"] / e.metrics["sine_tracking 400", NOTHING, "rmse_y"]

    def change(scenario, controller, metric, value):
        if scenario == LOSS and controller in ("nmpc", NDI) and metric == "rmse_y":
            return idle * e("sine_tracking 400", controller, "rmse_y")
        return value

    return _changed(e, change)


@control("R without effect")
def _any_weight(e: Evidence) -> Evidence:
    def change(scenario, controller, metric, value):
        first = metric.partition(" ")[0] + " 1"
        if controller == "sweep of R":
            return e.metrics.get((scenario, controller, first), value)
        return e.metrics.get((scenario, "nmpc", metric), value) if controller in (BETWEEN, SOFTEST) else value

    return _changed(e, change)


@control("no unbalanced acceleration")
def _balanced(e: Evidence) -> Evidence:
    """Cant for the full centrifugal acceleration."""
    return _tables(e, table1=lambda t: t.assign(phi_deg=t["phi_deg"] + [0.0, 1.27, 2.53, 3.8]))


@control("one code twice")
def _one_code(e: Evidence) -> Evidence:
    return _tables(e, solve_times=lambda t: _as_solver(t, "ltv_mpc", "gauss_newton"))


@control("interpreted solver")
def _slow_code(e: Evidence) -> Evidence:
    return _tables(e, solve_times=lambda t: _as_solver(t, "ltv_mpc", "ipopt"))


def _as_solver(table: pd.DataFrame, which: str, other: str) -> pd.DataFrame:
    rest = table[table["solver"] != which]
    return pd.concat([rest, rest[rest["solver"] == other].assign(solver=which)])


@control("a hard track")
def _hard(e: Evidence) -> Evidence:
    """Problems of one track take five times as long."""
    hard = {"curve_entry_T3": 5.0}
    return _tables(e, solve_times=lambda t: t.assign(median_ms=t["median_ms"] * t["scenario"].map(hard).fillna(1.0)))


@control("cause without effect")
def _no_cause(e: Evidence) -> Evidence:
    return _changed(e, lambda s, c, m, v: e.metrics[s, "nmpc", m] if c == NO_CREEP else v)


@control("cause decides")
def _all_cause(e: Evidence) -> Evidence:
    """Profiles triple the error."""
    return _changed(e, lambda s, c, m, v: e.metrics[s, "nmpc", m] / 3 if c == CONES else v)


@control("step without effect")
def _any_step(e: Evidence) -> Evidence:
    return _tables(e, adhesion_law=lambda t: t.assign(rms_error=1.0))


@control("fixed share costs nothing")
def _free_share(e: Evidence) -> Evidence:
    return _changed(e, lambda s, c, m, v: e.metrics[BRAKE, "nmpc", m] if c == FIXED and m != "share" else v)


@control("base torque without effect")
def _uninformed(e: Evidence) -> Evidence:
    return _changed(e, lambda s, c, m, v: e.metrics[s, "nmpc", m] if c == UNINFORMED else v)


@control("preview without effect")
def _blind(e: Evidence) -> Evidence:
    return _changed(e, lambda s, c, m, v: e.metrics[s, "nmpc", m] if c == PREVIEW else v)
