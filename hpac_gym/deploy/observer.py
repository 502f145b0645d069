"""The observation and the commands of a task on a real hand: from the same tables of terms as in the
simulation, without an engine."""

import warnings
from dataclasses import dataclass, replace
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from hpac_gym.body.objects import ObjectSpec
from hpac_gym.deploy.errors import DeployError, PoseError
from hpac_gym.envs import make_task
from hpac_gym.envs.commands import Commands
from hpac_gym.model import HPAC, SERVOS, Hand
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import SceneSetup, SceneState, matrix_from_quaternion
from hpac_gym.registration import GRASP, GRASP_ANY, GRASP_TYPE, PICK_PLACE
from hpac_gym.tasks.cameras import CameraNoise
from hpac_gym.tasks.task import CONTROL_HZ, Task
from hpac_gym.tasks.terms import (
    AXES,
    GRASP_CENTRE,
    LENGTH_UNIT,
    OBJECT_TERMS,
    Layout,
    Moment,
)

TASKS = (GRASP, GRASP_ANY, GRASP_TYPE, PICK_PLACE)
"""Tasks that a hand can do with a camera that sees an object."""

_DRAWN = 50
_BESIDE = 0.02
"""Episodes whose objects say where a task has them, and how far beside a place is told (chosen) [m].
"""
Quaternion = tuple[float, float, float, float]
"""Of a rotation, xyzw."""
UPRIGHT: Quaternion = (-0.5, -0.5, -0.5, 0.5)
"""An object that stands upright, in the frame of a hand in its default orientation, xyzw."""


@dataclass(frozen=True, slots=True)
class Pose:
    """Where an object is seen, in the frame of the hand, which moves with the arm."""

    position: Array
    """Its centre, shape (3,) [m]."""
    quaternion: Quaternion | None = None
    """Rotation from the object's axes to the hand's, xyzw; None: the object stands upright."""


class Observer:
    """A task on a hand, as a policy meets it: it has what `load_policy` reads of an environment.

    Args:
        env_id: id of the environment that the policy was trained on.
        object: the object as the camera knows it; its mass and friction are never observed.
        model: the hand with which commands and observations are computed.
        grasp: name of the grasp or type, for the tasks that have one.
        options: of the task, such as `wrist="free"`.

    Raises:
        DeployError: The task needs more than a camera that sees an object, or has no such option.

    Attributes:
        task: the task.
        setup: the episode: object, start posture, orientation of the hand.
        steps: number of control steps of an episode.
    """

    def __init__(
        self,
        env_id: str,
        object: ObjectSpec,
        model: Hand = HPAC,
        grasp: str | None = None,
        /,
        **options: Any,
    ) -> None:
        name = env_id.rpartition(":")[2]
        if name not in TASKS:
            raise DeployError(
                f"{name} cannot be deployed: a hand with a camera can do {', '.join(TASKS)}"
            )
        if grasp is not None:
            if name not in (GRASP, GRASP_TYPE):
                raise DeployError(f"{name} has no grasps by name, such as {grasp!r}")
            options |= {"grasp" if name == GRASP else "types": grasp}
        try:
            self.task: Task = make_task(name, **options)
        except TypeError as error:
            raise DeployError(
                f"{name} with {', '.join(options)} cannot be deployed: {error}"
            ) from None
        self.spec = gymnasium.spec(name)
        self.model = model
        self.unwrapped = self
        self._commands = Commands(1, model, self.task.wrist_actions, transmit=None)
        self._layout = Layout(self.task.terms, 1)
        self.observation_space = self._layout.space
        size = len(SERVOS) + len(self.task.wrist_actions)
        self.action_space = Box(-1.0, 1.0, (size,), np.float32)
        self.steps = self.task.control_steps
        self.setup = replace(self.task.setup(np.random.default_rng(0), HPAC), object=object)
        self.task.prepare(1, CameraNoise())
        self._times = tuple((np.arange(self.steps + 1) / CONTROL_HZ).tolist())
        self.start()

    def start(self, chosen: SceneSetup | None = None) -> None:
        """Begin an episode: the hand stands in the task's start posture, or where a policy has placed
        it.
        """
        setup = self._setup = chosen or self.setup
        self.task.start([0], [setup])
        self._layout.start([0], [setup])
        self._commands.start([0], [setup])
        self._wrist = self.task.wrist_path(setup, self._times)
        self.step = 0

    @property
    def servo(self) -> Array:
        """The last commanded angles, shape (6,) [rad]."""
        return self._commands.servo[0]

    def turned(self, pose: Pose) -> Pose:
        """The pose with the rotation of an object that stands upright, if it has none."""
        x, y, z, w = self.setup.hand_quaternion
        return replace(pose, quaternion=pose.quaternion or (-x, -y, -z, w))

    def phase(self) -> str:
        """Name of the phase that is running or begins."""
        return self.task.phases[int(self.task.phase(self._time())[0])]

    def wrist_offset(self) -> Array:
        """Where the task wants the wrist now: its offset from the start, along the world's axes,
        shape (3,) [m].
        """
        return self._wrist[min(self.step, self.steps)]

    def expects(self, pose: Pose) -> None:
        """Compare where the object is seen first with where the task draws it; warn beyond that.

        Raises:
            PoseError: It is further than an observation can tell.
        """
        drawn = [self.task.setup(np.random.default_rng(i), HPAC).position for i in range(_DRAWN)]
        low = np.min(drawn, axis=0)
        high = np.max(drawn, axis=0)
        worst = int(np.argmax(np.maximum(low - pose.position, pose.position - high)))
        place = pose.position[worst]
        told = f"the object is at {AXES[worst]} = {place:.3f} m in the hand's frame; "
        told += f"{self.spec.id} draws it at {low[worst]:.3f} to {high[worst]:.3f} m"
        if np.abs(pose.position - GRASP_CENTRE).max() > OBJECT_TERMS[0].high * LENGTH_UNIT:
            raise PoseError(told)
        if not low[worst] - _BESIDE <= place <= high[worst] + _BESIDE:
            warnings.warn(told, stacklevel=2)

    def see(self, pose: Pose) -> NDArray[np.float32]:
        """The observation for a pose of the object, shape (size,)."""
        rotation = matrix_from_quaternion(self.turned(pose).quaternion)
        shape = self.setup.object.shape
        state = SceneState.empty(1)
        state.time = self._time()
        state.palm_offset[0] = self.wrist_offset()
        seen = {
            "position": np.asarray(pose.position)[None],
            "up": rotation[None, :, 2] * (shape != "sphere"),
            "side": rotation[None, :, 0] * (shape == "box"),
            "half_extents": np.array([self.setup.object.half_extents]),
            "visible": np.ones(1),
        }
        return self._layout.see(
            Moment(
                state,
                self._commands.shown,
                self._commands.predicted,
                -self._setup.hand_rotation[None, 2],
                self.task.phase(state.time),
                self._commands.last_action,
                np.zeros((1, len(SERVOS))),
                seen,
            )
        )[0]

    def command(self, action: Array) -> Array:
        """Servo angles for an action, shape (6,) [rad]. After the first action of a task that places
        the wrist, `servo` is the posture in which the hand arrives there.

        Raises:
            ShapeError, WorkspaceError: Another shape, NaN, or an action that leaves −1…1.
        """
        action = np.asarray(action, dtype=float)
        target = self._commands.target(action[None])[0]
        if self.task.wrist_actions and self.step == 0:
            self.start(self.task.chosen(self.setup, action))
        self._commands.last_action = action[None, : len(SERVOS)]
        return target

    def sent(self, servo: Array) -> None:
        """Take note of the angles that the hand was sent; the next step begins."""
        self._commands.servo = np.array(servo, dtype=float)[None]
        self._commands.record(self._commands.last_action)
        self.step += 1

    def _time(self) -> Array:
        return np.array([self.step / CONTROL_HZ])
