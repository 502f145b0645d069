"""The pages of docs/environments and docs/grasps.md say what the code does."""

import math
import pkgutil
import re

import gymnasium
import numpy as np
import pytest

from hpac_gym.envs import Grasp, PickPlace
from hpac_gym.model import HPAC, servo_from_synergy
from hpac_gym.registration import GENTLE, GRASP, GRASP_ANY, GRASP_TYPE, IDS, PICK_PLACE, POSTURE
from hpac_gym.tasks import posture
from hpac_gym.tasks.grip import MAX_SLIP
from hpac_gym.tasks.task import CONTROL_HZ
from hpac_gym.tasks.terms import GRASP_CENTRE
from tools.tables import DOCS, PAGES, filled

ID_PAGES = {
    GRASP: "environments/grasp.md",
    GRASP_ANY: "environments/grasp_any.md",
    GRASP_TYPE: "environments/grasp_type.md",
    GENTLE: "environments/gentle.md",
    PICK_PLACE: "environments/pick_place.md",
    POSTURE: "environments/posture.md",
}
STEPS = {GRASP: 64, GRASP_ANY: 144, GRASP_TYPE: 64, GENTLE: 88, PICK_PLACE: 110, POSTURE: 40}
PARTS = (
    "Description",
    "Action space",
    "Observation space",
    "Rewards",
    "Starting state",
    "Episode end",
    "Info",
    "Arguments",
    "Baselines",
    "Version history",
)


def text(page: str) -> str:
    return (DOCS / page).read_text(encoding="utf-8")


def words(page: str) -> str:
    """A page in one line."""
    return " ".join(text(page).split())


def cells(page: str, name: str) -> list[list[str]]:
    """The rows of a table of a page, without its head."""
    lines = (
        text(page).split(f"<!-- {name} -->\n")[1].split(f"\n<!-- /{name} -->")[0].splitlines()[2:]
    )
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]


OF_ALL = "environments/README.md"


def rows_of(page: str, name: str) -> list[list[str]]:
    """The rows of a table of terms: place, field, entries, unit, bounds, meaning. Of the privileged
    ones a page lists the places, and the page of all environments the rest.
    """
    if name != "privileged":
        return cells(page, name)
    listed = text(page).split("<!-- privileged -->\n")[1].split("\n<!-- /privileged -->")[0]
    places = re.findall(r"`(\w+)` ([\d–]+)", listed)
    known = {row[0]: row for row in cells(OF_ALL, "privileged")}
    return [[place, *known[f"`{field}`"]] for field, place in places]


def bounds(page: str, *names: str) -> tuple[list[float], list[float]]:
    """The lower and the upper bounds of every entry of a vector that tables of a page describe, one
    after the other.
    """
    low = []
    high = []
    for index, _, entries, _, limits, _ in (row for name in names for row in rows_of(page, name)):
        first, _, last = index.partition("–")
        count = int(last or first) - int(first) + 1
        assert int(first) == len(low)
        named = re.fullmatch(r"(15 joints|6 servos)", entries)
        assert (int(entries.split()[0]) if named else len(entries.split(", "))) == count
        lowest, highest = (float(limit) for limit in limits.split(" … "))
        low += [lowest] * count
        high += [highest] * count
    return low, high


@pytest.mark.parametrize("page", PAGES)
def test_a_page_has_a_place_for_every_table(page):
    """Whether the tables are up to date is a test of `make generate`."""
    assert sorted(re.findall(r"<!-- ([\w-]+) -->", text(page))) == sorted(PAGES[page])
    with pytest.raises(ValueError, match="the page needs"):
        filled(text(page).replace("<!-- ", "<!- "), PAGES[page])


def test_every_id_has_a_page_that_is_linked():
    assert sorted(ID_PAGES) == sorted(IDS)
    for name, page in ID_PAGES.items():
        assert re.search(
            rf"\[`{name}`\]\({page.partition('/')[2]}\).* {STEPS[name]} steps \|\n",
            text("environments/README.md"),
        )


@pytest.mark.parametrize(("name", "page"), ID_PAGES.items())
def test_a_page_has_the_parts_that_people_expect_in_their_order(name, page):
    assert text(page).startswith(f"# {name}\n\n![")
    assert re.findall(r"^## (.*)", text(page), re.MULTILINE) == list(PARTS)
    assert f"{STEPS[name]} steps" in text(page).split("## Episode end")[1]
    assert ["length", f"{STEPS[name]} steps, {STEPS[name] / CONTROL_HZ:g} s"] in cells(
        page, "summary"
    )


@pytest.mark.parametrize("name", ID_PAGES)
def test_an_episode_is_as_long_as_its_page_says(name):
    """The time limit is as long as an episode, or one step longer than one that ends by itself."""
    with gymnasium.make(name) as env:
        assert round(env.unwrapped.task.duration * CONTROL_HZ) == STEPS[name]
        ends_by_itself = not env.unwrapped.task.goal_terms
    assert gymnasium.spec(name).max_episode_steps == STEPS[name] + ends_by_itself


@pytest.mark.parametrize(("name", "page"), ID_PAGES.items())
def test_the_picture_is_drawn_by_the_command_below_it(name, page):
    command = r"python -m tools\.film_strip (\S+) .* --out docs/(.*)"
    shown, drawn_of, drawn = re.search(
        rf"!\[.*\]\(\.\./(.*)\)\n\n```\n{command}\n```", text(page)
    ).groups()
    assert (drawn_of, drawn) == (name, shown)


@pytest.mark.parametrize(
    ("name", "part", "tables"),
    [
        *((name, "observation", ["observation"]) for name in ID_PAGES),
        *((name, "observation", ["observation", "privileged"]) for name in ID_PAGES),
        *((POSTURE, goal, ["goal"]) for goal in ("achieved_goal", "desired_goal")),
    ],
    ids=str,
)
def test_the_tables_have_the_bounds_of_the_spaces(name, part, tables):
    with gymnasium.make(name, obs="privileged" if "privileged" in tables else "deploy") as env:
        space = env.observation_space
    space = space[part] if isinstance(space, gymnasium.spaces.Dict) else space
    np.testing.assert_array_equal(
        [space.low, space.high], np.array(bounds(ID_PAGES[name], *tables), np.float32)
    )


@pytest.mark.parametrize("page", PAGES)
def test_every_name_of_the_package_on_a_page_is_there(page):
    """Import paths that a reader may copy."""
    for name in set(re.findall(r"`(hpac_gym(?:\.\w+)+)", text(page))):
        pkgutil.resolve_name(name)
    for file in set(re.findall(r"`((?:hpac_gym|assets|tests|tools)/[\w/.]+)`", text(page))):
        assert (DOCS.parent / file).exists(), file


@pytest.mark.parametrize("name", [GRASP, GRASP_ANY, GRASP_TYPE, PICK_PLACE])
def test_a_page_names_what_a_caller_may_have_to_import(name):
    page = words(ID_PAGES[name])
    for kind in ("SceneSetup", "ObjectSpec"):
        assert f"`hpac_gym.envs.{kind}`" in page
    for kind in ("CameraNoise", "Randomization"):
        assert f"`hpac_gym.envs.{kind}`" in words(OF_ALL)


def test_what_is_written_by_hand_has_the_numbers_of_the_code():
    grasp, place, goals = (words(ID_PAGES[name]) for name in (GRASP, PICK_PLACE, POSTURE))
    centre = f"({', '.join(f'{value:g}' for value in GRASP_CENTRE)}) m"
    assert centre in words(OF_ALL)
    assert f"lifts by {100 * Grasp().timetable.lift_height:g} cm" in grasp
    assert f"{1e3 * MAX_SLIP:g} mm in the hand since" in grasp
    assert f"{1e3 * PickPlace().timetable.clearance:g} mm above" in place
    assert goals.count(f"no joint is farther than {posture.TOLERANCE:g} rad from its goal") == 2
    mp, cmc = posture.FREE_FINGERS_THUMB
    assert f"MCP beyond {posture.FREE_THUMB_FINGERS:g} rad" in goals
    assert f"MP below {mp:g} rad and its CMC below {cmc:g} rad" in goals
    low, high = posture.BLOCKED_CMC
    blocked = f"MP beyond {posture.BLOCKED_MP:g} rad meets the index finger while its CMC is between {low:g} and {high:g} rad"
    assert blocked in goals
    assert f"noise of {np.rad2deg(posture.CAMERA_NOISE):g}° a joint" in goals
    fingers = servo_from_synergy(HPAC.synergy_max)[1:5] / HPAC.rate_limit
    (steps,) = {math.ceil(CONTROL_HZ * seconds) for seconds in fingers}
    whole = math.ceil(CONTROL_HZ * servo_from_synergy(HPAC.synergy_max).max() / HPAC.rate_limit)
    closing = round(CONTROL_HZ * Grasp().timetable.close_time)
    assert f"with the thumb's CMC, in {whole} of the {closing} steps that closing lasts" in words(
        "environments/README.md"
    )
    assert (
        f"rate limit of {HPAC.rate_limit:g} rad/s, all arriving together: a finger closes fully in {steps} steps"
        in words(OF_ALL)
    )
