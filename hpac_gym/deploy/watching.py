"""``--view``: a real or virtual hand, or a log, on the page in the browser. A hand has no joint
sensors: it is shown where the elastic model predicts it."""

import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from threading import Event, Thread
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from hpac_gym.bridge import BridgeError, HandLink
from hpac_gym.bridge.stop import UNCONFIRMED
from hpac_gym.deploy.observer import Pose
from hpac_gym.model import SERVOS, Hand
from hpac_gym.model.checks import Array
from hpac_gym.model.maps import CommandMap
from hpac_gym.physics.engine import SceneSetup
from hpac_gym.view.page import PICTURE_HZ, HandPage, Shown

ABOUT = "The hand as its commands and the elastic model have it; the object as the camera sees it."


class Predicted:
    """Pictures of a hand, one after the other.

    Args:
        hand: its model, of which zeros, slack and friction are taken into account.
    """

    def __init__(self, hand: Hand) -> None:
        self._map = CommandMap(hand)
        self._flexing = np.ones(len(SERVOS), dtype=bool)
        self._last = np.full(len(SERVOS), -np.inf)

    def __call__(self, servo: Array, pose: Pose | None, wrist: Array, text: str) -> Shown:
        """The picture of servo angles, shape (6,) [rad], and of an object that is seen."""
        turn = None if pose is None else Rotation.from_quat(pose.quaternion)
        place = None if pose is None else np.asarray(pose.position)
        self._flexing = np.where(servo == self._last, self._flexing, servo > self._last)
        self._last = servo
        bounds = self._map.bounds
        within = np.clip(servo, bounds.servo_min, bounds.servo_max)
        joints = self._map.joints_from_servo(within[None], self._flexing[None])[0]
        return Shown(joints, servo, wrist, None, place, turn, text)


@contextmanager
def watched(
    link: HandLink, setup: SceneSetup, hand: Hand
) -> Iterator[Callable[[dict[str, Any]], None]]:
    """Show a deployment during the block, from a thread of its own that only reads.

    Args:
        link: the hand.
        setup: the observer's scene.
        hand: the hand's model.

    Yields:
        What is called with every step's figures.
    """
    now = {"phase": "before or after the episode", "offset": np.zeros(3), "pose": None, "fault": ""}
    over = Event()
    predicted = Predicted(hand)

    def stop() -> None:
        try:
            link.estop()
        except BridgeError as error:
            now["fault"] = UNCONFIRMED.format(error)

    def show() -> None:
        while not over.wait(1 / PICTURE_HZ):
            status = link.last_status
            if status is not None:
                text = f"{now['fault']}{now['phase']}; {status.state}"
                page.show(predicted(status.servo, now["pose"], now["offset"], text))

    page = HandPage(replace(setup, fixed=True), ABOUT, stop, browser=True, driven=True)
    thread = Thread(target=show, daemon=True)
    thread.start()
    try:
        yield now.update
    finally:
        over.set()
        thread.join()
        page.close()


def show_log(setup: SceneSetup, steps: list[dict[str, Any]], hand: Hand) -> None:
    """Play the steps of a hand's log again and again, in real time, until Ctrl-C."""
    about = f"A log of {len(steps)} steps. {ABOUT}"
    page = HandPage(replace(setup, fixed=True), about, browser=True, driven=True)
    predicted = Predicted(hand)
    with closing(page), suppress(KeyboardInterrupt):
        while True:
            for row in steps:
                pose = Pose(np.array(row["position"]), tuple(row["quaternion"]))
                text = f"{row['t']:.2f} s, {row['phase']}"
                page.wait()
                page.show(predicted(np.array(row["hand"]), pose, np.zeros(3), text))
            time.sleep(1.0)
