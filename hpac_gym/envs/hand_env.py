"""One hand as a Gymnasium environment: `Episodes` of a single world."""

from collections.abc import Mapping
from typing import Any, ClassVar, NoReturn, SupportsIndex

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hpac_gym.envs.commands import Transmit, actions_of
from hpac_gym.envs.episodes import Episodes, open_episodes, quality
from hpac_gym.envs.observations import Observation, of_world
from hpac_gym.envs.options import RENDER_MODES, checked_options, setups_of
from hpac_gym.envs.randomization import Randomization, randomization
from hpac_gym.envs.snapshots import restore, save
from hpac_gym.errors import EpisodeError
from hpac_gym.model import ServoCommand
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import Engine, SceneState, Viewpoint
from hpac_gym.tasks.senses import VIEW_TARGET
from hpac_gym.tasks.task import CONTROL_HZ, RUNNING, Task


class HandEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """A hand with a task: six actions per step, which become one `ServoCommand`. The task moves the
    wrist.

    Args:
        task: draws episodes, judges them and shapes the reward.
        render_mode: None, "rgb_array" or "human".
        transmit: function applied to a command on its way to the simulated servos, such as the wire
            and the firmware; None is the identity. Observations use the original command.
        physics: an engine of one world instead of the one that the options name, for measurements.
        options: hand, reward, noise, obs, randomize, engine, body; see
            `hpac_gym.envs.options.Options`.

    Raises:
        TypeError: An unknown option.
        ParameterError: An unknown value, a bad hand file, or an engine that is not installed.

    Attributes:
        slices: slices of the observation vector, by field name.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": RENDER_MODES, "render_fps": CONTROL_HZ}

    def __init__(
        self,
        task: Task,
        render_mode: str | None = None,
        transmit: Transmit | None = None,
        physics: Engine | None = None,
        **options: Any,
    ) -> None:
        self.task = task
        self.render_mode = render_mode
        chosen = checked_options(render_mode=render_mode, **options)
        self.hand = chosen.hand
        self.model = chosen.model
        self.obs = chosen.obs
        self.reward = chosen.reward
        self._episodes: Episodes | None = Episodes(task, 1, chosen, transmit, physics)
        self.observation_space = self._episodes.observations.space
        self.action_space = self._episodes.action_space
        self.slices = self._episodes.observations.slices
        self.dt = self._episodes.dt

    def __reduce_ex__(self, protocol: SupportsIndex) -> NoReturn:
        """Refuse copies, which would step and close the original's physics.

        Raises:
            TypeError: Always.
        """
        name = type(self).__name__
        raise TypeError(f"a physics world cannot be copied or pickled: make a new {name}")

    episodes = property(open_episodes)

    @property
    def randomization(self) -> Randomization:
        """Domain randomization besides the task's own draw; a new value begins at `reset`."""
        return self.episodes.randomizations[0]

    @randomization.setter
    def randomization(self, given: Randomization | Mapping | str | None) -> None:
        self.episodes.randomizations[0] = randomization(given)

    @property
    def state(self) -> SceneState:
        """True state after the last step, with a leading axis of one; no policy may use it."""
        return self._begun().now.state

    @property
    def phase(self) -> str:
        """Current phase of the wrist motion, one of the task's `phases`."""
        return self.task.phases[self._begun().now.phase[0]]

    @property
    def command(self) -> ServoCommand:
        """Last servo command, as a bridge sends it to the real hand."""
        return self._begun().commands.command

    def _begun(self) -> Episodes:
        if self.episodes.now is None:
            raise EpisodeError("no episode is running: call reset() first")
        return self.episodes

    def _is_over(self) -> bool:
        return self._episodes.outcome.item() != RUNNING

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode.

        Args:
            seed: seed of the environment's generator. The same seed gives the same episode, to the
                bit.
            options: `{"setup": SceneSetup}` gives the episode instead of drawing it; for a task
                with goals `{"goal": posture}`, shape (15,) [rad].

        Raises:
            ParameterError: Unknown option, or an invalid setup.
            ShapeError: A setup or goal with an array of the wrong shape, NaN or infinity.
            WorkspaceError: A goal that leaves the bounds of the observation.
        """
        self.episodes.now = None  # a reset that is refused leaves no episode running
        given = setups_of(options, self.task, self.hand)
        super().reset(seed=seed)
        drawn = self.episodes.reset([0], [self.np_random], given)[0]
        self.episodes.pictures.show()
        return self._observe(), self._info() | {"randomized": drawn}

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Carry out one action for one control period.

        Raises:
            ShapeError: `action` has the wrong shape.
            WorkspaceError: `action` has NaN, or leaves −1…1: wrap in
                `gymnasium.wrappers.ClipAction`.
            EpisodeError: Before `reset`, after the end of an episode, or after `close`.
            PhysicsError: The simulation failed in PyBullet.

        Warns:
            PhysicsWarning: The simulation failed in MuJoCo: the episode ends as a failure.
        """
        episodes = self._begun()
        if self._is_over():
            raise EpisodeError("no episode is running: call reset() first")
        action = actions_of(action, self.action_space, "action")
        reward = float(episodes.step(action[None])[0])
        episodes.pictures.show()
        return self._observe(), reward, self._is_over(), False, self._info()

    def save_state(self) -> Any:
        """The state of the episode, for `restore_state`. Wrappers have state of their own: step
        `env.unwrapped` while planning.

        Raises:
            EpisodeError: Before `reset`, after `close`, or with `transmit`, whose receiver has a
                state of its own.
        """
        episodes = self._begun()
        if episodes.commands.transmit is not None:
            raise EpisodeError(
                "a state cannot be saved with transmit: what is at the far end keeps its own"
            )
        changing = episodes.simulation.engine.save(0), save(episodes)
        return episodes.episode, episodes.setups[0], episodes.now, *changing

    def restore_state(self, state: Any) -> None:
        """Restore a state from `save_state`, any number of times: the same actions then give the
        same steps, to the bit.

        Raises:
            EpisodeError: The state is of another episode, or of another environment; or after
                `close`.
        """
        episodes = self.episodes
        if not isinstance(state, tuple) or state[:1] != (episodes.episode,):
            raise EpisodeError(
                "a state can be restored only in the episode that it was saved in, not after another reset()"
            )
        _, setup, now, physics, values = state
        episodes.now = None  # until the end, so that nothing goes on from an interrupted call
        episodes.setups[0] = setup  # the wrist may have been placed since then
        episodes.simulation.engine.restore(0, physics)
        restore(episodes, values)
        episodes.now = now

    def _observe(self) -> Observation:
        return of_world(self._episodes.observe(), 0)

    def _info(self) -> dict[str, Any]:
        episodes = self._episodes
        report = self.task.report(episodes.now)
        info = {name: values.tolist()[0] for name, values in report.items()}
        if not self.task.goal_terms:
            info["reward_terms"] = {name: values.item() for name, values in episodes.terms.items()}
        if self._is_over():
            info["epsilon"] = quality(episodes, 0)
        return info

    def render(self) -> NDArray[np.uint8] | None:
        """RGB image, shape (360, 480, 3); None without a render mode and with "human".

        Raises:
            EpisodeError: Before `reset`, or after `close`.
        """
        seen = self.episodes.pictures.render()
        return seen[0] if seen else None

    def picture(self, viewpoint: Viewpoint, centre: Array = VIEW_TARGET) -> NDArray[np.uint8]:
        """RGB image, centred on a point of the hand frame, shape (3,) [m]; needs a render mode."""
        return self._begun().pictures.take(0, viewpoint, centre)

    def close(self) -> None:
        """Release the physics. Closing twice is allowed."""
        if self._episodes is not None:
            self._episodes.close()
        self._episodes = None


class GoalEnv(HandEnv):
    """`HandEnv` of a task with goals, which are joint angles, shape (..., 15) [rad], with the functions
    that hindsight replay needs.
    """

    def compute_reward(
        self, achieved_goal: NDArray, desired_goal: NDArray, info: Any
    ) -> NDArray[np.float64]:
        """Reward of achieved postures for given goals; `info` is ignored."""
        return self.task.goal_reward(achieved_goal, desired_goal, self.reward == "dense")

    def compute_terminated(
        self, achieved_goal: NDArray, desired_goal: NDArray, info: Any
    ) -> NDArray[np.bool_]:
        """Always False: a posture that is reached has to be held, and only the time limit truncates."""
        return np.zeros(
            np.broadcast_shapes(np.shape(achieved_goal), np.shape(desired_goal))[:-1], dtype=bool
        )[()]

    compute_truncated = compute_terminated
