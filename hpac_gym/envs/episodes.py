"""n episodes of a task as arrays: action to servos to physics to observation and reward. Both environment classes run on it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium import Space, spaces
from numpy.typing import NDArray

from hpac_gym.envs.options import Options
from hpac_gym.envs.randomization import changed_setup, stream
from hpac_gym.model import (
    SERVOS,
    ServoCommand,
    action_from_synergy,
    elastic_joints_from_servo,
    servo_from_action,
    servo_from_synergy,
    streamed_servo,
)
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import HAND_POSITION, SceneSetup, SceneState, Viewpoint
from hpac_gym.physics.settings import BODIES, HandSettings
from hpac_gym.physics.simulation import Simulation, make_engine
from hpac_gym.tasks.quality import grasp_quality
from hpac_gym.tasks.task import CONTROL_HZ, RUNNING, Task
from hpac_gym.tasks.terms import Layout, Moment

IMAGE_SIZE = 84
"""Width and height of an observed picture [px]."""
VIEW_TARGET = np.array([0.03, 0.0, 0.10])
"""What pictures are centred on, in the hand frame [m]."""

Transmit = Callable[[ServoCommand], ServoCommand]


class Episodes:
    """The episodes that run in n worlds.

    Args:
        task: draws episodes, judges them and shapes the reward.
        num_worlds: n.
        options: what the environment was asked for.
        transmit: what a command passes through on its way to the servos, for n = 1; None leaves it as it is.

    Attributes:
        observation_space: of one world.
        outcome: how each episode stands, an index into `hpac_gym.tasks.task.OUTCOMES`, shape (n,).
    """

    def __init__(self, task: Task, num_worlds: int, options: Options, transmit: Transmit | None = None) -> None:
        self.task, self.options, self._transmit = task, options, transmit
        visuals = options.visuals or options.obs == "image"
        self.simulation = Simulation(make_engine(options.engine, num_worlds, visuals=visuals))
        self.simulation.engine.require(BODIES[options.body])
        self.dt = 1.0 / CONTROL_HZ
        self._substeps = round(self.dt / self.simulation.engine.dt)
        count = round(task.duration * CONTROL_HZ) * self._substeps
        self._times = tuple(np.cumsum(np.full(count, self.simulation.engine.dt)).tolist())
        self._camera = task.prepare(num_worlds, options.noise)
        terms = (*task.terms, *task.privileged_terms) if options.obs == "privileged" else task.terms
        self._layout = Layout(terms, num_worlds)
        self._goals = Layout(task.goal_terms, num_worlds) if task.goal_terms else None
        self.observation_space = self._space()
        self.setups: list[SceneSetup | None] = [None] * num_worlds
        self.outcome = np.full(num_worlds, RUNNING)
        self._wrist = np.zeros((num_worlds, count, 3))
        self._step = np.zeros(num_worlds, dtype=int)
        self._servo, self._arrived = np.zeros((num_worlds, len(SERVOS))), np.zeros((num_worlds, len(SERVOS)))
        self._lost_share = np.zeros(num_worlds)
        self._losses: list[np.random.Generator | None] = [None] * num_worlds
        self._last_action = np.zeros((num_worlds, len(SERVOS)))
        self._rotation, self._down = np.zeros((num_worlds, 3, 3)), np.zeros((num_worlds, 3))
        self.now: Moment | None = None
        self.terms: dict[str, Array] = {}

    def _space(self) -> Space:
        """The observation space of one world."""
        parts: dict[str, Space] = {"observation" if self._goals else "deploy": self._layout.space}
        if self._goals:
            parts |= {"achieved_goal": self._goals.space, "desired_goal": self._goals.space}
        if self.options.obs == "image":
            parts["image"] = spaces.Box(0, 255, (IMAGE_SIZE, IMAGE_SIZE, 3), np.uint8)
        return self._layout.space if set(parts) == {"deploy"} else spaces.Dict(parts)

    # Episodes ------------------------------------------------------------------------------------------------------

    def reset(
        self, worlds: Sequence[int], generators: Sequence[np.random.Generator], given: SceneSetup | None = None
    ) -> list[Mapping[str, Array]]:
        """Start episodes in some worlds.

        Args:
            worlds: which ones.
            generators: of each of them; a world's episodes depend on its own alone.
            given: the episode, instead of a drawn one.

        Returns:
            What the randomization drew, for each of them.
        """
        options, randomization = self.options, self.options.randomization
        setups, values, cameras = [], [], []
        for world, generator in zip(worlds, generators, strict=True):
            setup_rng, camera_rng = generator.spawn(2)
            drawn = randomization.draw(setup_rng)
            setup = given or self.task.setup(setup_rng, options.hand)
            if setup.hand_settings == HandSettings():
                setup = replace(setup, hand_settings=BODIES[options.body])
            setups.append(changed_setup(setup, drawn))
            values.append(drawn)
            cameras.append((world, setups[-1], float(drawn.get("sensor_noise", [1.0])[0]), camera_rng))
            self._lost_share[world] = float(drawn.get("dropped_frames", [0.0])[0])
            self._losses[world] = stream(setup_rng, "losses")
        self.task.start(worlds, setups)
        self.simulation.reset(worlds, setups)
        for camera in cameras:
            self._camera.start(*camera)
        for layout in (self._layout, self._goals):
            if layout:
                layout.start(worlds, setups)
        for world, setup in zip(worlds, setups, strict=True):
            self.setups[world] = setup
            self._rotation[world] = setup.hand_rotation
            self._down[world] = -self._rotation[world][2]
            self._wrist[world] = self.task.wrist_path(setup, self._times)
            self._servo[world] = self._arrived[world] = servo_from_synergy(setup.synergy, options.hand)
            self._last_action[world] = action_from_synergy(setup.synergy, options.hand)
        index = np.asarray(worlds)
        self._step[index], self.outcome[index], self.terms = 0, RUNNING, {}
        self._look(self.simulation.state(), np.zeros_like(self._last_action), worlds)
        return values

    def step(self, actions: NDArray) -> Array:
        """Carry out one action in every world for one control period, and judge it.

        Args:
            actions: shape (n, 6), −1…1.

        Returns:
            Rewards, shape (n,).

        Raises:
            ShapeError: Wrong shape.
            WorkspaceError: NaN, or an action that leaves −1…1.
            PhysicsError: A world's simulation failed.
        """
        target = servo_from_action(actions, self.options.hand)
        self._servo = streamed_servo(self._servo, target, self.dt, self.options.hand)
        self._arrive()
        self.simulation.command(self._arrived, self.dt)
        row = np.minimum(self._step[:, None] * self._substeps + np.arange(self._substeps), len(self._times) - 1)
        self.simulation.advance(np.take_along_axis(self._wrist, row[:, :, None], axis=1))
        self._step += 1

        state, phase = self.simulation.state(), self.now.phase
        self.outcome = self.task.judge(state, self.dt)
        change = np.asarray(actions, dtype=float) - self._last_action
        self._last_action = np.array(actions, dtype=float)  # the caller may write the next one over it
        self._look(state, change, range(len(self.setups)))
        self.now.phase, after = phase, self.now.phase  # a step is rewarded by the phase that it began in
        self.terms = {term.name: term.value(self.now) for term in self.task.reward_terms}
        reward = sum(self.terms.values()) if self.options.reward == "dense" else self.task.sparse_reward(self.now)
        self.now.phase = after
        return reward

    def _arrive(self) -> None:
        """What reaches the servos: a lost command leaves them where the last one sent them."""
        lost = np.zeros(len(self._servo), dtype=bool)
        for world in np.flatnonzero(self._lost_share):
            lost[world] = self._losses[world].random() < self._lost_share[world]
        if self._transmit is not None and not lost[0]:
            self._arrived = self._transmit(self.command).servo[None].copy()
        else:
            self._arrived = np.where(lost[:, None], self._arrived, self._servo)

    def _look(self, state: SceneState, change: Array, worlds: Iterable[int]) -> None:
        """Take in a state; the camera looks anew at some worlds alone, so that no world's noise hangs on the others."""
        self.now = Moment(
            state, self._servo, elastic_joints_from_servo(self._servo, self.options.hand), self._down,
            self.task.phase(state.time), self._last_action, change, self._camera.look(state, worlds), self.task.grip,
            self.outcome,
        )  # fmt: skip
        if self._goals:
            self.achieved = self._goals.see(self.now)
            box = self._goals.space
            self.desired = np.minimum(np.maximum(self.task.goal, box.low), box.high, dtype=np.float32)
            self.task.measure(self.achieved, self.desired)

    @property
    def command(self) -> ServoCommand:
        """The last command to the servos of world 0: what a bridge sends to the real hand."""
        return ServoCommand(self._servo[0], self.dt)

    # What is told --------------------------------------------------------------------------------------------------

    def observe(self) -> NDArray[np.float32] | dict[str, NDArray]:
        """The observations now, with a leading axis n."""
        vector = self._layout.see(self.now)
        if isinstance(self.observation_space, spaces.Box):
            return vector
        parts = {"observation" if self._goals else "deploy": vector}
        if self._goals:
            parts |= {"achieved_goal": self.achieved, "desired_goal": self.desired}
        if self.options.obs == "image":
            small = replace(self.task.viewpoint, width=IMAGE_SIZE, height=IMAGE_SIZE)
            parts["image"] = np.stack([self.picture(world, small) for world in range(len(self.setups))])
        return parts

    def report(self) -> dict[str, Any]:
        """What `info` says: arrays of shape (n,), by name."""
        return dict(self.task.report(self.now))

    def quality(self, world: int) -> float:
        """Epsilon of the grasp of a world [N]; it takes milliseconds, so that it is given once, with an episode's last step."""
        return grasp_quality(self.simulation.engine.contacts(world), self.setups[world].object)

    def picture(self, world: int, viewpoint: Viewpoint | None = None, centre: Array = VIEW_TARGET) -> NDArray[np.uint8]:
        """RGB of a world, shape (height, width, 3), with a point of the hand frame, shape (3,) [m], in the middle."""
        target = HAND_POSITION + self.now.state.palm_offset[world] + self._rotation[world] @ centre
        return self.simulation.engine.picture(world, viewpoint or self.task.viewpoint, target)

    def close(self) -> None:
        """Free the engine. Closing twice is no error."""
        self.simulation.engine.close()

