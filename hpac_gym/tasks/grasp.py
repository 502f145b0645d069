"""The grasp task: close on an object, lift it, keep it through a shake, and bring it down again."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from hpac_gym.body.objects import SHAPES, ObjectSpec
from hpac_gym.body.own_objects import as_object
from hpac_gym.errors import ParameterError
from hpac_gym.model import HPAC, Hand
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import SceneSetup, SceneState
from hpac_gym.settings import check_bounds, setting, settings_from
from hpac_gym.tasks.grasp_data import (
    GRASPS,
    NOMINAL,
    GraspError,
    named_grasp,
    setup_of_grasp,
)
from hpac_gym.tasks.occlusion import SKIN, points_in_object
from hpac_gym.tasks.phases import PHASES, Timetable, wrist_table
from hpac_gym.tasks.privileged import PRIVILEGED_TERMS
from hpac_gym.tasks.scripted import Script, ScriptedClosure
from hpac_gym.tasks.task import (
    FAILURE,
    RUNNING,
    SUCCESS,
    Option,
    Task,
    carry_term,
    config_option,
    contact_term,
    effort_term,
    open_hand,
    outcome_term,
)
from hpac_gym.tasks.terms import (
    COMMAND_TERMS,
    OBJECT_TERMS,
    RewardTerm,
    progress_terms,
)

CLOSE = PHASES.index("close")
SHAKE = PHASES.index("shake")
PLACES = 50
MOST_PLACES = 1_000
"""Places that are drawn for an object of one's own: before it is refused, and in an episode."""
PALM_SURFACE = 0.0125
"""Distance of the palm's surface from the yz-plane of the hand frame [m]."""

OBJECT_RANGES = ("radius", "sphere_radius", "half_height", "mass", "friction")
"""Fields of `GraspConfig` that draw the object itself."""
GRASP_OPTION = Option(
    "a named grasp with its object; None draws a primitive in front of the open hand",
    (None, *GRASPS),
)
VARIANT_OPTION = Option(
    "variant of a named grasp's object",
    (NOMINAL, *dict.fromkeys(name for grasp in GRASPS.values() for name in grasp.held_out)),
)
OBJECT_OPTION = Option(
    "object that replaces the primitive, such as one that `own_object` loads from a file; a "
    "dictionary has the arguments of `own_object`",
    (None,),
    "`hpac_gym.body.objects.ObjectSpec`, dictionary",
)


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


class Grasp(Task):
    """Draws episodes, judges them, and shapes the reward: a `hpac_gym.tasks.task.Task`.

    Args:
        config: sampling ranges, drop criterion, timetable and reward weights, or a mapping of some
            of them.
        object: the object of every episode; a dictionary holds the arguments of `own_object`, and
            None draws a primitive.
        grasp: name of one of the sixteen `GRASPS`, with its own object, place and hand; None places
            the object in front of the open hand.
        variant: variant of a named grasp's object, such as "large" or "slippery"; see
            `tasks/data/grasps.toml`.

    Raises:
        GraspError: Unknown grasp or variant; or `variant` without a named grasp, or `object` with
            one.
        ParameterError: Invalid config or object, or a config with ranges that a named grasp or an
            object of one's own does not have.
    """

    phases = PHASES
    shapes: tuple[str, ...] = SHAPES
    """Shapes of the primitives, equally likely."""
    privileged_terms = PRIVILEGED_TERMS
    config_class = GraspConfig

    def __init__(
        self,
        config: Annotated[
            GraspConfig | Mapping[str, Any] | None, config_option(GraspConfig)
        ] = None,
        object: Annotated[ObjectSpec | Mapping[str, Any] | None, OBJECT_OPTION] = None,
        grasp: Annotated[str | None, GRASP_OPTION] = None,
        variant: Annotated[str, VARIANT_OPTION] = NOMINAL,
    ) -> None:
        if grasp is None and variant != NOMINAL:
            raise GraspError(f"variant {variant!r} needs a named grasp: grasp=NAME")
        if grasp is not None and object is not None:
            raise GraspError(f"grasp {grasp!r} has its own object: give either grasp or object")
        self.config = settings_from(self.config_class(), config, "config")
        self.timetable = self.config.timetable
        self.object = None if object is None else as_object(object)
        if object is not None:
            self._refuse_ranges(
                OBJECT_RANGES, "an object of one's own has its own size, mass and friction"
            )
        self.grasp = None if grasp is None else named_grasp(grasp)
        if self.grasp is not None:
            self.variant = self.grasp.variant(variant)
            reason = f"a named grasp such as {grasp!r} has its own object, place and hand"
            self._refuse_ranges(RANGES, reason)
        self.ends = self.timetable.ends
        self.duration = self.ends[-1]
        self.terms = (*COMMAND_TERMS, *OBJECT_TERMS, *progress_terms(PHASES, self.duration))
        self.reward_terms = self._rewards()
        if object is not None:
            self._require_places()

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
            carry_term(weights, CLOSE),
            effort_term(weights),
            outcome_term(weights),
        )

    def setup(self, rng: np.random.Generator, hand: Hand = HPAC) -> SceneSetup:
        """Draw one episode: the object, its place in front of the palm, and the open hand; or those
        of a named grasp. An object of one's own gets a place where the hand is not inside it.
        """
        if self.grasp is not None:
            return setup_of_grasp(self.grasp, self.variant, rng, hand)
        setup = self._drawn(rng, hand)
        for _ in range(MOST_PLACES if self.object else 0):
            if not points_in_object(setup, SKIN):
                break
            setup = self._drawn(rng, hand)
        return setup

    def _require_places(self) -> None:
        """Refuse an object of one's own for which too few places are free."""
        rng = np.random.default_rng(0)
        drawn = [self._drawn(rng, HPAC) for _ in range(PLACES)]
        if sum(points_in_object(setup, SKIN) == 0 for setup in drawn) < PLACES / 10:
            size = " x ".join(f"{2 * half:.3g}" for half in self.object.half_extents)
            raise ParameterError(
                f"the object, {size} m, does not fit in front of the open hand: thumb or fingers are in its way"
            )

    def _drawn(self, rng: np.random.Generator, hand: Hand) -> SceneSetup:
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
            width * abs(np.sin(yaw)) + depth * abs(np.cos(yaw))
            if shape == "box"
            else spec.half_extents[0]
        )
        place = [
            PALM_SURFACE + reach + rng.uniform(*config.gap),
            rng.uniform(*config.towards_thumb),
            rng.uniform(*config.beyond_wrist),
        ]
        return SceneSetup(spec, np.array(place), yaw, open_hand(config.thumb_preshape), hand)

    def wrist_path(self, setup: SceneSetup, times: tuple[float, ...]) -> Array:
        return wrist_table(self.timetable, times)

    def judge(self, state: SceneState, dt: float) -> NDArray[np.int_]:
        """Advance the hold timers by one control step and judge the episodes.

        An episode fails as soon as the object is knocked away, or after the lift once the hand does
        not hold it (`Grip`). It succeeds at the end of the timetable if the object was held through
        the shake in six directions and not dropped on the way down."""
        self.grip.follow(state.object_pos, state.touching.any(axis=1), state.supported, dt)
        ran = self.phase(state.time - dt / 2)
        lifted = self.phase(state.time + dt / 2) >= SHAKE  # of the next step
        self.grip.settle(lifted & (ran < SHAKE), state.object_pos)
        failed = (self.grip.moved > self.config.drop_distance) | (lifted & ~self.grip.holds)
        over = np.where(state.time >= self.duration - dt / 2, SUCCESS, RUNNING)
        return np.where(failed, FAILURE, over)

    def _push_term(self) -> RewardTerm:
        weight = self.config.weights.push
        farthest = self.config.drop_distance
        return RewardTerm(
            "push",
            f"while closing: {weight:g} · min(displacement / drop_distance, 1)",
            lambda now: np.where(
                now.began == CLOSE, weight * np.minimum(now.grip.moved / farthest, 1.0), 0.0
            ),
        )

    def script(self) -> Script:
        return ScriptedClosure(self.grasp)
