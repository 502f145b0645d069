"""The pages of docs/environments and docs/grasps.md say what the code does."""

import math
import pkgutil
import re

import gymnasium
import pytest

from hpac_gym.envs import make_task
from hpac_gym.model import HPAC, servo_from_synergy
from hpac_gym.registration import GENTLE, GRASP, GRASP_ANY, GRASP_TYPE, IDS, PICK_PLACE, POSTURE
from hpac_gym.tasks import posture
from hpac_gym.tasks.grasp_rules import HELD_OUT_TYPES
from hpac_gym.tasks.grasp_types import LOOK_EVERY, SETTLES
from hpac_gym.tasks.grip import MAX_SLIP
from hpac_gym.tasks.phases import PickPlaceTimetable, Timetable
from hpac_gym.tasks.placing import START, WRIST_CENTRE, WRIST_REACH, WRIST_TURN
from hpac_gym.tasks.task import CONTROL_HZ
from hpac_gym.tasks.terms import GRASP_CENTRE
from tools.generate import DOCS, PAGES, filled

ID_PAGES = {
    GRASP: "environments/grasp.md",
    GRASP_ANY: "environments/grasp_any.md",
    GRASP_TYPE: "environments/grasp_type.md",
    GENTLE: "environments/gentle.md",
    PICK_PLACE: "environments/pick_place.md",
    POSTURE: "environments/posture.md",
}
LENGTHS = {GRASP: 64, GRASP_ANY: 144, GRASP_TYPE: 64, GENTLE: 88, PICK_PLACE: 110, POSTURE: 40}
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
OF_ALL = "environments/README.md"


def text(page: str) -> str:
    return (DOCS / page).read_text(encoding="utf-8")


def words(page: str) -> str:
    """A page in one line."""
    return " ".join(text(page).split())


@pytest.mark.parametrize("page", PAGES)
def test_a_page_has_a_place_for_every_table(page):
    """Whether the tables are up to date is a test of `make generate`."""
    assert sorted(re.findall(r"<!-- ([\w-]+) -->", text(page))) == sorted(PAGES[page])
    with pytest.raises(ValueError, match="the page needs"):
        filled(text(page).replace("<!-- ", "<!- "), PAGES[page])


def test_every_id_has_a_page():
    assert sorted(ID_PAGES) == sorted(IDS)


@pytest.mark.parametrize(("name", "page"), ID_PAGES.items())
def test_a_page_has_the_parts_that_people_expect_in_their_order_and_the_length_of_an_episode(
    name, page
):
    """The time limit is as long as an episode, or one step longer than one that ends by itself."""
    assert text(page).startswith(f"# {name}\n\n![")
    assert re.findall(r"^## (.*)", text(page), re.MULTILINE) == list(PARTS)
    assert f"{LENGTHS[name]} steps" in text(page).split("## Episode end")[1]
    linked = rf"\[`{name}`\]\({page.partition('/')[2]}\).* {LENGTHS[name]} steps \|\n"
    assert re.search(linked, text(OF_ALL))
    task = make_task(name)
    assert round(task.duration * CONTROL_HZ) == LENGTHS[name]
    assert gymnasium.spec(name).max_episode_steps == LENGTHS[name] + (not task.endless)


@pytest.mark.parametrize(("name", "page"), ID_PAGES.items())
def test_the_picture_is_drawn_by_the_command_below_it(name, page):
    command = r"python -m tools\.film_strip (\S+) .* --out docs/(.*)"
    shown, drawn_of, drawn = re.search(
        rf"!\[.*\]\(\.\./(.*)\)\n\n```\n{command}\n```", text(page)
    ).groups()
    assert (drawn_of, drawn) == (name, shown)


@pytest.mark.parametrize(("name", "page"), ID_PAGES.items())
def test_every_field_of_the_observation_has_its_place_on_the_page(name, page):
    with gymnasium.make(name, obs="privileged") as env:
        slices = env.unwrapped.slices
    for field, part in slices.items():
        last = part.stop - 1
        place = f"{part.start}–{last}" if last > part.start else str(last)
        assert f"| {place} | `{field}` |" in text(page) or f"`{field}` {place}" in text(page), field


@pytest.mark.parametrize("page", PAGES)
def test_every_name_of_the_package_on_a_page_is_there(page):
    """Import paths that a reader may copy; paths of files are a test of all pages."""
    for name in set(re.findall(r"`(hpac_gym(?:\.\w+)+)", text(page))):
        pkgutil.resolve_name(name)


@pytest.mark.parametrize("name", [GRASP, GRASP_ANY, GRASP_TYPE, PICK_PLACE])
def test_a_page_names_what_a_caller_may_have_to_import(name):
    page = words(ID_PAGES[name])
    for kind in ("SceneSetup", "ObjectSpec"):
        assert f"`hpac_gym.envs.{kind}`" in page
    for kind in ("CameraNoise", "Randomization"):
        assert f"`hpac_gym.envs.{kind}`" in words(OF_ALL)


MP, CMC = posture.FREE_FINGERS_THUMB
LOW, HIGH = posture.BLOCKED_CMC
CLOSED = servo_from_synergy(HPAC.synergy_max)
STEPS = [math.ceil(CONTROL_HZ * angle / HPAC.rate_limit) for angle in CLOSED]
(FINGER,) = set(STEPS[1:5])
CLOSING = round(CONTROL_HZ * Timetable().close_time)
WRIST = zip("xyz", WRIST_CENTRE - WRIST_REACH, WRIST_CENTRE + WRIST_REACH, strict=True)
BY_HAND = {
    OF_ALL: (
        f"({', '.join(f'{value:g}' for value in GRASP_CENTRE)}) m",
        f"rate limit of {HPAC.rate_limit:g} rad/s, all arriving together: a finger closes fully in {FINGER} steps",
        f"with the thumb's CMC, in {max(STEPS)} of the {CLOSING} steps that closing lasts",
    ),
    ID_PAGES[GRASP]: (
        f"lifts by {100 * Timetable().lift_height:g} cm",
        f"{1e3 * MAX_SLIP:g} mm in the hand since",
    ),
    ID_PAGES[PICK_PLACE]: (f"{1e3 * PickPlaceTimetable().clearance:g} mm above",),
    ID_PAGES[POSTURE]: (
        f"no joint is farther than {posture.TOLERANCE:g} rad from its goal",
        f"MCP beyond {posture.FREE_THUMB_FINGERS:g} rad",
        f"MP below {MP:g} rad and its CMC below {CMC:g} rad",
        f"MP beyond {posture.BLOCKED_MP:g} rad meets the index finger while its CMC is between {LOW:g} and {HIGH:g} rad",
        f"noise of {math.degrees(posture.CAMERA_NOISE):g}° a joint",
    ),
    ID_PAGES[GRASP_TYPE]: (
        *(
            f"| {6 + index} | `grasp_{axis}` | {low:.3f} m | {high:.3f} m |"
            for index, (axis, low, high) in enumerate(WRIST)
        ),
        f"| -{WRIST_TURN:g} rad | {WRIST_TURN:g} rad |",
        f"{100 * START[0]:g} cm in front of the palm",
        f"pushes it by more than {1e3 * SETTLES:g} mm",
        f"every {['', 'first', 'second', 'third', 'fourth'][LOOK_EVERY]} step",
        *(f"`{name}`" for name in HELD_OUT_TYPES),
    ),
}


@pytest.mark.parametrize("page", BY_HAND)
def test_what_is_written_by_hand_has_the_numbers_of_the_code(page):
    told = words(page).replace("−", "-")
    assert [claim for claim in BY_HAND[page] if claim not in told] == []
