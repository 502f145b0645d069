"""docs/environments.md and docs/grasps.md say what the code does."""

import re

import gymnasium
import pytest

import hpac_gym  # noqa: F401  registers the environments
from hpac_gym.envs import Grasp, PickPlace
from hpac_gym.envs.randomization import BOUNDS, Randomization
from hpac_gym.envs.tables import GRASPS_PAGE, GRASPS_TABLES, PAGE, TABLES, attribute_docs, filled, length_of, task_fields
from hpac_gym.envs.views import PRIVILEGED_FIELDS
from tests.envs.fingerprints import IDS

TEXT = PAGE.read_text(encoding="utf-8")


def test_the_page_is_what_the_command_writes():
    assert filled(TEXT) == TEXT, "run: python -m hpac_gym.envs.tables"


def test_the_page_of_the_grasps_is_what_the_command_writes():
    text = GRASPS_PAGE.read_text(encoding="utf-8")
    assert filled(text, GRASPS_TABLES) == text, "run: python -m hpac_gym.envs.tables"


def test_every_id_has_a_chapter_with_the_parts_that_people_expect():
    for name in IDS:
        chapter = TEXT.split(f"\n## {name}\n")[1].split("\n## ")[0]
        for part in ("Observation space", "Rewards", "Starting state", "Episode end", "Version history"):
            assert f"### {part}" in chapter, f"{name}: {part}"


@pytest.mark.parametrize(("name", "task"), [("HPAC-Grasp-v0", Grasp()), ("HPAC-PickPlace-v0", PickPlace())])
def test_the_tables_are_as_long_as_the_spaces(name, task):
    with gymnasium.make(name, obs="privileged") as env:
        assert env.observation_space.shape == (length_of(task_fields(task)) + length_of(PRIVILEGED_FIELDS),)


def test_time_limits_are_those_of_the_registration():
    for name, steps in (("HPAC-Grasp-v0", 60), ("HPAC-PickPlace-v0", 110), ("HPAC-Posture-v0", 40)):
        assert gymnasium.spec(name).max_episode_steps == steps
        assert f"{steps} steps" in TEXT.split(f"\n## {name}\n")[1].split("\n## ")[0]


def test_every_quantity_has_a_text_and_bounds_that_it_states():
    documents = attribute_docs(Randomization)
    for name, (_, highest) in BOUNDS.items():
        text = documents[name]
        assert re.search(r"\d|π", text), name
        assert any(f"{value:g}" in text for value in (highest, 1e3 * highest)) or "π" in text, name


def test_no_table_is_left_out():
    assert set(re.findall(r"<!-- ([\w-]+) -->", TEXT)) == set(TABLES)
