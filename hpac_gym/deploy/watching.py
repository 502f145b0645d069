"""``--view``: a real or virtual hand, or a log, on the page in the browser. A hand has no joint
sensors: it is shown where the elastic model predicts it."""

import time
from threading import Event, Thread
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from hpac_gym.bridge import BridgeError, HandLink
from hpac_gym.bridge.stop import UNCONFIRMED
from hpac_gym.deploy.observer import Pose
from hpac_gym.model import HPAC, Hand, elastic_joints_from_servo
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import SceneSetup
from hpac_gym.view.page import PICTURE_HZ, HandPage
from hpac_gym.view.shown import Shown

ABOUT = "The hand as its commands and the elastic model have it; the object as the camera sees it."


def predicted(servo: Array, hand: Hand, pose: Pose | None, wrist: Array, text: str) -> Shown:
    """The picture of servo angles, shape (6,) [rad], and of an object that is seen."""
    turn = None if pose is None else Rotation.from_quat(pose.quaternion)
    place = None if pose is None else np.asarray(pose.position)
    joints = elastic_joints_from_servo(np.clip(servo, hand.servo_min, hand.servo_max), hand)
    return Shown(joints, servo, wrist, None, place, turn, text)


class Watch:
    """Shows a deployment while it runs, from a thread of its own that only reads.

    Args:
        link: the hand.
        setup: the observer's scene.
        hand: the hand's model.
    """

    def __init__(self, link: HandLink, setup: SceneSetup, hand: Hand) -> None:
        self._link = link
        self._hand = hand
        self._figures: dict[str, Any] = {}
        self._fault = ""
        self._page = HandPage(setup, ABOUT, self._stop, browser=True, supports=False, driven=True)
        self._over = Event()
        self._thread = Thread(target=self._run, daemon=True)
        self._thread.start()

    def live(self, figures: dict[str, Any]) -> None:
        """Take note of a step."""
        self._figures = figures

    def close(self) -> None:
        """End the page."""
        self._over.set()
        self._thread.join()
        self._page.close()

    def _stop(self) -> None:
        try:
            self._link.estop()
        except BridgeError as error:
            self._fault = UNCONFIRMED.format(error)

    def _run(self) -> None:
        while not self._over.wait(1 / PICTURE_HZ):
            status = self._link.last_status
            if status is not None:
                figures = self._figures
                text = f"{self._fault}{figures.get('phase', 'before or after the episode')}; {status.state}"
                wrist = figures.get("offset", np.zeros(3))
                pose = figures.get("pose")
                self._page.show(predicted(status.servo, self._hand, pose, wrist, text))


def show_log(setup: SceneSetup, steps: list[dict[str, Any]], browser: bool = True) -> None:
    """Play the steps of a log again and again, in real time, until Ctrl-C."""
    about = f"A log of {len(steps)} steps. {ABOUT}"
    page = HandPage(setup, about, browser=browser, supports=False, driven=True)
    try:
        while True:
            for row in steps:
                pose = Pose(np.array(row["position"]), tuple(row["quaternion"]))
                text = f"{row['t']:.2f} s, {row['phase']}"
                page.wait()
                page.show(predicted(np.array(row["hand"]), HPAC, pose, np.zeros(3), text))
            time.sleep(1.0)
    except KeyboardInterrupt:
        return
    finally:
        page.close()
