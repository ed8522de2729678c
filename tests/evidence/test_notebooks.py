"""Every notebook runs, in full or with small parameters, and writes what it declares; an edit does not stop it."""

from typing import NamedTuple

import pytest

from railrepro import data, paths
from railrepro.evidence.chain import chain, compare
from railrepro.evidence.report.sentences import false_in


@pytest.mark.parametrize("notebook", chain.chain().values(), ids=lambda notebook: notebook.name)
def test_notebook(notebook, tmp_path):
    """In a folder of its own: what a chapter reads is committed, not what another one wrote with small parameters."""
    chain.run(notebook, notebook.parameters | notebook.test_parameters, tmp_path)
    different = []
    for product in notebook.products if not notebook.test_parameters else ():  # a real run gives what is committed
        old, new = paths.ROOT / product, tmp_path / product
        entries = compare.compare(old, new, chain.load().verify)
        if (entries["outcome"] == compare.DIFFERENT).any():
            different.append(f"  {old.name}: {compare.summary(entries)}\n    committed {old}\n    rerun     {new}")
    assert not different, "\n".join(["other products than the committed ones, see CONTRIBUTING.md:", *different])


class Edit(NamedTuple):
    """An edit of a reader: the chapter (how its name begins), and changed parameters or a changed text in data/.

    One with `marks` must mark a sentence as false. `make test` runs the quick ones, `make test-slow` the others.
    """

    chapter: str
    parameters: dict = {}
    texts: dict = {}
    marks: bool = False
    quick: bool = False


VEHICLE, TRACKS, SCENARIOS, TUNING = (f"data/{name}.toml" for name in ("vehicle", "tracks", "scenarios", "tuning"))
HEAVY = {VEHICLE: ("value = 26000.0", "value = 24000.0")}
CONES = {VEHICLE: ('value = "s1002"', 'value = "cone"')}
EDITS = [
    Edit("00", {"setting": "loop"}, quick=True),
    Edit("00", {"scenario_name": "curve_entry_T4"}),
    Edit("00", {"scenario_name": "sine_tracking", "end_m": 200.0}),
    Edit("00", {"scenario_name": "braking", "end_m": 20.0}, marks=True),
    Edit("00", texts=CONES),
    Edit("01", {"step_m": 5.0}, quick=True),
    Edit("01", {"step_m": 20.0, "shown_m": 2.0}),
    Edit("01", texts={TRACKS: ("radius_m = 4250", "radius_m = 3000")}, marks=True),
    Edit("01", texts={TRACKS: ("clothoid_m = 423", "clothoid_m = 211.5")}, marks=True),
    Edit("02", {"speeds_kmh": [5, 40]}),
    Edit("02", {"wheel_load_kN": 110.0}, marks=True),
    Edit("02", texts={VEHICLE: ("value = 0.15,", "value = 0.12,")}),
    Edit("03", {"speed_kmh": 40}, marks=True, quick=True),
    Edit("03", {"periods_ms": [1, 100], "speeds_kmh": [100]}, marks=True),
    Edit("03", {"wheels": "s1002", "torque_Nm": -60}, marks=True),
    Edit("03", texts={VEHICLE: ("value = 0.025,", "value = 0.0125,")}),
    Edit("04", {"steps": 12}),
    Edit("04", {"run_m": 150.0, "now_m": 400.0, "late_m": 200.0}, marks=True),
    Edit("04", {"closed_loop_m": 200.0, "driven": ["sine_tracking"]}, marks=True),
    Edit("04", {"scenario_names": ["braking"], "weight_sets": 5}, marks=True, quick=True),
    Edit("04", {"scenario_names": [], "variants": ["D1"]}, marks=True),
    Edit("04", {"variants": ["corrected", "D2"], "scenario_names": ["curve_entry_T3", "sine_tracking"]}, marks=True),
    Edit("04", texts=HEAVY),
    Edit("05", {"controllers": ["nmpc_observer", "ndi"]}),
    Edit("05", {"check_controllers": None, "tolerance": 1e-9}),
    Edit("05", {"particles": 12, "seed": 7, "map_points": 2}),
    Edit("05", {"nmpc_particles": 1, "iterations": 1}, marks=True),
    Edit("05", {"poles": [40], "r_factors": [0.5, 2]}, marks=True),
    Edit("05", texts={TUNING: ("speeds_kmh = [400, 300, 200, 100]", "speeds_kmh = [400]")}),
    Edit("05", texts={TUNING: ("least = 0.5", "least = 0.3")}, marks=True),
    Edit("05", {"controllers": ["lqg_preview"], "check_controllers": ["lqg_preview"]}, marks=True),
    Edit("05", {"controllers": ["ltv_mpc", "lqg_preview"], "check_controllers": ["ltv_mpc"]}, marks=True),
    Edit("06", {"end_m": 100.0, "ndi_poles": [20, 40]}, marks=True),
    Edit("06", {"end_m": 30.0, "ndi_poles": []}, marks=True),
    Edit("06", {"scenario_name": "curve_entry_T4", "end_m": 700.0}),
    Edit("06", {"end_m": 300.0, "ndi_poles": [30], "horizons_s": [0.008], "crest_mm": 2.0}, marks=True),
    Edit("06", {"end_m": 300.0, "horizons_s": [], "ndi_poles": [30], "rho": 0.0}, CONES, marks=True),
    Edit("07", {"stiff_times": 3.0, "end_m": 300.0}),
    Edit("07", {"speeds_kmh": [100], "end_m": 300.0}, marks=True),
    Edit("07", {"stiff_times": 1.0, "end_m": 60.0}, marks=True),
    Edit("07", {"lags_ms": [5, 10, 15, 20, 30]}, marks=True),
    Edit("07", {"r_factors": [1], "ndi_poles": []}, marks=True),
    Edit("07", {"end_m": 300.0}, {SCENARIOS: ("period_m = 150", "period_m = 75")}),
    Edit("08", {"set_points": [0.05, 0.085]}, marks=True),
    Edit("08", {"creep_slopes": [0.5], "friction": 0.15}, marks=True),
    Edit("08", {"patch_kN": 8.0, "speed_kmh": 200.0}),
    Edit("08", texts={VEHICLE: ("value = 0.15,", "value = 0.12,")}),
    Edit("09", {"larger": 100.0, "short_wave_m": 25.0}, marks=True),
    Edit("09", {"speed_kmh": 60.0, "r_factors": [0.1, 100], "ndi_poles": [], "reserves": []}, marks=True),
    Edit("09", {"speed_kmh": 80.0, "r_factors": [1, 3, 10], "ndi_poles": [25], "reserves": [0.05, 0.1]}),
    Edit("10", {"sensed_kmh": [20]}),
    Edit("10", {"sensed": "ndi_feedforward"}),
    Edit("10", {"stress": {}}),
    Edit("10", {"controllers": ["ndi", "ndi_integral"], "judged": ["curve_entry_T3", "sine_tracking"]}, marks=True),
    Edit("10", {"sensor_changes": {"gyro.noise": 0.0004}, "lags_ms": [5, 20]}),
    Edit("11", {"changed": {"adhesion.poor.k_a": 0.3, "adhesion.poor.k_s": 0.1}}, marks=True),
    Edit("11", {"changed": {"amplitude_mm": 2.0, "ndi.pole": 20.0}, "speeds_kmh": [400]}, marks=True),
    Edit("11", {"end_m": 20.0, "loss_kmh": 100.0, "sine_m": 20.0}, marks=True),
    Edit("12", {"noise_seed": 7, "rail_seed": 5}),
    Edit("12", {"rho": 1e-12, "turn": 0.0}),
    Edit("12", {"ahead_s": 0.0}, marks=True),
    Edit("12", texts={TUNING: ("turn = 0.082", "turn = 0.0")}, marks=True),
    Edit("13", {"spectrum": "en_D_300"}, marks=True),
    Edit("13", {"smooth_m": 10.0, "seeds": [5]}),
    Edit("13", {"speed_kmh": 160.0, "spectrum": "erri_low"}),
    Edit("13", {"localisation_m": [0.0, 10.0]}, marks=True),
    Edit("13", {"end_m": 400.0}, marks=True, quick=True),
    Edit("13", {"spectrum": "erri_high", "end_m": 100.0, "controllers": ["ndi"]}, marks=True),
    Edit("14", {"pole": 40.0}),
    Edit("14", {"pole": 400.0, "particles": 1, "iterations": 1, "end_m": 50.0}, marks=True),
    Edit("14", {"car_change": {"body.mass": 40000.0}}),
    Edit("14", {"suite_of": ["curve_T3", "irregular"]}),
    Edit("15_car", {"speeds_kmh": {"T1": 20, "T3": 200}}, marks=True),
    Edit("15_car", {"free_speeds_kmh": [360, 380, 400]}, marks=True),
    Edit("15_car", texts=CONES),
    Edit("15_car", texts={VEHICLE: ('"k_x", value = 30000.0', '"k_x", value = 60000.0')}),
]
CASES = [
    pytest.param(edit, id=f"{edit.chapter}-{number}", marks=[] if edit.quick else pytest.mark.slow)
    for number, edit in enumerate(EDITS)
]


@pytest.mark.parametrize("edit", CASES)
def test_an_edit_stops_no_chapter(edit, tmp_path):
    notebook = next(each for name, each in chain.chain().items() if name.startswith(edit.chapter))
    for file, (old, new) in edit.texts.items():
        text = (paths.ROOT / file).read_text(encoding="utf-8")
        assert old in text
        (tmp_path / "data").mkdir()
        (tmp_path / file).write_text(text.replace(old, new), encoding="utf-8")
    chain.run(notebook, notebook.parameters | notebook.test_parameters | edit.parameters, tmp_path)
    assert edit.marks <= bool(false_in(data.read(tmp_path / f"notebooks/{notebook.name}.ipynb")["cells"]))
