"""The pages of docs/environments and docs/grasps.md say what the code does."""

import re

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence

import hpac_gym  # noqa: F401  registers the environments
from hpac_gym.envs import Grasp, PickPlace, posture
from hpac_gym.envs.arguments import arguments_of
from hpac_gym.envs.observation import GRASP_CENTRE
from hpac_gym.envs.randomization import BOUNDS, Randomization
from hpac_gym.envs.tables import DOCS, PAGES, attribute_docs, episode_steps, filled, reward_list
from hpac_gym.envs.task import Outcome
from tests.envs.fingerprints import IDS

ID_PAGES = {
    "HPAC-Grasp-v0": "environments/grasp.md",
    "HPAC-PickPlace-v0": "environments/pick_place.md",
    "HPAC-Posture-v0": "environments/posture.md",
}
PARTS = (
    "Description", "Action space", "Observation space", "Rewards", "Starting state", "Episode end", "Info", "Arguments",
    "Baselines", "Version history",
)  # fmt: skip


def text(page: str) -> str:
    return (DOCS / page).read_text(encoding="utf-8")


def cells(page: str, name: str) -> list[list[str]]:
    """The rows of a table of a page, without its head."""
    lines = text(page).split(f"<!-- {name} -->\n")[1].split(f"\n<!-- /{name} -->")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]


def bounds(page: str, *names: str) -> tuple[list[float], list[float]]:
    """The lower and the upper bounds of every entry of a vector that tables of a page describe, one after the other."""
    low, high = [], []
    for index, _, entries, _, limits, _ in (row for name in names for row in cells(page, name)):
        first, _, last = index.partition("–")
        count = int(last or first) - int(first) + 1
        assert int(first) == len(low)
        assert len(entries.split(", ")) == count
        lowest, highest = (float(limit) for limit in limits.split(" … "))
        low += [lowest] * count
        high += [highest] * count
    return low, high


@pytest.mark.parametrize("page", PAGES)
def test_a_page_is_what_the_command_writes(page):
    assert filled(text(page), PAGES[page]) == text(page), "run: python -m hpac_gym.envs.tables"


@pytest.mark.parametrize("page", PAGES)
def test_no_table_is_left_out(page):
    assert sorted(re.findall(r"<!-- ([\w-]+) -->", text(page))) == sorted(PAGES[page])


def test_every_id_has_a_page_that_is_linked():
    assert sorted(ID_PAGES) == IDS
    for name, page in ID_PAGES.items():
        steps = episode_steps(name)
        assert re.search(rf"\[`{name}`\]\({page.partition('/')[2]}\).* {steps} steps \|\n", text("environments/README.md"))


@pytest.mark.parametrize(("name", "page"), ID_PAGES.items())
def test_a_page_has_the_parts_that_people_expect_in_their_order(name, page):
    assert text(page).startswith(f"# {name}\n\n![")
    parts = [part for part in PARTS if part != "Baselines" or name != "HPAC-Posture-v0"]  # which no baseline plays
    assert re.findall(r"^## (.*)", text(page), re.MULTILINE) == parts
    assert f"{episode_steps(name)} steps" in text(page).split("## Episode end")[1]


@pytest.mark.parametrize(("name", "page"), ID_PAGES.items())
def test_the_picture_is_drawn_by_the_command_below_it(name, page):
    command = r"python -m hpac_gym\.evaluation\.film_strip (\S+) .* --out docs/(.*)"
    shown, drawn_of, drawn = re.search(rf"!\[.*\]\(\.\./(.*)\)\n\n```\n{command}\n```", text(page)).groups()
    assert (drawn_of, drawn) == (name, shown)


@pytest.mark.parametrize("tables", [("observation",), ("observation", "privileged")], ids=["deploy", "privileged"])
@pytest.mark.parametrize(("name", "page"), ID_PAGES.items())
def test_the_tables_have_the_bounds_of_the_spaces(name, page, tables):
    with gymnasium.make(name, obs="privileged" if "privileged" in tables else "deploy") as env:
        space = env.observation_space
    space = space["observation"] if isinstance(space, gymnasium.spaces.Dict) else space
    np.testing.assert_array_equal([space.low, space.high], np.array(bounds(page, *tables), np.float32))


def test_the_goals_have_the_bounds_of_their_spaces():
    with gymnasium.make("HPAC-Posture-v0") as env:
        for goal in ("achieved_goal", "desired_goal"):
            space = env.observation_space[goal]
            stated = bounds(ID_PAGES["HPAC-Posture-v0"], "goal")
            np.testing.assert_array_equal([space.low, space.high], np.array(stated, np.float32))


@pytest.mark.parametrize("name", IDS)
def test_an_id_takes_the_arguments_of_its_page_and_no_other(name):
    rows = cells(ID_PAGES[name], "arguments")
    described = {argument.name: argument for argument in arguments_of(name)}
    assert [row[0].strip("`") for row in rows] == list(described)
    assert all(all(row) for row in rows), "each has values, a default and a meaning"
    with gymnasium.make(name, **{argument.name: argument.default for argument in described.values()}) as given:
        with gymnasium.make(name) as default:
            seen, expected = given.reset(seed=0)[0], default.reset(seed=0)[0]
            assert data_equivalence(seen, expected)
    everything = {key for other in IDS for key in (argument.name for argument in arguments_of(other))}
    for other in everything - set(described) | {"task", "max_steps"}:
        with pytest.raises(TypeError, match=other):
            gymnasium.make(name, **{other: None})


def numbers(task: type, term: str) -> list[float]:
    """The numbers that the documentation of a task states for a term of its reward."""
    (stated,) = re.findall(rf"^\* `{term}`(?:.*\n?)(?:  .*\n?)*", reward_list(task), re.MULTILINE)
    return [float(number.replace("−", "-")) for number in re.findall(r"−?\d+(?:\.\d+)?", stated)]


@pytest.mark.parametrize("kind", [Grasp, PickPlace])
def test_the_rewards_have_the_numbers_that_are_stated(kind):
    task, rng, still = kind(), np.random.default_rng(0), np.zeros(6)
    setup = task.setup(rng)
    task.start(setup)
    # What `PickPlace.judge` finds of a lost object, of one that stands, and before the hand is lowered.
    task._lost, task._standing, task._lowered = 1.0, True, False
    phases = task.timetable.phases

    def terms(phase="close", forces=(), change=still, outcome=Outcome.RUNNING):
        far = setup.position + 1.0
        return task.reward_terms(outcome, phases.index(phase), far, dict.fromkeys(forces, 1.0), change)

    thumb, finger = terms(forces=["thumb"])["contact"], terms(forces=["index"])["contact"]
    opposed = terms(forces=["thumb", "index"])["contact"] - thumb - finger
    assert numbers(kind, "contact") == pytest.approx([thumb, finger, opposed])
    assert numbers(kind, "push") == [terms()["push"]]
    assert numbers(kind, "effort") == [terms(change=np.eye(6)[0])["effort"]]
    assert numbers(kind, "outcome") == [terms(outcome=end)["outcome"] for end in (Outcome.SUCCESS, Outcome.FAILURE)]
    task.grip.follow(setup.position, True, False, 0.05)
    assert numbers(kind, "carry") == [terms("lift")["carry"]]
    if kind is PickPlace:
        touched, free = terms("place", ["thumb"])["place"], terms("place")["place"]
        assert numbers(kind, "place") == [touched, free - touched]
    assert set(re.findall(r"^\* `(\w+)`", reward_list(kind), re.MULTILINE)) == set(terms())


def test_what_is_written_by_hand_has_the_numbers_of_the_code():
    centre = f"({', '.join(f'{value:g}' for value in GRASP_CENTRE)}) m"
    assert centre in text("environments/grasp.md")
    assert centre in text("environments/pick_place.md")
    assert f"lifts by {100 * Grasp().timetable.lift_height:g} cm" in text("environments/grasp.md")
    assert f"{1e3 * PickPlace().timetable.clearance:g} mm above" in text("environments/pick_place.md")
    page = " ".join(text("environments/posture.md").split())
    mp, cmc = posture.FREE_FINGERS_THUMB
    assert f"farther than {posture.TOLERANCE:g} rad" in page
    assert f"MCP beyond {posture.FREE_THUMB_FINGERS:g} rad" in page
    assert f"MP below {mp:g} rad and its CMC below {cmc:g} rad" in page
    assert f"noise of {np.rad2deg(posture.CAMERA_NOISE):g}° a joint" in page


def test_every_quantity_has_a_text_and_bounds_that_it_states():
    documents = attribute_docs(Randomization)
    for name, (_, highest) in BOUNDS.items():
        stated = documents[name]
        assert re.search(r"\d|π", stated), name
        assert any(f"{value:g}" in stated for value in (highest, 1e3 * highest)) or "π" in stated, name
