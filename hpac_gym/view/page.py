"""The page: a hand, its object and its tendons in the browser, with sliders where nothing else
drives it."""

import io
import sys
import time
import webbrowser
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import dataclass
from threading import Event
from typing import Self

import numpy as np
import viser
from scipy.spatial.transform import Rotation

from hpac_gym.model import (
    DIGITS,
    HPAC,
    JOINT_INDEX,
    SERVOS,
    elastic_joints_from_servo,
    rigid_joints_from_servo,
    servo_from_synergy,
)
from hpac_gym.model.checks import Array
from hpac_gym.output import markdown
from hpac_gym.physics.engine import HAND_POSITION, SceneSetup, SceneState
from hpac_gym.physics.supports import COLORS, support_boxes
from hpac_gym.view.meshes import Links, add_mesh, moved, object_meshes, solid

GHOSTS = {
    "rigid": ("nominal rigid prediction", (230, 80, 160)),
    "elastic": ("nominal elastic prediction", (60, 190, 120)),
    "goal": ("goal", (60, 130, 240)),
}
"""Postures that can be laid over the hand: label and colour."""
PICTURE_HZ = 20
"""Pictures a second."""
_ROUND_RANGE = (np.ceil(100 * HPAC.servo_min) / 100, np.floor(100 * HPAC.servo_max) / 100)


@dataclass(frozen=True, slots=True)
class Shown:
    """What a picture shows."""

    joint_pos: Array
    """Joint angles, shape (15,) [rad]."""
    servo: Array
    """Commanded servo angles, of which the predictions are, shape (6,) [rad]."""
    wrist: Array
    """Offset of the wrist along the world's axes, shape (3,) [m]."""
    tension: Array | None = None
    """Tension of the driving tendons, shape (5,) [N]; None where nobody knows it."""
    object_pos: Array | None = None
    """Centre of the object in the hand's frame, shape (3,) [m]."""
    object_rotation: Rotation | None = None
    """From the object's axes to the hand's."""
    text: str = ""
    """A line below the figures."""
    goal: Array | None = None
    """Joint angles that are asked for, shape (15,) [rad]; None where none are."""

    def ghost(self, name: str) -> Array | None:
        """Joint angles of one of `GHOSTS`, shape (15,) [rad]; None without a goal."""
        if name == "goal":
            return self.goal
        predicted = rigid_joints_from_servo if name == "rigid" else elastic_joints_from_servo
        return predicted(np.clip(self.servo, HPAC.servo_min, HPAC.servo_max))

    @classmethod
    def of_state(
        cls, state: SceneState, servo: Array, text: str = "", goal: Array | None = None
    ) -> Self:
        """The first world of a simulation, the servos' commands, shape (6,) [rad], and a goal."""
        return cls(
            state.joint_pos[0],
            servo,
            state.palm_offset[0],
            state.tension[0],
            state.object_pos[0],
            Rotation.from_matrix(turn) if (turn := state.object_rotation[0]).any() else None,
            text,
            goal,
        )


class HandPage:
    """A page on this computer alone, whose address is printed.

    Args:
        setup: the scene; its object may be None, or fixed where nobody knows what it stands on. The
            slider of the thumb's CMC begins at its angle.
        about: what is seen, in a sentence.
        stop: called by the button that sends ESTOP; None is a page without one.
        browser: open a browser.
        driven: something else moves the hand and the object; the sliders only follow.

    Attributes:
        address: URL of the page.
        sliders: the six sliders. lift: one for the wrist's height, not shown at first.
        object_back: set when the button that asks for it is pressed.
    """

    def __init__(
        self,
        setup: SceneSetup,
        about: str,
        stop: Callable[[], None] | None = None,
        browser: bool = False,
        driven: bool = False,
    ) -> None:
        self._driven = driven
        with redirect_stdout(io.StringIO()):  # its banner
            self._server = viser.ViserServer("127.0.0.1", label="H-PAC hand", verbose=False)
        self.address = f"http://127.0.0.1:{self._server.get_port()}/"
        self.object_back = Event()
        self._due = 0.0
        self._text_due = 0.0
        scene = self._server.scene
        scene.set_up_direction("+z")
        scene.configure_environment_map(None)
        scene.configure_default_lights(cast_shadow=False)
        scene.add_light_ambient("/lamps/all", intensity=1.0)
        scene.add_light_directional("/lamps/sun", intensity=1.2, position=(0.6, 1.0, 1.2))
        self._draw_controls(about, stop)
        self.sliders[-1].value = float(servo_from_synergy(setup.synergy, setup.hand)[-1])
        self._scene = scene.add_frame("/scene", show_axes=False)
        self.place(setup)
        print(f"hpac_gym: the page is at {self.address}", file=sys.stderr, flush=True)
        if browser:
            webbrowser.open(self.address)

    # Scene --------------------------------------------------------------------------------

    def place(self, setup: SceneSetup) -> None:
        """Show another scene."""
        self._hand_turn = Rotation.from_quat(setup.hand_quaternion)
        centre = HAND_POSITION + self._hand_turn.apply([0.03, 0.0, 0.1])
        aside = centre + np.array([-0.05, 0.0, 0.0])  # the panel covers the right
        camera = self._server.initial_camera
        camera.look_at = tuple(aside)
        camera.position = tuple(aside + np.array([0.12, 0.32, 0.09]))
        camera.up = (0.0, 0.0, 1.0)
        with self._server.atomic():
            self._scene.remove()
            self._scene = self._server.scene.add_frame("/scene", show_axes=False)
            self._hand = Links(self._server, setup)
            self._ghosts = {
                name: Links(self._server, setup, name, rgb) for name, (_, rgb) in GHOSTS.items()
            }
            self._again.visible = setup.object is not None and not self._driven
            self._object = self._server.scene.add_frame("/scene/object", show_axes=False)
            if setup.object is None:
                return
            for index, (mesh, color) in enumerate(object_meshes(setup.object)):
                add_mesh(self._server, f"/scene/object/{index}", mesh, color)
            for index, box in enumerate([] if setup.fixed else support_boxes(setup)):
                turn = Rotation.from_quat(box.quaternion)
                mesh = moved(solid("box", box.half_extents), box.centre, turn)
                add_mesh(self._server, f"/scene/support/{index}", mesh, COLORS[box.kind])

    # Controls -----------------------------------------------------------------------------

    def _draw_controls(self, about: str, stop: Callable[[], None] | None) -> None:
        gui = self._server.gui
        gui.configure_theme(control_width="medium", show_logo=False, show_share_button=False)
        gui.set_panel_label("H-PAC hand")
        self._about = gui.add_markdown(about)
        self._figures = gui.add_markdown("")
        if stop is not None:
            button = gui.add_button("ESTOP over the wire", color="red")
            button.on_click(lambda _: stop())
            gui.add_markdown(
                "*It stops the pulses if page, program and wire work: no safety device.*"
            )
        self._servos = gui.add_folder("Servos [rad]")
        with self._servos:
            self.sliders = [
                gui.add_slider(name, low, high, 0.01, max(low, 0.0))
                for name, low, high in zip(SERVOS, *_ROUND_RANGE, strict=True)
            ]
            most = min(slider.max for slider in self.sliders[:-1])
            self._all = gui.add_slider("all five", 0.0, most, 0.01, 0.0)
            self._all.on_update(lambda _: self._flex(_limited(self._all)))
            self._open = gui.add_button("Open the hand")
            self._open.on_click(lambda _: self._flex(0.0))
        self.free(not self._driven)
        self.lift = gui.add_slider("lift [m]", 0.0, 0.12, 0.005, 0.0, visible=False)
        self._again = gui.add_button("Put the object back")
        self._again.on_click(lambda _: self.object_back.set())
        with gui.add_folder("Show"):
            self._boxes = {
                name: gui.add_checkbox(label, name == "goal", visible=name != "goal")
                for name, (label, _) in GHOSTS.items()
            }

    def say(self, about: str) -> None:
        """Say something else of what is seen."""
        self._about.content = about

    def _flex(self, angle: float) -> None:
        """Set the sliders of the five digits, less the one that turns the thumb."""
        for slider in self.sliders[:-1]:
            slider.value = angle

    def wanted(self) -> Array:
        """The servo angles of the sliders, shape (6,) [rad]."""
        return np.array([_limited(slider) for slider in self.sliders])

    def lifted(self) -> float:
        """The wrist's height by its slider [m]."""
        return _limited(self.lift)

    def free(self, free: bool) -> None:
        """Let the sliders drive the hand, or only follow it."""
        self._servos.label = "Servos [rad]" if free else "Servos [rad], read-only"
        self._all.visible = self._open.visible = free
        for slider in self.sliders:
            slider.disabled = not free

    # Pictures -----------------------------------------------------------------------------

    def due(self) -> bool:
        """Whether it is time for the next picture."""
        return time.monotonic() >= self._due

    def wait(self) -> None:
        """Wait until it is."""
        time.sleep(max(self._due - time.monotonic(), 0.0))

    def show(self, shown: Shown) -> None:
        """Show a picture."""
        now = time.monotonic()
        self._due = now + 1 / PICTURE_HZ
        with self._server.atomic():
            self._hand.pose(shown.joint_pos, shown.wrist)
            self._boxes["goal"].visible = shown.goal is not None
            for name, box in self._boxes.items():
                posture = shown.ghost(name) if box.value else None
                self._ghosts[name].palm.visible = posture is not None
                if posture is not None:
                    self._ghosts[name].pose(posture, shown.wrist)
            if shown.tension is not None:
                self._hand.pull(shown.tension)
            self._object.visible = shown.object_pos is not None
            if shown.object_pos is not None:
                place = HAND_POSITION + shown.wrist + self._hand_turn.apply(shown.object_pos)
                self._object.position = tuple(place)
                turn = self._hand_turn * (shown.object_rotation or Rotation.identity())
                self._object.wxyz = turn.as_quat(scalar_first=True)
            if self.sliders[0].disabled:
                for slider, value in zip(self.sliders, shown.servo, strict=True):
                    slider.value = round(float(np.clip(value, slider.min, slider.max)), 2)
            if now >= self._text_due:
                self._text_due = now + 0.25
                self._figures.content = _figures(shown)
        self._server.flush()

    def close(self) -> None:
        """Stop the server."""
        with redirect_stdout(io.StringIO()):
            self._server.stop()


def _limited(slider: viser.GuiSliderHandle[float]) -> float:
    """Value of a slider; the page also takes a number beyond its range, which is brought back."""
    slider.value = min(max(slider.value, slider.min), slider.max)
    return slider.value


def _figures(shown: Shown) -> str:
    """A table of the joints that servos drive, and their tendons."""
    rows = []
    for i, servo in enumerate(SERVOS[: len(DIGITS)]):
        pull = "" if shown.tension is None else f"{shown.tension[i].round(1) + 0.0:.1f}"
        angle = shown.joint_pos[JOINT_INDEX[servo]].round(2) + 0.0  # no −0
        rows.append((servo, f"{angle:.2f}", pull))
    return markdown(("joint", "angle [rad]", "tendon [N]"), rows) + f"\n\n{shown.text}"
