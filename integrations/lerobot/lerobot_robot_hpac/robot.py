"""The hand as a LeRobot robot, over any port that `hpac` opens.

LeRobot blocks for seconds: while it saves an episode, or loads a policy. A thread then repeats the
last command, but no longer than for a bounded time; the hand opens slowly and is disarmed. The next
action arms it again and leads it slowly to where it begins."""

import logging
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from threading import Event, RLock, Thread
from time import monotonic

import numpy as np
from lerobot.cameras import CameraConfig
from lerobot.cameras.utils import make_cameras_from_configs
from lerobot.lerobot_types import RobotAction, RobotObservation
from lerobot.robots import Robot, RobotConfig
from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected

from hpac_gym.bridge import BridgeError, HandLink, Stream
from hpac_gym.bridge.commands import connector
from hpac_gym.bridge.link import go, open_hand
from hpac_gym.deploy.observer import UPRIGHT
from hpac_gym.deploy.poses import averaged
from hpac_gym.model import load_hand
from hpac_gym.settings import check_bounds, setting
from lerobot_robot_hpac.features import (
    ACTIONS,
    POSE,
    PREDICTED,
    Commands,
    clipped,
    named,
    shared_source,
)

PERIOD = 0.05
"""Time between two commands, as in the environments [s]."""
WATCHDOG = 1.0
"""Longest silence before the hand relaxes by itself [s]; chosen: imports and the saving of an episode
starve the thread for tenths of a second.
"""
SILENCE = 0.15
"""Silence after which the thread repeats the last command [s]."""

log = logging.getLogger(__name__)


@RobotConfig.register_subclass("hpac")
@dataclass(kw_only=True)
class HpacConfig(RobotConfig):
    """Settings of the hand.

    Attributes:
        port: serial port, a pseudo-terminal of `hpac virtual`, socket://HOST:PORT, or `host`.
        hand: hand file, as `hpac calibrate` writes it; None is the nominal hand.
        patience: time without an action for which the hand keeps its posture, before it opens and
            is disarmed [s].
        start: action to which `connect` leads the hand slowly, before LeRobot's clock runs; None is
            the open hand.
        pose: source of an object's poses, as of `hpac deploy --pose`, which are then observed; one
            without a quaternion is upright before a hand in its default orientation.
        object: the object before a camera, as of `hpac deploy --object`.
        cameras: LeRobot's cameras.
    """

    port: str
    hand: str | None = None
    patience: float = setting(10.0, bounds=(0.0, np.inf), above=True, unit="s")
    start: list[float] | None = setting(None, bounds=(-1.0, 1.0), size=len(ACTIONS))
    pose: str | None = None
    object: str | None = None
    cameras: dict[str, CameraConfig] = field(default_factory=dict)


class Hpac(Robot):
    """The hand: six actions, −1…1; see `hpac_gym` for its model and its firmware."""

    config_class = HpacConfig
    name = "hpac"
    action_features = dict.fromkeys(ACTIONS, float)
    is_calibrated = True
    """`hpac calibrate` calibrates a hand, and its file is the setting `hand`."""
    is_connected = False

    def __init__(self, config: HpacConfig) -> None:
        super().__init__(config)
        check_bounds(config, "robot")
        self.config = config
        self.cameras = make_cameras_from_configs(config.cameras)
        self._hand = load_hand(config.hand)
        self._commands = Commands(self._hand)
        self._stack = ExitStack()
        # Of the link and all that follows: the caller's thread and the keeper's take turns.
        self._lock = RLock()
        self._stream: Stream | None = None
        self._armed = False
        self._failed: BridgeError | None = None

    @property
    def observation_features(self) -> dict[str, type | tuple[int, ...]]:
        """What is observed: what was commanded last, predicted joints, the object, pictures."""
        numbers = (*ACTIONS, *PREDICTED, *(POSE if self.config.pose else ()))
        pictures = {name: (cam.height, cam.width, 3) for name, cam in self.cameras.items()}
        return dict.fromkeys(numbers, float) | pictures

    def calibrate(self) -> None:
        """Nothing to do."""

    def configure(self) -> None:
        """Nothing to do."""

    @check_if_already_connected
    def connect(self, calibrate: bool = True) -> None:
        """Open the port and arm the hand, which comes to rest, open.

        Raises:
            BridgeError: The port cannot be opened, or the hand refuses.
            PoseError: No pose of the object comes within 5 s.
        """
        with ExitStack() as stack:
            for camera in self.cameras.values():
                camera.connect()
                stack.callback(camera.disconnect)
            if self.config.pose:
                source = shared_source(self.config.pose, self.config.object)
                self._source = stack.enter_context(source)
                averaged(self._source, 0.0, np.inf)
            port = connector(self.config.port, stack, self._hand)
            self._link = stack.enter_context(HandLink(port, hand=self._hand))
            self._failed = None
            self._arm()
            self._over = Event()
            self._keeper = Thread(target=self._keep, daemon=True)
            self._keeper.start()
            self._stack = stack.pop_all()
        self.is_connected = True
        if self.config.start:
            self.send_action(named(ACTIONS, self.config.start))

    def _arm(self) -> None:
        self._link.arm(watchdog=WATCHDOG)
        self._servo = self._link.status().servo
        self._armed = True
        self._acted_at = self._fed_at = monotonic()

    @check_if_not_connected
    def get_observation(self) -> RobotObservation:
        """What was commanded last, what the model predicts of it, the object's pose, pictures.

        Raises:
            BridgeError: The hand has stopped, or does not answer.
        """
        with self._lock:
            self._raise_failed()
            servo = self._servo
        seen = named(ACTIONS, self._commands.action(servo))
        seen |= named(PREDICTED, self._commands.predicted(servo))
        if self.config.pose:
            # An arm and fingers that hide the object leave the last pose.
            pose, _ = self._source.latest()
            seen |= named(POSE, [*pose.position, *(pose.quaternion or UPRIGHT)])
        return seen | {name: camera.read_latest() for name, camera in self.cameras.items()}

    @check_if_not_connected
    def send_action(self, action: RobotAction) -> RobotAction:
        """Send a command, 20 a second at most; the first one, and the first after a pause that was
        too long, slowly. Returns what was sent, within −1…1 and the rate limit.

        Raises:
            ActionError: A servo is missing, or not finite.
            BridgeError: The hand has stopped, or does not answer.
        """
        given = clipped(action)
        with self._lock:
            self._raise_failed()
            self._target = self._commands.servo(given)
            if not self._armed:
                log.warning("the hand is armed again, and moves slowly to where it goes on")
                self._arm()
            if self._stream is None:
                go(self._link, self._target)
                self._stream = self._link.stream(PERIOD)
            self._servo = self._stream.send(self._target)
            self._acted_at = self._fed_at = monotonic()
            return named(ACTIONS, self._commands.action(self._servo))

    def disconnect(self) -> None:
        """Open the hand slowly, disarm it and release the port, whatever state it is in."""
        if not self.is_connected:
            return
        self._over.set()
        self._keeper.join()
        self.is_connected = False
        with self._stack:
            if self._armed:
                with suppress(BridgeError):  # the link's end tells what is not confirmed
                    self._relax()

    def _relax(self) -> None:
        self._stream = None
        open_hand(self._link)
        self._servo = self._link.status().servo
        self._armed = False
        self._link.clear()

    def _keep(self) -> None:
        """Keep an armed hand alive while LeRobot is busy, for a bounded time."""
        while not self._over.wait(SILENCE / 3):
            with self._lock:
                now = monotonic()
                if self._over.is_set() or not self._armed or now - self._fed_at < SILENCE:
                    continue
                try:
                    if now - self._acted_at > self.config.patience:
                        log.warning("no action for %g s: the hand opens", self.config.patience)
                        self._relax()
                    elif self._stream is None:
                        self._link.heartbeat()
                    else:
                        self._servo = self._stream.send(self._target)
                    self._fed_at = now
                except BridgeError as error:
                    log.error("%s", error)
                    self._failed = error
                    self._armed = False

    def _raise_failed(self) -> None:
        if self._failed is not None:
            raise self._failed
