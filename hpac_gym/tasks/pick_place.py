"""HPAC-PickPlace-v0: the paper's four phases. The wrist is scripted; the policy decides when and
how to close and open.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from hpac_gym.body.objects import ObjectSpec
from hpac_gym.errors import ParameterError
from hpac_gym.model import HPAC, Hand
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import HAND_QUATERNION, SceneSetup, SceneState, Viewpoint
from hpac_gym.settings import check_bounds, setting, settings_from
from hpac_gym.tasks.cameras import CameraNoise, ObjectCamera
from hpac_gym.tasks.grasp import PALM_SURFACE, GraspWeights
from hpac_gym.tasks.grip import lengths
from hpac_gym.tasks.phases import PickPlaceTimetable
from hpac_gym.tasks.privileged import PRIVILEGED_TERMS
from hpac_gym.tasks.scripted import ScriptedPickPlace
from hpac_gym.tasks.task import (
    FAILURE,
    RUNNING,
    SUCCESS,
    Task,
    config_option,
    contact_term,
    effort_term,
    open_hand,
    outcome_term,
)
from hpac_gym.tasks.terms import (
    AXES,
    COMMAND_TERMS,
    GRASP_CENTRE,
    LENGTH_UNIT,
    OBJECT_TERMS,
    RewardTerm,
    Term,
    progress_terms,
)

PHASES = ("reach", "close", "lift", "place")
REACH, CLOSE, LIFT, PLACE = range(4)
HAND_AXES = [1, 2, 0]
"""The world's axes along which the hand's x, y and z point with `HAND_QUATERNION`."""


@dataclass(frozen=True, slots=True)
class PickPlaceWeights(GraspWeights):
    """Weights of the dense reward terms."""

    success: float = 20.0
    place: float = 0.5
    release: float = 0.5


@dataclass(frozen=True, slots=True)
class PickPlaceConfig:
    """Uniform sampling ranges of an episode, success criteria, and reward weights.

    Raises:
        ParameterError: A number or a range leaves its bounds.
    """

    radius: tuple[float, float] = setting(
        (0.020, 0.028), "radius of a cylinder, half-width of a box [m]", bounds=(0.002, 0.06)
    )
    half_height: tuple[float, float] = setting(
        (0.068, 0.080),
        "half-height, tall enough for the hand to clear the object's support [m]",
        bounds=(0.005, 0.15),
    )
    mass: tuple[float, float] = setting((0.05, 0.20), "mass of the object [kg]", bounds=(1e-3, 2.0))
    friction: tuple[float, float] = setting(
        (0.6, 1.0),
        "Coulomb coefficient of the object's surface; the hand's skin multiplies it by 0.9",
        bounds=(0.05, 3.0),
    )
    gap: tuple[float, float] = setting(
        (0.006, 0.015),
        "distance from the palm to the object, once the wrist has reached it [m]",
        bounds=(0.0, 0.1),
    )
    towards_thumb: tuple[float, float] = setting(
        (-0.005, 0.010),
        "place of the object's centre along y of the hand frame [m]",
        bounds=(-0.1, 0.1),
    )
    beyond_wrist: tuple[float, float] = setting(
        (0.105, 0.125),
        "place of the object's centre along z of the hand frame, once the wrist has reached it [m]",
        bounds=(0.02, 0.25),
    )
    carry_forward: tuple[float, float] = setting(
        (-0.04, 0.08), "target offset along the fingers [m]", bounds=(-0.3, 0.3)
    )
    carry_aside: tuple[float, float] = setting(
        (0.16, 0.24), "target offset along the palm's normal [m]", bounds=(0.07, 0.4)
    )
    thumb_preshape: float = setting(
        1.2, "initial CMC, at which the thumb opposes the fingers [rad]", bounds=(0.0, 1.57)
    )
    drop_distance: float = setting(
        0.06,
        "displacement from its intended place beyond which an object is dropped [m]",
        bounds=(5e-3, 1.0),
    )
    tolerance: float = setting(
        0.03, "largest horizontal distance from the target [m]", bounds=(1e-3, 0.2)
    )
    upright: float = setting(
        0.05, "largest tilt of an object that stands [rad]", bounds=(1e-3, 1.57)
    )
    timetable: PickPlaceTimetable = field(default_factory=PickPlaceTimetable)
    weights: PickPlaceWeights = field(default_factory=PickPlaceWeights)

    def __post_init__(self) -> None:
        check_bounds(self, "config")


class PickPlace(Task):
    """Draws episodes, judges them, and shapes the reward: a `hpac_gym.tasks.task.Task`.

    Args:
        config: sampling ranges, success criteria and reward weights, or a mapping of some of them.

    Raises:
        ParameterError: Invalid config.
    """

    phases = PHASES
    changing = ("grip", "_grasped_at", "_astray", "_lowered", "_standing")
    viewpoint = Viewpoint(distance=0.62, yaw_deg=115.0, pitch_deg=-25.0)
    privileged_terms = PRIVILEGED_TERMS

    def __init__(
        self,
        config: Annotated[
            PickPlaceConfig | Mapping[str, Any] | None, config_option(PickPlaceConfig)
        ] = None,
    ) -> None:
        self.config = config = settings_from(PickPlaceConfig(), config, "config")
        self.timetable = config.timetable
        ends = self.timetable.ends
        self.ends = (*ends[: LIFT + 1], ends[-1])  # all after the lift is "place"
        self.duration = ends[-1]
        target = Term(
            "target_pos",
            AXES,
            "0.05 m",
            -10.0,
            10.0,
            "target position of the object, as `object_pos`",
            lambda now: (
                (self._target - now.state.palm_offset[:, HAND_AXES] - GRASP_CENTRE) / LENGTH_UNIT
            ),
        )
        self.terms = (*COMMAND_TERMS, *OBJECT_TERMS, *progress_terms(PHASES, self.duration), target)
        weights = config.weights
        self.reward_terms = (
            contact_term(weights, CLOSE),
            RewardTerm(
                "push",
                f"while reaching and closing: {weights.push:g} · min(displacement / drop_distance, 1)",
                lambda now: np.where(
                    now.began <= CLOSE,
                    weights.push * np.minimum(self._astray / config.drop_distance, 1.0),
                    0.0,
                ),
            ),
            RewardTerm(
                "carry",
                f"from the lift until the hand is lowered: {weights.carry:g} for carrying the object free of its "
                "support. Paid any longer, never releasing would be the best policy",
                lambda now: np.where(
                    (now.began > CLOSE) & ~self._lowered,
                    weights.carry * (self.grip.time > 0),
                    0.0,
                ),
            ),
            RewardTerm(
                "place",
                f"while placing: {weights.place:g} for an object that stands at its target, {weights.release:g} "
                "more when the hand has released it",
                lambda now: np.where(
                    (now.began == PLACE) & self._standing,
                    weights.place + weights.release * ~now.state.touching.any(axis=1),
                    0.0,
                ),
            ),
            effort_term(weights),
            outcome_term(weights),
        )

    def prepare(self, num_worlds: int, noise: CameraNoise) -> ObjectCamera:
        self._place, self._target, self._grasped_at = (np.zeros((num_worlds, 3)) for _ in range(3))
        self._astray, self._lowered, self._standing = (
            np.zeros(num_worlds, dtype=kind) for kind in (float, bool, bool)
        )
        return super().prepare(num_worlds, noise)

    def setup(self, rng: np.random.Generator, hand: Hand = HPAC) -> SceneSetup:
        """Draw one episode: the object, its position in front of the hand, its target, and the open
        hand.
        """
        config = self.config
        shape = ("cylinder", "box")[rng.integers(2)]
        width = rng.uniform(*config.radius)
        height = rng.uniform(*config.half_height)
        spec = ObjectSpec(
            shape, (width, width, height), rng.uniform(*config.mass), rng.uniform(*config.friction)
        )
        place = np.array(
            [
                PALM_SURFACE + width + rng.uniform(*config.gap),
                rng.uniform(*config.towards_thumb),
                rng.uniform(*config.beyond_wrist),
            ]
        )
        forward, aside, up = self.timetable.reach
        place += [aside, up, forward]
        target = place + np.array(
            [rng.uniform(*config.carry_aside), 0.0, rng.uniform(*config.carry_forward)]
        )
        return SceneSetup(spec, place, 0.0, open_hand(config.thumb_preshape), hand, target=target)

    def check(self, setup: SceneSetup) -> None:
        """Refuse a setup without a target, or with a turned hand, whose wrist has another path."""
        if setup.target is None:
            raise ParameterError("a setup of PickPlace needs a target, shape (3,) [m], not None")
        if setup.hand_quaternion != HAND_QUATERNION:
            raise ParameterError(
                f"setup hand_quaternion = {setup.hand_quaternion}: PickPlace has no other than {HAND_QUATERNION}"
            )

    def start(self, worlds: Sequence[int], setups: Sequence[SceneSetup]) -> None:
        super().start(worlds, setups)
        index = np.asarray(worlds)
        self._place[index] = [s.position for s in setups]
        self._target[index] = [s.target for s in setups]

    def wrist_path(self, setup: SceneSetup, times: tuple[float, ...]) -> Array:
        """Offset of the wrist at times [s], along the world's axes, shape (len(times), 3) [m], via
        the setup's target.
        """
        aside, up, forward = setup.target - setup.position
        return self.timetable.wrist_path(times, np.array([forward, aside, up]))

    def judge(self, state: SceneState, dt: float) -> NDArray[np.int_]:
        """Advance by one control step and judge the episodes.

        An episode fails as soon as the object is knocked away before the lift, or lost between lift
        and release. It succeeds at the end of the timetable if the object stands at its target and
        the hand does not touch it."""
        config = self.config
        touched = state.touching.any(axis=1)
        self.grip.follow(state.object_pos, touched, state.supported, dt)
        # Along the hand's axes, from the hand's initial position.
        away = state.object_pos + state.palm_offset[:, HAND_AXES]
        _, close, _, _, lowered, *_ = self.timetable.ends
        closing = state.time < close + dt / 2
        self._lowered = state.time > lowered - dt / 2
        up = state.object_rotation[:, HAND_AXES.index(2), 2]
        self._standing = state.on_target & (np.arccos(np.clip(up, -1.0, 1.0)) < config.upright)
        self._grasped_at[closing] = state.object_pos[closing]
        reference = np.where(closing[:, None], self._place, self._target)
        carried = ~closing & (state.time < lowered - dt / 2)
        way = np.where(carried[:, None], state.object_pos - self._grasped_at, away - reference)
        self._astray = lengths(way)
        beside = lengths((away - self._target)[:, [0, 2]])
        placed = self._standing & ~touched & (beside < config.tolerance)
        over = state.time >= self.duration - dt / 2
        ended = np.where(over, np.where(placed, SUCCESS, FAILURE), RUNNING)
        return np.where(self._astray > config.drop_distance, FAILURE, ended)

    def script(self) -> ScriptedPickPlace:
        return ScriptedPickPlace(self.timetable)
