"""Negative controls: `CONTROLS` has functions from evidence to the evidence in the named counterfactual, in which a
rule must not hold. data/claims.toml names one or more per statement. Serves the paper's section Multi-Body Simulation
Results."""

from collections.abc import Callable
from dataclasses import replace

import pandas as pd

from railrepro.control.registry import PAPER_TRIO
from railrepro.evidence.claims import statements
from railrepro.evidence.claims.statements import LOSS, NDI, NO_LAW, NOTHING, SINES, T3, Evidence

Control = Callable[[Evidence], Evidence]
_LARGER_R = (statements.BETWEEN, statements.SOFTEST)
_DRIVEN = (*PAPER_TRIO, statements.SOFT, *_LARGER_R)
_STANDS_STILL = {"delay": float("inf"), "ndi_later": 0.0, "ndi_alike": 0.0, "effort_du": 0.0}
_STANDS_STILL |= {"set_point_gain": 0.0, "error_growth": 1.0}
_SWEEP, _POLES, _DRY = "sweep of R", "sweep of poles", statements.FASTEST


def metrics(change: Callable[[Evidence, str, str, str, float], float]) -> Control:
    """Evidence with each metric changed: (evidence, scenario, controller, metric, value) -> value."""
    return lambda e: replace(e, metrics={key: change(e, *key, value) for key, value in e.metrics.items()})


def table(name: str, change: Callable[[pd.DataFrame], pd.DataFrame]) -> Control:
    """Evidence with one of its tables changed."""
    return lambda e: replace(e, tables=lambda which: change(e.table(which)) if which == name else e.table(which))


def with_times_of(other: str) -> Control:
    """The solver of LTV-MPC takes the times of another one."""

    def change(times: pd.DataFrame) -> pd.DataFrame:
        rest = times[times["solver"] != "ltv_mpc"]
        return pd.concat([rest, rest[rest["solver"] == other].assign(solver="ltv_mpc")])

    return table("solve_times", change)


def like_nmpc(controller: str, but: str = "") -> Control:
    """A controller has the data of NMPC."""
    return metrics(lambda e, s, c, m, v: e.metrics[s, "nmpc", m] if c == controller and m != but else v)


@metrics
def still(e: Evidence, scenario: str, controller: str, metric: str, value: float) -> float:
    """No controller leaves the centre line."""
    if controller not in _DRIVEN:
        return value
    return _STANDS_STILL.get(metric, e.metrics.get((scenario, NOTHING, metric), value))


def thrice(e: Evidence) -> Evidence:
    """LTV-MPC, NDI and all larger R have the data of NMPC, the sweep of poles has those of the sweep of R."""
    alike = {
        key: e.metrics.get((key[0], "nmpc", key[2]), value) for key, value in e.metrics.items() if key[1] in _DRIVEN
    }
    poles = {(s, _POLES, m): v for (s, c, m), v in e.metrics.items() if c == _SWEEP}
    at_once = {key: 0.0 for key in e.metrics if key[2] == "ndi_later"}
    return replace(e, metrics={k: v for k, v in e.metrics.items() if k[1] != _POLES} | alike | at_once | poles)


def set_point_ignored(e: Evidence) -> Evidence:
    """The wheels roll, whatever adhesion is demanded."""
    ignored = {"regular_deviation": 1.0, "approached": 0.0}
    rolling = metrics(lambda e, s, c, m, v: ignored.get(m, v))(e)
    return table("adhesion_map", lambda t: t.assign(utilisation=0.0))(rolling)


def no_slip_control(e: Evidence) -> Evidence:
    """The base torque follows the demand and nothing else, with the same R."""
    ramped = metrics(lambda e, s, c, m, v: e.metrics.get((s, NO_LAW.get(c, c), m), v))(e)

    def without(fields: pd.DataFrame) -> pd.DataFrame:
        free = fields[fields["map"] == "no slip control"]
        return pd.concat([free, free.assign(map="friction")])

    return table("adhesion_map", without)(ramped)


@metrics
def rail_without_effect(e: Evidence, scenario: str, controller: str, metric: str, value: float) -> float:
    """The errors on poor rail are those on dry rail, relative to y = 0."""
    if scenario != LOSS or controller not in ("nmpc", NDI) or metric != "rmse_y":
        return value
    return e.metrics[LOSS, NOTHING, metric] / e.metrics[_DRY, NOTHING, metric] * e(_DRY, controller, metric)


@metrics
def weight_without_effect(e: Evidence, scenario: str, controller: str, metric: str, value: float) -> float:
    """Every R has the results of the first one."""
    if controller == _SWEEP:
        return e.metrics.get((scenario, controller, metric.partition(" ")[0] + " 1"), value)
    return e.metrics.get((scenario, "nmpc", metric), value) if controller in _LARGER_R else value


CONTROLS: dict[str, Control] = {
    "y = 0": still,
    "one controller thrice": thrice,
    "set point ignored": set_point_ignored,
    "rail without effect": rail_without_effect,
    "R without effect": weight_without_effect,
    "speed without effect": metrics(
        lambda e, s, c, m, v: e.metrics.get((SINES[80], c, m), v) if s.startswith("sine_tracking") else v
    ),
    # running gears keep their heading while the track turns
    "straight on": metrics(lambda e, s, c, m, v: 1.0 if m == "path_error" else v),
    # both MPC follow their set point as late as NDI
    "delay of NDI": metrics(lambda e, s, c, m, v: e.metrics[s, NDI, m] if m == "delay" else v),
    "no slip control": no_slip_control,
    "straight track": metrics(  # T3 without curve and cant: neither steady error nor gyroscopic torque
        lambda e, s, c, m, v: 0.0 if s == T3 and m in (statements.DRIFT, "gyroscopic_share") else v
    ),
    # T1 needs the torque of T3
    "one track": metrics(lambda e, s, c, m, v: e.metrics.get((T3, c, m), v) if s == "curve_entry_T1" else v),
    "no shortfall": metrics(lambda e, s, c, m, v: 0.0 if m == "shortfall" else v),
    # cant for the full centrifugal acceleration
    "no unbalanced acceleration": table("table1", lambda t: t.assign(phi_deg=t["phi_deg"] + [0.0, 1.27, 2.53, 3.8])),
    "one code twice": with_times_of("gauss_newton"),
    "interpreted solver": with_times_of("ipopt"),
    "a hard track": table(  # problems of one track take five times as long
        "solve_times", lambda t: t.assign(median_ms=t["median_ms"].mask(t["scenario"] == T3, 5 * t["median_ms"]))
    ),
    "cause without effect": like_nmpc(statements.AS_MODELLED),
    "cause decides": metrics(  # profiles and creep triple the error
        lambda e, s, c, m, v: e.metrics[s, "nmpc", m] / 3 if c in (statements.CONES, statements.NO_CREEP) else v
    ),
    # a quarter of the bound, so that smaller steps are judged
    "smaller steps": table("adhesion_law", lambda t: t.assign(p2_over_bound=4 * t["p2_over_bound"])),
    "step without effect": table("adhesion_law", lambda t: t.assign(rms_error=1.0)),
    "fixed share costs nothing": like_nmpc(statements.FIXED, but="share"),
    "base torque without effect": like_nmpc(statements.UNINFORMED),
    "future without effect": metrics(  # controllers without preview are as late as those with preview
        lambda e, s, c, m, v: (
            e.metrics[s, "nmpc", m]
            if c in (statements.RATES, statements.SHORT, statements.HELD) and m == "delay"
            else v
        )
    ),
    "a lag doubles the error": metrics(
        lambda e, s, c, m, v: (
            2.1 * e.metrics[s.partition("ms, ")[2], c, m] if s.startswith("lag ") and m == "rmse_y" else v
        )
    ),
    "a lag derails": metrics(lambda e, s, c, m, v: 1.0 if s.startswith("lag 10 ") and m == "failed" else v),
    "preview without effect": like_nmpc(statements.PREVIEW),
}
