"""Every notebook runs, in full or with small parameters, and writes what it declares; an edit does not stop it."""

import ast
import json
import re
import shutil
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


PLACEHOLDER = re.compile(r"(?<![\\\w}])\{(?!term|cite)([a-z_]\w*[^{}]*|[^{}$]*:[.\d]*[fg%])\}")


def test_sentences_of_results_are_formatted():
    """A placeholder in a string without its f would be printed as it is, and no condition notices it."""
    for notebook in chain.chain():
        cells = data.read(paths.NOTEBOOKS / f"{notebook}.ipynb")["cells"]
        code = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
        calls = [node for node in ast.walk(ast.parse(code)) if isinstance(node, ast.Call)]
        said = [call.args[0] for call in calls if isinstance(call.func, ast.Name) and call.func.id == "says"]
        texts = [node.value for text in said for node in ast.walk(text) if isinstance(node, ast.Constant)]
        bare = [text for text in map(str, texts) if PLACEHOLDER.search(text)]
        assert said and not bare, f"{notebook}: {bare}"


class Edit(NamedTuple):
    """An edit of a reader: the chapter (how its name begins), and changed parameters, texts in data/ or code in cells.
    One with `marks` must mark a sentence as false. `make test` runs the quick ones, `make test-slow` the others."""

    chapter: str
    parameters: dict = {}
    texts: dict = {}
    cells: dict = {}
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
    Edit("00", cells={"in (0.0, 0.5, 3.0)": "in (0.0, 0.5, 1.0, 3.0)"}),
    Edit("00", cells={"in (0.0, 0.5, 3.0)": "in (1.0, 3.0)"}, marks=True),
    Edit("00", cells={'"wheel.spin_inertia": 1.0': '"wheel.spin_inertia": 60.0'}, marks=True),
    Edit("00", cells={'["ndi", "nmpc", "ltv_mpc"]': '["ndi", "nmpc", "ltv_mpc", "ndi_feedforward"]'}),
    Edit("00", cells={".but(end_m=end_m)": ".but(end_m=end_m, speed_kmh=330)"}),
    Edit("00", {"pole": 30.0}, cells={"return self.torque": "return 1.5 * self.torque"}),
    Edit("01", {"step_m": 5.0}, quick=True),
    Edit("01", texts={TRACKS: ("radius_m = 4250", "radius_m = 3000")}, marks=True),
    Edit("01", texts={TRACKS: ("clothoid_m = 423", "clothoid_m = 211.5")}, marks=True),
    Edit("01", cells={'{"radius_m": 2000.0}': '{"radius_m": 1000.0}'}),
    Edit("01", texts={TRACKS: ("unbalanced_acceleration_mps2 = 0.65", "unbalanced_acceleration_mps2 = 0.0")}),
    Edit("02", {"wheel_load_kN": 110.0}, marks=True),
    Edit("02", texts={VEHICLE: ("value = 0.15,", "value = 0.12,")}),
    Edit("02", cells={"np.arctan(rail.k_s * epsilon)": "np.pi / 2 * np.tanh(rail.k_s * epsilon)"}),
    Edit("02", cells={"polach(-slip, 0.0, 0.0, v / 3.6, rails": "polach(-slip, 0.0, 0.2, v / 3.6, rails"}),
    Edit("03", {"speed_kmh": 40}, marks=True, quick=True),
    Edit("03", {"periods_ms": [1, 100], "speeds_kmh": [100]}, marks=True),
    Edit("03", {"wheels": "s1002", "torque_Nm": -60}, marks=True),
    Edit("03", texts={VEHICLE: ("value = 0.025,", "value = 0.0125,")}),
    Edit("03", cells={" - Gamma * y**2 - r_0": " - r_0"}),
    Edit("03", cells={"J_W, w_ri, w_le = sp.diag(J_Wz, J_Wy, J_Wz)": "J_W, w_ri, w_le = sp.diag(J_Wy, J_Wy, J_Wy)"}),
    Edit("04", {"bound_mm": 2.5}, marks=True),
    Edit("04", {"run_m": 150.0, "now_m": 400.0, "late_m": 200.0}, marks=True),
    Edit("04", {"scenario_names": ["braking"], "weight_sets": 5}, marks=True, quick=True),
    Edit("04", {"scenario_names": [], "variants": ["D1"]}, marks=True),
    Edit("04", {"variants": ["corrected", "D2"], "scenario_names": ["curve_entry_T3", "sine_tracking"]}, marks=True),
    Edit("04", texts=HEAVY),
    Edit("04", cells={"T * s.r * dU[k] ** 2  # (31a)": "T * s.r * (dU[k] - (dU[k - 1] if k else 0)) ** 2"}),
    Edit("04", cells={'gains["k0"] * (y_ref - y)': '2 * gains["k0"] * (y_ref - y)'}),
    Edit("04", cells={"(8, 10, 12, 15, 25, 50)": "(5, 10, 26)", "(0.01, 0.1, 10, 100)": "(10,)"}),
    Edit("04", cells={"vertcat(x_d[0], 0, x_d[2], 0, 0, 0)": "vertcat(x_d[0], theta[0], x_d[2], 0, 0, 0)"}),
    Edit("05", {"controllers": ["nmpc_observer", "ndi"]}),
    Edit("05", {"check_controllers": None, "tolerance": 1e-9, "particles": 12, "seed": 7, "map_points": 2}),
    Edit("05", {"nmpc_particles": 1, "iterations": 1}, marks=True),
    Edit("05", {"poles": [40], "r_factors": [0.5, 2]}, marks=True),
    Edit("05", texts={TUNING: ("speeds_kmh = [400, 300, 200, 100]", "speeds_kmh = [400]")}),
    Edit("05", texts={TUNING: ("least = 0.5", "least = 0.3")}, marks=True),
    Edit("05", {"controllers": ["lqg_preview"], "check_controllers": ["lqg_preview"]}, marks=True),
    Edit("05", cells={"0.7298 * (v + 2.05 * r1 * (own - x) + 2.05 * r2 *": "(0.5 * v + 1.5 * r2 *"}),
    Edit("05", cells={'"damping": 0.0744}': '"damping": 0.3}'}, marks=True),
    Edit("06", {"end_m": 100.0, "ndi_poles": [20, 40]}, marks=True),
    Edit("06", {"scenario_name": "curve_entry_T4", "end_m": 700.0}),
    Edit("06", {"end_m": 300.0, "ndi_poles": [30], "horizons_s": [0.008], "crest_mm": 2.0}, marks=True),
    Edit("06", {"end_m": 300.0, "horizons_s": [], "ndi_poles": [30], "rho": 0.0}, CONES, marks=True),
    Edit("06", cells={"(scenario, PAPER_TRIO, stride=5)": '(scenario, ["nmpc", "ltv_mpc", "ndi"], stride=5)'}),
    Edit("06", {"scenario_name": "curve_entry_T2", "rho": 0.3}),
    Edit("06", {"end_m": 300.0}, cells={'"ndi_feedforward", "ndi_swarm"]': '"ndi_feedforward", "nmpc_observer"]'}),
    Edit("06", {"end_m": 300.0}, cells={'tuned("nmpc")(vehicle, R': 'tuned("ltv_mpc")(vehicle, R'}, marks=True),
    Edit("06", {"end_m": 300.0}, cells={'"NMPC, slope and curvature": 2': '"NMPC, slope and curvature": 1'}),
    Edit("07", {"stiff_times": 3.0, "end_m": 300.0}),
    Edit("07", {"speeds_kmh": [100], "end_m": 300.0}, marks=True),
    Edit("07", {"stiff_times": 1.0, "end_m": 60.0}, marks=True),
    Edit("07", {"lags_ms": [5, 10, 15, 20, 30]}, marks=True),
    Edit("07", {"r_factors": [1], "ndi_poles": []}, marks=True),
    Edit("07", {"end_m": 300.0}, {SCENARIOS: ("period_m = 150", "period_m = 75")}),
    Edit("07", texts={SCENARIOS: ("amplitude_mm = 3", "amplitude_mm = 5")}),
    Edit("08", {"set_points": [0.05, 0.085]}, marks=True),
    Edit("08", {"creep_slopes": [0.5], "friction": 0.15}, marks=True),
    Edit("08", {"patch_kN": 8.0, "speed_kmh": 200.0}),
    Edit("08", texts={VEHICLE: ("value = 0.15,", "value = 0.12,")}),
    Edit("08", cells={"return -p.drop_step": "return -20.0"}),
    Edit("08", cells={"return (x > 0) - (x < 0)": "return max(-1.0, min(1.0, 100 * x))"}),
    Edit("08", cells={'"r_times": 100.0': '"r_times": 3000.0'}),
    Edit("09", {"larger": 100.0, "short_wave_m": 25.0}, marks=True),
    Edit("09", {"speed_kmh": 60.0, "r_factors": [0.1, 100], "ndi_poles": [], "reserves": []}, marks=True),
    Edit("09", {"speed_kmh": 80.0, "r_factors": [1, 3, 10], "ndi_poles": [25], "reserves": [0.05, 0.1]}),
    Edit("09", cells={"room = tau_max - abs(du)": "room = 0.9 * tau_max"}),
    Edit("09", cells={".but(speed_kmh=speed_kmh)": '.but(speed_kmh=speed_kmh, track="T5")'}),
    Edit("10", {"stress": {}}),
    Edit("10", {"controllers": ["ndi", "ndi_integral"], "judged": ["curve_entry_T3", "sine_tracking"]}, marks=True),
    Edit("10", {"lags_ms": [5, 20, 40]}, marks=True),
    Edit("11", {"changed": {"adhesion.poor.k_a": 0.3, "adhesion.poor.k_s": 0.1}}, marks=True),
    Edit("11", {"changed": {"adhesion.poor.mu0": 0.15}, "loss_m": 300.0}, marks=True, quick=True),
    Edit("11", {"loss_kmh": 100.0, "loss_m": 200.0}, marks=True),
    Edit("11", {"changed": {"ndi.pole": 20.0}}, marks=True),
    Edit("12", {"noise_seed": 7, "rail_seed": 5}),
    Edit("12", {"rho": 1e-12, "turn": 0.0}),
    Edit("12", {"ahead_s": 0.0}, marks=True),
    Edit("12", texts={TUNING: ("turn = 0.082", "turn = 0.0")}, marks=True),
    Edit("13", {"spectrum": "en_D_300"}, marks=True),
    Edit("13", {"speed_kmh": 160.0, "spectrum": "erri_low"}),
    Edit("13", {"end_m": 400.0}, marks=True, quick=True),
    Edit("13", {"spectrum": "erri_high", "end_m": 100.0, "controllers": ["ndi"]}, marks=True),
    Edit("14", {"pole": 400.0, "particles": 1, "iterations": 1, "end_m": 50.0}, marks=True),
    Edit("14", {"car_change": {"body.mass": 40000.0}}),
    Edit("14", {"suite_of": ["curve_T3", "irregular"]}),
    Edit("14", cells={"self.route.reference_at(s)[:, 0]": "self.route.reference_at(s + 5)[:, 0]"}),
    Edit("15_car", {"speeds_kmh": {"T1": 20, "T3": 200}}, marks=True),
    Edit("15_car", {"free_speeds_kmh": [360, 380, 400]}, marks=True),
    Edit("15_car", texts=CONES),
    Edit("15_car", texts={VEHICLE: ('"k_x", value = 30000.0', '"k_x", value = 60000.0')}),
    Edit("15_car", cells={"cross(body.w, inertia * body.w + [0, h, 0])": "cross(body.w, inertia * body.w)"}),
    Edit("16", {"sensed_kmh": [20]}, quick=True),
    Edit("16", {"sensor_changes": {"gyro.noise": 0.0004}}, marks=True),
    Edit("17", {"step_mm": 2.0, "rail_seed": 2}, quick=True),
    Edit("17", cells={'horizons["brief"]': 'horizons["brief"] | {"horizon_s": 0.04}'}, marks=True),
    Edit("17", cells={'"frequency": 37.9': '"frequency": 80.0'}, marks=True),
    Edit("18", {"aside_mm": 5.0, "closed_loop_m": 200.0, "driven": ["sine_tracking"]}, marks=True),
]
CASES = [
    pytest.param(edit, id=f"{edit.chapter}-{number}", marks=[] if edit.quick else pytest.mark.slow)
    for number, edit in enumerate(EDITS)
]


@pytest.mark.parametrize("edit", CASES)
def test_an_edit_stops_no_chapter(edit, tmp_path, monkeypatch):
    notebook = next(each for name, each in chain.chain().items() if name.startswith(edit.chapter))
    for file, (old, new) in edit.texts.items():
        text = (paths.ROOT / file).read_text(encoding="utf-8")
        assert old in text
        (tmp_path / "data").mkdir()
        (tmp_path / file).write_text(text.replace(old, new), encoding="utf-8")
    if edit.cells:
        content = data.read(notebook.path)
        for old, new in edit.cells.items():
            cell = next(each for each in content["cells"] if old in "".join(each["source"]))
            cell["source"] = "".join(cell["source"]).replace(old, new)
        shutil.copytree(paths.NOTEBOOKS, tmp_path / "edited")
        monkeypatch.setattr(paths, "NOTEBOOKS", tmp_path / "edited")
        notebook.path.write_text(json.dumps(content), encoding="utf-8")
    chain.run(notebook, notebook.parameters | notebook.test_parameters | edit.parameters, tmp_path)
    assert edit.marks <= bool(false_in(data.read(tmp_path / f"notebooks/{notebook.name}.ipynb")["cells"]))
