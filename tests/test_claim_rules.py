"""Rule of each claim on result tables made by hand: value and verdict on both sides of every limit.

The limits here are round numbers of the test; those that count are in data/claims.toml.
"""

import casadi as ca
import numpy as np
import pandas as pd
import pytest

from railrepro.report import claims
from railrepro.report.claims import NOT, PARTLY, REPRODUCED, UNTESTABLE

FIG08 = "NMPC, R x 10"


class Tables(claims.Results):
    """Results that were handed in."""

    def __init__(self, **tables):
        super().__init__()
        self._tables = tables

    def __getitem__(self, name):
        return self._tables[name]


def judge(identity, tables, tolerance=None, paper=None):
    measured = claims.MEASURES[identity](Tables(**tables), {"tolerance": tolerance, "paper": paper})
    return measured.value, measured.verdict


def rows(columns, *values):
    return pd.DataFrame(values, columns=columns.split())


def long(scenario, metric, **values):
    """Rows of a table of metrics, one per controller."""
    return [(scenario, name, 400, metric, value) for name, value in values.items()]


def curve(metric, nmpc, ltv_mpc, ltv_mpc_printed, ndi):
    values = {"nmpc": nmpc, "ltv_mpc": ltv_mpc, "ltv_mpc_printed": ltv_mpc_printed, "ndi": ndi}
    return {"curve_entry_metrics": rows("scenario controller speed_kmh metric value", *long("T3", metric, **values))}


def sine(nmpc, ltv_mpc_printed, ndi, scenario="sine_tracking"):
    """RMSE at the speeds 100, 200, … km/h, or in the curves T1, T2, …; with rows that do not count."""
    entries = [("other", "nmpc", 100, "delay", 9.0)]
    for name, values in (("nmpc", nmpc), ("ltv_mpc_printed", ltv_mpc_printed), ("ndi", ndi)):
        for i, value in enumerate(values):
            if scenario == "sine_tracking":
                entries.append((scenario, name, 100 * (i + 1), "rmse_y", value))
                entries.append(("curve_entry_T1", name, 100 * (i + 1), "delay", 7.0))
            else:
                entries.append((f"curve_entry_T{i + 1}", name, 100, "rmse_y", value))
                entries.append(("sine_tracking", name, 100, "delay", 7.0))
    return {"sine_metrics": rows("scenario controller speed_kmh metric value", *entries)}


def curves(nmpc, ltv_mpc_printed, ndi):
    return sine(nmpc, ltv_mpc_printed, ndi, "curves")


def efforts(**values):
    nmpc = [(f"curve_entry_{track}", "nmpc", 1, "effort_du", value) for track, value in values.items()]
    others = (("sine_tracking", "nmpc", 1, "effort_du", 99.0), ("curve_entry_T2", "ndi", 1, "effort_du", 99.0))
    other_metric = ("curve_entry_T2", "nmpc", 1, "rmse_y", 99.0)
    return {"sine_metrics": rows("scenario controller speed_kmh metric value", *nmpc, *others, other_metric)}


def table_one(sin, tan):
    return {
        "table1": rows(
            "printed_m b_sin_phi_m b_tan_phi_m", *((1.0, 1 + a, 1 + b) for a, b in zip(sin, tan, strict=True))
        )
    }


def gap(nmpc, printed):
    entries = [("curve_entry_T3", "nmpc", nmpc), ("curve_entry_T3", "ltv printed", printed)]
    entries += [("curve_entry_T1", "nmpc", 9.0), ("curve_entry_T1", "ltv printed", 1.0)]
    return {"ltv_gap": rows("scenario kind rmse_y", *entries)}


def cause_table(metric, tuned, changed, cause):
    """A cause against the tuned case on T3 (and on the straight, given as pairs)."""
    other = "mean_error_last_third" if metric == "rmse_y" else "rmse_y"
    entries = [
        (case, name, value)
        for name, pair in (("as tuned", tuned), (cause, changed))
        for case, value in zip(("T3, 280 km/h", "straight, 160 km/h"), pair, strict=True)
    ]
    return {"sine_causes": rows(f"case cause {metric}", *entries).assign(**{other: 5.0})}


def times(gauss_newton, ltv_mpc=(1.0,), bounds=5.0):
    """Largest and median time of each scenario, one more with tightened bounds."""
    entries = [("gauss_newton", f"T{i}", value, value) for i, value in enumerate(gauss_newton)]
    entries += [("ltv_mpc", f"T{i}", value, value) for i, value in enumerate(ltv_mpc)]
    entries += [("gauss_newton", "T3, bounds", bounds, bounds), ("ltv_mpc", "T3, bounds", 99.0, 99.0)]
    entries += [("ipopt", "T3", 400.0, 400.0)]
    return {"solve_times": rows("solver scenario median_ms max_ms", *entries)}


def fig08(**values):
    row = {"reached_m": 240.0, "largest_slip": 0.02, "largest_error": 4e-3, "failed": False} | values
    other = {"reached_m": 1.0, "largest_slip": 9.0, "largest_error": 9.0, "failed": True}
    table = pd.DataFrame(
        [
            {"experiment": "fig08", "case": FIG08, **row},
            {"experiment": "fig08", "case": "NMPC, tuned", **other},
            {"experiment": "sudden", "case": FIG08, **other},
        ]
    )
    return {"adhesion_metrics": table}


def fig08_series(fx_ri, fx_le, f_star, segment=1, p_m=None):
    p_m = np.linspace(81, 124, len(fx_ri)) if p_m is None else p_m
    table = pd.DataFrame({"p_m": p_m, "fx_ri": fx_ri, "fx_le": fx_le, "f_star": f_star, "segment": segment})
    other = pd.DataFrame({"p_m": [80.0, 100.0, 125.0], "fx_ri": 9.0, "fx_le": 9.0, "f_star": 0.0, "segment": 1})
    marks = [FIG08, "another", FIG08]
    return {"fig08_adhesion_loss": pd.concat([table.assign(case=FIG08), other.assign(case=marks)])}


def macro_slip(level, segments=(1, 3)):
    """A mean adhesion of `level` behind 250 m; the last fifth has the maximum, 1.25 on the right wheel, and a spike."""
    n = 1000
    adhesion = np.full(n, (level - 0.2) / 0.8)
    adhesion[-n // 5 :] = 1.0
    right = 1.25 * adhesion
    right[-1] += 100.0
    left = 2 * adhesion - right
    places, turns = np.linspace(251, 900, n), np.resize(segments, n)
    return fig08_series(right, left, 1.0, turns, places)


def sudden(*slips):
    """Pairs of largest slip with and without slip control."""
    entries = []
    for i, (with_control, without) in enumerate(slips):
        entries += [("sudden", i, "traction", True, with_control), ("sudden", i, "traction", False, without)]
    entries += [("fig08", 9, "traction", True, 9.0), ("fig08", 9, "traction", False, 1.0)]
    return {"adhesion_metrics": rows("experiment place drive slip_control largest_slip", *entries)}


def friction_map(*utilisation):
    entries = [("friction", value) for value in utilisation] + [("speed", 0.0)]
    return {"adhesion_map": rows("map utilisation", *entries)}


def bound(*errors):
    """Error of the adhesion for steps of 0.5, 1.0, 1.5 and 3 times the bound, out of order."""
    table = rows("p2_over_bound rms_error", *zip((0.5, 1.0, 1.5, 3.0), errors, strict=True))
    return {"adhesion_law": table.iloc[::-1]}


def front(sweep=(), nmpc=(), ndi=(1000.0, 1.0), fixed=()):
    """Braking runs (distance, error): sweep of R by factor, tuned settings, NDI, fixed shares; and one that failed."""
    entries = [("nmpc", "nmpc", factor, *run, True) for factor, *run in sweep]
    entries += [("tuned", "nmpc", np.nan, *run, True) for run in nmpc]
    entries += [("tuned", "ndi", np.nan, *ndi, True)]
    entries += [("fixed", "nmpc", np.nan, distance, 1.0, True) for distance in fixed]
    entries += [(kind, "nmpc", 50.0, 1.0, 9.0, False) for kind in ("nmpc", "tuned", "fixed")]
    return {"braking_front": rows("kind controller factor stopping_distance rmse_y stopped", *entries)}


FALLING = ((1, 1003.0, 1.0), (10, 1002.0, 2.0), (100, 1001.0, 3.0))
DECOYS = ((0.01, 1001.5, 2.5), (0.1, 1000.0, 4.0))


def dependence(informed, blind):
    entries = [(1, 3, 1.0, 4000.0, informed), (1, 3, 1.0, 0.0, blind)]
    entries += [(2, 3, 1.0, 4000.0, 9.0), (1, 2, 1.0, 4000.0, 9.0), (1, 3, 0.5, 0.0, 9.0), (1, 3, 1.0, 1000.0, 9.0)]
    return {"braking_dependence": rows("factor amplitude_mm wavelength limit_Nm rmse_y", *entries[::-1])}


def rough(metrics, s1002=(1.0, 1.0)):
    """Ride figures of NMPC on the cone without and with preview, decoys beside them."""
    cases = [("cone", name, values) for name, values in metrics.items()] + [("S1002", "rmse_y", s1002)]
    table = [
        (controller, track, car, preview, seed, name, value * factor + spread)
        for car, name, values in cases
        for preview, value in zip(("none", "exact"), values, strict=True)
        for controller, track, factor in (("nmpc", "straight", 1.0), ("nmpc", "T3", 7.0), ("ndi", "straight", 0.1))
        for seed, spread in ((1, -0.25 * value), (2, 0.25 * value))
    ]
    return {"ride_metrics": rows("controller track car preview seed metric value", *table)}


def cones(*arguments, irregular=1.0):
    return cause_table(*arguments, "S1002 profiles") | rough({"rmse_y": (5.0, 1.0)}, (9.0, irregular))


GROWING, SHRINKING = (1.0, 2.0, 3.0), (3.0, 2.0, 1.0)


@pytest.mark.parametrize(
    ("identity", "limits", "tables", "value", "verdict"),
    [
        ("C01", (0.5,), table_one((0.1, -0.5), (9, 9)), 0.5, REPRODUCED),
        ("C01", (0.5,), table_one((-0.75, 0.1), (0, 0)), 0.75, NOT),
        ("C02", (0.5,), table_one((9, 9), (0.1, -0.5)), 0.5, REPRODUCED),
        ("C02", (0.5,), table_one((0, 0), (0.1, 0.75)), 0.75, NOT),
        ("C03", (1.0,), efforts(T1=4.0, T2=1.0, T3=2.0), 2.0, REPRODUCED),
        ("C03", (1.0,), efforts(T1=2.0, T2=2.0, T3=1.0), 1.0, NOT),
        ("C03", (1.0,), efforts(T1=2.0, T2=4.0, T3=1.0), 0.5, NOT),
        ("C04", (6.0,), curve("largest_error", 1e-3, 2e-3, 3e-3, 4e-3), 4.0, REPRODUCED),
        ("C04", (6.0,), curve("largest_error", 7e-3, 2e-3, 3e-3, 4e-3), 7.0, NOT),
        ("C04", (6.0,), curve("largest_error", 1e-3, 7e-3, 3e-3, 4e-3), 7.0, NOT),
        ("C04", (6.0,), curve("largest_error", 1e-3, 2e-3, 7e-3, 4e-3), 7.0, NOT),
        ("C04", (6.0,), curve("largest_error", 1e-3, 2e-3, 3e-3, 6e-3), 6.0, NOT),
        ("C05", (0.5,), curve("rmse_y", 0.4, 9, 0.3, 1), 0.4, REPRODUCED),
        ("C05", (0.5,), curve("rmse_y", 0.4, 9, 0.5, 1), 0.5, PARTLY),
        ("C05", (0.5,), curve("rmse_y", 0.8, 9, 0.9, 2), 0.45, REPRODUCED),
        ("C05", (0.5,), curve("rmse_y", 0.5, 9, 0.3, 1), 0.5, NOT),
        ("C05", (0.5,), curve("rmse_y", 0.9, 9, 1.2, 2), 0.6, PARTLY),
        ("C06", (0.5,), curve("rmse_y", 0.4, 0, 1, 2), 0.4, REPRODUCED),
        ("C06", (0.5,), curve("rmse_y", 0.9, 0, 3, 2), 0.45, REPRODUCED),
        ("C06", (0.5,), curve("rmse_y", 0.5, 0, 1, 2), 0.5, PARTLY),
        ("C06", (0.5,), curve("rmse_y", 2.03, 0, 2, 3), 1.015, PARTLY),
        ("C06", (0.5,), curve("rmse_y", 1.02, 0, 2, 1), 1.02, NOT),
        ("C06", (0.5,), curve("rmse_y", 2.1, 0, 2, 3), 1.05, NOT),
        ("C07", (1.5,), gap(2.0, 2.06), 1.03, REPRODUCED),
        ("C07", (1.5,), gap(2.0, 3.0), 1.5, PARTLY),
        ("C07", (1.5,), gap(2.0, 2.02), 1.01, NOT),
        ("C07", (1.5,), gap(1.0, 1.02), 1.02, NOT),
        ("C08", (2.0,), curve("delay", 1.0, -1.5, 0.5, 9), 1.5, REPRODUCED),
        ("C08", (2.0,), curve("delay", -2.0, 1, 1, 5), 2.0, PARTLY),
        ("C08", (2.0,), curve("delay", 1, 1, 3.0, 7), 3.0, PARTLY),
        ("C08", (2.0,), curve("delay", 1, 3.0, 1, 6), 3.0, NOT),
        ("C11", (0.3,), curve("mean_error_last_third", -4e-4, 0, 0, 0), -0.4, REPRODUCED),
        ("C11", (0.3,), curve("mean_error_last_third", 4e-4, 0, 0, 0), 0.4, REPRODUCED),
        ("C11", (0.5,), curve("mean_error_last_third", 5e-4, 9, 9, 9), 0.5, NOT),
        ("C13", (0.5,), cause_table("mean_error_last_third", (-4, 1), (1, 9), "no creep"), 0.25, REPRODUCED),
        ("C13", (0.5,), cause_table("mean_error_last_third", (4, 9), (-2, 1), "no creep"), 0.5, NOT),
        ("C14", (None, 4.0), times((6.0, 7.0, 9.0), (1.0, 2.0, 9.0)), 3.5, REPRODUCED),
        ("C14", (None, 4.0), times((7.9,)), 7.9, REPRODUCED),
        ("C14", (None, 4.0), times((2.1,)), 2.1, REPRODUCED),
        ("C14", (None, 4.0), times((8.1,)), 8.1, PARTLY),
        ("C14", (None, 4.0), times((1.9,)), 1.9, PARTLY),
        ("C14", (None, 4.0), times((1.0,)), 1.0, NOT),
        ("C15", (5.0,), times((1.0, 4.0), bounds=4.5), 4.5, REPRODUCED),
        ("C15", (5.0,), times((1.0, 4.0)), 5.0, PARTLY),
        ("C15", (5.0,), times((1.0, 5.0)), 5.0, NOT),
        ("C15", (5.0,), times((1.0, 6.0), bounds=1.0), 6.0, NOT),
        ("C16", (0.75,), curves([1, 1, 1, 2], [2, 2, 2, 1], [3] * 4), 0.75, REPRODUCED),
        ("C16", (0.75,), curves([1, 1, 2, 2], [2, 2, 1, 2], [3] * 4), 0.5, PARTLY),
        ("C16", (0.75,), curves([1, 1, 2, np.nan], [2, 2, 1, 2], [3, 2, 3, 3]), 0.25, PARTLY),
        ("C16", (0.75,), curves([1, 1, 1, 1], [2, 2, 2, 2], [3, 3, 3, np.nan]), 1.0, REPRODUCED),
        ("C16", (0.75,), curves([2, 2, 3, 1], [1, 2, 2, 3], [3, 3, 1, 2]), 0.0, NOT),
        ("C17", (0.5,), sine([1, 2], [2, 1], [3, 3]), 0.5, REPRODUCED),
        ("C17", (0.9,), sine([1] * 10, [0] + 9 * [2], [3] * 10), 0.9, REPRODUCED),
        ("C17", (1.0,), sine([1] * 10, [0] * 10, [0.5] + 9 * [3]), 0.0, PARTLY),
        ("C17", (1.0,), sine([1] * 10, [2] * 10, [0.5, 1] + 8 * [3]), 0.8, NOT),
        ("C18", (0.9,), sine(GROWING, GROWING, GROWING), 1.0, REPRODUCED),
        ("C18", (0.9,), sine(GROWING, (1, 3, 2), GROWING), 0.5, PARTLY),
        ("C18", (0.9,), sine((1, 3, 2), GROWING, GROWING), 0.5, PARTLY),
        ("C18", (0.5,), sine(GROWING, GROWING, (1, 3, 2)), 0.5, PARTLY),
        ("C18", (0.9,), sine(GROWING, GROWING, SHRINKING), -1.0, NOT),
        ("C18", (0.9,), sine((1, 3, 1), GROWING, GROWING), 0.0, NOT),
        ("C19", (1.0,), sine((1, 2), (1, 1.5), (1, 3)), 2.0, REPRODUCED),
        ("C19", (1.0,), sine((1, 2), (1, 3), (1, 2)), 0.5, NOT),
        ("C20", (0.9,), sine([1] * 10, [0] * 10, [2] * 9 + [1]), 0.9, REPRODUCED),
        ("C20", (0.9,), sine([1] * 10, [0] * 10, [2] * 5 + [1] * 5), 0.5, PARTLY),
        ("C20", (0.9,), sine([1] * 10, [0] * 10, [2] * 4 + [1] * 6), 0.4, NOT),
        ("C21", (0.006,), fig08_series([0.05, 0.04], [0.06, 0.05], 0.05), 0.005, REPRODUCED),
        ("C21", (0.006,), fig08_series([0.06, 0.04], [0.06, 0.04], 0.05), 0.01, NOT),
        ("C21", (0.5,), fig08_series([1.0, 1.0], [2.0, 2.0], 1.0), 0.5, NOT),
        ("C22", (0.25, 240.0), fig08(reached_m=180.5), 180.5, REPRODUCED),
        ("C22", (0.25, 240.0), fig08(reached_m=299.0), 299.0, REPRODUCED),
        ("C22", (0.25, 240.0), fig08(reached_m=180.0), 180.0, PARTLY),
        ("C22", (0.25, 240.0), fig08(reached_m=300.0), 300.0, PARTLY),
        ("C22", (0.25, 240.0), fig08(reached_m=np.nan), np.nan, NOT),
        ("C23", (0.06,), fig08(largest_slip=0.05), 0.05, REPRODUCED),
        ("C23", (0.06,), fig08(largest_slip=0.06), 0.06, NOT),
        ("C24", (0.5,), macro_slip(0.75), 0.6, REPRODUCED),
        ("C24", (0.5,), macro_slip(0.5), 0.4, PARTLY),
        ("C24", (0.5,), macro_slip(0.75, (1, 2)), 0.6, NOT),
        ("C24", (0.5,), macro_slip(0.75, (2, 3)), 0.6, NOT),
        ("C25", (1.0,), sudden((0.1, 0.3), (0.2, 0.5)), 1.0, REPRODUCED),
        ("C25", (1.0,), sudden((0.1, 0.3), (0.25, 0.5)), 0.5, PARTLY),
        ("C25", (1.0,), sudden((0.1, 0.3), (0.25, 0.5), (0.3, 0.4)), 1 / 3, NOT),
        ("C26", (0.75,), friction_map(0.8, 0.76, 0.9, 0.75), 0.75, REPRODUCED),
        ("C26", (0.75,), friction_map(0.8, 0.74, 0.9, 0.75), 0.5, PARTLY),
        ("C26", (0.75,), friction_map(0.8, 0.74, 0.7, 0.75), 0.25, NOT),
        ("C27", (1.0,), bound(9.0, 1.4, 1.0, 1.0), 1.0, REPRODUCED),
        ("C27", (1.0,), bound(9.0, 2.8, 2.0, 2.0), 1.0, REPRODUCED),
        ("C27", (1.0,), bound(9.0, 1.5, 1.4, 1.0), 1.5, PARTLY),
        ("C27", (1.0,), bound(1.1, 1.2, 1.0, 9.0), 0.5, NOT),
        ("C27", (1.0,), bound(9.0, 9.0, 1.6, 1.0), 3.0, PARTLY),
        ("C28", (5.0,), fig08(largest_error=4e-3), 4.0, REPRODUCED),
        ("C28", (5.0,), fig08(largest_error=5e-3), 5.0, PARTLY),
        ("C28", (5.0,), fig08(largest_error=4e-3, failed=True), 4.0, NOT),
        ("C30", (1.0,), front(FALLING), 2.0, REPRODUCED),
        ("C30", (2.0,), front(FALLING), 2.0, PARTLY),
        ("C30", (1.0,), front(FALLING[::-1]), 2.0, REPRODUCED),
        ("C30", (1.0,), front(FALLING + DECOYS), 3.0, PARTLY),
        ("C30", (1.0,), front([(f, -d, e) for f, d, e in FALLING]), 2.0, NOT),
        ("C30", (1.0,), front([(f, d, -e) for f, d, e in FALLING]), 2.0, NOT),
        ("C30", (1.0,), front([(f, d, -e) for f, d, e in FALLING + DECOYS]), 3.0, NOT),
        ("C30", (1.0,), front([(1, 4, 1), (2, 5, 2), (3, 3, 3), (4, 2, 4), (5, 1, 5)]), 4.0, REPRODUCED),
        ("C30", (1.0,), front([(1, 5, 2), (2, 4, 1), (3, 3, 3), (4, 2, 4), (5, 1, 5)]), 4.0, REPRODUCED),
        ("C30", (1.0,), front([(1, 5, 2), (2, 4, 1), (3, 3, 4), (4, 2, 3), (5, 1, 5)]), 4.0, REPRODUCED),
        ("C30", (1.0,), front([(1, 5, 2), (2, 4, 3), (3, 3, 1), (4, 2, 4), (5, 1, 5)]), 4.0, NOT),
        ("C30", (1.0,), front([(1, 4, 1), (2, 3, 2), (3, 5, 3), (4, 2, 4), (5, 1, 5)]), 4.0, NOT),
        ("C30", (1.0,), front([(1, 3, 1), (2, 4, 2), (3, 5, 3), (4, 2, 4), (5, 1, 5)]), 4.0, NOT),
        ("C30", (1.0,), front([(1, 5, 3), (2, 4, 2), (3, 3, 1), (4, 2, 4), (5, 1, 5)]), 4.0, NOT),
        ("C31", (1.0,), front(nmpc=[(1, 0.5), (1, 0.8)]), 0.8, REPRODUCED),
        ("C31", (0.5,), front(nmpc=[(1, 0.8), (1, 0.9)], ndi=(9, 2.0)), 0.45, REPRODUCED),
        ("C31", (1.0,), front(nmpc=[(1, 0.5), (1, 1.0)]), 1.0, PARTLY),
        ("C31", (1.0,), front(nmpc=[(1, 1.0), (1, 1.5)]), 1.5, NOT),
        ("C32", (0.0,), front(nmpc=[(990.0, 9), (998.0, 9)]), -2.0, REPRODUCED),
        ("C32", (0.0,), front(nmpc=[(990.0, 9), (1000.0, 9)]), 0.0, PARTLY),
        ("C32", (0.0,), front(nmpc=[(1000.0, 1), (1002.0, 1)]), 2.0, NOT),
        ("C33", (0.25, 1000.0), front([(1, 1249.0, 1), (10, 1300.0, 1)]), 1249.0, REPRODUCED),
        ("C33", (0.25, 1000.0), front([(1, 1250.0, 1), (10, 1300.0, 1)]), 1250.0, NOT),
        ("C34", (None, 0.05), front(nmpc=[(960.0, 1), (999.0, 1)], fixed=(1000.0, 1200.0)), 0.04, REPRODUCED),
        ("C34", (None, 0.05), front(nmpc=[(960.0, 1)], fixed=(975.0, 1035.0)), 5 / 69, PARTLY),
        ("C34", (None, 0.05), front(nmpc=[(990.0, 1)], fixed=(900.0, 1100.0)), 0.1, PARTLY),
        ("C34", (None, 0.05), front(nmpc=[(960.0, 1)], fixed=(960.0, 900.0)), 0.0, NOT),
        ("C35", (0.25,), cones("rmse_y", (1, 2), (1.125, 2)), 0.125, REPRODUCED),
        ("C35", (0.25,), cones("rmse_y", (1, 2), (0.875, 3)), 0.5, PARTLY),
        ("C35", (0.25,), cones("rmse_y", (1, 2), (1, 2), irregular=0.5), 0.5, PARTLY),
        ("C35", (0.25,), cones("rmse_y", (1, 2), (0.75, 2)), 0.25, NOT),
        ("C36", (0.25,), cause_table("rmse_y", (1, 9), (0.875, 1), "no creep"), 0.125, REPRODUCED),
        ("C36", (0.25,), cause_table("rmse_y", (2, 9), (1.5, 1), "no creep"), 0.25, PARTLY),
        ("C36", (0.25,), cause_table("rmse_y", (2, 9), (1, 9), "no creep"), 0.5, NOT),
        ("C37", (1.0,), dependence(1.0, 1.02), 1.02, REPRODUCED),
        ("C37", (1.0,), dependence(1.0, 1.01), 1.01, PARTLY),
        ("C37", (1.0,), dependence(2.0, 2.0), 1.0, NOT),
        ("C38", (0.0,), {}, np.nan, NOT),
        ("C39", (0.5,), rough({"rail_rmse_y": (1.0, 0.4)}), 0.4, REPRODUCED),
        ("C39", (0.5,), rough({"rail_rmse_y": (2.0, 1.0)}), 0.5, PARTLY),
        ("C39", (0.5,), rough({"rail_rmse_y": (2.0, 2.0)}), 1.0, NOT),
        ("C40", (0.0,), {}, np.nan, UNTESTABLE),
        ("C41", (0.75,), rough({"sum_y_over_limit": (1.0, 0.5), "n_mv_floor_front": (1.0, 0.25)}), 0.5, REPRODUCED),
        ("C41", (0.75,), rough({"sum_y_over_limit": (1.0, 0.5), "n_mv_floor_front": (1.0, 1.5)}), 1.5, PARTLY),
        ("C41", (0.75,), rough({"sum_y_over_limit": (1.0, 1.0), "n_mv_floor_front": (1.0, 1.0)}), 1.0, NOT),
    ],
)
def test_rule(identity, limits, tables, value, verdict):
    found, judged = judge(identity, tables, *limits)
    assert found == pytest.approx(value, nan_ok=True)
    assert judged == verdict


def torques(later, noise=0.0):
    """Torque of MPC over the way, and of NDI `later` metres behind, with noise."""
    p = np.arange(0.0, 650.0, 0.5)
    scatter = np.random.default_rng(5).normal(0, noise, p.size)

    def shape(place):
        return np.sin(place / 15 + 4 * np.sin(place / 100))

    mpc, ndi = shape(p), shape(p - later) + scatter
    pairs = (("nmpc", mpc), ("ndi", ndi))
    tables = [pd.DataFrame({"controller": name, "p_m": p, "du_Nm": du}) for name, du in pairs]
    return {"fig06_curve_entry": pd.concat(tables)}


@pytest.mark.parametrize(
    ("later", "noise", "tolerance", "verdict"),
    [
        (5.0, 0.0, 0.8, REPRODUCED),
        (0.75, 0.0, 0.8, REPRODUCED),
        (38.0, 0.0, 0.8, REPRODUCED),
        (5.0, 0.3, 0.8, REPRODUCED),
        (5.0, 0.9, 0.8, PARTLY),
        (0.0, 0.0, 0.8, NOT),
        (-12.0, 0.0, 0.8, NOT),
    ],
)
def test_torque_of_ndi_comes_later(later, noise, tolerance, verdict):
    found, judged = judge("C09", torques(later, noise), tolerance)
    assert found == pytest.approx(later, abs=0.26)
    assert judged == verdict


def gyroscope(**ratios):
    """A torque of `ratio` times the gyroscopic one behind 60 m, on top of a torque before the clothoid."""
    # T3: v^2/R - 0.4333 m/s2 is balanced by a cant that rises along 423 m; J_Wy 60 kg m2, b 1.5 m.
    v = 280 / 3.6
    cant_rate = np.arcsin((v**2 / 4250 - 0.4333) / 9.81) / 423
    torque = -2 * 60.0 * v**2 * cant_rate / 1.5
    p = np.arange(0.0, 400.0)
    tables = []
    for name, ratio in ratios.items():
        du = np.select([p < 20, p < 60, p <= 300], [30.0, 1e4, 30.0 + ratio * torque], -1e4)
        tables.append(pd.DataFrame({"controller": name, "p_m": p, "du_Nm": du}))
    return {"fig06_curve_entry": pd.concat(tables)}


@pytest.mark.parametrize(
    ("ratios", "value", "verdict"),
    [
        ((1.0, 1.1, 0.8), 0.8, REPRODUCED),
        ((1.25, 1.1, 0.9), 1.25, REPRODUCED),
        ((1.35, 1.1, 0.9), 1.35, PARTLY),
        ((1.0, 0.6, 1.0), 0.6, PARTLY),
        ((1.0, 1.0, -0.2), -0.2, NOT),
        ((2.5, 1.0, -0.2), 2.5, NOT),
    ],
)
def test_torque_step_against_the_gyroscopic_torque(ratios, value, verdict):
    found, judged = judge("C10", gyroscope(**dict(zip(("nmpc", "ltv_mpc", "ndi"), ratios, strict=True))), 0.3)
    assert found == pytest.approx(value, abs=0.01)
    assert judged == verdict


def large_values(ratio):
    """Set points on both sides of 2.5 mm, errors of either sign; at rest the error does not count."""
    reference = 1e-3 * np.array([3.0, -3.0, 2.6, 2.4, -1.0, 0.2, 0.05, 0.0])
    error = np.array([ratio, -ratio, ratio, 1.0, -1.0, 1.0, 50.0, -50.0])
    return {"fig06_curve_entry": pd.DataFrame({"controller": "nmpc", "y_ref_m": reference, "y_m": reference + error})}


@pytest.mark.parametrize(("ratio", "verdict"), [(1.3, REPRODUCED), (1.1, NOT)])
def test_errors_at_large_set_points(ratio, verdict):
    found, judged = judge("C12", large_values(ratio), 1.2)
    assert found == pytest.approx(ratio)
    assert judged == verdict


def rule_of_allocation(excess_le=0.0, excess_ri=0.0, lost=0.0):
    """The integration rule with faults: motors beyond their limit, a differential torque that is not kept."""

    def faulty(u_d, du, limit):
        kept = ca.fmin(ca.fmax(du, -limit), limit)
        room = limit - ca.fabs(kept)
        long = ca.fmin(ca.fmax(u_d, -room), room)
        return long + kept + excess_le, long - kept + excess_ri, long, kept - lost

    return faulty


@pytest.mark.parametrize("fault", [{"excess_le": 3.0}, {"excess_ri": -3.0}, {"lost": 3.0}, {"lost": -3.0}])
def test_violations_of_the_integration_rule(fault, monkeypatch):
    assert judge("C29", {}, 1e-6) == (0.0, REPRODUCED)
    monkeypatch.setattr(claims, "allocate", rule_of_allocation(**fault))
    assert judge("C29", {}, 1e-6) == (pytest.approx(3.0), NOT)
    assert judge("C29", {}, 4.0)[1] == REPRODUCED
