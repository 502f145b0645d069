"""Teleoperators of the hand: a policy, sliders on a page, keys, and a tracked human hand.

`lerobot-record` stores what a teleoperator gives, so each gives six numbers within −1…1."""

import logging
import time
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from lerobot.lerobot_types import RobotAction
from lerobot.teleoperators import Teleoperator, TeleoperatorConfig
from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected
from lerobot.utils.keyboard_input import create_key_listener

from hpac_gym.deploy.arm import arm_of
from hpac_gym.deploy.commands import object_of
from hpac_gym.deploy.episode import AVERAGED, OLDEST, decided
from hpac_gym.deploy.errors import MALFORMED, DeployError, packet, udp
from hpac_gym.deploy.observer import Observer
from hpac_gym.deploy.poses import averaged
from hpac_gym.errors import HpacError
from hpac_gym.evaluation.options import env_id_of
from hpac_gym.model import SERVOS, action_from_synergy, load_hand, streamed_servo
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import SceneSetup
from hpac_gym.policies.loading import load_policy, needed_options
from hpac_gym.settings import check_bounds, setting
from hpac_gym.tasks.task import CONTROL_HZ
from lerobot_robot_hpac.features import ACTIONS, Commands, clipped, named, shared_source
from lerobot_robot_hpac.landmarks import synergy_from_landmarks

OPEN = -np.ones(len(SERVOS))
log = logging.getLogger(__name__)


class HpacTeleoperator(Teleoperator):
    """What the teleoperators share; each has `_open`, which leaves on the stack what closes it, and
    `_wanted`.
    """

    action_features = dict.fromkeys(ACTIONS, float)
    feedback_features: ClassVar[dict[str, type]] = {}
    is_calibrated = True
    is_connected = False

    def __init__(self, config: TeleoperatorConfig) -> None:
        super().__init__(config)
        check_bounds(config, "teleop")
        self.config = config
        self._stack = ExitStack()

    def calibrate(self) -> None:
        """Nothing to do."""

    def configure(self) -> None:
        """Nothing to do."""

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Nothing to do."""

    @check_if_already_connected
    def connect(self, calibrate: bool = True) -> None:
        """Open what the actions come from."""
        with ExitStack() as stack:
            self._open(stack)
            self._stack = stack.pop_all()
        self.is_connected = True

    @check_if_not_connected
    def get_action(self) -> RobotAction:
        """The six actions that are wanted now, within −1…1.

        Raises:
            ActionError: They are not six finite numbers. ShapeError: Those of a policy are not.
        """
        return named(ACTIONS, clipped(named(ACTIONS, self._wanted())))

    def disconnect(self) -> None:
        """Close what `connect` opened."""
        self.is_connected = False
        self._stack.close()


# A policy ---------------------------------------------------------------------------------


@TeleoperatorConfig.register_subclass("hpac_policy")
@dataclass(kw_only=True)
class HpacPolicyConfig(TeleoperatorConfig):
    """Settings, as of `hpac deploy`.

    Attributes:
        policy: a shipped policy such as grasp, a policy file, or scripted.
        object: what the camera knows of the object.
        pose: where the object is.
        arm: who carries the hand: none, enter or udp:HOST:PORT.
        env: environment; None is the policy's own.
        grasp: named grasp or type, for the tasks that have them.
        hand: hand file of the robot; None is the nominal hand.
        hold: time for which the last action is repeated, before the hand opens [s].
    """

    policy: str
    object: str
    pose: str
    arm: str = "none"
    env: str | None = None
    grasp: str | None = None
    hand: str | None = None
    hold: float = setting(2.0, bounds=(0.0, np.inf), unit="s")


class _Began(logging.Handler):
    """Hears that LeRobot begins to record an episode: it tells nobody but its log."""

    heard = True

    def emit(self, record: logging.LogRecord) -> None:
        self.heard |= record.getMessage().startswith("Recording episode")


class HpacPolicy(HpacTeleoperator):
    """A policy of this project: one episode at first, and one whenever LeRobot records one; between
    them the hand waits in the task's start posture.
    """

    config_class = HpacPolicyConfig
    name = "hpac_policy"

    def _open(self, stack: ExitStack) -> None:
        config = self.config
        env_id = config.env or env_id_of(config.policy)
        thing = object_of(config.object)
        hand = load_hand(config.hand)
        options = needed_options(config.policy, env_id)
        self._observer = Observer(env_id, thing, hand, config.grasp, **options)
        if self._observer.task.wrist_actions:
            raise DeployError(f"{config.policy} places the wrist, which LeRobot's actions have not")
        self._policy = load_policy(config.policy, self._observer)
        self._source = stack.enter_context(shared_source(config.pose, config.object))
        self._arm = arm_of(config.arm)
        stack.callback(self._arm.close)
        self._began = _Began()
        logging.getLogger().addHandler(self._began)
        stack.callback(logging.getLogger().removeHandler, self._began)

    def _begin(self) -> None:
        self._began.heard = False
        self._memory: Any = None
        self._step = 0
        self._observer.start()
        self._arm.ready(time.sleep, {"phase": "ready", "time": 0.0, "offset": [0.0, 0.0, 0.0]})
        self._pose = averaged(self._source, AVERAGED, OLDEST)

    def _wanted(self) -> Array:
        if self._began.heard:
            self._begin()
        observer = self._observer
        step = self._step
        self._step += 1
        if step >= observer.steps + round(self.config.hold * CONTROL_HZ):
            return action_from_synergy(observer.setup.synergy)
        if step < observer.steps:
            if step:
                self._pose, _ = self._source.latest()
            offset = observer.wrist_offset().tolist()
            self._arm.tell({"phase": observer.phase(), "time": step / CONTROL_HZ, "offset": offset})
            _, self._action, target, self._memory = decided(
                self._policy, observer, self._pose, self._memory, begins=step == 0
            )
            observer.sent(streamed_servo(observer.servo, target, 1 / CONTROL_HZ))
        return self._action


# Sliders ----------------------------------------------------------------------------------


@TeleoperatorConfig.register_subclass("hpac_sliders")
@dataclass(kw_only=True)
class HpacSlidersConfig(TeleoperatorConfig):
    """Settings.

    Attributes:
        browser: open a browser; the page's address is printed anyway.
    """

    browser: bool = True


class HpacSliders(HpacTeleoperator):
    """Six sliders on a page, which also shows the hand as the model predicts it."""

    config_class = HpacSlidersConfig
    name = "hpac_sliders"

    def _open(self, stack: ExitStack) -> None:
        from hpac_gym.view.page import HandPage

        text = "Each slider is a servo of the hand that LeRobot drives."
        self._page = HandPage(SceneSetup(None), text, browser=self.config.browser)
        stack.callback(self._page.close)
        self._commands = Commands()

    def _wanted(self) -> Array:
        from hpac_gym.view.page import Shown

        servo = self._page.wanted()
        if self._page.due():
            self._page.show(Shown(self._commands.predicted(servo), servo, np.zeros(3)))
        return self._commands.action(servo)


# Keys -------------------------------------------------------------------------------------


@TeleoperatorConfig.register_subclass("hpac_keyboard")
@dataclass(kw_only=True)
class HpacKeyboardConfig(TeleoperatorConfig):
    """Settings.

    Attributes:
        step: change of an action by one key, of its range of 2.
    """

    step: float = setting(0.1, bounds=(0.0, 2.0), above=True)


class HpacKeyboard(HpacTeleoperator):
    """Keys: ``a s d f g h`` close a servo by a step, with Shift they open it; ``w`` closes the five
    digits, with Shift it opens them; space opens all. LeRobot itself has n, r, q and the arrows.
    """

    config_class = HpacKeyboardConfig
    name = "hpac_keyboard"
    keys: ClassVar[dict[str, Array]] = {
        **dict(zip("asdfgh", np.eye(len(SERVOS)), strict=True)),
        "w": np.array([1.0, 1.0, 1.0, 1.0, 1.0, 0.0]),
    }
    """What each key moves."""

    def _open(self, stack: ExitStack) -> None:
        self._at = OPEN
        text = f"asdfgh: close {', '.join(SERVOS)}; w: all digits; Shift: open; space: open all"
        listener = create_key_listener(self.press, controls_help=text)
        if listener is None:
            raise HpacError("no keys: neither a terminal nor an X11 display; use hpac_sliders")
        stack.callback(listener.stop)

    def press(self, key: str) -> None:
        """A key was pressed."""
        if key == "space":
            self._at = OPEN
        elif key.lower() in self.keys:
            step = self.config.step if key.islower() else -self.config.step
            self._at = np.clip(self._at + step * self.keys[key.lower()], -1.0, 1.0)

    def _wanted(self) -> Array:
        return self._at


# Landmarks --------------------------------------------------------------------------------


@TeleoperatorConfig.register_subclass("hpac_landmarks")
@dataclass(kw_only=True)
class HpacLandmarksConfig(TeleoperatorConfig):
    """Settings.

    Attributes:
        port: UDP port of this computer; 0 is a free one.
        oldest: age of the landmarks from which on the hand opens [s].
    """

    port: int = 9021
    oldest: float = setting(1.0, bounds=(0.0, np.inf), above=True, unit="s")


class HpacLandmarks(HpacTeleoperator):
    """A human right hand that another program tracks. A datagram is ``{"hpac_landmarks": 1,
    "points": [[x, y, z], …]}`` with 21 points.

    Attributes:
        refused: number of datagrams that were none.
    """

    config_class = HpacLandmarksConfig
    name = "hpac_landmarks"

    def _open(self, stack: ExitStack) -> None:
        port = self.config.port
        self._socket = stack.enter_context(udp(f"UDP port {port}", "127.0.0.1", port, bind=True))
        self.port = self._socket.getsockname()[1]
        self.refused = 0
        self._heard_at = -np.inf

    def _wanted(self) -> Array:
        while True:
            try:
                points = packet(self._socket.recv(8192), "hpac_landmarks")["points"]
                self._action = action_from_synergy(synergy_from_landmarks(points))
                self._heard_at = time.monotonic()
            except BlockingIOError:
                break
            except MALFORMED as error:
                self.refused += 1
                log.warning("no landmarks: %s", error)
        old = time.monotonic() - self._heard_at > self.config.oldest
        return OPEN if old else self._action
