"""What an environment needs from a task: to draw episodes, to judge them, to shape the reward, and the tables of its terms.

A task is a plain object. It holds the state of n episodes as arrays between `start` and their outcomes, and knows no action and
no engine: only the `SceneState` that it is shown.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hpac_gym.model import FINGERS, Hand
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import PARTS, Contacts, SceneSetup, SceneState, Viewpoint
from hpac_gym.tasks.cameras import CameraNoise, MarkerCamera, ObjectCamera
from hpac_gym.tasks.grip import Grip
from hpac_gym.tasks.terms import Moment, RewardTerm, Term

CONTROL_HZ = 20
"""Commands a second."""
OUTCOMES = ("running", "success", "failure")
RUNNING, SUCCESS, FAILURE = range(len(OUTCOMES))
_OUTCOMES = np.array(OUTCOMES, dtype=object)


class Task(Protocol):
    """One task of the environments. What has a value here a task may leave out."""

    phases: tuple[str, ...]
    """Names of an episode's phases, in order."""
    duration: float
    """Length of an episode [s]."""
    terms: tuple[Term, ...]
    """The deployed observation."""
    privileged_terms: tuple[Term, ...]
    """What only a critic may see."""
    goal_terms: tuple[Term, ...]
    """Of an achieved and of a desired goal; empty for a task without goals."""
    reward_terms: tuple[RewardTerm, ...]
    """The dense reward is their sum."""
    viewpoint: Viewpoint
    """Where pictures are taken from; they follow the wrist."""
    grip: Grip | None
    """How the hands hold their objects."""
    sensed_terms: Mapping[str, tuple[Term, ...]] = MappingProxyType({})
    """Kinds of `obs` that this task has beside those of all tasks, and what each adds to the deployed observation."""
    wrist_actions: tuple[str, ...] = ()
    """Numbers of an action beyond the six of the servos; an episode's first action moves the wrist by them."""

    def prepare(self, num_worlds: int, noise: CameraNoise) -> ObjectCamera | MarkerCamera:
        """Get ready for n worlds; returns their camera."""
        ...

    def setup(self, rng: np.random.Generator, hand: Hand) -> SceneSetup:
        """Draw one episode; everything random comes from `rng`."""
        ...

    def start(self, worlds: Sequence[int], setups: Sequence[SceneSetup]) -> None:
        """Begin to judge episodes in some worlds."""
        ...

    def wrist_path(self, setup: SceneSetup, times: tuple[float, ...]) -> Array:
        """Offset of the wrist at times [s], along the world's axes, shape (len(times), 3) [m]."""
        ...

    def phase(self, time: Array) -> NDArray[np.int_]:
        """Index into `phases` of the one that runs, or begins, at times [s], shape (n,); the last one stays."""
        ...

    def chosen(self, setup: SceneSetup, action: Array) -> SceneSetup:
        """The setup of an episode whose first action is this one, shape (6 + len(wrist_actions),), −1…1."""
        return setup

    def push(self, times: Array) -> Array | None:
        """Force on the objects at times of each world, shape (n, k) [s]: shape (n, k, 3) [N], along the world's axes; or None."""
        return None

    def watch(self, state: SceneState, dt: float, contacts: Callable[[int], Contacts]) -> None:
        """See a state before it is judged, for a task that asks for the contacts of some worlds; each takes milliseconds."""

    def judge(self, state: SceneState, dt: float) -> NDArray[np.int_]:
        """Advance by one control step of `dt` [s] and judge the episodes: indices into `OUTCOMES`, shape (n,)."""
        ...

    def sparse_reward(self, now: Moment) -> Array:
        """The reward that only tells whether the aim is reached, shape (n,): 1 on success, 0 otherwise."""
        return (now.outcome == SUCCESS).astype(float)

    def report(self, now: Moment) -> Mapping[str, Any]:
        """What `info` says of a step: arrays of shape (n,), by name."""
        return scene_report(self, now)


def setting(default: Any, meaning: str, **more: Any) -> Any:
    """A field of a config, with its meaning for the documentation and what else shall be known of it."""
    return field(default=default, metadata={"meaning": meaning, **more})


class Weights(Protocol):
    """What the reward terms weigh that tasks with an object share."""

    thumb: float
    finger: float
    opposed: float
    effort: float
    success: float
    failure: float


_FINGERS = [PARTS.index(name) for name in FINGERS]
_THUMB = PARTS.index("thumb")


def contact_term(weights: Weights, phase: int) -> RewardTerm:
    """Reward for touching the object in one phase."""

    def value(now: Moment) -> Array:
        fingers, thumb = now.state.touching[:, _FINGERS].sum(axis=1), now.state.touching[:, _THUMB]
        opposed = thumb & (fingers > 0)
        found = weights.thumb * thumb + weights.finger * fingers + weights.opposed * opposed
        return np.where(now.phase == phase, found, 0.0)

    meaning = (
        f"while closing: {weights.thumb:g} for the thumb and {weights.finger:g} for each finger that touches the object, "
        f"{weights.opposed:g} when they oppose each other"
    )
    return RewardTerm("contact", meaning, value)


def effort_term(weights: Weights) -> RewardTerm:
    """Cost of changing the action."""
    return RewardTerm(
        "effort",
        f"{weights.effort:g} · sum of the squared changes of the action",
        lambda now: weights.effort * np.square(now.action_change).sum(axis=1),
    )


def outcome_term(weights: Weights) -> RewardTerm:
    """Reward for how an episode ends."""
    by_outcome = np.array([0.0, weights.success, weights.failure])
    meaning = f"{weights.success:g} for success or {weights.failure:g} for failure, once"
    return RewardTerm("outcome", meaning, lambda now: by_outcome[now.outcome])


def scene_report(task: Task, now: Moment) -> dict[str, Any]:
    """The `info` of a task with an object; `docs/environments/README.md` says what its entries mean."""
    return {
        "is_success": now.outcome == SUCCESS,
        "outcome": _OUTCOMES[now.outcome],
        "phase": np.array(task.phases, dtype=object)[now.phase],
        "contact_force": now.state.contact_force.sum(axis=1),
        "hold_time": now.grip.time.copy(),
        "slip": now.grip.slip.copy(),
    }
