"""Interface between environments and tasks: sampling and judging of episodes, reward, and the
tables of terms.

A task is a plain object. It holds the state of n episodes as arrays between `start` and their
outcomes. It depends on no engine, only on the `SceneState` that it receives. `docs/own_task.md`
shows how to write one."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from inspect import Parameter, signature
from math import isfinite
from types import MappingProxyType
from typing import Any, get_type_hints

import numpy as np
from numpy.typing import NDArray

from hpac_gym.errors import ParameterError
from hpac_gym.model import FINGERS, SERVO_INDEX, Hand
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import PARTS, Contacts, SceneSetup, SceneState, Viewpoint
from hpac_gym.tasks.cameras import CameraNoise, MarkerCamera, ObjectCamera
from hpac_gym.tasks.grip import Grip
from hpac_gym.tasks.phases import CONTROL_HZ as CONTROL_HZ, phase_limits
from hpac_gym.tasks.scripted import Script, ScriptedClosure
from hpac_gym.tasks.terms import Moment, RewardTerm, Term

OUTCOMES = ("running", "success", "failure")
RUNNING, SUCCESS, FAILURE = range(len(OUTCOMES))


@dataclass(frozen=True, slots=True)
class GoalSetup(SceneSetup):
    """A setup of a task with goals."""

    goal: Array | None = None
    """Goal joint angles, shape (15,) [rad]."""


class Task(ABC):
    """One task of the environments. Its constructor sets `duration`, `terms` and `reward_terms`;
    `setup` and `judge` are needed, and everything else has a default for a hand at rest in front of
    an object.
    """

    duration: float
    """Length of an episode [s]."""
    terms: tuple[Term, ...]
    """The deployed observation."""
    reward_terms: tuple[RewardTerm, ...]
    """Terms whose sum is the dense reward."""
    config: Any = None
    """Settings of the task, a frozen dataclass."""
    phases: tuple[str, ...] = ("move",)
    """Names of an episode's phases, in order."""
    ends: tuple[float, ...] = ()
    """End time of each phase, in order [s]; empty for a single one."""
    privileged_terms: tuple[Term, ...] = ()
    """Additional terms that only a critic may observe."""
    goal_terms: tuple[Term, ...] = ()
    """Terms of achieved and desired goals, which are joint angles; empty for a task without goals.
    One with goals is a `Posture`, and its only reward term is what `goal_reward` computes.
    """
    viewpoint: Viewpoint = Viewpoint()
    """Viewpoint of images; it follows the wrist."""
    grip: Grip | None = None
    """Grip of the hands on their objects; None for a task without objects."""
    sensed_terms: Mapping[str, tuple[Term, ...]] = MappingProxyType({})
    """Kinds of `obs` that only this task has, and the terms that each adds to the deployed
    observation.
    """
    wrist_actions: tuple[str, ...] = ()
    """Entries of an action beyond the six for the servos; in an episode's first action they move
    the wrist.
    """
    hands: str = "nominal"
    """Set from which an episode's hand is drawn; "nominal" draws none."""
    every_step: bool = False
    """True if the task reads `SceneState.force_steps`, which costs time."""
    endless: bool = False
    """True if only the time limit ends an episode."""
    unused: tuple[str, ...] = ()
    """Options of every environment that mean nothing to this task."""
    obs: str = "deploy"
    """Kind of observation in use, which an environment sets before `prepare`."""
    user: object = None
    """Token of the environment that was made with it last: the arrays are those of one alone."""
    changing: tuple[str, ...] = ("grip",)
    """Names of the attributes that change in an episode, for snapshots: arrays, numbers, generators
    and objects with such names of their own. `hpac_gym.envs.snapshots.undeclared` finds a forgotten
    one.
    """

    @property
    def observations(self) -> tuple[str, ...]:
        """The values of the option `obs`."""
        return ("deploy", *self.sensed_terms, "privileged", "image")

    @abstractmethod
    def setup(self, rng: np.random.Generator, hand: Hand) -> SceneSetup:
        """Draw one episode; everything random comes from `rng`."""

    @abstractmethod
    def judge(self, state: SceneState, dt: float) -> NDArray[np.int_]:
        """Advance by one control step of `dt` [s] and judge the episodes: indices into `OUTCOMES`,
        shape (n,).
        """

    def check(self, setup: SceneSetup) -> None:  # noqa: B027
        """Refuse a setup that was given and is no episode of this task.

        Raises:
            ParameterError: It is not.
        """

    def prepare(self, num_worlds: int, noise: CameraNoise) -> ObjectCamera | MarkerCamera:
        """Allocate the state of n worlds; returns their camera."""
        self.grip = Grip(num_worlds)
        return ObjectCamera(num_worlds, noise)

    def start(self, worlds: Sequence[int], setups: Sequence[SceneSetup]) -> None:
        """Begin to judge episodes in some worlds."""
        self.grip.start(worlds, [setup.position for setup in setups])

    def wrist_path(self, setup: SceneSetup, times: tuple[float, ...]) -> Array:
        """Offset of the wrist at times [s], along the world's axes, shape (len(times), 3) [m]."""
        return np.zeros((len(times), 3))

    def phase(self, time: Array) -> NDArray[np.int_]:
        """Index into `phases` of the phase that is running or begins at times [s], shape (n,); the
        last phase stays.
        """
        return phase_limits(self.ends).searchsorted(time)

    def chosen(self, setup: SceneSetup, action: Array) -> SceneSetup:
        """The setup of an episode as changed by its first action, shape (6 + len(wrist_actions),),
        −1…1.
        """
        return setup

    def push(self, times: Array) -> Array | None:
        """Force on the objects, shape (n, k, 3) [N], along the world's axes, at times, shape (n, k)
        [s]; None for no force.
        """
        return None

    def watch(self, state: SceneState, dt: float, contacts: Callable[[int], Contacts]) -> None:  # noqa: B027
        """Inspect a state before it is judged, for tasks that need contacts; `contacts` takes
        milliseconds per world.
        """

    @property
    def control_steps(self) -> int:
        """Length of an episode in control steps.

        Raises:
            ParameterError: `duration` is not finite, or shorter than a control step.
        """
        if not (isfinite(self.duration) and round(self.duration * CONTROL_HZ) >= 1):
            raise ParameterError(
                f"an episode of {self.duration:g} s must have a control step of {1 / CONTROL_HZ:g} s, and an end"
            )
        return round(self.duration * CONTROL_HZ)

    def sparse_reward(self, now: Moment) -> Array:
        """Sparse reward, shape (n,): 1 on success, 0 otherwise."""
        return (now.outcome == SUCCESS).astype(float)

    def report(self, now: Moment) -> Mapping[str, Any]:
        """Entries of `info` for a step, arrays of shape (n,) or (n, …), by name: those of a task with
        an object, which `docs/environments/README.md` describes.
        """
        return {
            "is_success": now.outcome == SUCCESS,
            "outcome": np.array(OUTCOMES, dtype=object)[now.outcome],
            "phase": np.array(self.phases, dtype=object)[now.phase],
            "contact_force": np.add.reduce(now.state.contact_force, axis=1),
            "hold_time": now.grip.time.copy(),
            "slip": now.grip.slip.copy(),
        }

    def script(self) -> Script:
        """A simple baseline that a learned policy has to beat."""
        return ScriptedClosure()


@dataclass(frozen=True, slots=True)
class Option:
    """An argument of an id. A task states it beside the parameter of its constructor, as
    ``Annotated[type, Option(...)]``, where name and default are the parameter's.
    """

    meaning: str = ""
    values: tuple[Any, ...] = ()
    """Values that can be given by name."""
    others: str = ""
    """Other accepted values, in words."""
    name: str = ""
    default: Any = None


def options_of(make: Callable[..., Any]) -> tuple[Option, ...]:
    """Options of a task: the parameters of its class, or of the function that makes it."""
    hints = get_type_hints(make.__init__ if isinstance(make, type) else make, include_extras=True)
    found = []
    for name, parameter in signature(make).parameters.items():
        if parameter.kind in (Parameter.VAR_POSITIONAL, Parameter.VAR_KEYWORD):
            continue
        told = getattr(hints.get(name), "__metadata__", ())
        option = next((entry for entry in told if isinstance(entry, Option)), Option())
        found.append(replace(option, name=name, default=parameter.default))
    return tuple(found)


def config_option(
    kind: type, holds: str = "sampling ranges, success criteria and reward weights"
) -> Option:
    """The option `config` of a task whose settings are of a class."""
    return Option(
        f"{holds}; None is as on this page",
        (None,),
        f"`hpac_gym.envs.{kind.__name__}`, dictionary of its fields",
    )


def open_hand(thumb_cmc: float) -> Array:
    """Synergy of the open hand with a CMC at which the thumb opposes the fingers, shape (6,)
    [rad].
    """
    synergy = np.zeros(len(SERVO_INDEX))
    synergy[SERVO_INDEX["thumb_cmc"]] = thumb_cmc
    return synergy


FINGER_PARTS = slice(PARTS.index(FINGERS[0]), PARTS.index(FINGERS[-1]) + 1)
THUMB_PART = PARTS.index("thumb")


def contact_score(weights: Any, touching: NDArray[np.bool_]) -> Array:
    """Score of the parts that touch the object, shape (n,), for `SceneState.touching`."""
    fingers = touching[:, FINGER_PARTS].sum(axis=1)
    thumb = touching[:, THUMB_PART]
    opposed = thumb & (fingers > 0)
    return weights.thumb * thumb + weights.finger * fingers + weights.opposed * opposed


def contact_term(weights: Any, phase: int) -> RewardTerm:
    """Reward for touching the object in one phase."""
    return RewardTerm(
        "contact",
        f"while closing: {weights.thumb:g} for the thumb and {weights.finger:g} for each finger that touches the object, "
        f"{weights.opposed:g} when they oppose each other",
        lambda now: np.where(now.began == phase, contact_score(weights, now.state.touching), 0.0),
    )


def carry_term(weights: Any, closing: int) -> RewardTerm:
    """Reward for carrying the object after the closing phase."""
    return RewardTerm(
        "carry",
        f"afterwards: {weights.carry:g} · max(1 − slip / MAX_SLIP, 0) for an object that the hand carries free of its support",
        lambda now: np.where(now.began != closing, weights.carry * now.grip.firmness, 0.0),
    )


def effort_term(weights: Any) -> RewardTerm:
    """Cost of changing the action."""
    return RewardTerm(
        "effort",
        f"{weights.effort:g} · sum of the squared changes of the action",
        lambda now: weights.effort * np.add.reduce(np.square(now.action_change), axis=1),
    )


def outcome_term(weights: Any) -> RewardTerm:
    """Reward for how an episode ends."""
    by_outcome = np.array([0.0, weights.success, weights.failure])
    return RewardTerm(
        "outcome",
        f"{weights.success:g} for success or {weights.failure:g} for failure, once",
        lambda now: by_outcome[now.outcome],
    )
