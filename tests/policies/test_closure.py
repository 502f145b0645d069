"""A closure is a way to close the hand, told by its numbers; a policy file says in which ranges
they lie.
"""

import gymnasium
import numpy as np
import pytest

from hpac_gym.errors import ParameterError
from hpac_gym.model import SERVO_INDEX
from hpac_gym.policies import Closures, LearnedPolicy, PolicyError
from hpac_gym.policies.made_for import difference, made_for
from hpac_gym.policies.policy_file import from_description
from hpac_gym.tasks.grasp_any import WRIST_ACTIONS as WRIST_SHIFT
from hpac_gym.tasks.placing import WRIST_ACTIONS
from tests.policies.episodes import actions_of

CMC = SERVO_INDEX["thumb_cmc"]
THUMB = SERVO_INDEX["thumb_mp"]
RNG = np.random.default_rng(0)


def way(closures: Closures, decision, steps: int = 64) -> np.ndarray:
    """Actions of one closure, shape (steps, 6)."""
    return closures.actions(np.repeat([decision], steps, axis=0), np.arange(steps))


def test_a_closure_goes_from_open_to_its_goals_and_stays_there():
    closures = Closures()
    for decision in RNG.uniform(-1, 1, (50, 8)):
        actions = way(closures, decision)
        low, high = closures.bounds
        goals = (low + (decision + 1) / 2 * (high - low))[:6]
        digits = np.delete(actions, CMC, axis=1)
        assert np.all(np.diff(digits, axis=0) >= -1e-12)
        assert digits[0].max() < 0
        np.testing.assert_allclose(actions[30], goals)
        np.testing.assert_array_equal(actions[30:], np.repeat(actions[30:31], 34, axis=0))
        assert np.all(actions[:, CMC] == goals[CMC])


def test_the_delay_holds_back_the_thumb_or_the_fingers():
    closures = Closures(duration=(10, 10))
    late, early = (way(closures, [0, 0, 0, 0, 0, 0, 0, lead]) for lead in (1, -1))
    assert np.all(late[:8, THUMB] == -1)
    assert np.all(early[:8, 1:5] == -1)
    np.testing.assert_allclose(late[8:, THUMB], late[:-8, 1])
    np.testing.assert_allclose(early[8:, 1], early[:-8, THUMB])


def test_a_closure_without_a_duration_is_at_its_goals_at_once():
    actions = way(Closures(duration=(0, 0)), [0, 0, 0, 0, 0, 0, 0, 1 / 8])
    np.testing.assert_allclose(actions[:3, [1, THUMB]], [[0.3, -1], [0.3, 0.3], [0.3, 0.3]])


def test_a_closure_with_a_release_begins_and_lets_go_when_it_is_told():
    closures = Closures(thumb_delay=(0, 0), begin=(6, 18), release=(40, 50))
    assert closures.names[-2:] == ("begin", "release")
    digits = np.delete(way(closures, [*np.zeros(8), 1, -1]), CMC, axis=1)
    assert np.all(digits[:18] == -1)
    assert np.all(digits[36:41] > 0)
    assert np.all(digits[41:] == -1)


def test_a_closure_with_a_wrist_pose_goes_from_its_preshape_to_its_goals():
    closures = Closures(goal=(-1, 1), thumb_delay=(0, 0), wrist=(-1, 1))
    assert closures.names[8:14] == WRIST_ACTIONS
    for decision in RNG.uniform(-1, 1, (20, 20)):
        actions = way(closures, decision)
        np.testing.assert_allclose(actions[0], [*decision[14:], *decision[8:14]])
        np.testing.assert_allclose(actions[23:], np.tile([*decision[:6], *decision[8:14]], (41, 1)))
        assert np.abs(actions[1, :6] - actions[0, :6]).max() > 0
    timed = Closures(wrist=(-1, 1), begin=(6, 18), release=(40, 50))
    assert timed.actions(np.zeros((3, len(timed.names))), [0, 20, 60]).shape == (3, 12)


def test_a_closure_that_shifts_the_wrist_closes_as_another_and_shifts_it_by_its_last_numbers():
    closures = Closures(shift=(-0.5, 1))
    assert closures.names[8:] == WRIST_SHIFT
    for decision in RNG.uniform(-1, 1, (20, 12)):
        actions = way(closures, decision)
        np.testing.assert_array_equal(actions[:, :6], way(Closures(), decision[:8]))
        shift = 0.25 + 0.75 * decision[8:]
        np.testing.assert_allclose(actions[:, 6:], np.tile(shift, (len(actions), 1)))
    with pytest.raises(ParameterError, match="wrist and shift"):
        Closures(wrist=(-1, 1), shift=(-1, 1))


def test_all_worlds_at_once_are_what_each_is_alone():
    closures = Closures()
    decisions = RNG.uniform(-1, 1, (20, 8))
    steps = RNG.integers(0, 64, 20)
    together = closures.actions(decisions, steps)
    alone = [
        closures.actions([decision], [step])[0]
        for decision, step in zip(decisions, steps, strict=True)
    ]
    np.testing.assert_array_equal(together, alone)
    assert np.all(np.abs(together) <= 1)


def test_a_policy_of_closures_decides_once_an_episode():
    closures = Closures()
    asked = []

    def actor(seen):
        asked.append(seen)
        return np.full(8, seen[0])

    policy = LearnedPolicy(actor, closures=closures)
    for first in (0.5, -0.5):
        acted = actions_of(policy, [np.array([first + step]) for step in range(5)])
        np.testing.assert_allclose(acted, way(closures, np.full(8, first), 5), atol=1e-7)
    assert len(asked) == 2


@pytest.mark.parametrize(
    ("ranges", "complaint"),
    [
        ({"goal": [1.0, -1.0]}, r"closure range goal = \[1.0, -1.0\] must be a range"),
        ({"goal": [0.0]}, "goal"),
        ({"goal": ["low", "high"]}, "invalid Closures"),
        ({"duration": [1.0, float("nan")]}, "duration"),
        ({"duration": [-2.0, 4.0]}, "duration"),
        ({"speed": [0.0, 1.0]}, "unexpected keyword argument .speed."),
        ({"begin": [0.0, 1.0]}, "both begin"),
    ],
)
def test_ranges_that_are_none_are_refused(ranges, complaint):
    with pytest.raises(PolicyError, match=complaint):
        from_description(Closures, ranges)


def test_the_first_difference_between_two_environments_is_named():
    with gymnasium.make("HPAC-Grasp-v0", engine="mujoco") as env:
        made = made_for(env)
    other = made | {"action": ["index_mcp"]}
    assert difference(other, made).startswith("action was ['index_mcp'], and is")
    entries = [list(entry) for entry in made["observation"]]
    entries[21][4] = 9.0
    said = "entry 21 was object_pos x [0.05 m] -4…9, and is object_pos x [0.05 m] -4…4"
    assert difference(made | {"observation": entries}, made) == f"observation {said}"
    shorter = made | {"observation": made["observation"][:-1]}
    assert "was none, and is" in difference(shorter, made)
    assert difference(made, shorter).endswith("and is none")


def test_a_range_of_one_value_has_a_decision_and_one_beyond_an_action_is_refused():
    closures = Closures(goal=(0.5, 0.5))
    values = [*[0.5] * 6, 10.0, 0.0]
    np.testing.assert_allclose(way(closures, closures.decisions(values))[40, 0], 0.5)
    for name in ("goal", "wrist", "shift"):
        with pytest.raises(ParameterError, match=rf"range {name} = \(-5, 5\) must .* \[-1, 1\]"):
            Closures(**{name: (-5, 5)})
