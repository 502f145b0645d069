"""HPAC-GraspType-v0: the paper's sixteen grasps with one policy for all, each judged by the rule of
its type.

A grasp type has no hand shape of its own: its hand closes to the posture of the same name in
`hpac_gym.model.POSTURES` by Eqs. (14) and (15), without retuning, and the object is placed to fit
that posture. `hpac_gym.tasks.grasp_rules` has the placement and the rule by which the grasp is judged."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from hpac_gym.model import HPAC, Hand, action_from_synergy
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import Contacts, SceneSetup, SceneState
from hpac_gym.settings import check_bounds, check_choice, setting
from hpac_gym.tasks.cameras import CameraNoise, ObjectCamera
from hpac_gym.tasks.grasp import CLOSE, Grasp
from hpac_gym.tasks.grasp_data import NOMINAL, setup_of_grasp
from hpac_gym.tasks.grasp_rules import (
    GRASP_TYPES,
    TYPE_SPLITS,
    TYPE_TERMS,
    GraspType,
    Judged,
    chosen_types,
)
from hpac_gym.tasks.occlusion import in_the_way
from hpac_gym.tasks.phases import CONTROL_HZ, Timetable
from hpac_gym.tasks.placing import WRIST_ACTIONS, arrived, out_of_reach, wrist_choice
from hpac_gym.tasks.scripted import CLOSE_TIME, Script
from hpac_gym.tasks.task import (
    FAILURE,
    SUCCESS,
    Option,
    config_option,
    effort_term,
    outcome_term,
)
from hpac_gym.tasks.terms import (
    COMMAND_TERMS,
    OBJECT_TERMS,
    Layout,
    Moment,
    RewardTerm,
    progress_terms,
)

OBJECTS = ("train", "test")
WRISTS = ("free", "script")
LOOK_EVERY = 4
"""Control steps between two evaluations of the contacts of a hold, since one takes about as long as
a step.
"""
SETTLES = 0.002
"""Displacement in the first step beyond which the arriving hand has pushed the object; settling
alone takes 1 mm [m].
"""


@dataclass(frozen=True, slots=True)
class GraspTypeWeights:
    """Weights of the dense reward terms."""

    touch: float = 0.4
    avoid: float = -0.1
    push: float = -0.3
    carry: float = 0.5
    effort: float = -0.01
    success: float = 10.0
    failure: float = -5.0


@dataclass(frozen=True, slots=True)
class GraspTypeConfig:
    """Spread of episodes about their type's data, drop criterion, and reward weights.

    Raises:
        ParameterError: A number leaves its bounds.
    """

    spread: float = setting(1.0, "factor of a type's position and yaw noise", bounds=(0.0, 5.0))
    drop_distance: float = setting(
        0.06, "displacement in the hand beyond which an object is dropped [m]", bounds=(5e-3, 1.0)
    )
    timetable: Timetable = field(default_factory=Timetable)
    weights: GraspTypeWeights = field(default_factory=GraspTypeWeights)

    def __post_init__(self) -> None:
        check_bounds(self, "config")


@dataclass(frozen=True, slots=True)
class GraspTypeSetup(SceneSetup):
    """A setup of `GraspByType`."""

    grasp: str | None = None
    """Name of the requested grasp type."""


TYPES_OPTION = Option(
    "the types that an episode may ask for: all sixteen, those to train on, those held out, one, or several",
    (*TYPE_SPLITS, *GRASP_TYPES),
    "list of names",
)
OBJECTS_OPTION = Option(
    "*train* has the types' own objects, *test* draws one of their held-out variants, on "
    "which nothing may be trained",
    OBJECTS,
)
WRIST_OPTION = Option(
    "*free* lets the first action of an episode say where the wrist goes, by six numbers "
    "more; *script* puts it where the type wants it",
    WRISTS,
)


class GraspByType(Grasp):
    """Draws episodes of grasp types; success requires that the object is held, as in `Grasp`,
    according to the type's `Rule`.

    Args:
        types: a split of `TYPE_SPLITS`, the name of a type, or several names.
        objects: "train" has the types' own objects, "test" draws from their held-out variants.
        wrist: "free" begins with the open hand out of reach, and an episode's first action sets the
            wrist pose and the hand's preshape; "script" begins at the wrist pose of the type's
            data.
        config: spread, drop criterion, timetable and reward weights.

    Raises:
        GraspError: Unknown type.
        ParameterError: Invalid config, `objects` is not one of `OBJECTS`, or `wrist` not one of
            `WRISTS`.
    """

    config_class = GraspTypeConfig
    changing = (*Grasp.changing, "holds", "held", "free", "_types")

    def __init__(
        self,
        types: Annotated[str | Sequence[str], TYPES_OPTION] = "all",
        objects: Annotated[str, OBJECTS_OPTION] = "train",
        wrist: Annotated[str, WRIST_OPTION] = "free",
        config: Annotated[
            GraspTypeConfig | Mapping[str, Any] | None, config_option(GraspTypeConfig)
        ] = None,
    ) -> None:
        check_choice("objects", objects, OBJECTS)
        check_choice("wrist", wrist, WRISTS)
        self.kinds = chosen_types(types)
        self.objects = objects
        self.wrist_actions = WRIST_ACTIONS if wrist == "free" else ()
        super().__init__(config)
        self.terms = (
            *COMMAND_TERMS,
            *OBJECT_TERMS,
            *TYPE_TERMS,
            *progress_terms(self.phases, self.duration),
        )

    def _rewards(self) -> tuple[RewardTerm, ...]:
        weights = self.config.weights
        return (
            RewardTerm(
                "contact",
                f"while closing: {weights.touch:g} · fraction of the required parts that touch the object, {weights.avoid:g} "
                "for each forbidden part that touches it",
                lambda now: np.where(
                    now.began == CLOSE,
                    weights.touch * self.holds.touched_share(now.state.touching)
                    + weights.avoid * self.holds.forbidden(now.state.touching),
                    0.0,
                ),
            ),
            self._push_term(),
            RewardTerm(
                "carry",
                f"afterwards: {weights.carry:g} · max(1 − slip / MAX_SLIP, 0) for an object that the hand carries "
                "free of its support, times the score of the type's rule: the mean over its clauses at the last evaluation",
                lambda now: np.where(
                    now.began != CLOSE,
                    weights.carry * self.grip.firmness * self.holds.kept,
                    0.0,
                ),
            ),
            effort_term(weights),
            outcome_term(weights),
        )

    # Episodes
    # ------------------------------------------------------------------------------------------------------

    def prepare(self, num_worlds: int, noise: CameraNoise) -> ObjectCamera:
        self.holds = Judged(num_worlds)
        self.held = np.zeros(num_worlds, bool)
        self.free = np.ones(num_worlds, bool)
        self._types = np.full(num_worlds, "", dtype=object)
        return super().prepare(num_worlds, noise)

    def draw(self, rng: np.random.Generator) -> GraspType:
        """Draw the type of an episode."""
        return self.kinds[rng.integers(len(self.kinds))]

    def setup(self, rng: np.random.Generator, hand: Hand = HPAC) -> SceneSetup:
        """Draw one episode: its type, its object, and the object's offset from the type's data."""
        start = self.draw(rng).start
        variants = list(start.held_out) if self.objects == "test" else [NOMINAL]
        variant = start.variant(variants[rng.integers(len(variants))])
        drawn = setup_of_grasp(start, variant, rng, hand, self.config.spread)
        setup = drawn.to(GraspTypeSetup, grasp=start.name)
        return out_of_reach(setup, start) if self.wrist_actions else setup

    def chosen(self, setup: SceneSetup, action: Array) -> SceneSetup:
        """The setup requested by an episode's first action, shape (12,)."""
        return arrived(setup, action)

    def check(self, setup: SceneSetup) -> None:
        """Refuse a setup that names no grasp type."""
        check_choice("setup grasp", getattr(setup, "grasp", None), tuple(GRASP_TYPES))

    def start(self, worlds: Sequence[int], setups: Sequence[SceneSetup]) -> None:
        super().start(worlds, setups)
        for world, setup in zip(worlds, setups, strict=True):
            name = setup.grasp
            self.holds.start(world, GRASP_TYPES[name].rule.scaled(setup.object.scale), setup)
            self._types[world] = name
            self.held[world] = False
            self.free[world] = not in_the_way(setup)

    def watch(self, state: SceneState, dt: float, contacts: Callable[[int], Contacts]) -> None:
        """Evaluate the contacts of held objects every `LOOK_EVERY` steps from the end of the lift,
        and in the last step.
        """
        since = np.round((state.time - self.timetable.ends[1]) / dt)
        over = state.time >= self.duration - dt / 2
        looks = (
            (since >= 0)
            & ((since % LOOK_EVERY == 0) | over)
            & (state.touching.any(axis=1) | self.grip.carrying)
        )
        self.holds.follow(state, since, looks, contacts)

    def judge(self, state: SceneState, dt: float) -> NDArray[np.int_]:
        """Advance by one control step and judge the episodes.

        An episode fails where `Grasp` fails; if something is in the hand's way where it arrives
        (`in_the_way`), or it touches or pushes the object on arrival; and at the end if the object
        was held but not according to the type's rule."""
        outcome = super().judge(state, dt)
        if (arrived := state.time < 1.5 * dt).any():
            inside = state.touching.any(axis=1) | (self.grip.moved > SETTLES)
            self.free = self.free & ~(arrived & inside)
        self.held = outcome == SUCCESS
        return np.where(~self.free | (self.held & (self.holds.missed != "")), FAILURE, outcome)

    def report(self, now: Moment) -> dict[str, Any]:
        return super().report(now) | {
            "type": self._types.copy(),
            "held": self.held.copy(),
            "kept": self.holds.kept.copy(),
            "missed": self.holds.missed.copy(),
        }

    def script(self) -> Script:
        return ScriptedGraspType(self)


class ScriptedGraspType(Script):
    """Closure of each type: the wrist at the pose of the type's data, then linearly from the
    preshape to the posture.

    Args:
        task: task whose observations it receives, as a vector or in a dictionary.
        closure: name of a type whose closure all types use, with their own wrist poses; None is
            each type's own.
    """

    def __init__(self, task: GraspByType, closure: str | None = None) -> None:
        self._told = Layout(task.terms, 1).slices["type"]
        self._free = bool(task.wrist_actions)
        self._closes = closure and GRASP_TYPES[closure].start

    def act(self, observation: NDArray[np.float32] | dict[str, NDArray]) -> NDArray[np.float32]:
        """The next action; it uses only the type in the first observation of an episode."""
        if self._time == 0.0:
            vector = observation["deploy"] if isinstance(observation, dict) else observation
            self._start = list(GRASP_TYPES.values())[int(vector[self._told].argmax())].start
            self._wrist = wrist_choice(self._start) if self._free else np.zeros(0)
        start = self._closes or self._start
        share = min(self._time / CLOSE_TIME, 1.0)
        self._time += 1 / CONTROL_HZ
        action = action_from_synergy(start.preshape + share * (start.closed - start.preshape))
        return np.append(action, self._wrist).astype(np.float32)
