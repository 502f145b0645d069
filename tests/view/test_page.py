"""The page: its solids everywhere, and the page itself in a browser where one is installed."""

import re
import signal
from contextlib import closing, contextmanager

import numpy as np
import pytest

from hpac_gym.body.geometry import HPAC_GEOMETRY
from hpac_gym.body.object_models import load_object_models
from hpac_gym.body.objects import ObjectSpec
from hpac_gym.bridge import FaultError, HandLink
from hpac_gym.model import HPAC, ServoCommand
from hpac_gym.physics.engine import SceneSetup
from hpac_gym.view.meshes import hand_meshes, object_meshes, solid
from hpac_gym.view.page import HandPage, Shown
from tests.conftest import CHROMIUM
from tests.processes import started, wait_for

HALF = (0.02, 0.02, 0.05)


@pytest.mark.parametrize(
    ("kind", "half", "expected"),
    [
        ("box", HALF, 8 * 0.02 * 0.02 * 0.05),
        ("cylinder", HALF, np.pi * 0.02**2 * 0.1),
        ("sphere", (0.02, 0.02, 0.02), 4 / 3 * np.pi * 0.02**3),
        ("capsule", HALF, np.pi * 0.02**2 * (0.06 + 4 / 3 * 0.02)),
    ],
)
def test_solids_have_their_volume_and_look_outwards(kind, half, expected):
    mesh = solid(kind, half)
    assert mesh.volume == pytest.approx(expected, rel=0.03)
    np.testing.assert_allclose(mesh.vertices.max(axis=0), half, rtol=0.02)


def test_every_link_of_the_hand_and_every_object_is_drawn():
    links = {link for link, _, _ in hand_meshes(HPAC_GEOMETRY)}
    assert links == {"palm", *(phalanx.link for phalanx in HPAC_GEOMETRY.phalanges)}
    assert all(mesh.volume > 0 for _, mesh, _ in hand_meshes(HPAC_GEOMETRY))
    for name, model in load_object_models().items():
        spec = ObjectSpec(model.shape, model.half_extents, model.mass, 0.8, name)
        meshes = [mesh for mesh, _ in object_meshes(spec)]
        assert len(meshes) == len(model.solids)
        assert all(mesh.volume > 0 for mesh in meshes)
        reach = np.max([np.abs(mesh.vertices).max(axis=0) for mesh in meshes], axis=0)
        np.testing.assert_allclose(reach, model.half_extents, rtol=0.05)


@pytest.fixture(scope="module")
def page():
    """The page of a hand with a turned thumb and a box."""
    synergy = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.9])
    with closing(
        HandPage(SceneSetup(ObjectSpec("box", HALF, 0.1, 0.8), synergy=synergy), "")
    ) as made:
        yield made


def test_the_sliders_begin_as_in_the_scene_and_take_no_number_beyond_their_range(page):
    np.testing.assert_allclose(page.wanted(), [0, 0, 0, 0, 0, 0.9 / HPAC.cmc_gain])
    page.lift.value = 1.2
    page.sliders[1].value = 9.0
    page.sliders[2].value = -9.0
    assert page.lifted() == page.lift.value == page.lift.max == 0.12
    assert page.wanted()[1:3].tolist() == [page.sliders[1].max, page.sliders[2].min]


def test_a_page_that_something_else_drives_says_so_and_has_no_buttons_for_it(page):
    for driven in (True, False, True):
        page.free(not driven)
        assert page._servos.label == "Servos [rad]" + ", read-only" * driven
        assert {slider.disabled for slider in page.sliders} == {driven}
        assert (page._all.visible, page._open.visible) == (not driven, not driven)
    labels = [box.label for box in page._boxes.values()]
    assert labels == ["nominal rigid prediction", "nominal elastic prediction", "goal"]
    page.show(Shown(np.full(15, 0.5), np.zeros(6), np.zeros(3), np.full(5, -0.01)))
    assert "| joint | angle [rad] |" in page._figures.content
    assert "| thumb_mp | 0.50 | 0.0 |" in page._figures.content


def test_an_object_is_shown_only_where_somebody_has_seen_it(page):
    for place in (None, np.array([0.05, 0.0, 0.1]), None):
        page.show(Shown(np.zeros(15), np.zeros(6), np.zeros(3), object_pos=place))
        assert page._object.visible == (place is not None)


# --- in the browser


@contextmanager
def opened(*words):
    """A command with a page, and its page in a browser; at the end no error was on its console."""
    from playwright.sync_api import sync_playwright

    errors = []
    with started("-m", "hpac", *words, BROWSER="true") as process:
        greeting = [process.stdout.readline() for _ in range(3)] if words[0] == "virtual" else []
        address = process.stderr.readline().split()[-1]
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(
                executable_path=CHROMIUM, args=["--no-sandbox", "--use-angle=swiftshader"]
            )
            page = browser.new_page()
            page.on("pageerror", lambda error: errors.append(f"{error}"))
            page.on(
                "console", lambda said: errors.append(said.text) if said.type == "error" else None
            )
            page.set_default_timeout(60_000)
            page.goto(address)
            page.wait_for_selector("[role=slider]", state="attached")
            yield page, greeting
            browser.close()
        assert errors == []
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=20)


def joint(page, digit, column=1):
    """The angle [rad] that the page shows for a digit's driven joint; in column 2 its tension [N]."""
    return float(page.locator("table tr", has_text=digit).first.inner_text().split()[column])


@pytest.mark.slow
@pytest.mark.browser
def test_a_slider_moves_the_hand_and_the_button_opens_it():
    with opened("play", "--no-browser") as (page, _):
        assert page.locator("[role=slider]:visible").count() == 8
        assert joint(page, "index") < 0.05
        page.locator("[role=slider]").nth(1).press("End")
        wait_for(lambda: joint(page, "index") > 0.5, 60)
        wait_for(lambda: joint(page, "index", column=2) > 1.0, 60)
        assert joint(page, "ring") < 0.1
        page.locator("[role=slider]").nth(6).press("End")  # all five
        wait_for(lambda: joint(page, "pinky") > 0.1, 60)
        page.get_by_role("button", name="Open the hand").click()
        wait_for(lambda: joint(page, "index") < 0.05, 60)
        assert page.get_by_text("ESTOP").count() == 0  # nothing to stop


@pytest.mark.slow
@pytest.mark.browser
def test_a_virtual_hand_is_driven_by_its_sliders_or_by_a_program_which_the_page_can_stop():
    with opened("virtual", "--view", "--no-browser") as (page, greeting):
        port = greeting[0].split()[3].rstrip(";")
        page.locator("[role=slider]").nth(2).press("End")
        wait_for(lambda: joint(page, "middle") > 0.5, 60)
        page.get_by_text("no safety device").wait_for()
        with HandLink(port) as link:
            link.arm(watchdog=2.0)
            link.move(ServoCommand(np.array([0, 0, 0, 0.8, 0, 0]), 2.0))
            driven = page.get_by_text("A program drives the hand.")
            # The link's sleep tells the firmware that its host is alive.
            wait_for(lambda: link.sleep(0.1) or driven.count() == 1, 60)
            wait_for(lambda: link.sleep(0.1) or joint(page, "ring") > 0.4, 60)
            assert joint(page, "middle") < 0.2
            page.get_by_role("button", name="ESTOP over the wire").click()
            with pytest.raises(FaultError, match="estop"):
                wait_for(lambda: link.sleep(0.1), 20)
            page.get_by_text("Stopped: fault estop until").wait_for()


@pytest.mark.slow
@pytest.mark.browser
def test_a_policy_is_watched_and_the_sliders_follow_it():
    with opened("show", "--no-browser", "--seed", "3000000") as (page, _):
        page.get_by_text("seed 300000").wait_for()  # a slow browser comes during a later episode
        wait_for(lambda: joint(page, "index") > 0.5, 60)
        slider = page.locator("[role=slider]").nth(1)
        wait_for(lambda: float(slider.get_attribute("aria-valuenow")) > 0.5, 10)
        assert slider.get_attribute("data-disabled") == "true"
        assert page.get_by_text("read-only").is_visible()
        assert not page.get_by_text("all five").is_visible()
        page.get_by_text(re.compile(r"\d of \d succeeded")).wait_for()
        wait_for(lambda: joint(page, "index") < 0.1, 60)  # the next episode begins
        assert not page.get_by_role("button", name="Put the object back").is_visible()


@pytest.mark.slow
@pytest.mark.browser
def test_a_deployment_and_its_log_are_shown(tmp_path):
    log = tmp_path / "log.jsonl"
    grasp = ("grasp", "--object", "cylinder:0.02,0.05", "--pose", "0.05,0.005,0.11")
    words = ("deploy", *grasp, "--port", "host", "--log", str(log), "--hold", "25", "--view")
    with opened(*words) as (page, _):
        page.get_by_text("armed").wait_for()
        wait_for(lambda: joint(page, "index") > 0.3, 20)
    with opened("replay", str(log), "--view") as (page, _):
        page.get_by_text("s, close").wait_for()
        wait_for(lambda: joint(page, "index") > 0.3, 30)
        assert page.locator("[role=slider]").first.get_attribute("data-disabled") == "true"
