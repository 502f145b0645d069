"""The policies that come with the repository fit the environments that come with it."""

from pathlib import Path

import pytest

from hpac_gym.evaluation.evaluate import evaluate
from hpac_gym.policies import read_policy
from hpac_gym.policies.loading import needed_options
from hpac_gym.policies.policy_file import SHIPPED

FOLDER = Path(__file__).resolve().parents[2] / "agents" / "trained"
SEEDS = {"grasp-any-wrist": 2}
"""Of the trainings; 0 for the others."""


def path_of(name):
    return name if name in SHIPPED else str(FOLDER / f"{name}.hpac")


@pytest.mark.parametrize(
    ("name", "env_id", "trials"),
    [
        ("grasp", "HPAC-Grasp-v0", 60_000),
        ("grasp-best", "HPAC-Grasp-v0", 300_000),
        ("grasp-robust", "HPAC-Grasp-v0", 240_000),
        ("grasp-any", "HPAC-GraspAny-v1", 181_495),
        ("grasp-any-wrist", "HPAC-GraspAny-v1", 105_143),
        ("grasp-type", "HPAC-GraspType-v0", 3_000),
        ("gentle", "HPAC-Gentle-v0", 1_024),
        ("pick-place", "HPAC-PickPlace-v0", 8_000),
        ("posture", "HPAC-Posture-v1", 8_485),
    ],
)
def test_it_says_how_it_was_made(name, env_id, trials):
    about = read_policy(path_of(name)).about
    assert about["env_id"].endswith(env_id)
    assert (about["settings"]["seed"], about["episodes"]) == (SEEDS.get(name, 0), trials)
    assert about["versions"]["torch"].startswith("2.13.0")
    assert about["made_for"]["control_hz"] == 20


def test_the_changelog_counts_them():
    words = {6: "six", 7: "seven", 8: "eight", 9: "nine", 10: "ten", 11: "eleven", 12: "twelve"}
    everywhere = len(SHIPPED) + len(list(FOLDER.glob("*.hpac")))
    told = f"{words[everywhere]} trained policies, of which {words[len(SHIPPED)]} are in the wheel"
    assert told in (FOLDER.parents[1] / "CHANGELOG.md").read_text(encoding="utf-8")


@pytest.mark.processor
@pytest.mark.parametrize(
    ("name", "engine", "episodes", "held"),
    [
        pytest.param("grasp", "pybullet", 6, 4, marks=pytest.mark.pybullet),
        ("grasp", "mujoco", 12, 9),
        pytest.param("grasp-best", "mujoco", 12, 10, marks=pytest.mark.slow),  # 92 % of 1,000
        pytest.param("grasp-robust", "mujoco", 12, 9, marks=pytest.mark.slow),  # 91 % of 1,000
        pytest.param(
            "grasp-any", "mujoco", 12, 5, marks=pytest.mark.slow
        ),  # 79 % of 1,000, random actions 6 %
        pytest.param("grasp-any-wrist", "mujoco", 12, 5, marks=pytest.mark.slow),
        pytest.param(
            "grasp-type", "mujoco", 12, 6, marks=pytest.mark.slow
        ),  # a quarter of its types are held out
        ("gentle", "mujoco", 24, 9),  # one fixed closure holds 8 %
        pytest.param("pick-place", "mujoco", 12, 11, marks=pytest.mark.slow),
        ("posture", "mujoco", 12, 8),  # the constant action reaches none
    ],
)
def test_it_still_grasps(name, engine, episodes, held):
    """90 % of 1,000 held-out episodes of grasp on MuJoCo; another observation or physics would drop
    most of them.
    """
    about = read_policy(path_of(name)).about
    result = evaluate(
        [path_of(name)],
        about["env_id"],
        episodes,
        options={"engine": engine} | needed_options(path_of(name)),
    )
    assert sum(episode.success for episode in result.episodes["learned"]) >= held
