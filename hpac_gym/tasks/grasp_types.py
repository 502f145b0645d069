"""HPAC-GraspType-v0: the paper's sixteen grasps with one policy for all, each judged by the rule of
its type.

A grasp type has no hand shape of its own: its hand closes to the posture of the same name in
`hpac_gym.model.POSTURES` by Eqs. (14) and (15), without retuning, and the object is placed to fit
that posture. ``data/grasp_types.toml`` has the placement and the rule by which the grasp is judged
(`hpac_gym.tasks.grasp_rules`)."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.resources import files
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hpac_gym.body.object_models import load_object_models
from hpac_gym.errors import ParameterError
from hpac_gym.model import (
    HPAC,
    POSTURES,
    SERVOS,
    Hand,
    action_from_synergy,
    clip_synergy,
    clip_to_workspace,
    joints_from_synergy,
    synergy_from_action,
    synergy_from_joints,
)
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import (
    HAND_POSITION,
    HAND_QUATERNION,
    PARTS,
    Contacts,
    SceneSetup,
    SceneState,
    matrix_from_quaternion,
)
from hpac_gym.physics.supports import POST, TABLE_HALF_EXTENTS, support_boxes
from hpac_gym.settings import check_bounds, setting
from hpac_gym.tasks.cameras import CameraNoise, ObjectCamera
from hpac_gym.tasks.grasp import CLOSE, Grasp
from hpac_gym.tasks.grasp_data import NOMINAL, GraspError, NamedGrasp, grasps_from_toml
from hpac_gym.tasks.grasp_rules import ASKED, Hold, Hole, Rule, look_at
from hpac_gym.tasks.grasp_setups import quaternion_from_rpy, setup_of_grasp
from hpac_gym.tasks.occlusion import SKIN, Skeleton
from hpac_gym.tasks.options import Option, check_choice, config_option
from hpac_gym.tasks.phases import CONTROL_HZ, Timetable
from hpac_gym.tasks.scripted import CLOSE_TIME, Script
from hpac_gym.tasks.task import (
    FAILURE,
    FINGER_PARTS,
    SUCCESS,
    THUMB_PART,
    effort_term,
    outcome_term,
)
from hpac_gym.tasks.terms import (
    COMMAND_TERMS,
    OBJECT_TERMS,
    Layout,
    Moment,
    RewardTerm,
    Term,
    progress_terms,
)

HELD_OUT_TYPES = ("large_sphere", "three_finger_pinch", "screwdriver", "tape_roll")
"""Held-out types, never used in training. Chosen: each is similar to one of the others."""
OBJECTS = ("train", "test")
WRISTS = ("free", "script")
WRIST_ACTIONS = ("grasp_x", "grasp_y", "grasp_z", "turn_x", "turn_y", "turn_z")
START = np.array([0.20, 0.0, 0.11])
"""Centre of the object in the hand frame when an episode with a free wrist begins: out of reach
[m].
"""
WRIST_CENTRE = np.array([0.06, 0.0, 0.11])
WRIST_REACH = 0.065
"""Object centre in the hand frame for a wrist action of 0, and its displacement along the hand's
axes for one of 1 [m].
"""
WRIST_TURN = 2.0
"""Component of the rotation vector from `HAND_QUATERNION`, along the hand's axes, for an action of
1 [rad].
"""
SETTLES = 0.002
"""Displacement in the first step beyond which the arriving hand has pushed the object; settling
alone takes 1 mm [m].
"""
ALONG = 9
"""Points along each link at which it is compared with the support, at most 8 mm apart."""
LOOK_EVERY = 4
"""Control steps between two evaluations of the contacts of a hold, since one takes about as long as
a step.
"""
NOTHING = "nothing touches"
"""Missed clause of a hold that has not been evaluated."""
_SKELETON = Skeleton(1)


@dataclass(frozen=True, slots=True)
class GraspType:
    """One of the sixteen types: the placement of its object for the posture, and the rule that
    defines it.
    """

    start: NamedGrasp
    """Object, wrist and support; `closed` is the synergy of the posture of the same name."""
    rule: Rule


def synergy_of_posture(name: str, hand: Hand = HPAC) -> Array:
    """Synergy that reaches a posture's q_d by Eqs. (14) and (15), shape (6,) [rad], read-only."""
    target = clip_to_workspace(POSTURES[name].target_joint_pos, hand)
    synergy = clip_synergy(synergy_from_joints(target, hand), hand)
    synergy.setflags(write=False)
    return synergy


def grasp_types_from_toml(text: str) -> dict[str, GraspType]:
    """Types described by a TOML text: each is a grasp as in ``grasps.toml`` without `closed`, and
    its `rule`.

    Raises:
        ParameterError: Not TOML, a name without a posture, or a field that is missing, unknown or
            out of bounds.
    """
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ParameterError(f"grasp types: {error}") from None
    rules = {}
    for name, entry in table.items():
        if name == "held_out":
            continue
        if name not in POSTURES:
            raise ParameterError(f"grasp type {name}: there is no posture of this name")
        if "closed" in entry:
            raise ParameterError(
                f"grasp type {name}: unknown fields closed; the posture {name} says how the hand closes"
            )
        try:
            rules[name] = _rule(entry.pop("rule"))
        except KeyError as error:
            raise ParameterError(f"grasp type {name}: {error.args[0]} is missing") from None
        except (TypeError, ValueError) as error:
            raise ParameterError(f"grasp type {name}: {error}") from None
    starts = grasps_from_toml(
        table, load_object_models(), {name: synergy_of_posture(name) for name in rules}
    )
    return {name: GraspType(start, rules[name]) for name, start in starts.items()}


def _rule(entry: dict[str, Any]) -> Rule:
    holes = tuple(
        Hole(tuple(hole["centre"]), hole["axis"], tuple(hole["half"]))
        for hole in entry.pop("holes", ())
    )
    return Rule(
        holes=holes,
        **{key: tuple(value) if isinstance(value, list) else value for key, value in entry.items()},
    )


def data_text() -> str:
    """Text of ``data/grasp_types.toml``."""
    return (files("hpac_gym.tasks") / "data" / "grasp_types.toml").read_text(encoding="utf-8")


GRASP_TYPES: Mapping[str, GraspType] = MappingProxyType(grasp_types_from_toml(data_text()))
"""All grasp types by name, in the order of the paper's panels."""
TYPE_SPLITS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "all": tuple(GRASP_TYPES),
        "train": tuple(name for name in GRASP_TYPES if name not in HELD_OUT_TYPES),
        "test": HELD_OUT_TYPES,
    }
)
TYPE_TERMS = (
    Term(
        "type",
        tuple(GRASP_TYPES),
        "0/1",
        0.0,
        1.0,
        "requested grasp type, one-hot",
        lambda setup: [float(setup.grasp == name) for name in GRASP_TYPES],
        fixed=True,
    ),
    Term(
        "asked_parts",
        PARTS,
        "1",
        -1.0,
        1.0,
        "1 for a part that must touch the object, −1 for one that must not",
        lambda setup: GRASP_TYPES[setup.grasp].rule.asked_parts,
        fixed=True,
    ),
    Term(
        "asked",
        ASKED,
        "1, 10 N, rad",
        -1.0,
        4.0,
        "other conditions: least numbers of fingers and digits that touch, only "
        "last links, least force, least force on the button, shares of the force along the object's axes (negative: across), "
        "side of the index, thumb through an opening, largest turn in the hand and of the object's axis",
        lambda setup: GRASP_TYPES[setup.grasp].rule.asked,
        fixed=True,
    ),
)
"""Encoding of the type for a policy: its name, and the conditions of its rule, which also describe
unseen types.
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
    changing = (
        *(*Grasp.changing, "held", "free", "kept", "_touch", "_never", "_counts"),
        *("_hand", "_rotation", "_seen", "_rules", "_types", "_missed"),
    )

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
        self.kinds = tuple(GRASP_TYPES[name] for name in _names(types))
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
                lambda now: np.where(now.began == CLOSE, self._paid_touch(now.state), 0.0),
            ),
            self._push_term(),
            RewardTerm(
                "carry",
                f"afterwards: {weights.carry:g} · (1 − slip / MAX_SLIP) for an object that the hand carries free of its support, "
                "times the score of the type's rule: the mean over its clauses at the last evaluation",
                lambda now: np.where(
                    now.began == CLOSE, 0.0, weights.carry * self.grip.firmness * self.kept
                ),
            ),
            effort_term(weights),
            outcome_term(weights),
        )

    def _paid_touch(self, state: SceneState) -> Array:
        weights = self.config.weights
        return weights.touch * self._touched_share(state.touching) + weights.avoid * (
            state.touching & self._never
        ).sum(axis=1)

    def _touched_share(self, touching: NDArray[np.bool_]) -> Array:
        """Fraction of the required parts that touch, shape (n,)."""
        fingers = touching[:, FINGER_PARTS].sum(axis=1)
        counts = np.stack([fingers, fingers + touching[:, THUMB_PART]], axis=1)
        found = (touching & self._touch).sum(axis=1) + np.minimum(counts, self._counts).sum(axis=1)
        return found / np.maximum(self._touch.sum(axis=1) + self._counts.sum(axis=1), 1)

    # Episodes
    # ------------------------------------------------------------------------------------------------------

    def prepare(self, num_worlds: int, noise: CameraNoise) -> ObjectCamera:
        self._touch, self._never = np.zeros((2, num_worlds, len(PARTS)), dtype=bool)
        self._counts = np.zeros((num_worlds, 2), dtype=int)
        self._rotation, self._hand = np.zeros((2, num_worlds, 3, 3))
        self._seen, self._rules, self._types, self._missed = (
            np.full(num_worlds, "", dtype=object) for _ in range(4)
        )
        self.held = np.zeros(num_worlds, bool)
        self.free = np.ones(num_worlds, bool)
        self.kept = np.zeros(num_worlds)
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
        if not self.wrist_actions:
            return setup
        return _elsewhere(
            setup, np.zeros(len(SERVOS)), START + setup.position - start.position, HAND_QUATERNION
        )

    def chosen(self, setup: SceneSetup, action: Array) -> SceneSetup:
        """The setup requested by an episode's first action, shape (12,): hand synergy, wrist
        position and rotation.

        The object's position noise is kept, since the arm does not know it.
        """
        place, turn = np.split(action[len(SERVOS) :], 2)
        rotation = Rotation.from_quat(HAND_QUATERNION) * Rotation.from_rotvec(WRIST_TURN * turn)
        position = WRIST_CENTRE + WRIST_REACH * place + setup.position - START
        return _elsewhere(
            setup,
            synergy_from_action(action[: len(SERVOS)], setup.hand),
            position,
            rotation.as_quat(),
        )

    def start(self, worlds: Sequence[int], setups: Sequence[SceneSetup]) -> None:
        """Begin to judge episodes in some worlds.

        Raises:
            ParameterError: A given setup names no grasp type.
        """
        super().start(worlds, setups)
        for world, setup in zip(worlds, setups, strict=True):
            name = getattr(setup, "grasp", None)
            if name not in GRASP_TYPES:
                raise ParameterError(f"setup grasp {name!r} is not one of {', '.join(GRASP_TYPES)}")
            rule = GRASP_TYPES[name].rule.scaled(setup.object.scale)
            parts = np.array(rule.asked_parts)
            self._touch[world] = parts > 0
            self._never[world] = parts < 0
            self._counts[world] = (rule.fingers, rule.digits)
            self._rules[world] = rule
            self._types[world] = name
            self._missed[world] = NOTHING
            self._seen[world] = ()
            self._hand[world] = setup.hand_rotation
            self._rotation[world] = setup.hand_rotation.T @ matrix_from_quaternion(
                setup.object_turn[0]
            )
            self.held[world] = False
            self.kept[world] = 0.0
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
        self.kept = np.where(since < 0, self._touched_share(state.touching), self.kept)
        for world in np.flatnonzero(looks):
            if since[world] == 0:
                self._seen[world] = ()
            self.look(world, state, contacts(world))

    def look(self, world: int, state: SceneState, contacts: Contacts) -> None:
        """Add the current contacts of a world to its hold, and evaluate its rule."""
        self._seen[world] += (look_at(contacts, state, world, self._hand[world]),)
        clauses = self._rules[world].clauses(self.hold(world))
        self.kept[world] = np.mean(list(clauses.values()))
        self._missed[world] = "; ".join(name for name, value in clauses.items() if value < 1)

    def hold(self, world: int) -> Hold:
        """The hold of a world as observed so far."""
        return Hold(self._seen[world], self._rotation[world].copy())

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
        return np.where(~self.free | (self.held & (self._missed != "")), FAILURE, outcome)

    def report(self, now: Moment) -> dict[str, Any]:
        return super().report(now) | {
            "type": self._types.copy(),
            "held": self.held.copy(),
            "kept": self.kept.copy(),
            "missed": self._missed.copy(),
        }

    def script(self) -> ScriptedGraspType:
        return ScriptedGraspType(self)


def _names(types: str | Sequence[str]) -> tuple[str, ...]:
    if isinstance(types, str):
        types = TYPE_SPLITS.get(types, (types,))
    names = types if isinstance(types, list | tuple) else (types,)
    if not names or (
        unknown := [name for name in names if not isinstance(name, str) or name not in GRASP_TYPES]
    ):
        wrong = unknown[0] if names else types
        raise GraspError(
            f"no grasp type {wrong!r}; there are {', '.join((*TYPE_SPLITS, *GRASP_TYPES))}"
        )
    return tuple(names)


def in_the_way(setup: SceneSetup) -> bool:
    """True if the hand at the start of an episode has its thumb inside a finger, or penetrates the
    support of its object or the table.

    Judged by geometry: a digit that is wedged against a support stays about its joint's stop.
    """
    joint_pos = joints_from_synergy(setup.synergy, setup.hand)
    if _SKELETON.thumb_in_finger(joint_pos, 0):
        return True
    first, second = (
        HAND_POSITION + ends[0] @ setup.hand_rotation.T
        for ends in _SKELETON.segments(joint_pos[None], np.array([0]))
    )
    bones = first + np.linspace(0, 1, ALONG)[:, None, None] * (second - first)
    boxes, table, _, turn = support_boxes(setup)
    turned = (matrix_from_quaternion(turn), *(np.array(box) for box in zip(*boxes, strict=True)))
    level = np.eye(3), np.array([TABLE_HALF_EXTENTS]), np.array([table])
    for rotation, half, centre in (turned, level):
        outside = np.abs((bones[:, :, None] - centre) @ rotation) - half
        distance = np.linalg.norm(np.maximum(outside, 0.0), axis=-1)
        if (distance < SKIN * _SKELETON.radius[0, :, None]).any():
            return True
    return False


def _elsewhere(
    setup: SceneSetup, synergy: Array, position: Array, quaternion: Sequence[float]
) -> SceneSetup:
    """The setup with another synergy, another object position in the hand frame, and another hand
    orientation.

    Engines keep the wrist in place, so the object, its support and the table move up or down
    instead."""
    rises = (matrix_from_quaternion(quaternion) @ position - setup.hand_rotation @ setup.position)[
        2
    ]
    support = setup.support or POST
    return replace(
        setup,
        synergy=synergy,
        position=position,
        hand_quaternion=tuple(map(float, quaternion)),
        support=replace(support, table_height=support.table_height + float(rises)),
    )


def wrist_choice(start: NamedGrasp) -> Array:
    """Last six numbers of the first action that moves the wrist to the pose of a type's data, shape
    (6,), −1…1.
    """
    turn = Rotation.from_quat(HAND_QUATERNION).inv() * Rotation.from_quat(
        quaternion_from_rpy(start.hand_rpy)
    )
    return np.concatenate(
        [(np.array(start.position) - WRIST_CENTRE) / WRIST_REACH, turn.as_rotvec() / WRIST_TURN]
    )


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
