"""Guidance laws: own ones at 1 kHz and slower ones, refusals, and the inversion against the control model."""

import re
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from railrepro import paths
from railrepro.control import lateral, law, ndi
from railrepro.control.mpc import NMPC
from railrepro.control.ndi import NDI
from railrepro.data import InputError
from railrepro.model.control_model import STATES, THETA, X, Y, control_model
from railrepro.simulation import scenarios, simulate
from railrepro.vehicle.parameters import load_vehicle


class Own:
    """A law whose torque is given; for everything else it is well formed."""

    memory = ("past",)

    def __init__(self, torque, gains=None):
        self._torque, self._gains = torque, gains or {"k": 1.0}

    def gains(self):
        return self._gains

    def torque(self, q):
        return self._torque(q), {"past": q.y}


def quantities(values):
    """What a law is given, with the short names of states."""
    return SimpleNamespace(**values, **{short: values[name] for short, name in lateral.SHORT.items()})


def blocks(page):
    """Fenced Python blocks of a page of the users' guide."""
    return re.findall(r"```python\n(.*?)```", (paths.NOTEBOOKS / "book" / page).read_text(), flags=re.DOTALL)


def test_the_examples_of_the_library_run_as_they_stand(tmp_path, monkeypatch):
    """A run, the car alone and as a unit, the car on a real track, a controller behind sensors."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("RAILREPRO_CFLAGS", "-O0 -ffp-contract=off")
    names = {}
    for block in blocks("using.md"):
        exec(compile(block, "page", "exec"), names)
    assert not names["run"].failed and (tmp_path / "car.fmu").exists()
    assert names["car"].left_rail == "" and 1e-3 < names["car"].outputs["front.y"] < 5e-3
    assert 0 < names["row"]["rail_rmse_y"] < 2e-3 and names["row"]["n_mv_floor_front"] > 0


def test_controllers_of_the_guide_run_as_they_stand():
    names = {}
    for block in blocks("own_car.md") + blocks("adding.md"):
        exec(compile(block, "page", "exec"), names)
        assert not names["run"].failed
        assert names["run"].ended.startswith("end of the run")
    assert {"StateFeedback", "Preview"} <= set(names)
    fast, slow = (lateral.signature(names["StateFeedback"](pole=pole)) for pole in (20.0, 40.0))
    assert fast == slow, "one compiled object must serve both tunings"


def test_a_constant_of_an_own_law_is_not_taken_from_another_one():
    torques = []
    for stiffness in (1e4, 3e4):
        own = Own(lambda q, stiffness=stiffness: -stiffness * q.psi - 1e2)
        run = simulate.run(scenarios.load_scenario("curve_entry_T3").but(end_m=10.0), own)
        torques.append(run.series["front.du"] + 1e2)
    assert np.allclose(torques[1].iloc[1], 3 * torques[0].iloc[1], rtol=1e-3)


@pytest.mark.parametrize(
    ("guidance", "sentence"),
    [
        (
            Own(lambda q: ca.vertcat(q.y, 1)),
            r"law Own: its torque is an expression of shape \(2, 1\)",
        ),
        (Own(lambda q: "left"), "law Own: its torque is 'left', a scalar expression is needed"),
        (Own(lambda q: None), "law Own: its torque is None, a scalar expression is needed"),
        (Own(lambda q: q.yaw), r"law Own: torque\(\) asks for q.yaw; there are .*'psi_Ax'.*'past', 'k', 'J_eff'"),
        (Own(lambda q: 0, {"psi": 1.0}), "law Own: 'psi' of its gains is the name of another quantity already"),
        (Own(lambda q: ca.SX.sym("z")), r"law Own: the symbols \[.*z.*\] are not given to torque"),
        (Own(lambda q: 0, {"k": float("nan")}), "law Own: gain 'k' is nan, a finite number is needed"),
        (Own(lambda q: 0, {"k": "much"}), "law Own: gain 'k' is 'much', a finite number is needed"),
        (Own(lambda q: 1 if q.y > 0 else 2), "law Own: .* casadi.if_else takes the place of if"),
        (Own(lambda q: max(q.y, 0)), "law Own: .* casadi.fmin and casadi.fmax that of min and max"),
        (Own, r"guidance Own is a class, an object of it is needed: Own\(\)"),
        ("nmpc", "guidance 'nmpc': an object with torque"),
    ],
)
def test_an_own_law_that_is_not_well_formed_is_refused_in_one_sentence(guidance, sentence):
    with pytest.raises(InputError, match=sentence) as refusal:
        simulate.run(scenarios.load_scenario("sine_tracking").but(end_m=30.0), guidance)
    assert "\n" not in str(refusal.value)


def test_memory_that_is_not_declared_is_refused():
    class Forgetful(Own):
        memory = ()

    with pytest.raises(InputError, match=r"law Forgetful: torque\(\) gave memory \['past'\], declared is \[\]"):
        lateral.signature(Forgetful(lambda q: 0.0))


def test_a_guidance_is_split_into_its_fast_law_and_its_slow_controllers():
    class Both(lateral.ZeroOrderHold):
        def __call__(self, vehicle, route, gear):
            return None

    fast, both = NDI(), Both()
    assert lateral.split(fast) == (fast, None)
    assert lateral.split(both) == (both, both)
    assert lateral.split(NMPC) == (lateral.ZeroOrderHold(), NMPC)
    for nothing in (3.0, None):
        with pytest.raises(InputError, match=r"an object with torque\(q\), or a factory"):
            lateral.split(nothing)


def jerk_of_the_model(vehicle, x, theta, ddpsi_dp, u_d, du):
    """Third time derivative of y along the control model, as the track passes by, with torques held."""
    state = ca.SX.sym("state", len(STATES))
    here = {"psi_Tr": theta["psi_Tr"] + theta["dpsi_dp"] * state[X], "dpsi_dp": theta["dpsi_dp"] + ddpsi_dp * state[X]}
    track = ca.vertcat(*((theta | here)[name] for name in THETA))
    model = control_model()
    parameters = dict(zip(model.parameters, model.parameter_vector(vehicle), strict=True)) | {"g": 0.0}
    rate = model.rhs(state, ca.vertcat(u_d - du, u_d + du), track, np.array(list(parameters.values())))
    derivative = state[Y]
    for _ in range(3):
        derivative = ca.jtimes(derivative, state, rate)
    return ca.substitute(derivative, state, x)


@pytest.mark.parametrize("speed", [40 / 3.6, 400 / 3.6])
@pytest.mark.parametrize(("base_torque", "tolerance"), [(0.0, 1e-9), (-2500.0, 5e-3)])
def test_the_inversion_inverts_the_control_model(speed, base_torque, tolerance):
    """To first order in all lateral quantities, which `scale` multiplies, the wanted third derivative of y comes out.

    The inversion leaves out the yaw stiffness of the weight (one hundredth of the spring's), so the model is taken
    without gravity, and the moment of a base torque on unequal radii, so it is exact when rolling freely only.
    """
    vehicle, generator, scale = load_vehicle(), np.random.default_rng(3), ca.SX.sym("scale")

    def lateral_quantity(size):
        return scale * generator.normal(0, size)

    x = {"x": 0.0, "xdot": speed, "psi_TrAx": lateral_quantity(1e-3), "y_TrAx": lateral_quantity(3e-3)}
    x |= {"psidot_Ax": lateral_quantity(0.05)}
    theta = {"psi_Tr": lateral_quantity(0.1), "dpsi_dp": lateral_quantity(1e-3), "phi_Tr": lateral_quantity(0.1)}
    theta |= {"dphi_dp": lateral_quantity(1e-3), "eps_Tr": 0.0, "deps_dp": 0.0, "m_CB": vehicle.body.mass}
    theta |= {"psi_CB": theta["psi_Tr"] + lateral_quantity(2e-3), "dpsi_dp_CB": lateral_quantity(1e-3)}
    x["psi_Ax"] = theta["psi_Tr"] + x["psi_TrAx"]
    extra = {name: lateral_quantity(size) for name, size in (("ddpsi_dp", 1e-5), ("y_ref", 3e-3), ("dy_ref", 1e-4))}
    extra |= {"ddy_ref": lateral_quantity(1e-5), "dddy_ref": lateral_quantity(1e-6)}

    gain, model = NDI(derivatives=3, integral=0.2).gains(), vars(law._model(vehicle))
    gear = x | {"xddot": 2 * base_torque / (model["r_0"] * model["m_x_eff"]), "held": 0.0}
    q = quantities(gear | theta | extra | gain | model | {"integral": lateral_quantity(1e-4), "tau_max": 4000.0})
    du, _ = NDI().torque(q)
    wanted = ndi.wanted_jerk(q)
    state = ca.vertcat(*(x[name] for name in STATES))
    found = jerk_of_the_model(vehicle, state, theta, extra["ddpsi_dp"], base_torque, du)
    slopes = ca.Function("slopes", [scale], [ca.jacobian(wanted, scale), ca.jacobian(found, scale)])
    first_order = [float(slope) for slope in slopes(0.0)]
    assert first_order[1] == pytest.approx(first_order[0], rel=tolerance)


def test_the_wanted_jerk_is_that_of_the_error_dynamics():
    """Time derivatives of y and of the set point along an accelerated run, by differentiation of both over time."""
    t, v0, acceleration, curvature, integral = ca.SX.sym("t"), 30.0, -1.3, 2e-3, 4e-4
    p, y = v0 * t + acceleration * t**2 / 2, 2e-3 + 5e-3 * t - 7e-3 * t**2 + 4e-3 * t**3
    place = ca.SX.sym("p")
    set_point = [3e-3 - 2e-4 * place + 1e-5 * place**2 + 4e-7 * place**3]
    for _ in range(3):
        set_point.append(ca.gradient(set_point[-1], place))

    def over_time(function, order):
        for _ in range(order):
            function = ca.gradient(function, t)
        return function

    v, psi_r = over_time(p, 1), over_time(y, 1) / over_time(p, 1)
    gear = {"xdot": v, "xddot": acceleration, "psi_TrAx": psi_r, "y_TrAx": y}
    gear["psidot_Ax"] = (over_time(y, 2) - acceleration * psi_r) / v + v * curvature
    names = ("y_ref", "dy_ref", "ddy_ref", "dddy_ref")
    track_ahead = {name: ca.substitute(value, place, p) for name, value in zip(names, set_point, strict=True)}
    track_ahead["dpsi_dp"] = curvature
    gain = NDI(pole=20.0, frequency=30.0, damping=0.7, integral=0.1, derivatives=3).gains()
    q = quantities(gear | track_ahead | gain | {"integral": integral})
    wanted = over_time(track_ahead["y_ref"], 3) + gain["ki"] * integral
    wanted += sum(gain[f"k{i}"] * over_time(track_ahead["y_ref"] - y, i) for i in range(3))
    both = ca.Function("both", [t], [ndi.wanted_jerk(q), wanted])
    found, expected = map(float, both(0.3))
    assert found == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize(("share", "grows"), [(0.9, 1), (1.1, 0), (-0.9, 1), (-1.1, 0)])
def test_the_integral_rests_while_the_error_asks_for_more_torque_than_there_is(share, grows):
    """On the straight a triple pole p asks for the jerk p^3 e, which takes the torque r_0/b J p^3 e/v."""
    pole, speed, inertia = 20.0, 30.0, 2000.0 + 60.0 * 1.5**2 / 2 / 0.46**2
    error = share * 4000.0 * 1.5 / 0.46 * speed / (inertia * pole**3)
    model = dict.fromkeys(lateral.MODEL, 0.0) | {"J_eff": inertia, "r_0": 0.46, "b": 1.5, "tau_max": 4000.0}
    here = dict.fromkeys((*lateral.GEAR, *lateral.ROAD), 0.0) | {"xdot": speed, "y_TrAx": -error}
    guidance = NDI(pole, pole, 1.0, integral=0.1)
    du, memory = guidance.torque(quantities(here | model | guidance.gains() | {"integral": 0.0}))
    assert float(du) == pytest.approx(share * 4000.0)
    assert float(memory["integral"]) == pytest.approx(1e-3 * error * grows)
