"""Simulate what the paper's statements are about: a few runs of one car, and the metrics by which they are judged. Such
a set of runs is a probe, of the nominal car as of each sampled car, so that the same functions (`statements`) judge
all. Serves the paper's section Multi-Body Simulation Results."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import astuple
from itertools import pairwise, product

import casadi as ca
import numpy as np
import pandas as pd

from railrepro import paths
from railrepro.contact.creep import adhesion_maximum, polach
from railrepro.contact.table import middle_patch
from railrepro.control.adhesion import AdhesionSettings
from railrepro.control.registry import EMPHASIS, LOOP, PAPER_TRIO, with_r_times
from railrepro.data import InputError, write
from railrepro.evidence.claims import statements
from railrepro.evidence.claims.setup import COLUMNS, ProbeSetup, setup
from railrepro.evidence.claims.statements import BETWEEN, BRAKE, LOSS, NDI, NOTHING, SOFT, SOFTEST, T3, Key
from railrepro.simulation import metrics, simulate
from railrepro.simulation.scenarios import Scenario, load_scenario
from railrepro.studies import store
from railrepro.studies.executor import ordered_map
from railrepro.studies.experiment import Experiment
from railrepro.track.table import Track, build_table, load_track
from railrepro.tuning.task import triple_pole
from railrepro.vehicle.parameters import Vehicle, load_vehicle

PARTS = ("curve", "curves", "sine", "loss", "brake")
"""Usual groups of runs of a probe: curve entry on T3; on T1, T2, T4; sine at five speeds; loss of adhesion; braking."""
ONCE = ("causes", "sudden", "share", "rails", "lags")
"""Groups of runs once per setting: creep and cones, sudden losses of adhesion, allocation, irregular rails, lags."""
SEEDS = (101, 102, 103)  # of the sensor noise in nominal runs; tuning has others

# Fig. 8
PERTURBED = (0.98, 0.99, 1.0, 1.01, 1.02)  # factors on R to average over: at the adhesion peak single runs are chaotic
REGULAR_END, DEMANDED, REACHED = 110.0, 130.0, 240.0
"""Track coordinates (m): the adhesion is at its set point, the set point passes the peak, the run reaches the peak."""
RECOVERY = 0.135  # time within which a wheel must leave macro slip, a tenth of a wave of the set point (s)
APPROACH = 0.9  # adhesion over its peak from which the peak is approached, and below which slip beyond it is excessive
FALL = 0.1  # fraction by which the torque must fall in macro slip
# Fig. 9
R_FACTORS, POLES = (1.0, 10**0.5, 10.0, 10**1.5, 100.0), (8.0, 15.0, 25.0, 40.0, 60.0)
"""Sweeps: factors on the weight R of NMPC, besides `r_brake` (-); triple poles of NDI (rad/s)."""
NEIGHBOURS = (0.9, 1.0, 1.1)  # factors on R of NMPC and on the poles of NDI whose runs give the scatter
SHARES = (0.0, 0.02, 0.03, 0.045, 0.07, 0.1, 0.15, 0.22, 0.33)
"""Fixed shares of the torque for guidance (-), tried from below: too large a share lengthens the run and its error."""
# Sudden loss of adhesion
PATCH, CHECKED = (300.0, 500.0), 100.0
"""Begin and end of the very poor rail, and the distance before it on which operation must be regular (m)."""
NO_SLIP_CONTROL = AdhesionSettings(active=False)

_FOLLOWING = ("rmse_y", "largest_error", "mean_error_last_third", "effort_du")
_METRES = (*_FOLLOWING[:3], "delay", "shortest_wave", "shortfall", "ndi_later", "stopping_distance", "rail_rmse_y")
UNITS = dict.fromkeys(_METRES, "m") | {"effort_du": "N m"}
Measured = Iterator[tuple[str, str, dict[str, float]]]
"""What a group of runs yields, run by run: scenario, controller, and a dict metric -> value (SI)."""

# The functions following, entering, losing, slipping, riding and braked are measures for `Experiment.measured`: they
# return a pair, metrics by name and a DataFrame or None. A failed run has few metrics; its `failed` is 1.


def probe(world: ProbeSetup, parts: Iterable[str] = PARTS) -> dict[Key, float]:
    """Simulate the runs that judge the paper's statements, with the car and the controllers of `world`; returns
    metrics, (scenario, controller, metric) -> value (SI). `parts` are names of groups of runs: those of `PARTS`, such
    as "loss" (Fig. 8), judge each car; those of `ONCE`, such as "lags" (slow drives), only some. A failed run has the
    metric `failed` = 1 and few others; over a patch of poor rail ("sudden") it keeps all. Braking runs have no
    `failed`: without a stop their rmse_y and stopping_distance are inf."""
    return {
        (scenario, controller, name): float(value)
        for part in parts
        for scenario, controller, values in _DRIVE[part](world)
        for name, value in values.items()
    }


def nothing(scenario: Scenario) -> dict[str, float]:
    """Compute metrics without guidance from the set point y* of a scenario, which must not be "none": a dict with
    rmse_y and largest_error of a running gear that stays at y = 0 (m), and shortest_wave, the shortest period of y*
    (m)."""
    reference = scenario.reference()
    values = ca.DM(reference(np.arange(0.0, scenario.end_m, 0.1))).full()
    waves = [value for key, value in scenario.set_point.items() if key.startswith("period")]
    largest, rmse = float(np.abs(values).max()), float(np.sqrt(np.mean(values**2)))
    return {"rmse_y": rmse, "largest_error": largest, "shortest_wave": float(min(waves))}


def _unless_failed(run: simulate.Run, experiment: Experiment, names: Iterable[str]) -> dict[str, float]:
    """Take metrics of `Experiment.values` by name, none of a failed run, and `failed`."""
    row = experiment.values(run)
    return {name: row[name] for name in names if not run.failed} | {"failed": float(run.failed)}


def following(run: simulate.Run, experiment: Experiment) -> store.Entry:
    """Measure how the front gear follows its set point: RMS error rmse_y, largest_error and mean_error_last_third (m),
    RMS differential torque effort_du (N m), failed (0 or 1; if 1, the only key). Returns (dict, None)."""
    return _unless_failed(run, experiment, _FOLLOWING), None


def entering(run: simulate.Run, experiment: Experiment) -> store.Entry:
    """Measure a run of Fig. 6 (curve entry). Returns a pair: a dict of metrics, and a DataFrame with every 10th row of
    the run (`metrics.gear_series`). Keys: those of `following`; delay, distance along the track by which y trails its
    set point y* (m); `shortfall`, the distance by which y stays inside the crests of y*, where |y*| is above 5/6 of its
    maximum, on the worse side (m); torque_step, the mean differential torque over the first wave of y* minus the mean
    before this wave (N m); path_error, RMS yaw of the gear against the track over RMS heading of the track (-). Of a
    failed run the dict has only failed = 1, and the DataFrame is None."""
    values, _ = following(run, experiment)
    if run.failed:
        return values, None
    series = metrics.gear_series(run.series, stride=10)
    values |= {"delay": metrics.delay(run.series), "shortfall": shortfall(series)}
    return values | {"torque_step": torque_step(series), "path_error": path_error(series)}, series


def losing(run: simulate.Run, experiment: Experiment) -> store.Entry:
    """Measure a run of Fig. 8 (loss of adhesion). Returns (dict, None). The dict has the metrics of `following`,
    `macro_slips` and `oscillation`; largest_slip of all wheels (-); utilisation_late, adhesion of the front gear over
    its peak from p = 240 m on (-); flange, 1 if one touches a rail, else 0; regular_deviation, mean deviation of the
    adhesion from its set point, relative to it, from 110 to 130 m, where the set point is reached and below the peak
    (-). A failed run has only the keys regular_deviation and failed."""
    (values, _), series = following(run, experiment), metrics.gear_series(run.series, stride=10)
    if not run.failed:
        scenario, car = experiment.scenario, experiment.car()
        whole, late = (
            metrics.longitudinal(rows, scenario, car)
            for rows in (run.series, run.series[run.series["front.p"] >= REACHED])
        )
        values |= {"largest_slip": whole["largest_slip"][0], "utilisation_late": late["utilisation"][0]}
        values |= macro_slips(series, *adhesion_peak(scenario, car)) | oscillation(series)
        values["flange"] = float(metrics.reaches_flange(run.series))
    return values | {"regular_deviation": deviation(series, REGULAR_END, DEMANDED)}, None


def slipping(run: simulate.Run, experiment: Experiment) -> store.Entry:
    """Measure a run over a slippery patch, p = 300 to 500 m. Returns (dict, None). Keys, even if it failed:
    largest_slip of all wheels (-); utilisation, mean adhesion of the left front wheel there over the peak of this rail
    (-); regular_deviation, mean relative deviation of the adhesion from its set point at 200 to 299 m (-); failed."""
    scenario, car, series = experiment.scenario, experiment.car(), metrics.gear_series(run.series, stride=10)
    patch = series[series["front.p"].between(*PATCH)]
    adhesion = float((np.sign(patch["front.f_star"]) * patch["front_le.adhesion"]).mean())
    return {
        "largest_slip": metrics.longitudinal(run.series, scenario, car)["largest_slip"][0],
        "utilisation": adhesion / adhesion_peak(scenario, car)[0],
        "regular_deviation": deviation(series, PATCH[0] - CHECKED, PATCH[0] - 1),
        "failed": float(run.failed),
    }, None


def riding(run: simulate.Run, experiment: Experiment) -> store.Entry:
    """Measure a run on irregular rails. Returns (dict, None): rail_rmse_y, RMS displacement from them (m);
    sum_y_over_limit, largest track shifting force over its limit (-); n_mv_floor_front, comfort index of the front
    floor (-); failed (0 or 1), of a failed run the only key."""
    return _unless_failed(run, experiment, ("rail_rmse_y", "sum_y_over_limit", "n_mv_floor_front")), None


def braked(run: simulate.Run, experiment: Experiment) -> store.Entry:
    """Measure a braking run. Returns (dict, None): rmse_y, stopping_distance (m), inf if it failed or did not stop."""
    row = experiment.values(run)
    stopped = not run.failed and run.series["front.v"].iloc[-1] < 0.2
    return {name: row[name] if stopped else float("inf") for name in ("rmse_y", "stopping_distance")}, None


def _follow(world: ProbeSetup, scenario: Scenario, label: str) -> Measured:
    """Drive a scenario under the paper's three controllers."""
    yield label, NOTHING, nothing(scenario)
    for name in PAPER_TRIO:
        yield label, name, world.experiment(scenario, name).measured(following)[0]


def _curves(world: ProbeSetup) -> Measured:
    """Drive T1, T2 and T4 under the three controllers, and all four curves under NMPC with y* = 0."""
    for name, length in {"curve_entry_T1": 80.0, "curve_entry_T2": 400.0, T3: 600.0, "curve_entry_T4": 700.0}.items():
        scenario = load_scenario(name).but(end_m=length)
        if name != T3:
            yield from _follow(world, scenario, name)
        middle = scenario.but(set_point={"kind": "none"})
        yield name, statements.CENTRED, world.experiment(middle, "nmpc").measured(following)[0]


def _sine(world: ProbeSetup) -> Measured:
    """Drive Fig. 7 at five speeds."""
    for speed, label in statements.SINES.items():
        yield from _follow(world, load_scenario("sine_tracking").but(speed_kmh=float(speed), end_m=300.0), label)


def _curve(world: ProbeSetup) -> Measured:
    """Drive Fig. 6, also with hardly any preview; add lag of the torque and balanced gyroscopic moment."""
    scenario, stretched = world.scenario(T3), world.stretched()
    track = Track("T3", build_table(stretched)) if stretched else load_track(scenario.track)
    vehicle, v, cant_rate = load_vehicle(**world.vehicle), scenario.speed, track.interpolate(200.0)[3, 0]
    # gyroscopic yaw moment of the rolling wheels of a running gear in the cant ramp, and the torque that balances it
    moment = -2 * vehicle.wheel.spin_inertia * v / vehicle.wheel.radius * cant_rate * v
    expected = float(moment * vehicle.wheel.radius / vehicle.gear.contact_base)
    yield T3, NOTHING, nothing(scenario)
    series = {}
    for name in PAPER_TRIO:
        values, table = world.experiment(scenario, name, alignment=stretched).measured(entering)
        if table is not None:
            series[name] = table
            values |= {"gyroscopic_share": values.pop("torque_step") / expected}
        yield T3, name, values
    for name in statements.MPC:
        if {name, NDI} <= set(series):
            yield T3, name, torque_shift(series[name], series[NDI])
    short = world.parameters["nmpc"] | {"horizon_s": 0.06}  # 5 m
    unforeseen = {
        statements.RATES: world.experiment(scenario, NDI, changes={"rates": True}, alignment=stretched),
        statements.SHORT: world.experiment(scenario, "nmpc", short, alignment=stretched),
        statements.HELD: world.experiment(scenario, "nmpc", changes={"previewed": False}, alignment=stretched),
    }
    for label, run in unforeseen.items():
        values, _ = run.measured(entering)
        yield T3, label, {key: value for key, value in values.items() if key in ("rmse_y", "delay", "failed")}


def _lags(world: ProbeSetup) -> Measured:
    """Drive the curve entry and the fastest sine under both MPC with lags of the drive that they do not know."""
    sine = load_scenario("sine_tracking").but(speed_kmh=400.0, end_m=300.0)
    for label, scenario, alignment in ((T3, world.scenario(T3), world.stretched()), (statements.FASTEST, sine, None)):
        for lag, name in product(statements.LAGS_MS, statements.MPC):
            run = world.experiment(scenario, name, plant={"drive.lag": 1e-3 * lag}, alignment=alignment)
            yield f"lag {lag:g} ms, {label}", name, run.measured(following)[0]


def _loss(world: ProbeSetup) -> Measured:
    """Drive Fig. 8: NMPC as tuned and with R x 10, over `PERTURBED` and once without slip control; NDI."""
    scenario, car = load_scenario(LOSS), world.car()
    yield LOSS, NOTHING, nothing(scenario) | {"excessive_slip": excessive_slip(scenario, car)}
    nmpc, cases = with_r_times(world.parameters["nmpc"], world.r_loss), {}
    tuned = {"nmpc": nmpc, SOFT: with_r_times(nmpc, EMPHASIS)}
    for label, nmpc in tuned.items():
        cases[label] = [world.experiment(scenario, "nmpc", with_r_times(nmpc, factor)) for factor in PERTURBED]
    cases[NDI] = [world.experiment(scenario, NDI)]
    for label, nmpc in tuned.items():
        cases[statements.NO_LAW[label]] = [world.experiment(scenario, "nmpc", nmpc, adhesion=NO_SLIP_CONTROL)]
    for label, runs in cases.items():
        each = [run.measured(losing)[0] for run in runs]
        values = _mean(each)
        if not values["failed"]:
            values["set_point_gain"] = max((run["set_point_gain"] for run in each), key=lambda gain: abs(gain - 1))
            values |= {name: max(run[name] for run in each) for name in ("error_growth", "largest_slip")}
        regular = {"regular_deviation": values.pop("regular_deviation")}
        yield LOSS, label, values
        if label in statements.REGULAR:
            yield LOSS, statements.REGULAR[label], regular


def _causes(world: ProbeSetup) -> Measured:
    """Drive curve and sines under NMPC: on cones, nearly without creep, in the curve also with both."""
    sine, curve = load_scenario("sine_tracking"), load_scenario(T3)
    driven = curve, curve.but(track="T5"), sine.but(speed_kmh=160.0), sine
    # in a stiff contact wheels nearly roll
    cones, stiff = {"contact.profile": "cone"}, {"contact.shear_modulus": 12.0 * world.car().contact.shear_modulus}
    for case, scenario in zip(statements.CASES, driven, strict=True):
        plants = {statements.CONES: cones, statements.NO_CREEP: stiff}
        plants |= {statements.AS_MODELLED: cones | stiff} if case == T3 else {"nmpc": {}}
        for label, plant in plants.items():
            yield case, label, world.experiment(scenario, "nmpc", plant=plant).measured(following)[0]


def _sudden(world: ProbeSetup) -> Measured:
    """Drive NMPC as tuned over a patch of very poor rail, with and without slip control."""
    begin, end = PATCH
    points = ((0.0, 0.0), (begin - 0.5, 0.0), (begin + 0.5, 1.0), (end - 0.5, 1.0), (end + 0.5, 0.0))
    base = load_scenario(LOSS).but(speed_kmh=280.0, end_m=end + 300, poor="very_poor", poor_share=())
    for case in statements.SUDDEN:
        share = {"poor_share" if case.startswith("both rails") else "poor_share_left": points}
        force = 17.0 if case.endswith("traction") else -17.0
        scenario = base.but(force_kN=((0.0, force),), **share)  # per running gear
        for label, law in (("nmpc", None), (statements.NO_LAW["nmpc"], NO_SLIP_CONTROL)):
            yield case, label, world.experiment(scenario, "nmpc", adhesion=law).measured(slipping)[0]


def _rails(world: ProbeSetup) -> Measured:
    """Drive an irregular straight under NMPC with and without exact preview; average over realisations."""
    end = 1000.0
    scenario = load_scenario("sine_tracking").but(set_point={"kind": "none"}, speed_kmh=300.0, end_m=end)
    defects = [
        {"kind": "dip", "start": 0.3 * end, "length": 8.0, "depth": 3e-3, "rail": "ri"},
        {"kind": "alignment_fault", "start": 0.5 * end, "length": 20.0, "amplitude": 4e-3},
        {"kind": "lateral_offset", "start": 0.7 * end, "length": 0.15 * end, "offset": 3e-3, "transition": 15.0},
    ]
    rough = [{"spectrum": "en_B_300", "seed": seed, "defects": defects} for seed in (1, 2, 3)]
    for label, known in (("nmpc", {}), (statements.PREVIEW, {"share": 1.0, "smoothing_m": 3.0})):
        runs = [world.experiment(scenario, "nmpc", irregular=each, preview=known, ride=True) for each in rough]
        yield statements.RAILS, label, _mean([run.measured(riding)[0] for run in runs])


def _mean(runs: list[dict[str, float]]) -> dict[str, float]:
    """Average each metric that all runs have; failed if one failed."""
    common = set.intersection(*map(set, runs))
    mean = {key: float(np.mean([run[key] for run in runs])) for key in runs[0] if key in common}
    return mean | {"failed": max(run["failed"] for run in runs)}


def _brake(world: ProbeSetup) -> Measured:
    """Drive Fig. 9: sweeps of R and of the poles of NDI, both R with one between them, neighbours of both."""
    yield BRAKE, NOTHING, nothing(world.scenario(BRAKE))
    for factor in R_FACTORS:
        yield BRAKE, "sweep of R", {f"{name} {factor:g}": value for name, value in _braked(world, factor).items()}
    for label, factor in {"nmpc": 1.0, BETWEEN: world.r_second**0.5, SOFTEST: world.r_second}.items():
        yield BRAKE, label, _braked(world, factor)
    for pole in POLES:
        values = _stopped(world, NDI, triple_pole(pole))
        yield BRAKE, "sweep of poles", {f"{name} {pole:g}": value for name, value in values.items()}
    yield BRAKE, "nmpc", _scatter([_braked(world, factor) for factor in NEIGHBOURS])
    ndi = world.parameters[NDI]
    near = [ndi | {key: factor * ndi[key] for key in ("pole", "frequency")} for factor in NEIGHBOURS]
    runs = [_stopped(world, NDI, parameters) for parameters in near]
    yield BRAKE, NDI, runs[NEIGHBOURS.index(1.0)] | _scatter(runs)


def _stopped(world: ProbeSetup, name: str, parameters: dict, **more) -> dict[str, float]:
    return world.experiment(world.scenario(BRAKE), name, parameters, **more).measured(braked)[0]


def _braked(world: ProbeSetup, factor: float = 1.0, **more) -> dict[str, float]:
    """Drive Fig. 9 under NMPC with R times a factor: error and stopping distance."""
    return _stopped(world, "nmpc", with_r_times(with_r_times(world.parameters["nmpc"], world.r_brake), factor), **more)


def _scatter(runs: list[dict[str, float]]) -> dict[str, float]:
    """Compute ln(largest / smallest value) of each metric; inf if a run failed."""
    values = pd.DataFrame(runs)
    return np.log(values.max() / values.min()).fillna(np.inf).add_suffix("_spread").to_dict()


def _share(world: ProbeSetup) -> Measured:
    """Drive Fig. 9 with a fixed allocation of the torque, and under an NMPC that does not know the base torque."""
    yield BRAKE, statements.FIXED, _allocated(world)
    yield BRAKE, statements.UNINFORMED, _braked(world, changes={"informed": False})


def _allocated(world: ProbeSetup) -> dict[str, float]:
    """Find the least fixed share of torque that guides as well as a variable one: its run; inf if there is none."""
    enough = statements.GUIDES_AS_WELL * _braked(world)["rmse_y"]
    tried = ((low, high, _braked(world, fixed_share=high)) for low, high in pairwise(SHARES))
    low, high, result = next((step for step in tried if step[2]["rmse_y"] <= enough), (0.0, np.nan, {}))
    if not result:
        return {"rmse_y": np.inf, "stopping_distance": np.inf}
    for _ in range(6):
        middle = (low + high) / 2
        values = _braked(world, fixed_share=middle)
        low, high, result = (low, middle, values) if values["rmse_y"] <= enough else (middle, high, result)
    return result | {"share": high}


_DRIVE: dict[str, Callable[[ProbeSetup], Measured]] = {
    **{"curve": _curve, "curves": _curves, "sine": _sine, "loss": _loss, "brake": _brake},
    **{"causes": _causes, "sudden": _sudden, "share": _share, "rails": _rails, "lags": _lags},
}


def torque_step(series: pd.DataFrame) -> float:
    """Compute the mean differential torque over the first wave of the set point minus the mean before it (N m).
    `series` has the columns front.y_ref and front.du. The wave begins at the first nonzero set point and ends where the
    second half wave does. If the run has no third half wave, only the first one counts; NaN if it has no second one."""
    reference = series["front.y_ref"].to_numpy()
    begin = int(np.argmax(reference != 0))
    first_half = reference * reference[begin] > 0
    middle = begin + int(np.argmin(first_half[begin:]))
    end = middle + int(np.argmax(first_half[middle:]))
    torque = series["front.du"]
    return float(torque[begin:end].mean() - torque[:begin].mean())


def torque_shift(first: pd.DataFrame, second: pd.DataFrame) -> dict[str, float]:
    """Compute how far along the track the differential torque of a run `second` lags that of a run `first`, between p =
    75 and 525 m of `first`. Both have the columns front.p and front.du. Returns a dict: ndi_later, the lag of best
    correlation (m, -15 to 40, positive if `second` is later), and ndi_alike, this correlation (-)."""
    grid = np.arange(60.0, 590.0, 0.25)
    one, other = (np.interp(grid, rows["front.p"], rows["front.du"]) for rows in (first, second))
    shifts = np.arange(-60, 161)
    alike = np.array([np.corrcoef(other[60 + k : 60 + k + 1800], one[60:1860])[0, 1] for k in shifts])
    best = int(np.argmax(alike))
    return {"ndi_later": 0.25 * float(shifts[best]), "ndi_alike": float(alike[best])}


def shortfall(series: pd.DataFrame) -> float:
    """Compute how far y stays inside the crests of its set point y* (m), the rows with |y*| above 5/6 of its maximum:
    mean over the positive or the negative ones, the larger counts. `series` has front.y and front.y_ref (y*)."""
    reference = series["front.y_ref"]
    short, crest = reference - series["front.y"], reference.abs().max() * 5 / 6
    return float(max(short[reference > crest].mean(), -short[reference < -crest].mean()))


def path_error(series: pd.DataFrame) -> float:
    """Compute the RMS yaw of a running gear against the track over the RMS heading of the track (-): 1 if it keeps its
    direction. `series` has the columns front.psi_TrAx (yaw against the track) and front.psi_Ax (yaw)."""
    heading = series["front.psi_Ax"] - series["front.psi_TrAx"]
    return float(np.sqrt((series["front.psi_TrAx"] ** 2).mean() / (heading**2).mean()))


def oscillation(series: pd.DataFrame) -> dict[str, float]:
    """Measure how y follows its set point in Fig. 8 from p = 240 m on; `series` is from `metrics.gear_series`. Returns
    a dict: set_point_gain, the slope of the regression of y on the set point through the origin (-), and error_growth,
    the RMS error on the second half of this distance over the one on the first half (-)."""
    rows = series[series["front.p"] >= REACHED]
    error, half = rows["front.y"] - rows["front.y_ref"], rows["front.p"] >= rows["front.p"].iloc[[0, -1]].mean()
    growth = np.sqrt((error[half] ** 2).mean() / (error[~half] ** 2).mean())
    gain = (rows["front.y"] * rows["front.y_ref"]).sum() / (rows["front.y_ref"] ** 2).sum()
    return {"set_point_gain": float(gain), "error_growth": float(growth)}


def deviation(series: pd.DataFrame, begin: float, end: float) -> float:
    """Compute the mean relative deviation |f - f*| / |f*| (-) of the adhesion f from its set point f*, over the rows of
    `series` (`metrics.gear_series`) from p = `begin` to `end` (m); inf without rows. f is the mean of front wheels."""
    rows = series[series["front.p"].between(begin, end, inclusive="left")]
    if rows.empty:
        return float("inf")
    f = (rows["front_ri.adhesion"] + rows["front_le.adhesion"]) / 2
    return float(((f - rows["front.f_star"]).abs() / rows["front.f_star"].abs()).mean())


def macro_slips(series: pd.DataFrame, peak: float, slip: float) -> dict[str, float]:
    """Count macro slips and approaches to the adhesion peak in a run of Fig. 8 from p = 240 m on. `series` is that of
    `metrics.gear_series`, `peak` and `slip` are adhesion and slip at the peak (-). A macro slip begins where the slip
    of a front wheel exceeds `slip`. An approach goes from 240 m or the begin of a macro slip to the next one or the
    end. Returns counts: macro_slips that begin more than 0.135 s (a tenth of a wave of the set point) before the end;
    recovered, those of them in which, within 0.135 s, the base torque falls by a tenth and both slips are below `slip`
    once (all by the paper); approaches; approached, those in which the mean adhesion of the front wheels reaches 0.9
    `peak` while neither exceeds `slip` (all by the paper). A last one of under 110 m that does not is left out."""
    rows = series[series["front.p"] >= REACHED]
    time, torque = rows["t_s"].to_numpy(), rows["front.u_d"].to_numpy()
    beyond = (rows[["front_ri.sx", "front_le.sx"]].abs() > slip).any(axis=1).to_numpy()
    near = ((rows["front_ri.adhesion"] + rows["front_le.adhesion"]) / 2 >= APPROACH * peak).to_numpy()
    entries = np.flatnonzero(np.diff(beyond.astype(int), prepend=0) > 0)
    judged = recovered = 0
    for entry in entries[time[-1] - time[entries] > RECOVERY]:
        soon = slice(entry, np.searchsorted(time, time[entry] + RECOVERY))
        judged += 1
        recovered += not beyond[soon].all() and torque[soon].min() < (1 - FALL) * torque[entry]
    bounds = [0, *entries, time.size]
    approaches = [bool((near & ~beyond)[begin:end].any()) for begin, end in pairwise(bounds) if end > begin]
    last = rows["front.p"].iloc[-1] - rows["front.p"].iloc[bounds[-2]]
    if not approaches[-1] and len(approaches) > 1 and last < REACHED - DEMANDED:
        approaches.pop()
    return {
        "macro_slips": float(judged),
        "recovered": float(recovered),
        "approaches": float(len(approaches)),
        "approached": float(sum(approaches)),
    }


def adhesion_peak(scenario: Scenario, car: Vehicle) -> tuple[float, float]:
    """Find the largest adhesion and the slip there (-) on poor rail in a scenario, at initial speed and static load."""
    patch = car.wheel_load, *middle_patch(car), car.contact.shear_modulus
    return adhesion_maximum(car.adhesion[scenario.poor], scenario.speed, *patch)


def excessive_slip(scenario: Scenario, car: Vehicle) -> float:
    """Find the largest slip (-), up to 1, at which 0.9 of the adhesion peak (`adhesion_peak`) is left."""
    (peak, best), (a, b, kalker) = adhesion_peak(scenario, car), middle_patch(car)
    slips, rail = np.geomspace(best, 1.0, 2000), astuple(car.adhesion[scenario.poor])
    contact = car.wheel_load, a, b, *kalker, car.contact.shear_modulus, *rail
    force, *_ = polach(-slips, 0.0, 0.0, *contact, slip_speed=slips * scenario.speed)
    return float(slips[force / car.wheel_load > APPROACH * peak].max())


def nominal(settings: Iterable[str] = COLUMNS) -> pd.DataFrame:
    """Simulate the runs that judge the statements on the nominal car: one row per metric of a run. Each of `settings`
    is "paper", "loop" (with sensors), or "swarm" ("paper" with poles of NDI by particle swarm). Columns scenario,
    controller, metric, value (in `unit`), unit, setting, swarm (rank of the parameters among tuning runs by cost, 0 the
    final ones), seed (of the sensor noise; 0 without). Braking runs and those of `ONCE` occur once per setting."""
    tasks = []
    for setting in settings:
        seeds = SEEDS if setting == LOOP else (0,)
        for rank, seed in [*product([0], seeds), (1, seeds[0]), (2, seeds[0])]:
            # braking takes most of the time: once per setting
            parts = (*PARTS, *ONCE) if rank == 0 and seed == seeds[0] else PARTS[:-1]
            tasks += [(setting, rank, seed, part) for part in parts]

    def driven(task: tuple[str, int, int, str]) -> list[tuple]:
        setting, rank, seed, part = task
        metrics = probe(setup({}, setting, rank=rank, seed=seed), (part,))
        return [(*key, value, UNITS.get(key[2], "-"), setting, rank, seed) for key, value in metrics.items()]

    rows = [row for rows in ordered_map(driven, tasks, "nominal") for row in rows]
    return pd.DataFrame(rows, columns=["scenario", "controller", "metric", "value", "unit", "setting", "swarm", "seed"])


def main(settings: Sequence[str] = ()) -> None:
    """Write data/results/nominal_metrics.csv, metrics of the nominal car, from which statements are judged. `settings`
    (default all) are "paper" (exact measurements), "swarm" (NDI's poles by swarm), "loop" (sensors)."""
    unknown = set(settings) - set(COLUMNS)
    if unknown:
        raise InputError(f"setting {min(unknown)!r} is not known; there are {COLUMNS}")
    table = nominal(settings or COLUMNS)
    write(paths.product("data/results/nominal_metrics.csv"), table.to_csv(index=False, float_format="%.6g"))
