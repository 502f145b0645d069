"""The grasp task: close on an object, lift it, keep it through a shake, and bring it down again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hpac_gym.body.objects import SHAPES, ObjectSpec, Support
from hpac_gym.body.own_objects import as_object
from hpac_gym.errors import ParameterError
from hpac_gym.model import HPAC, Hand
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import SceneSetup, SceneState
from hpac_gym.settings import check_bounds, setting, settings_from
from hpac_gym.tasks.cameras import CameraNoise, ObjectCamera
from hpac_gym.tasks.grasp_data import (
    GRASPS,
    NOMINAL,
    GraspError,
    NamedGrasp,
    Variant,
    named_grasp,
)
from hpac_gym.tasks.grip import Grip, lengths
from hpac_gym.tasks.options import Option, config_option
from hpac_gym.tasks.phases import PHASES, Timetable, phase_at, wrist_table
from hpac_gym.tasks.scripted import Script, ScriptedClosure
from hpac_gym.tasks.task import (
    FAILURE,
    RUNNING,
    SUCCESS,
    Task,
    contact_term,
    effort_term,
    open_hand,
    outcome_term,
)
from hpac_gym.tasks.terms import (
    COMMAND_TERMS,
    OBJECT_TERMS,
    PRIVILEGED_TERMS,
    Moment,
    RewardTerm,
    progress_terms,
)

PALM_SURFACE = 0.0125
"""Distance of the palm's surface from the yz-plane of the hand frame [m]."""

CLOSE = PHASES.index("close")
OBJECT_RANGES = ("radius", "sphere_radius", "half_height", "mass", "friction")
"""Fields of `GraspConfig` that draw the object itself."""


@dataclass(frozen=True, slots=True)
class GraspWeights:
    """Weights of the dense reward terms."""

    thumb: float = 0.1
    finger: float = 0.05
    opposed: float = 0.2
    push: float = -0.3
    carry: float = 0.5
    effort: float = -0.01
    success: float = 10.0
    failure: float = -5.0


@dataclass(frozen=True, slots=True)
class GraspConfig:
    """Uniform sampling ranges of an episode, drop criterion, and reward weights.

    Raises:
        ParameterError: A number or a range leaves its bounds.
    """

    radius: tuple[float, float] = setting(
        (0.010, 0.030), "half width of a box, radius of a cylinder [m]", bounds=(0.002, 0.06)
    )
    sphere_radius: tuple[float, float] = setting(
        (0.020, 0.033),
        "radius of a sphere, a golf ball's to a tennis ball's; smaller ones roll off before the hand closes [m]",
        bounds=(0.002, 0.06),
    )
    half_height: tuple[float, float] = setting(
        (0.030, 0.060), "half-height of a box or cylinder [m]", bounds=(0.005, 0.15)
    )
    mass: tuple[float, float] = setting((0.05, 0.25), "mass of the object [kg]", bounds=(1e-3, 2.0))
    friction: tuple[float, float] = setting(
        (0.6, 1.0),
        "Coulomb coefficient of the object's surface; the hand's skin multiplies it by 0.9",
        bounds=(0.05, 3.0),
    )
    gap: tuple[float, float] = setting(
        (0.003, 0.030), "distance from the palm to the object [m]", bounds=(0.0, 0.1)
    )
    towards_thumb: tuple[float, float] = setting(
        (-0.030, 0.035),
        "place of the object's centre along y of the hand frame [m]",
        bounds=(-0.1, 0.1),
    )
    beyond_wrist: tuple[float, float] = setting(
        (0.095, 0.140),
        "place of the object's centre along z of the hand frame [m]",
        bounds=(0.02, 0.25),
    )
    box_yaw: tuple[float, float] = setting(
        (-0.8, 0.8), "yaw of a box about the vertical [rad]", bounds=(-np.pi, np.pi)
    )
    thumb_preshape: float = setting(
        1.2, "initial CMC, at which the thumb opposes the fingers [rad]", bounds=(0.0, 1.57)
    )
    drop_distance: float = setting(
        0.06, "displacement in the hand beyond which an object is dropped [m]", bounds=(5e-3, 1.0)
    )
    timetable: Timetable = field(default_factory=Timetable)
    weights: GraspWeights = field(default_factory=GraspWeights)

    def __post_init__(self) -> None:
        check_bounds(self, "config")


RANGES = tuple(
    entry.name
    for entry in fields(GraspConfig)
    if "bounds" in entry.metadata and entry.name != "drop_distance"
)
"""Fields of `GraspConfig` that draw an episode."""
GRASP_OPTION = Option(
    "a named grasp with its object; None draws a primitive in front of the open hand",
    (None, *GRASPS),
)
VARIANT_OPTION = Option(
    "variant of a named grasp's object",
    (NOMINAL, *dict.fromkeys(name for grasp in GRASPS.values() for name in grasp.held_out)),
)
CONFIG_OPTION = config_option(GraspConfig)
OBJECT_OPTION = Option(
    "object that replaces the primitive, such as one that `own_object` loads from a file; a "
    "dictionary has the arguments of `own_object`",
    (None,),
    "`hpac_gym.body.objects.ObjectSpec`, dictionary",
)


class Grasp(Task):
    """Draws episodes, judges them, and shapes the reward: a `hpac_gym.tasks.task.Task`.

    Args:
        config: sampling ranges, drop criterion, timetable and reward weights, or a mapping of some
            of them.
        object: the object of every episode; a dictionary holds the arguments of `own_object`, and
            None draws a primitive.

    Raises:
        ParameterError: Invalid config or object, or a config with ranges for an object of one's
            own.
    """

    phases = PHASES
    shapes: tuple[str, ...] = SHAPES
    """Shapes of the primitives, equally likely."""
    privileged_terms = PRIVILEGED_TERMS
    changing = ("grip", "_place", "_moved", "_lifted")
    config_class = GraspConfig

    def __init__(
        self,
        config: Annotated[GraspConfig | Mapping[str, Any] | None, CONFIG_OPTION] = None,
        object: Annotated[ObjectSpec | Mapping[str, Any] | None, OBJECT_OPTION] = None,
    ) -> None:
        self.config = settings_from(self.config_class(), config, "config")
        self.timetable = self.config.timetable
        self.object = None if object is None else as_object(object)
        if object is not None:
            self._refuse_ranges(
                OBJECT_RANGES, "an object of one's own has its own size, mass and friction"
            )
        self.duration = self.timetable.ends[-1]
        self.terms = (*COMMAND_TERMS, *OBJECT_TERMS, *progress_terms(PHASES, self.duration))
        self.reward_terms = self._rewards()

    def _refuse_ranges(self, names: Sequence[str], reason: str) -> None:
        """Raise `ParameterError` for a config with other than the default ranges of these names."""
        default = self.config_class()
        if given := [n for n in names if getattr(self.config, n) != getattr(default, n)]:
            raise ParameterError(f"config {', '.join(given)}: {reason}")

    def _rewards(self) -> tuple[RewardTerm, ...]:
        weights = self.config.weights
        return (
            contact_term(weights, CLOSE),
            self._push_term(),
            RewardTerm(
                "carry",
                f"afterwards: {weights.carry:g} · (1 − slip / MAX_SLIP) for an object that the hand carries free "
                "of its support",
                self._carry,
            ),
            effort_term(weights),
            outcome_term(weights),
        )

    def prepare(self, num_worlds: int, noise: CameraNoise) -> ObjectCamera:
        self.grip = Grip(num_worlds)
        self._place = np.zeros((num_worlds, 3))
        self._moved = np.zeros(num_worlds)
        self._lifted = np.zeros(num_worlds, dtype=bool)
        return ObjectCamera(num_worlds, noise)

    def setup(self, rng: np.random.Generator, hand: Hand = HPAC) -> SceneSetup:
        """Draw one episode: the object, its place in front of the palm, and the open hand."""
        config = self.config
        shape = self.shapes[rng.integers(len(self.shapes))]
        width = rng.uniform(*config.radius)
        depth = rng.uniform(*config.radius)
        height = rng.uniform(*config.half_height)
        yaw = rng.uniform(*config.box_yaw)
        ball = rng.uniform(*config.sphere_radius)
        extents = {
            "cylinder": (width, width, height),
            "box": (width, depth, height),
            "sphere": (ball, ball, ball),
        }[shape]
        spec = ObjectSpec(shape, extents, rng.uniform(*config.mass), rng.uniform(*config.friction))
        if self.object is not None:
            spec = self.object
            shape = spec.shape
            (width, depth, _) = spec.half_extents
        reach = (
            width * abs(np.sin(yaw)) + depth * np.cos(yaw)
            if shape == "box"
            else spec.half_extents[0]
        )
        place = [
            PALM_SURFACE + reach + rng.uniform(*config.gap),
            rng.uniform(*config.towards_thumb),
            rng.uniform(*config.beyond_wrist),
        ]
        return SceneSetup(spec, np.array(place), yaw, open_hand(config.thumb_preshape), hand)

    def start(self, worlds: Sequence[int], setups: Sequence[SceneSetup]) -> None:
        index = np.asarray(worlds)
        self._place[index] = [setup.position for setup in setups]
        self._moved[index] = 0.0
        self._lifted[index] = False
        self.grip.start(index)

    def wrist_path(self, setup: SceneSetup, times: tuple[float, ...]) -> Array:
        return wrist_table(self.timetable, times)

    def phase(self, time: Array) -> NDArray[np.int_]:
        return phase_at(time, self.timetable.ends)

    def judge(self, state: SceneState, dt: float) -> NDArray[np.int_]:
        """Advance the hold timers by one control step and judge the episodes.

        An episode fails as soon as the object is knocked away, or after the lift once the hand does
        not hold it (`Grip`). It succeeds at the end of the timetable if the object was held through
        the shake in six directions and not dropped on the way down."""
        self.grip.follow(state.object_pos, state.touching.any(axis=1), state.supported, dt)
        lifted = state.time > self.timetable.ends[1] - dt / 2
        self.grip.settle(lifted & ~self._lifted)
        self._lifted = lifted
        self._moved = lengths(state.object_pos - self._place)
        failed = (self._moved > self.config.drop_distance) | (lifted & ~self.grip.holds)
        over = state.time >= self.duration - dt / 2
        return np.where(failed, FAILURE, np.where(over, SUCCESS, RUNNING))

    def _push_term(self) -> RewardTerm:
        weight = self.config.weights.push

        def value(now: Moment) -> Array:
            return np.where(
                now.began == CLOSE,
                weight * np.minimum(self._moved / self.config.drop_distance, 1.0),
                0.0,
            )

        return RewardTerm(
            "push", f"while closing: {weight:g} · min(displacement / drop_distance, 1)", value
        )

    def _carry(self, now: Moment) -> Array:
        return np.where(now.began == CLOSE, 0.0, self.config.weights.carry * self.grip.firmness)


class GraspByName(Grasp):
    """Draws episodes of one named grasp; judges and rewards them as `Grasp` does.

    Args:
        name: name of the grasp.
        variant: variant of its object; "nominal", or a held-out one.
        config: drop criterion, timetable and reward weights; it has no ranges.

    Raises:
        GraspError: No grasp or variant has that name.
        ParameterError: Invalid config, or one with ranges.
    """

    def __init__(
        self,
        name: str,
        variant: str = NOMINAL,
        config: GraspConfig | Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__(config)
        self.grasp = named_grasp(name)
        self.variant = self.grasp.variant(variant)
        reason = f"a named grasp such as {name!r} has its own object, place and hand"
        self._refuse_ranges(RANGES, reason)

    def setup(self, rng: np.random.Generator, hand: Hand = HPAC) -> SceneSetup:
        """Draw one episode: the object's position in the hand frame, and its rotation about the
        vertical.
        """
        return setup_of_grasp(self.grasp, self.variant, rng, hand)

    def script(self) -> Script:
        return ScriptedClosure(self.grasp)


def grasp_task(
    grasp: Annotated[str | None, GRASP_OPTION] = None,
    variant: Annotated[str, VARIANT_OPTION] = NOMINAL,
    object: Annotated[ObjectSpec | Mapping[str, Any] | None, OBJECT_OPTION] = None,
    config: Annotated[GraspConfig | Mapping[str, Any] | None, CONFIG_OPTION] = None,
) -> Grasp:
    """The task of `HPAC-Grasp-v0`.

    Args:
        grasp: name of one of the sixteen `GRASPS`; None draws a primitive in front of the open
            hand.
        variant: variant of a named grasp's object, such as "large" or "slippery"; see
            `tasks/data/grasps.toml`.
        object: as for `Grasp`.
        config: as for `Grasp`.

    Raises:
        GraspError: Unknown grasp or variant; or `variant` without a named grasp, or `object` with
            one.
        ParameterError: As from `Grasp` and `GraspByName`.
    """
    if grasp is None:
        if variant != NOMINAL:
            raise GraspError(f"variant {variant!r} needs a named grasp: grasp=NAME")
        return Grasp(config, object)
    if object is not None:
        raise GraspError(f"grasp {grasp!r} has its own object: give either grasp or object")
    return GraspByName(grasp, variant, config)


def setup_of_grasp(
    grasp: NamedGrasp,
    variant: Variant,
    rng: np.random.Generator,
    hand: Hand = HPAC,
    spread: float = 1.0,
) -> SceneSetup:
    """Draw one episode of a named grasp, with `spread` times its position and yaw noise."""
    model = variant.object or grasp.object
    spec = ObjectSpec(
        model.shape,
        tuple(variant.scale * half for half in model.half_extents),
        variant.mass * model.mass,
        variant.friction * grasp.friction,
        model.name,
        variant.scale,
    )
    noise = spread * rng.uniform(-1.0, 1.0, 4)
    return SceneSetup(
        spec,
        np.array(grasp.position) + noise[:3] * grasp.position_noise,
        float(noise[3] * grasp.yaw_noise),
        grasp.preshape,
        hand,
        hand_quaternion=quaternion_from_rpy(grasp.hand_rpy),
        object_quaternion=quaternion_from_rpy(grasp.object_rpy),
        support=_scaled(grasp.support, variant.scale),
    )


def quaternion_from_rpy(rpy: tuple[float, float, float]) -> tuple[float, float, float, float]:
    """The quaternion xyzw of URDF's fixed-axis roll, pitch, yaw: Rz(yaw) Ry(pitch) Rx(roll)."""
    x, y, z, w = Rotation.from_euler("xyz", rpy).as_quat().tolist()
    return x, y, z, w


def _scaled(support: Support, scale: float) -> Support:
    """The support with the distance between its walls scaled like the object."""
    gap: Array | None = None if support.gap is None else np.array(support.gap) * scale
    return replace(support, gap=None if gap is None else tuple(gap.tolist()))
