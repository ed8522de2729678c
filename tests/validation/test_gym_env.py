"""The environment of examples/: Gymnasium's check, feedback of its observation, a derailment that does not pay."""

import importlib.util

import numpy as np
import pytest

from railrepro import paths
from railrepro.data import InputError
from railrepro.simulation.scenarios import load_scenario
from railrepro.vehicle.parameters import load_vehicle

pytest.importorskip("gymnasium", reason="the example needs Gymnasium")
SHORT = load_scenario("curve_entry_T3").but(end_m=160.0)


@pytest.fixture(scope="module")
def example():
    spec = importlib.util.spec_from_file_location("gym_env", paths.ROOT / "examples/gym_env.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def weights(env, pole):
    """Feedback of the first three numbers of a running gear with three equal poles (rad/s)."""
    vehicle, v = env.vehicle, env.scenario.speed
    gain = vehicle.wheel.radius / vehicle.gear.contact_base * vehicle.effective_yaw_inertia / vehicle.drive.torque_limit
    return gain * np.array([1e-3 * pole**3 / v, 3e-3 * pole**2, -3e-2 * pole])


def driven(env, policy, seed=1):
    """Return and end of an episode, the last reward with the time left, and the last info."""
    observation, info = env.reset(seed=seed)
    total, ends = 0.0, (False, False)
    while not any(ends):
        left = env.duration - info["time"]
        observation, reward, *ends, info = env.step(policy(observation))
        total += reward
    return total, ends, (reward, left), info


@pytest.mark.parametrize("sensors", [False, True])
def test_the_example_is_an_environment_that_a_feedback_of_its_observation_steers(example, sensors):
    from gymnasium.utils.env_checker import check_env

    env = example.GuidanceEnv(SHORT, sensors)
    check_env(env, skip_render_check=True)

    def feedback(observation):
        return observation[:-1].reshape(2, -1)[:, :3] @ weights(env, 12.0)

    followed, ends, _, info = driven(env, feedback)
    assert ends == [False, True] and info["p"] == pytest.approx(160, abs=2)
    assert followed == driven(env, feedback)[0] != driven(env, feedback, seed=2)[0]
    idle = driven(env, lambda _: np.zeros(2))[0]
    assert idle < followed < 0
    env.vehicle = load_vehicle(**{"contact.profile": "cone"})  # no flange holds it
    lost, ends, (reward, left), info = driven(env, lambda _: np.ones(2))
    assert ends == [True, False] and reward == pytest.approx(-example.WORST * left) and lost < idle
    assert info["torque"].tolist() == [env.vehicle.drive.torque_limit] * 2 and (info["error"] < 0).all()
    env.reset()
    with pytest.raises(InputError, match="two numbers from -1 to 1 are needed"):
        env.step(np.zeros(3))
