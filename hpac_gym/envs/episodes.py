"""n episodes of a task as arrays: action, servos, physics, observation and reward. Both environment
classes use it.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from hpac_gym.envs.commands import Commands, LinkFaults, Transmit, Wrists
from hpac_gym.envs.observations import Observation, Observations, Pictures
from hpac_gym.envs.options import CALIBRATED, Options
from hpac_gym.envs.randomization import changed_setup, stream
from hpac_gym.errors import EpisodeError, ParameterError, ShapeError
from hpac_gym.model import HPAC, SERVOS
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import Engine, PhysicsError, PhysicsWarning, SceneSetup, SceneState
from hpac_gym.physics.settings import BODIES, HandSettings
from hpac_gym.physics.simulation import Simulation, make_engine
from hpac_gym.settings import check_choice
from hpac_gym.tasks.grip import contact_wrenches, largest_ball
from hpac_gym.tasks.task import CONTROL_HZ, FAILURE, OUTCOMES, RUNNING, GoalSetup, Task
from hpac_gym.tasks.terms import Moment, require_own_names

_NO_CHOICE = HandSettings()
_JUDGED = frozenset(range(len(OUTCOMES)))


class Episodes:
    """The episodes that run in n worlds.

    Args:
        task: draws episodes, judges them and shapes the reward.
        num_worlds: n.
        options: options of the environment.
        transmit: applied to a command on its way to the servos, for n = 1; None is the identity.
        engine: physics of n worlds; None makes those of the options.

    Raises:
        ParameterError: The task does not have the requested observation, or its terms do not go
            together, or the physics' rate is no multiple of the commands'.

    Attributes:
        observations: what is observed, with the observation space of one world.
        action_space: action space of one world.
        randomizations: randomization of future episodes, one per world.
        setups: the running episodes, one per world.
        user: a token, which the task loses to other `Episodes` that are made with it.
        episode: a token of its own for what was started by the last `reset`.
        outcome: status of each episode, an index into `hpac_gym.tasks.task.OUTCOMES`, shape (n,).
        now: the worlds after the last step; None before `reset` and after an interrupted call.
        terms: terms of the last step's dense reward, shape (n,), by name.
    """

    changing = (
        *("task", "simulation", "commands", "wrists", "observations", "outcome", "terms"),
        *("_camera", "_down"),
    )

    def __init__(
        self,
        task: Task,
        num_worlds: int,
        options: Options,
        transmit: Transmit | None = None,
        engine: Engine | None = None,
    ) -> None:
        _check(task, options)
        self.task = task
        self.options = options
        visuals = options.render_mode == "rgb_array" or options.obs == "image"
        engine = engine or make_engine(options.engine, num_worlds, options.world, visuals)
        self.simulation = Simulation(engine)
        self.pictures = Pictures(self, options.render_mode)
        try:
            engine.require(BODIES[options.body])
            engine.every_step = task.every_step
            task.obs = options.obs
            self.user = task.user = object()
            self._camera = task.prepare(num_worlds, options.noise)
            self.observations = Observations(
                task, options.obs, num_worlds, self.pictures, self._camera
            )
            self.wrists = Wrists(task, num_worlds, engine.dt)
        except Exception:
            engine.close()
            raise
        self.dt = 1.0 / CONTROL_HZ
        self.commands = Commands(num_worlds, options.model, task.wrist_actions, transmit)
        width = len(SERVOS) + len(task.wrist_actions)
        self.action_space = spaces.Box(-1.0, 1.0, (width,), np.float32)
        self.setups: list[SceneSetup | None] = [None] * num_worlds
        self.randomizations = [options.randomize] * num_worlds
        self.outcome = np.full(num_worlds, RUNNING)
        self._down = np.zeros((num_worlds, 3))
        self.now: Moment | None = None
        self.terms: dict[str, Array] = {}
        self.episode = object()

    def reset(
        self,
        worlds: Sequence[int],
        generators: Sequence[np.random.Generator],
        given: Sequence[SceneSetup] | None = None,
    ) -> list[dict[str, list[float]]]:
        """Start episodes in some worlds.

        Args:
            worlds: indices of the worlds.
            generators: random generator of each of them; a world's episodes depend only on its own.
            given: setups of the worlds to use instead of drawn ones.

        Returns:
            Values drawn by the randomization, by name, for each of the worlds.
        """
        self.now = None  # until the end, so that nothing goes on from an interrupted call
        self.episode = object()
        setups = []
        drawn = []
        for world, rng, own in zip(worlds, generators, given or [None] * len(worlds), strict=True):
            setup_rng, camera_rng = rng.spawn(2)
            values = self.randomizations[world].draw(setup_rng)
            setup = changed_setup(_setup(self.task, self.options, setup_rng, own), values)
            lost = values.get("dropped_frames", 0.0)
            late = values.get("late_frames", 0.0)
            self.commands.faults[world] = LinkFaults(
                lost, late, stream(setup_rng, "losses") if lost or late else None
            )
            self._camera.start(world, setup, values.get("sensor_noise", 1.0), camera_rng)
            setups.append(setup)
            drawn.append({name: np.atleast_1d(value).tolist() for name, value in values.items()})
        self._begin(worlds, setups)
        self.outcome[np.asarray(worlds)] = RUNNING
        self.terms = {}
        still = np.zeros_like(self.commands.last_action)
        self._look(self.simulation.state(), still, worlds)
        return drawn

    def _begin(self, worlds: Sequence[int], setups: Sequence[SceneSetup]) -> None:
        """Set up the scenes of some worlds."""
        self.task.start(worlds, setups)
        self.simulation.reset(worlds, setups)
        self.observations.start(worlds, setups)
        self.commands.start(worlds, setups)
        self.wrists.start(worlds, setups)
        self._down = self._down.copy()  # the previous `Moment` keeps the array
        for world, setup in zip(worlds, setups, strict=True):
            self.setups[world] = setup
            self._down[world] = -setup.hand_rotation[2]

    def step(self, actions: NDArray) -> Array:
        """Carry out one action in every world for one control period, and judge it.

        Args:
            actions: shape (n, 6), −1…1; more columns with a free wrist.

        Returns:
            Rewards, shape (n,).

        Raises:
            ShapeError, WorkspaceError: As `Commands.target`.
            PhysicsError: A simulation failed, and the engine cannot continue.

        Warns:
            PhysicsWarning: A world's simulation failed: its episode alone ends, as a failure.
        """
        target = self.commands.target(actions)
        phase = self.now.phase
        self.now = None  # as in `reset`
        if self.task.wrist_actions:  # the first one of an episode places the wrist
            first = np.flatnonzero((self.wrists.step == 0) & (self.outcome == RUNNING)).tolist()
            if first:
                chosen = [self.task.chosen(self.setups[world], actions[world]) for world in first]
                self._begin(first, chosen)
        self.simulation.command(self.commands.stream(target), self.dt)
        failed: list[int] = []
        try:
            self.simulation.advance(*self.wrists.advance())
        except PhysicsError as error:
            if not error.worlds:
                raise
            if failed := [world for world in error.worlds if self.outcome[world] == RUNNING]:
                warnings.warn(f"{error}; it ends as a failure", PhysicsWarning, stacklevel=2)
        state = self.simulation.state()
        self.task.watch(state, self.dt, self.simulation.engine.contacts)
        self.outcome = _judged(self.task.judge(state, self.dt), phase.shape)
        if failed:
            self.outcome[failed] = FAILURE
        self._look(state, self.commands.record(actions), range(len(self.setups)), phase)
        self.terms = _terms(self.task, self.now)
        if self.options.reward == "dense":
            return sum(self.terms.values(), np.zeros(len(self.setups)))
        return self.task.sparse_reward(self.now)

    def _look(
        self,
        state: SceneState,
        change: Array,
        worlds: Iterable[int],
        began: NDArray[np.int_] | None = None,
    ) -> None:
        """Record a state; the camera measures only the given worlds, each with noise of its own."""
        phase = self.task.phase(state.time)
        commands = self.commands
        self.now = Moment(
            state,
            commands.shown,
            commands.predicted,
            self._down,
            phase,
            commands.last_action,
            change,
            self._camera.look(state, worlds),
            self.task.grip,
            self.outcome,
            phase if began is None else began,
            commands.servo,
        )
        self.observations.measure(self.now)

    def observe(self) -> Observation:
        """Current observations, with a leading axis n."""
        return self.observations.see(self.now)

    def close(self) -> None:
        """Close the engine and the page. Closing twice is allowed."""
        self.simulation.engine.close()
        self.pictures.close()


def _setup(
    task: Task, options: Options, rng: np.random.Generator, given: SceneSetup | None
) -> SceneSetup:
    """The setup of an episode, drawn by the task if none is given, with the servo zeros and the
    body of the options; a given one keeps its own.
    """
    drawn = given is None or isinstance(given, GoalSetup)
    setup = given or task.setup(rng, options.hand)
    if not isinstance(setup, SceneSetup):
        raise ParameterError(f"setup must return a SceneSetup, not {setup!r}")
    settings = setup.hand_settings
    if drawn and any(zero := options.hand.calibration.servo_zero):
        zero = tuple(np.add(settings.servo_zero, zero).tolist())
        settings = replace(settings, servo_zero=zero)
    body = BODIES[options.body]
    if body != _NO_CHOICE and (drawn or settings == _NO_CHOICE):
        settings = replace(settings, armature=body.armature, hub_inertia=body.hub_inertia)
    return setup if settings is setup.hand_settings else replace(setup, hand_settings=settings)


def _judged(outcome: Any, shape: tuple[int, ...]) -> NDArray[np.int_]:
    """What a task's `judge` returned, as an array of its own: `Episodes.reset` writes to it."""
    if np.shape(outcome) != shape or not _JUDGED.issuperset(np.asarray(outcome).tolist()):
        raise ShapeError(
            f"judge must return {shape} indices into {', '.join(OUTCOMES)}, not {outcome!r}"
        )
    return np.array(outcome, int)


def _terms(task: Task, now: Moment) -> dict[str, Array]:
    """Terms of a task's dense reward, shape (n,), by name."""
    terms = {term.name: np.asarray(term.value(now)) for term in task.reward_terms}
    for name, value in terms.items():
        if value.shape != now.phase.shape:
            raise ShapeError(
                f"reward term {name!r} must have shape {now.phase.shape}, not {value.shape}"
            )
    if not np.isfinite([*terms.values()]).all():
        bad = next(name for name, value in terms.items() if not np.isfinite(value).all())
        raise ShapeError(f"reward term {bad!r} must be finite, not {terms[bad]}")
    return terms


def quality(episodes: Episodes, world: int) -> float:
    """Grasp quality epsilon of a world [N], with torques divided by the object's largest half
    extent; since it takes milliseconds, it is reported only in an episode's last step.
    """
    if not episodes.now.state.touching[world].any():  # most failed episodes
        return 0.0
    found = episodes.simulation.engine.contacts(world)
    length = max(episodes.setups[world].object.half_extents)
    return largest_ball(
        contact_wrenches(found.point, found.normal, found.friction, found.centre, length)
    )


def _check(task: Task, options: Options) -> None:
    """Refuse what is no task, and options that do not fit one."""
    if not isinstance(task, Task):
        raise ParameterError(f"{task!r} is no hpac_gym.tasks.task.Task: gymnasium.make takes an id")
    check_choice("obs", options.obs, task.observations)
    require_own_names("the reward", task.reward_terms)
    if list(task.ends) != sorted(task.ends) or len(task.phases) != max(len(task.ends), 1):
        raise ParameterError(
            f"phases {task.phases}: ends {task.ends} is not a time of each, in order"
        )
    if task.goal_terms:
        kind = type(task).__name__
        if missing := [name for name in ("measure", "goal_reward") if not hasattr(task, name)]:
            raise ParameterError(
                f"{kind} has goal_terms but no {' and '.join(missing)}: make it a subclass of Posture"
            )
        if len(task.reward_terms) > 1:
            raise ParameterError(
                f"{kind} has goals and {len(task.reward_terms)} reward terms: one is possible, that of goal_reward"
            )
    if options.model == CALIBRATED and task.hands != "test":
        raise ParameterError(
            f"model 'calibrated' is that of held-out hands: it needs hands='test', not {task.hands!r}"
        )
    if task.hands != "nominal" and options.hand != HPAC:
        raise ParameterError(
            f"hands {task.hands!r} and a hand of one's own were given: give either"
        )


def open_episodes(env: Any) -> Episodes:
    """What runs below an environment. For figures and tests; a policy must not look.

    Raises:
        EpisodeError: The environment is closed, or another one was made with its task.
    """
    episodes = env._episodes
    if episodes is None:
        raise EpisodeError("this environment is closed: make a new one")
    if episodes.task.user is not episodes.user:
        raise EpisodeError("the task of this environment was given to another: make one for each")
    return episodes
