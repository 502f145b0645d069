"""The gentle task: what counts as squeezing, in both engines, and what each observation tells."""

from dataclasses import replace

import numpy as np
import pytest

from hpac_gym.envs import HandEnv
from hpac_gym.physics.engine import SceneSetup, SceneState
from hpac_gym.physics.settings import GRAVITY
from hpac_gym.physics.simulation import ENGINES
from hpac_gym.tasks.gentle import Gentle, GentleSetup
from hpac_gym.tasks.grasp import Grasp
from hpac_gym.tasks.task import FAILURE, RUNNING
from tests.envs.episodes import Still, run

CLOSED = np.array([0.3, 1, 1, 1, 1, 0.5], np.float32)
BEARS_ALL = {"crush_limit": (1000.0, 1000.0)}
DT = 0.05


def states(forces):
    """A state whose physics steps have these sums of forces, shape (n, k) [N]."""
    state = SceneState.empty(len(forces))
    state.force_steps = np.array(forces, float)
    return state


def started(num_worlds=1, limit=3.0, **config):
    task = Gentle(config)
    task.prepare(num_worlds, None)
    setup = task.setup(np.random.default_rng(0))
    task.start(
        range(num_worlds), [replace(setup, position=np.zeros(3), crush_limit=limit)] * num_worlds
    )
    return task


@pytest.mark.parametrize("engine", ENGINES)
def test_every_physics_step_is_felt_and_the_last_one_is_the_state_s(engine):
    with HandEnv(Gentle(BEARS_ALL), engine=engine) as env:
        env.reset(seed=0)
        felt = []
        for _ in range(30):
            env.step(CLOSED)
            state = env.episodes.now.state
            felt.append(state.force_steps[0])
            assert felt[-1].shape == (6,)
            assert felt[-1][-1] == pytest.approx(state.contact_force[0].sum())
    # Only all steps show the blow: the last ones miss more than half a newton of its peak.
    assert np.max(felt) > 0.5 + max(step[-1] for step in felt)
    with HandEnv(Grasp(), engine=engine) as env:  # which does not ask for them
        env.reset(seed=0)
        env.step(CLOSED)
        assert env.episodes.now.state.force_steps.shape == (1, 0)


def test_the_squeeze_is_half_of_the_sum_after_the_low_pass():
    task = started()
    for steps in range(1, 41):
        task.judge(states([[4.0] * 6]), DT)
        share = 1 - np.exp(-steps * DT / task.config.squeeze_time)
        assert task.squeeze == pytest.approx(2.0 * share)


def test_a_blow_within_a_control_step_crushes_and_a_limit_that_bears_it_does_not():
    blow = [[0.0, 0.0, 60.0, 0.0, 0.0, 0.0]]
    assert started(limit=3.0).judge(states(blow), DT) == FAILURE
    assert started(limit=5.0).judge(states(blow), DT) == RUNNING
    task = started(limit=3.0)
    task.judge(states(blow), DT)
    task.judge(states([[0.0] * 6]), DT)
    assert task.crushed  # what is crushed stays so
    task.start([0], [task.setup(np.random.default_rng(1))])
    assert not task.crushed


def test_closing_with_all_force_crushes_what_a_stronger_object_survives():
    ends = []
    for task in (Gentle(), Gentle(BEARS_ALL)):
        with HandEnv(task, engine="mujoco") as env:
            infos, _ = run(env, Still(CLOSED))
        ends.append(infos[-1] | {"steps": len(infos)})
    weak, strong = ends
    assert (weak["is_crushed"], weak["is_success"], strong["is_crushed"]) == (True, False, False)
    assert weak["peak_squeeze"] > weak["crush_limit"]
    assert strong["steps"] > weak["steps"]


def test_observations_tell_what_they_are_meant_to():
    firm = {"crush_limit": (30.0, 45.0)}
    with (
        HandEnv(Gentle(firm), engine="mujoco") as deploy,
        HandEnv(Gentle(firm), engine="mujoco", obs="load") as load,
        HandEnv(Gentle(firm, told=False), engine="mujoco") as untold,
        HandEnv(Gentle(firm, told=False), engine="mujoco", obs="privileged") as critic,
    ):
        seen = [env.reset(seed=3)[0] for env in (deploy, load, untold, critic)]
        for _ in range(8):
            seen = [env.step(CLOSED / 2)[0] for env in (deploy, load, untold, critic)]
        assert {"load", "horn_lag"} == set(load.slices) - set(deploy.slices)
        assert seen[0] == pytest.approx(seen[1][: len(seen[0])])
        assert "crush_limit" not in untold.slices
        limit = load.episodes.setups[0].crush_limit
        assert seen[0][deploy.slices["crush_limit"]] == pytest.approx(limit / 5)
        assert seen[3][critic.slices["crush_limit"]] == pytest.approx(limit / 5)
        assert seen[3][critic.slices["squeeze"]] == pytest.approx(critic.task.squeeze / 5)


def needed_squeeze(task: Gentle, setup: SceneSetup) -> float:
    """Squeeze of two opposed sides whose friction alone, by Coulomb's law, carries the object
    through all of the wrist's motion [N].
    """
    dt = 1e-3
    path = task.wrist_path(setup, tuple(np.arange(0.0, task.duration, dt).tolist()))
    acceleration = np.diff(path, 2, axis=0) / dt**2 + [0.0, 0.0, GRAVITY]
    friction = setup.object.friction * setup.hand_settings.contact_friction
    return setup.object.mass * np.linalg.norm(acceleration, axis=1).max() / (2 * friction)


def test_episodes_are_cylinders_and_boxes_that_can_be_held_below_their_limit():
    task = Gentle()
    setups = [task.setup(np.random.default_rng(seed)) for seed in range(120)]
    assert {setup.object.shape for setup in setups} == {"cylinder", "box"}
    assert all(2.5 <= setup.crush_limit <= 5.0 for setup in setups)
    needed = np.array([needed_squeeze(task, setup) for setup in setups])
    assert np.mean(needed < 3.0) > 0.95
    assert np.mean(needed < 4.0) > 0.99
    assert needed.max() > 2.0  # so that touching alone does not do
    # The shake of `HPAC-Grasp-v0` would ask for more.
    rough = Gentle({"timetable": {"shake_distance": 0.02, "close_time": 2.4}})
    assert np.mean([needed_squeeze(rough, setup) for setup in setups]) > 1.2 * needed.mean()


def test_a_setup_of_a_plain_scene_has_the_middle_of_the_range():
    plain = Grasp().setup(np.random.default_rng(0))
    with HandEnv(Gentle(), engine="mujoco") as env:
        env.reset(seed=0, options={"setup": plain})
        assert env.task.crush_limit == 3.75
        env.reset(seed=0, options={"setup": plain.to(GentleSetup, crush_limit=7.0)})
        assert env.task.crush_limit == 7.0
