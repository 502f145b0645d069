"""HPAC-PickPlace-v0: the four phases, what counts as placed, and the target."""

import gymnasium
import numpy as np
import pytest

from hpac_gym.envs import HandEnv, PickPlace, ScriptedClosure, ScriptedPickPlace
from hpac_gym.tasks.pick_place import PickPlaceConfig, PickPlaceTimetable
from tests.envs.episodes import OPEN, Still, run

ID = "HPAC-PickPlace-v0"


@pytest.fixture(scope="module")
def env():
    with gymnasium.make(ID) as made:
        yield made


@pytest.fixture(scope="module")
def scripted(env):
    """Infos, last state and setup of scripted episodes, by their seeds."""

    def episode(seed: int):
        infos, _ = run(env, env.unwrapped.task.script(), seed=seed)
        return infos, env.unwrapped.state, env.unwrapped.episodes.setups[0]

    return [episode(seed) for seed in range(6)]


class NeverOpens(ScriptedPickPlace):
    """Closes and holds on."""

    def reset(self) -> None:
        super().reset()
        self._open = np.inf


def test_scripted_placing_succeeds_where_holding_on_or_doing_nothing_fails(env, scripted):
    won = [infos[-1]["is_success"] for infos, *_ in scripted]
    assert sum(won) >= 3
    for seed in np.flatnonzero(won)[:3].tolist():
        assert not any(
            run(env, policy, seed=seed)[0][-1]["is_success"]
            for policy in (NeverOpens(PickPlaceTimetable()), Still(), ScriptedClosure())
        )


def test_holding_on_pays_only_until_the_hand_is_lowered():
    timetable = PickPlaceTimetable(clearance=0.02)  # so that the object never touches its target
    with HandEnv(PickPlace(PickPlaceConfig(timetable=timetable))) as env:
        infos, _ = run(env, NeverOpens(timetable), seed=2)
    lift, lowered, released = (round(20 * timetable.ends[index]) for index in (2, 4, 5))
    assert all(info["hold_time"] > 0 for info in infos[lift:released])
    paid = [info["reward_terms"]["carry"] for info in infos]
    assert all(value > 0 for value in paid[lift : lowered - 1])
    assert not any(paid[lowered - 1 :])


def test_an_open_hand_does_not_touch_the_object_on_its_way(env):
    for seed in range(6):
        env.reset(seed=seed)
        for _ in range(12):
            *_, terminated, _, info = env.step(OPEN)
            assert not terminated
            assert info["contact_force"] == 0.0


def test_success_is_an_object_that_stands_alone_at_its_target(scripted):
    for infos, state, setup in scripted:
        if infos[-1]["is_success"]:
            assert infos[-1]["contact_force"] == 0.0
            assert state.on_target[0]
            # In the hand frame at the start.
            centre = state.object_pos[0] + setup.hand_rotation.T @ state.palm_offset[0]
            assert np.linalg.norm((centre - setup.target)[[0, 2]]) < PickPlaceConfig().tolerance
            assert centre[1] == pytest.approx(setup.target[1], abs=2e-3)


def test_the_wrist_path_is_smooth_and_ends_where_it_should():
    table = PickPlaceTimetable()
    dt = 1e-3
    times = tuple(np.arange(0, table.ends[-1], dt).tolist())
    offsets = table.wrist_path(times, np.array([0.05, 0.2, 0.01]))
    assert np.abs(np.diff(offsets, 2, axis=0) / dt**2).max() < 5.0  # [m/s²]
    np.testing.assert_allclose(offsets[-1], [0.05, 0.2, 0.01 + table.clearance], atol=1e-6)
