"""The one environment class: action to servos to physics to observation. What is to be done is the task's business."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from os import PathLike
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from hpac_gym.envs.errors import EpisodeError
from hpac_gym.envs.link import Link
from hpac_gym.envs.observation import Camera, CameraNoise, deployed_fields, one_hot, space_of, within
from hpac_gym.envs.options import RENDER_MODES, Reward, hand_of, noise_of, require_options, setup_of
from hpac_gym.envs.randomization import Randomization, changed_noise, changed_setup, randomization
from hpac_gym.envs.report import report
from hpac_gym.envs.task import Outcome, Task
from hpac_gym.envs.views import Moment, Obs, Observation, view, view_target
from hpac_gym.model import HPAC, SERVOS, Hand, ServoCommand, action_from_synergy, elastic_joints_from_servo
from hpac_gym.model.checks import as_array
from hpac_gym.sim import Scene
from hpac_gym.sim.world import refuse_copying

CONTROL_HZ = 20
"""Commands a second."""


class HandEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """A hand on a scripted wrist; six actions a step, one `ServoCommand` each.

    Args:
        task: draws episodes, judges them and shapes the reward.
        hand: the hand's parameters, or a hand file.
        reward: "dense" for the task's terms, "sparse" for 1 on success and 0 otherwise.
        render_mode: None or "rgb_array".
        noise: of the camera that sees the object.
        obs: "deploy" for what the real hand has, "privileged" for a critic, "image" for a picture and the deployed vector.
        randomize: what else differs between episodes: a preset of `hpac_gym.envs.randomization.PRESETS`, a
            `Randomization`, or ranges by name; None is "nominal", which changes nothing.

    Attributes:
        transmit: what a command passes through on its way to the simulated servos: identity, unless a bridge puts the
            wire and the firmware between. Observations keep to what was commanded.

    Raises:
        ParameterError: An unknown reward, render mode, obs or randomize, or a bad hand file.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": RENDER_MODES, "render_fps": CONTROL_HZ}
    __reduce_ex__ = refuse_copying

    def __init__(
        self,
        task: Task,
        hand: Hand | str | PathLike[str] = HPAC,
        reward: Reward = "dense",
        render_mode: str | None = None,
        noise: CameraNoise = CameraNoise(),
        obs: Obs = "deploy",
        randomize: Randomization | Mapping | str | None = None,
    ) -> None:
        require_options(reward, render_mode)
        self.task, self.reward, self.render_mode = task, reward, render_mode
        self.randomization = randomization(randomize)
        self.hand = hand_of(hand)
        fields = deployed_fields(task.timetable.phases, task.fields)
        self._view, self._deployed = view(obs, fields, task.viewpoint), space_of(fields)
        self.action_space = Box(-1.0, 1.0, (len(SERVOS),), np.float32)
        self.observation_space = self._view.space
        self.dt = 1.0 / CONTROL_HZ
        self.transmit: Callable[[ServoCommand], ServoCommand] = lambda command: command
        self._noise = noise_of(noise)
        self._scene: Scene | None = Scene(visuals=render_mode is not None or obs == "image")
        self._running = False

    @property
    def scene(self) -> Scene:
        """The physics below. For figures and tests; a policy must not look.

        Raises:
            EpisodeError: The environment is closed.
        """
        if self._scene is None:
            raise EpisodeError("this environment is closed: make a new one")
        return self._scene

    @property
    def phase(self) -> str:
        """What the wrist is doing: one of the task's `timetable.phases`."""
        return self.task.timetable.phases[self._phase]

    @property
    def command(self) -> ServoCommand:
        """The last command that went to the servos: what a bridge sends to the real hand."""
        return self._link.command

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observation, dict[str, Any]]:
        """Start an episode.

        Args:
            seed: of the environment's generator. Same seed, same episode, to the bit.
            options: `{"setup": SceneSetup}` gives the episode instead of drawing it.

        Raises:
            ParameterError: Another option, or a setup that is none.
            ShapeError: A setup with an array of the wrong shape, NaN or infinity.
        """
        self._running = False
        given = setup_of(options)
        super().reset(seed=seed)
        setup_rng, camera_rng = self.np_random.spawn(2)
        setup = given or self.task.setup(setup_rng, self.hand)
        drawn = self.randomization.draw(setup_rng)
        setup = changed_setup(setup, drawn)
        self.scene.reset(setup)
        self.task.start(setup)
        self._camera = Camera(setup.object, changed_noise(self._noise, drawn), camera_rng)
        self._link = Link(self.hand, setup.synergy, self.dt, drawn, setup_rng)
        self._last_action = action_from_synergy(setup.synergy, self.hand)
        self._phase, self._running = 0, True
        object_pos, rotation = self.scene.object_pose()
        info = self._info(Outcome.RUNNING, {}, {})
        return self._observe(object_pos, rotation, {}), info | {"randomized": {name: list(v) for name, v in drawn.items()}}

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Carry out one action for one control period.

        Raises:
            ShapeError: `action` has the wrong shape.
            WorkspaceError: `action` has NaN, or leaves −1…1.
            EpisodeError: Before `reset`, after the end of an episode, or after `close`.
        """
        scene = self.scene
        if not self._running:
            raise EpisodeError("no episode is running: call reset() first")
        action = as_array(action, len(SERVOS), "action")
        scene.advance(self._link.send(action, self.transmit), self.task.timetable.wrist_path)

        object_pos, rotation = scene.object_pose()
        forces = scene.contact_forces()
        outcome = self.task.judge(scene, object_pos, forces, self.dt)
        terms = self.task.reward_terms(outcome, self._phase, object_pos, forces, action - self._last_action)
        self._last_action = action.copy()  # the caller may write the next one over it
        self._phase = self.task.timetable.phase(scene.time)
        self._running = outcome is Outcome.RUNNING
        reward = sum(terms.values()) if self.reward == "dense" else float(outcome is Outcome.SUCCESS)
        info = self._info(outcome, terms, forces)
        return self._observe(object_pos, rotation, forces), reward, not self._running, False, info

    def _observe(self, object_pos: NDArray, rotation: NDArray, forces: dict[str, float]) -> Observation:
        servo, timetable = self._link.command.servo, self.task.timetable
        parts = [
            servo,
            elastic_joints_from_servo(servo, self.hand),
            *self._camera.look(object_pos, rotation),
            -self.scene.hand_rotation[2],
            one_hot(self._phase, len(timetable.phases)),
            [self.scene.time / timetable.duration],
            self.task.values(self.scene),
        ]
        moment = Moment(self.scene, forces, self.task.grip, self._last_action)
        return self._view.see(within(self._deployed, np.concatenate(parts)), moment)

    def _info(self, outcome: Outcome, terms: dict[str, float], forces: dict[str, float]) -> dict[str, Any]:
        return report(self.scene, outcome, self.phase, terms, forces, self.task.grip)

    def render(self) -> NDArray[np.uint8] | None:
        """A picture, shape (360, 480, 3), or None without a render mode.

        Raises:
            EpisodeError: Before `reset`, or after `close`.
        """
        scene = self.scene
        if self.render_mode is None:
            return None
        if not hasattr(self, "_camera"):
            raise EpisodeError("nothing to render: call reset() first")
        return self.task.viewpoint.picture(scene.world, view_target(scene))

    def close(self) -> None:
        """Leave the physics client. Closing twice is no error."""
        if self._scene is not None:
            self._scene.close()
        self._scene, self._running = None, False
