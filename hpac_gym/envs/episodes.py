"""n episodes of a task as arrays: action, servos, physics, observation and reward. Both environment
classes use it.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
from gymnasium import Space, spaces
from numpy.typing import NDArray

from hpac_gym.envs.models import model_of
from hpac_gym.envs.options import CALIBRATED, Options
from hpac_gym.envs.page import Page
from hpac_gym.envs.randomization import changed_setup, stream
from hpac_gym.errors import EpisodeError, ParameterError, WorkspaceError
from hpac_gym.model import (
    HPAC,
    JOINTS,
    SERVOS,
    Hand,
    ServoCommand,
    action_from_synergy,
    elastic_joints_from_servo,
    servo_from_synergy,
    streamed_servo,
)
from hpac_gym.model.checks import Array, as_bounded_array
from hpac_gym.model.maps import CommandMap
from hpac_gym.physics.engine import (
    HAND_POSITION,
    PhysicsError,
    PhysicsWarning,
    SceneSetup,
    SceneState,
    Viewpoint,
)
from hpac_gym.physics.settings import BODIES, HandSettings, WorldSettings
from hpac_gym.physics.simulation import Simulation, make_engine
from hpac_gym.tasks.options import check_choice
from hpac_gym.tasks.quality import grasp_quality
from hpac_gym.tasks.senses import POINTS, POINTS_BOUND
from hpac_gym.tasks.task import CONTROL_HZ, FAILURE, RUNNING, Task
from hpac_gym.tasks.terms import Layout, Moment

IMAGE_SIZE = 84
"""Width and height of an observed picture [px]."""
VIEW_TARGET = np.array([0.03, 0.0, 0.10])
"""Point in the hand frame on which images are centred [m]."""

Transmit = Callable[[ServoCommand], ServoCommand]
_NO_CHOICE = HandSettings()


class Episodes:
    """The episodes that run in n worlds.

    Args:
        task: draws episodes, judges them and shapes the reward.
        num_worlds: n.
        options: options of the environment.
        transmit: function applied to a command on its way to the servos, for n = 1; None is the
            identity.

    Raises:
        ParameterError: The task does not have the requested observation, or the physics' rate is no
            multiple of the commands'.

    Attributes:
        observation_space: observation space of one world.
        randomizations: randomization of future episodes, one per world.
        action_space: action space of one world.
        times: ends of an episode's physics steps [s].
        outcome: status of each episode, an index into `hpac_gym.tasks.task.OUTCOMES`, shape (n,).
    """

    def __init__(
        self, task: Task, num_worlds: int, options: Options, transmit: Transmit | None = None
    ) -> None:
        if (rate := options.world.physics_hz) % CONTROL_HZ:
            raise ParameterError(
                f"physics_hz = {rate} Hz must be a multiple of {CONTROL_HZ} Hz, the rate of the commands"
            )
        check_choice("obs", options.obs, task.observations)
        if options.model == CALIBRATED and task.hands != "test":
            raise ParameterError(
                f"model 'calibrated' is that of held-out hands: it needs hands='test', not {task.hands!r}"
            )
        self.task = task
        self.options = options
        self._transmit = transmit
        visuals = options.visuals or options.obs == "image"
        self.simulation = Simulation(
            make_engine(options.engine, num_worlds, options.world, visuals)
        )
        try:
            self.simulation.engine.require(BODIES[options.body])
            self._camera = task.prepare(num_worlds, options.noise)
        except Exception:
            self.simulation.engine.close()
            raise
        self.dt = 1.0 / CONTROL_HZ
        self._substeps = round(self.dt / self.simulation.engine.dt)
        steps = round(task.duration * CONTROL_HZ)
        times = np.cumsum(np.full(steps * self._substeps, self.simulation.engine.dt))
        self.times = tuple(times.tolist())
        self._clock = self._by_step(times)
        more = {"privileged": task.privileged_terms, **task.sensed_terms}
        self._layout = Layout((*task.terms, *more.get(options.obs, ())), num_worlds)
        self._goals = Layout(task.goal_terms, num_worlds) if task.goal_terms else None
        self.observation_space = self._space()
        self.action_space = spaces.Box(
            -1.0, 1.0, (len(SERVOS) + len(task.wrist_actions),), np.float32
        )
        self.setups: list[SceneSetup | None] = [None] * num_worlds
        self.randomizations = [options.randomize] * num_worlds
        self.outcome = np.full(num_worlds, RUNNING)
        self._wrist = np.zeros((num_worlds, *self._clock.shape, 3))
        self._worlds = np.arange(num_worlds)
        self._step = np.zeros(num_worlds, dtype=int)
        self._servo = np.zeros((num_worlds, len(SERVOS)))
        self._arrived = np.zeros((num_worlds, len(SERVOS)))
        self._lost_share = np.zeros(num_worlds)
        self._losses: list[np.random.Generator | None] = [None] * num_worlds
        self._last_action = np.zeros((num_worlds, len(SERVOS)))
        self._predicted = np.zeros((num_worlds, len(JOINTS)))
        model = options.model
        self._map = CommandMap(model if isinstance(model, Hand) else HPAC, num_worlds)
        self._flexing = np.ones((num_worlds, len(SERVOS)), dtype=bool)
        # Most tasks begin with the same posture.
        self._start_of = lru_cache(maxsize=16)(partial(_start_of, self._map.bounds))
        self._rotation = np.zeros((num_worlds, 3, 3))
        self._down = np.zeros((num_worlds, 3))
        self.now: Moment | None = None
        self.terms: dict[str, Array] = {}
        self._episode = object()
        self._page: Page | None = None

    def _by_step(self, table: Array) -> Array:
        """A table with a row for each physics step, by control steps: shape (steps + 1, k, ...),
        the last of which is for all after the episode's end.
        """
        after = np.repeat(table[-1:], self._substeps, axis=0)
        return np.concatenate([table, after]).reshape(-1, self._substeps, *table.shape[1:])

    def _space(self) -> Space:
        """The observation space of one world."""
        parts: dict[str, Space] = {"observation" if self._goals else "deploy": self._layout.space}
        if self._goals:
            parts |= {"achieved_goal": self._goals.space, "desired_goal": self._goals.space}
        if self.options.obs == "image":
            parts["image"] = spaces.Box(0, 255, (IMAGE_SIZE, IMAGE_SIZE, 3), np.uint8)
        if self.options.obs == "points":
            parts["points"] = spaces.Box(-POINTS_BOUND, POINTS_BOUND, (POINTS, 4), np.float32)
        return self._layout.space if set(parts) == {"deploy"} else spaces.Dict(parts)

    # Episodes
    # ------------------------------------------------------------------------------------------------------

    def reset(
        self,
        worlds: Sequence[int],
        generators: Sequence[np.random.Generator],
        given: Sequence[SceneSetup] | None = None,
    ) -> list[Mapping[str, Array]]:
        """Start episodes in some worlds.

        Args:
            worlds: indices of the worlds.
            generators: random generator of each of them; a world's episodes depend only on its own.
            given: setups of the worlds to use instead of drawn ones.

        Returns:
            Values drawn by the randomization, by name, for each of the worlds.
        """
        options = self.options
        body = BODIES[self.options.body]
        inertia = (
            {}
            if body == _NO_CHOICE
            else {"armature": body.armature, "hub_inertia": body.hub_inertia}
        )
        setups = []
        values = []
        cameras = []
        chosen = given or [None] * len(worlds)
        for world, generator, own in zip(worlds, generators, chosen, strict=True):
            setup_rng, camera_rng = generator.spawn(2)
            drawn = self.randomizations[world].draw(setup_rng)
            setup = own or self.task.setup(setup_rng, options.hand)
            if own is None and any(zero := options.hand.calibration.servo_zero):
                zero = tuple(np.add(setup.hand_settings.servo_zero, zero).tolist())
                setup = replace(setup, hand_settings=replace(setup.hand_settings, servo_zero=zero))
            if inertia and (own is None or setup.hand_settings == _NO_CHOICE):
                setup = replace(setup, hand_settings=replace(setup.hand_settings, **inertia))
            setups.append(changed_setup(setup, drawn))
            values.append(drawn)
            cameras.append(
                (world, setups[-1], float(drawn.get("sensor_noise", [1.0])[0]), camera_rng)
            )
            self._lost_share[world] = share = float(drawn.get("dropped_frames", [0.0])[0])
            self._losses[world] = stream(setup_rng, "losses") if share else None
        for camera in cameras:
            self._camera.start(*camera)
        self._begin(worlds, setups)
        index = np.asarray(worlds)
        self._step[index] = 0
        self.outcome[index] = RUNNING
        self.terms = {}
        self._episode = object()
        self._look(self.simulation.state(), np.zeros_like(self._last_action), worlds)
        return values

    def _begin(self, worlds: Sequence[int], setups: Sequence[SceneSetup]) -> None:
        """Set up the scenes of some worlds."""
        self.task.start(worlds, setups)
        self.simulation.reset(worlds, setups)
        for layout in (self._layout, self._goals):
            if layout:
                layout.start(worlds, setups)
        self._predicted = self._predicted.copy()  # the previous `Moment` keeps its array
        for world, setup in zip(worlds, setups, strict=True):
            self.setups[world] = setup
            self._rotation[world] = setup.hand_rotation
            self._wrist[world] = self._by_step(self.task.wrist_path(setup, self.times))
            start = self._start_of(*setup.synergy.tolist())
            self._servo[world], self._predicted[world], self._last_action[world] = start
        index = np.asarray(worlds)
        self._flexing[index] = True
        if isinstance(self.options.model, str):
            self._map.take(
                worlds, [model_of(self.options.model, self.setups[world]) for world in worlds]
            )
        if self._map.inverts_files:
            synergy = np.stack([setup.synergy for setup in setups])
            self._servo[index] = self._map.servo_from_synergy(synergy, self._flexing[index], index)
            self._predicted[index] = self._map.joints_from_servo(self._servo, self._flexing)[index]
        self._down[index] = -self._rotation[index, 2]
        self._arrived[index] = self._servo[index]

    def step(self, actions: NDArray) -> Array:
        """Carry out one action in every world for one control period, and judge it.

        Args:
            actions: shape (n, 6), −1…1; more columns with a free wrist.

        Returns:
            Rewards, shape (n,).

        Raises:
            ShapeError: Wrong shape.
            WorkspaceError: NaN, or an action that leaves −1…1: wrap in
                `gymnasium.wrappers.ClipAction`.
            PhysicsError: A simulation failed, and the engine cannot continue.

        Warns:
            PhysicsWarning: A world's simulation failed: its episode ends as a failure, and the
                others continue.
        """
        every = actions
        actions = every[:, : len(SERVOS)]
        choices = every[:, len(SERVOS) :]
        try:
            if self._map.inverts_files:
                change = actions - self._last_action
                self._flexing = np.where(change == 0, self._flexing, change > 0)
            target = self._map.servo_from_action(actions, self._flexing)
            if self.task.wrist_actions:
                one = np.ones(len(self.task.wrist_actions))
                as_bounded_array(
                    choices, -one, one, self.task.wrist_actions, "action", "(no unit)", 1e-6
                )
                if first := np.flatnonzero(
                    (self._step == 0) & (self.outcome == RUNNING)
                ).tolist():  # places the wrist
                    self._begin(
                        first,
                        [self.task.chosen(self.setups[world], every[world]) for world in first],
                    )
        except WorkspaceError as error:
            if np.isnan(every).any():
                raise
            raise WorkspaceError(
                f"{error}; wrap in gymnasium.wrappers.ClipAction, which clips it"
            ) from None
        self._servo = streamed_servo(self._servo, target, self.dt, self._map.bounds)
        self._arrive()
        self.simulation.command(self._arrived, self.dt)
        step = np.minimum(self._step, len(self._clock) - 1)
        push = self.task.push(self._clock[step])
        failed: tuple[int, ...] = ()
        try:
            self.simulation.advance(self._wrist[self._worlds, step], push)
        except PhysicsError as error:
            if not error.worlds:
                raise
            failed = tuple(world for world in error.worlds if self.outcome[world] == RUNNING)
            warnings.warn(f"{error}; it ends as a failure", PhysicsWarning, stacklevel=2)
        self._step += 1

        state = self.simulation.state()
        phase = self.now.phase
        self.task.watch(state, self.dt, self.simulation.engine.contacts)
        self.outcome = self.task.judge(state, self.dt)
        if failed:
            self.outcome = self.outcome.copy()
            self.outcome[list(failed)] = FAILURE
        change = np.asarray(actions, dtype=float) - self._last_action
        self._last_action = np.array(actions, dtype=float)  # the caller may reuse its array
        self._predicted = self._map.joints_from_servo(self._servo, self._flexing)
        self._look(state, change, range(len(self.setups)))
        # A step's reward belongs to the phase in which it began.
        self.now.phase, after = (
            phase,
            self.now.phase,
        )
        self.terms = {term.name: term.value(self.now) for term in self.task.reward_terms}
        reward = (
            sum(self.terms.values())
            if self.options.reward == "dense"
            else self.task.sparse_reward(self.now)
        )
        self.now.phase = after
        return reward

    def _arrive(self) -> None:
        """Compute the angles that reach the servos; after a lost command they keep the previous
        ones.
        """
        lost = [
            world
            for world in np.flatnonzero(self._lost_share)
            if self._losses[world].random() < self._lost_share[world]
        ]
        if self._transmit is not None and not lost:
            self._arrived = self._transmit(self.command).servo[None].copy()
        else:
            arrived = self._servo.copy()
            if lost:
                arrived[lost] = self._arrived[lost]
            self._arrived = arrived

    def _look(self, state: SceneState, change: Array, worlds: Iterable[int]) -> None:
        """Record a state; the camera measures only the given worlds anew, so that no world's noise
        depends on the others.
        """
        self.now = Moment(
            state,
            self._map.shown_servo(self._servo, self._predicted),
            self._predicted,
            self._down,
            self.task.phase(state.time),
            self._last_action,
            change,
            self._camera.look(state, worlds),
            self.task.grip,
            self.outcome,
        )
        if self._goals:
            self.achieved = self._goals.see(self.now)
            box = self._goals.space
            self.desired = np.minimum(
                np.maximum(self.task.goal, box.low), box.high, dtype=np.float32
            )
            self.task.measure(self.achieved, self.desired)

    @property
    def command(self) -> ServoCommand:
        """Last servo command of world 0, as a bridge sends it to the real hand."""
        return ServoCommand(self._servo[0], self.dt)

    @property
    def slices(self) -> dict[str, slice]:
        """Slices of the observation vector, by field name."""
        return dict(self._layout.slices)

    # Snapshots
    # -----------------------------------------------------------------------------------------------------

    def save(self) -> Any:
        """A snapshot of a single world, which `restore` continues bit-exactly.

        The mutable state of an episode is arrays and generators of the task, the camera, the servos
        and this object."""
        values = [(owner, name, deepcopy(vars(owner)[name])) for owner, name in _changing(self)]
        return (
            self._episode,
            self.setups[0],
            self.simulation.engine.save(0),
            values,
            self.now,
            self.terms,
        )

    def restore(self, snapshot: Any) -> None:
        """Restore the world to a snapshot, which is not modified.

        Raises:
            EpisodeError: The snapshot is of another episode, or of another environment.
        """
        episode, setup, physics, values, now, terms = snapshot
        if episode is not self._episode:
            raise EpisodeError(
                "a state can be restored only in the episode that it was saved in, not after another reset()"
            )
        self.setups[0] = setup  # the wrist may have been placed since then
        self.simulation.engine.restore(0, physics)
        for owner, name, value in values:
            setattr(owner, name, deepcopy(value))
        self.now = now
        self.terms = terms

    # Outputs
    # -------------------------------------------------------------------------------------------------------

    def observe(self) -> NDArray[np.float32] | dict[str, NDArray]:
        """Current observations, with a leading axis n."""
        vector = self._layout.see(self.now)
        if isinstance(self.observation_space, spaces.Box):
            return vector
        parts = {"observation" if self._goals else "deploy": vector}
        if self._goals:
            parts |= {"achieved_goal": self.achieved, "desired_goal": self.desired}
        if self.options.obs == "image":
            small = replace(self.task.viewpoint, width=IMAGE_SIZE, height=IMAGE_SIZE)
            parts["image"] = np.stack(
                [self.picture(world, small) for world in range(len(self.setups))]
            )
        if self.options.obs == "points":
            parts["points"] = self._camera.points(self.now.state)
        return parts

    def report(self) -> dict[str, Any]:
        """Entries of `info`: arrays of shape (n,), by name."""
        return dict(self.task.report(self.now))

    def quality(self, world: int) -> float:
        """Grasp quality epsilon of a world [N]; since it takes milliseconds, it is reported only in
        an episode's last step.
        """
        if not self.now.state.touching[
            world
        ].any():  # most failed episodes; reading the contacts takes milliseconds
            return 0.0
        return grasp_quality(self.simulation.engine.contacts(world), self.setups[world].object)

    def picture(
        self, world: int, viewpoint: Viewpoint | None = None, centre: Array = VIEW_TARGET
    ) -> NDArray[np.uint8]:
        """RGB image of a world, shape (height, width, 3), centred on a point of the hand frame,
        shape (3,) [m].
        """
        target = HAND_POSITION + self.now.state.palm_offset[world] + self._rotation[world] @ centre
        return self.simulation.engine.picture(world, viewpoint or self.task.viewpoint, target)

    def pictures(self, render_mode: str | None) -> list[NDArray[np.uint8]] | None:
        """A picture of every world; None without a render mode, and with "human", which shows every
        step by itself.

        Raises:
            EpisodeError: Before the first `reset`.
        """
        if render_mode is not None and self.now is None:
            raise EpisodeError("nothing to render: call reset() first")
        return (
            [self.picture(world) for world in range(len(self.setups))]
            if render_mode == "rgb_array"
            else None
        )

    def show(self) -> None:
        """Show an image of world 0 on the page of `render_mode="human"`, in real time."""
        self._page = self._page or Page()
        self._page.show(self.picture(0))

    def close(self) -> None:
        """Close the engine and the page. Closing twice is allowed."""
        self.simulation.engine.close()
        if self._page is not None:
            self._page.close()
        self._page = None


def open_episodes(env: Any) -> Episodes:
    """What runs below an environment. For figures and tests; a policy must not look.

    Raises:
        EpisodeError: The environment is closed.
    """
    if env._episodes is None:
        raise EpisodeError("this environment is closed: make a new one")
    return env._episodes


def change_physics(env: Any, world: WorldSettings) -> None:
    """Give an environment, before its first episode, physics with other settings. For measurements:
    its id has its own.
    """
    episodes = open_episodes(env)
    options = replace(episodes.options, world=world)
    episodes.close()
    env._episodes = Episodes(episodes.task, len(episodes.setups), options, episodes._transmit)


def _start_of(hand: Hand, *synergy: float) -> tuple[Array, Array, Array]:
    """Servo angles [rad], predicted joint angles [rad] and action of a hand that starts at a
    synergy [rad].
    """
    servo = servo_from_synergy(synergy, hand)
    return servo, elastic_joints_from_servo(servo, hand), action_from_synergy(synergy, hand)


def _changing(owner: Any) -> Iterator[tuple[Any, str]]:
    """Attributes that hold arrays, numbers or generators, of an object and of its hpac_gym objects
    except the engine.
    """
    for name, value in vars(owner).items():
        generators = isinstance(value, list) and all(
            isinstance(entry, np.random.Generator) for entry in value
        )
        arrays = isinstance(value, dict) and all(
            isinstance(entry, np.ndarray) for entry in value.values()
        )
        if generators or arrays or isinstance(value, np.ndarray | float | int):
            yield owner, name
        elif (
            name not in ("engine", "_page", "_map")
            and (name == "task" or type(value).__module__.startswith("hpac_gym."))
            and hasattr(value, "__dict__")
        ):
            yield from _changing(value)
