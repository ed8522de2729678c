"""Guidance laws of users, and the inversion against the control model."""

import re
import runpy
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from railrepro import paths
from railrepro.control import lateral, law, ndi
from railrepro.control.ndi import NDI
from railrepro.model.control_model import STATES, THETA, X, Y, control_model, parameter_vector
from railrepro.model.parameters import PARAMETERS
from railrepro.vehicle.parameters import load_vehicle


def blocks(page):
    """Fenced Python blocks of a page of the users' guide."""
    return re.findall(r"```python\n(.*?)```", (paths.NOTEBOOKS / "book" / page).read_text(), flags=re.DOTALL)


def examples(*pages):
    """Names after all Python blocks of pages of the users' guide. No run may fail."""
    names = {}
    for page in pages:
        for block in blocks(page):
            exec(compile(block, "page", "exec"), names)
        assert not names["run"].failed and names["run"].ended.startswith("end of the run")
    return names


def test_examples_of_the_guide_run_as_they_stand(tmp_path, monkeypatch):
    """A run, the car alone and as a unit, on a real track, behind sensors; own cars and controllers."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("RAILREPRO_CFLAGS", "-O0 -ffp-contract=off")
    names = examples("using.md")
    assert (tmp_path / "car.fmu").exists()
    assert names["car"].left_rail == "" and 1e-3 < names["car"].outputs["front.y"] < 5e-3
    assert 0 < names["row"]["rail_rmse_y"] < 2e-3 and names["row"]["n_mv_floor_front"] > 0
    law = examples("own_car.md", "adding.md")["StateFeedback"]
    assert lateral.signature(law(pole=20.0)) == lateral.signature(law(pole=40.0)), "both tunings share compiled code"


class Own:
    def __init__(self, factor):
        self.factor = factor

    def torque(self, q):
        return self.factor * q.y


class Softened(NDI):
    """A class that inherits `alike`, although its torque depends on the object."""

    def torque(self, q):
        du, following = super().torque(q)
        return du / self.pole, following


def test_laws_share_equations_only_where_their_class_says_that_gains_are_all_that_differs(monkeypatch):
    assert lateral.signature(NDI(pole=20.0)) is lateral.signature(NDI(pole=40.0))
    own = [lateral.signature(Softened(pole=pole)).text for pole in (20.0, 40.0)]
    own += [lateral.signature(Own(factor)).text for factor in (1.0, 2.0)]
    own += [lateral.signature(NDI()).text]
    monkeypatch.setattr(NDI, "torque", lambda self, q: (q.y, {"integral": q.y}))
    assert len({*own, lateral.signature(NDI()).text}) == 6


def along_the_model(vehicle, expressions, state, theta, ddpsi_dp, u_d, du):
    """Expressions of the state, a row each, with their first three derivatives by time along the control model. Torques
    and the derivative of the curvature are constant."""
    here = {"psi_Tr": theta["psi_Tr"] + theta["dpsi_dp"] * state[X], "dpsi_dp": theta["dpsi_dp"] + ddpsi_dp * state[X]}
    parameters = dict(zip(PARAMETERS, parameter_vector(vehicle), strict=True)) | {"g": 0.0}
    track = ca.vertcat(*((theta | here)[name] for name in THETA))
    rate = control_model()(state, ca.vertcat(u_d - du, u_d + du), track, np.array(list(parameters.values())))
    orders = [ca.vertcat(*expressions)]
    for _ in range(3):
        orders.append(ca.jtimes(orders[-1], state, rate))
    return ca.horzcat(*orders)


@pytest.mark.parametrize("speed", [40 / 3.6, 400 / 3.6])
@pytest.mark.parametrize(("base_torque", "off", "tolerance"), [(0.0, 1, 1e-9), (-2500.0, 1, 5e-3), (-2500.0, 0, 1e-9)])
def test_the_inversion_gives_the_control_model_the_error_dynamics(speed, base_torque, off, tolerance):
    """y has the third derivative of y*, and k2, k1, k0 and ki times the error's derivatives, itself and its integral,
    to first order in all lateral quantities, which `scale` multiplies. The inversion leaves out the yaw stiffness of
    the weight (one hundredth of the spring's), so the model is taken without gravity, and the moment of a base torque
    on unequal radii or a rolled axle, so while braking it is exact in the middle of a level track only."""
    vehicle, generator, scale = load_vehicle(), np.random.default_rng(3), ca.SX.sym("scale")
    sizes = {"psi": 1e-3, "y": off * 3e-3, "yaw_rate": 0.05, "psi_Tr": 0.1, "dpsi_dp": 1e-3, "phi_Tr": off * 0.1}
    sizes |= {"dphi_dp": 1e-3, "psi_CB": 2e-3, "dpsi_dp_CB": 1e-3, "ddpsi_dp": 1e-5, "integral": 1e-4}
    set_point = {"y_ref": 3e-3, "dy_ref": 1e-4, "ddy_ref": 1e-5, "dddy_ref": 1e-6}
    x = {name: scale * generator.normal(0, size) for name, size in (sizes | set_point).items()}
    x |= {"x": 0.0, "v": speed, "psi_Ax": x["psi_Tr"] + x["psi"], "psi_CB": x["psi_Tr"] + x["psi_CB"]}
    x |= {"eps_Tr": 0.0, "deps_dp": 0.0, "m_CB": vehicle.body.mass, "tau_max": 4000.0}

    guidance, model = NDI(integral=0.2, rates=True), vars(law._model(vehicle))
    gain, xddot = guidance.gains(), 2 * base_torque / (model["r_0"] * model["m_x_eff"])
    q = SimpleNamespace(**(x | gain | model | {"xddot": xddot}))
    du, _ = guidance.torque(q)
    state = ca.SX.sym("state", len(STATES))
    place, (y0, y1, y2, y3) = state[X], (x[name] for name in set_point)
    reference = y0 + y1 * place + y2 * place**2 / 2 + y3 * place**3 / 6
    orders = along_the_model(vehicle, [state[Y], reference], state, x, x["ddpsi_dp"], base_torque, du)
    here = ca.vertcat(*(x[name] for name in [*lateral.GEAR][: len(STATES)]))
    y, wished = map(ca.horzsplit, ca.vertsplit(ca.substitute(orders, state, here)))
    wanted = wished[3] + gain["ki"] * x["integral"] + sum(gain[f"k{i}"] * (wished[i] - y[i]) for i in range(3))
    jerks = [ca.jacobian(jerk, scale) for jerk in (wanted, ndi.wanted_jerk(q), y[3])]
    expected, demanded, reached = map(float, ca.Function("jerks", [scale], jerks)(0.0))
    assert demanded == pytest.approx(expected, rel=1e-9)
    assert reached == pytest.approx(expected, rel=tolerance)


def of_the_guide(pole):
    """The integral law of the guide with a pole (rad/s)."""
    names = {}
    exec(blocks("adding.md")[0].partition("scenario =")[0], names)
    return names["StateFeedback"](pole)


INTEGRAL_LAWS = {
    "NDI": lambda pole: NDI(pole, pole, 1.0, integral=0.1),
    "guide": of_the_guide,
    "examples/pid.py": lambda pole: runpy.run_path(str(paths.ROOT / "examples/pid.py"))["PID"](pole),
}


@pytest.mark.parametrize("law", INTEGRAL_LAWS)
@pytest.mark.parametrize(("share", "grows"), [(0.9, 1), (1.1, 0), (-0.9, 1), (-1.1, 0)])
def test_the_integral_rests_while_the_error_asks_for_more_torque_than_there_is(share, grows, law):
    """On the straight a triple pole p asks for the jerk p^3 e, which takes the torque r_0/b J p^3 e/v."""
    pole, speed, inertia = 20.0, 30.0, 2000.0 + 60.0 * 1.5**2 / 2 / 0.46**2
    error = share * 4000.0 * 1.5 / 0.46 * speed / (inertia * pole**3)
    model = dict.fromkeys(lateral.MODEL, 0.0) | {"J_eff": inertia, "r_0": 0.46, "b": 1.5, "tau_max": 4000.0}
    here = dict.fromkeys((*lateral.GEAR, *lateral.ROAD), 0.0) | {"v": speed, "y": -error}
    guidance = INTEGRAL_LAWS[law](pole)
    du, memory = guidance.torque(SimpleNamespace(**here, **model, **guidance.gains(), integral=0.0))
    assert float(du) == pytest.approx(share * 4000.0)
    assert float(memory["integral"]) == pytest.approx(1e-3 * error * grows)
