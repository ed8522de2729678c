"""The environment passes Gymnasium's own check, is seeded, and rewards a controller that follows."""

import numpy as np
import pytest

from railrepro.control import ndi
from railrepro.control.law import GEARS
from railrepro.errors import InputError
from railrepro.model.control_model import STATES
from railrepro.simulation import simulate
from railrepro.simulation.scenarios import load_scenario
from railrepro.vehicle.parameters import load_vehicle

gymnasium = pytest.importorskip("gymnasium", reason="the extra `learn` is installed by `make test-extras`")
NAME = "railrepro.evidence.env.guidance:railrepro/Guidance-v0"
from railrepro.evidence.env import guidance, learn  # noqa: E402

CONE = load_vehicle(**{"contact.profile": "cone"})  # no flange holds it
SHORT = load_scenario("curve_entry_T3").but(end_m=160.0)


def made(**options):
    return gymnasium.make(NAME, **{"scenario": SHORT} | options)


def inversion(env, pole=15.0):
    """Torques of an inversion with three equal poles from the states that the environment measures."""
    model = {"r_0": env.vehicle.wheel.radius, "b": env.vehicle.gear.contact_base}
    model["J_eff"] = env.vehicle.effective_yaw_inertia
    torques = []
    for x in env.states:
        gear = dict(zip(STATES, x, strict=True))
        (y_ref,), (slope,) = env.route.reference_at(gear["x"])
        _, (curvature,), *_ = env.route.track_at(gear["x"])
        track_ahead = {"y_ref": y_ref, "dy_ref": slope, "ddy_ref": 0.0, "dddy_ref": 0.0, "dpsi_dp": curvature}
        gains = ndi.NDI(pole, pole, 1.0, derivatives=1).gains()
        jerk = ndi.wanted_jerk(gear | {"xddot": 0.0}, track_ahead, 0.0, gains)
        torques.append(model["r_0"] / model["b"] * model["J_eff"] * float(jerk) / gear["xdot"])
    return np.array(torques, dtype=np.float32) / env.vehicle.drive.torque_limit


def driven(env, policy, seed):
    env.reset(seed=seed)
    total, steps, ended = 0.0, 0, (False, False)
    while not any(ended):
        observation, reward, *ended, _ = env.step(policy(env.unwrapped))
        assert env.observation_space.contains(observation)
        total, steps = total + reward, steps + 1
    return total, steps, ended


@pytest.mark.parametrize("sensors", [False, True])
def test_gymnasium_finds_nothing_wrong(sensors):
    from gymnasium.utils.env_checker import check_env

    check_env(made(sensors=sensors).unwrapped, skip_render_check=True)


def test_an_inversion_follows_and_random_torques_leave_the_rail():
    env = made()
    env.action_space.seed(1)
    good, steps, ended = driven(env, inversion, seed=1)
    assert ended == [False, True] and steps == pytest.approx(160 / (280 / 3.6) / 0.005, abs=2)
    env.unwrapped.vehicle = CONE
    full, _, ended = driven(env, lambda env: np.ones(2, np.float32), seed=1)
    assert ended == [True, False] and full < good < 0
    driven(env, lambda _: env.action_space.sample(), seed=1)


def test_no_early_end_is_better_than_any_way_on():
    """The step that derails costs all that the rest of the episode could: the worst return is that of derailing."""
    env = made().unwrapped
    env.vehicle = CONE
    worst = -guidance.WORST * env.duration
    weak = driven(made(), lambda env: 0.1 * inversion(env, pole=5.0), seed=1)[0]
    for torque in (np.ones(2), -np.ones(2), np.array([1.0, -1.0]), np.array([0.05, 0.05])):
        env.reset(seed=1)
        total, ended, left = 0.0, False, env.duration
        while not ended:
            _, reward, ended, truncated, info = env.step(torque)
            assert not truncated and -guidance.WORST * left <= reward <= 0
            before, left, total = left, env.duration - info["time"], total + reward
        assert reward == pytest.approx(-guidance.WORST * before) and worst <= total < weak


def test_an_episode_ends_in_time():
    env = made(scenario=SHORT.but(end_m=20.0)).unwrapped
    assert env.duration == pytest.approx(1.25 * 20 / SHORT.speed)
    env.duration = 0.1
    env.reset(seed=1)
    steps = [env.step(np.zeros(2)) for _ in range(20)]
    assert [step[3] for step in steps] == [False] * 19 + [True]
    with pytest.raises(InputError, match="reset"):
        env.step(np.zeros(2))
    braking = made(scenario=load_scenario("braking").but(end_m=1450.0)).unwrapped
    run = simulate.run(braking.scenario, ndi.NDI())
    assert run.series["t_s"].iloc[-1] < braking.duration


def test_info_is_what_the_module_says():
    env = made().unwrapped
    _, info = env.reset(seed=1)
    assert set(info) == {"error", "torque", "p", "v", "time"}
    observation, _, _, _, info = env.step(np.array([0.5, -0.25]))
    assert info["torque"].tolist() == [2000.0, -1000.0] and info["time"] == pytest.approx(0.005)
    assert info["error"] == pytest.approx(1e-3 * observation[[0, 14]], abs=1e-9)
    assert info["v"] == pytest.approx(280 / 3.6, rel=1e-3) and info["p"] == pytest.approx(0.389, abs=1e-3)
    y = env.states[:, STATES.index("y_TrAx")]
    assert [info["margins"][f"{gear}.lateral"] for gear in GEARS] == pytest.approx(0.03 - np.abs(y), abs=1e-4)


def test_evolution_finds_a_better_policy(capsys):
    weights = learn.evolve(end=60.0, population=8, generations=3)
    said = [float(line.split("mean ")[1].split(",")[0]) for line in capsys.readouterr().out.splitlines()]
    assert len(said) == 3 and said[-1] > said[0] and weights.shape == (14,)


def test_torques_that_are_held_do_what_they_do_in_a_run():
    class Constant:
        period = 0.005

        def __init__(self, vehicle, route, gear):
            self.torque = (40.0, -20.0)[gear]

        def plan(self, x_hat, u_d):
            return self.torque

    env = made().unwrapped
    env.reset(seed=1)
    env._exchange = simulate.start(SHORT, simulate.lateral.Held(), env.route, env.vehicle, env.vehicle)
    for _ in range(60):
        env.step(np.array([40.0, -20.0]) / env.vehicle.drive.torque_limit)
    series = simulate.run(SHORT, Constant).series
    assert env.states[:, STATES.index("y_TrAx")].tolist() == series.iloc[300][[f"{g}.y" for g in GEARS]].tolist()


def test_a_seed_draws_the_start_and_the_noise():
    for options in ({}, {"sensors": True}):
        env = made(**options)
        first, same, other = (driven(env, inversion, seed)[0] for seed in (1, 1, 2))
        assert first == same != other


def test_several_side_by_side():
    envs = gymnasium.make_vec(NAME, num_envs=2, vectorization_mode="sync", scenario=SHORT)
    seen, _ = envs.reset(seed=[1, 2])
    assert seen.shape == (2, 29) and (seen[0] != seen[1]).any()
    seen, rewards, *_ = envs.step(np.zeros((2, 2), np.float32))
    assert rewards.shape == (2,) and np.isfinite(seen).all()


@pytest.mark.parametrize("action", [[0.0], [0.0, np.nan], [0.0, 0.0, 0.0]])
def test_a_wrong_action_is_refused(action):
    env = made().unwrapped
    env.reset(seed=1)
    with pytest.raises(InputError, match="two numbers from -1 to 1 are needed"):
        env.step(np.array(action))


def test_a_step_before_reset_is_refused():
    with pytest.raises(InputError, match="reset"):
        made().unwrapped.step(np.zeros(2))
