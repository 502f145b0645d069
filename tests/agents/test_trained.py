"""The policy that comes with the repository fits the environment that comes with it."""

from pathlib import Path

import pytest

from agents.evaluate import evaluate
from hpac_gym.policies import read_policy

POLICY = Path(__file__).resolve().parents[2] / "agents" / "trained" / "grasp-sac.zip"


def test_it_says_how_it_was_made():
    about = read_policy(POLICY).about
    assert about["env_id"].endswith("HPAC-Grasp-v0")
    assert about["settings"]["seed"] == 0
    assert about["steps"] > 50_000
    assert about["versions"]["torch"].startswith("2.13.0")


@pytest.mark.processor
def test_it_still_grasps():
    """64 % of 400 held out, and 22 of these 24; a physics or observation that it was not trained on would drop most of 24."""
    result = evaluate([str(POLICY)], "HPAC-Grasp-v0", 24)
    assert sum(episode.success for episode in result.episodes["learned"]) >= 16
