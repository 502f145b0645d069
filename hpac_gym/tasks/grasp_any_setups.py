"""Episodes of HPAC-GraspAny before they begin: settings, and the draw of object, pose, hand and
wrist.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hpac_gym.body.hands import hand_set
from hpac_gym.body.object_sets import RestingPose, object_set
from hpac_gym.body.objects import ObjectSpec
from hpac_gym.body.own_objects import as_object
from hpac_gym.errors import ParameterError
from hpac_gym.model import HPAC, Hand
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import SceneSetup
from hpac_gym.physics.simulation import resting_object
from hpac_gym.settings import check_bounds, setting
from hpac_gym.tasks import placing
from hpac_gym.tasks.phases import CONTROL_HZ, Timetable
from hpac_gym.tasks.task import open_hand
from hpac_gym.tasks.terms import AXES, LENGTH_UNIT, Term

PHASES = ("close", "lift", "shake", "sides", "ramp")
CLOSE, LIFT, SHAKE, SIDES, RAMP = range(len(PHASES))
SIDE_DIRECTIONS = np.array(
    [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float
)
"""Successive directions of apparent gravity in the world, shape (6, 3)."""


@dataclass(frozen=True, slots=True)
class GraspAnyWeights:
    """Weights of the dense reward terms."""

    thumb: float = 0.5
    finger: float = 0.25
    opposed: float = 1.0
    push: float = -1.0
    carry: float = 0.1
    effort: float = -0.01
    success: float = 10.0
    force: float = 5.0
    failure: float = -5.0


@dataclass(frozen=True, slots=True)
class GraspAnyConfig:
    """Uniform sampling ranges of an episode, success criteria, and reward weights."""

    width: tuple[float, float] = setting(
        (0.005, 0.080),
        "smaller horizontal side of an object in a pose that the task includes [m]",
        bounds=(0.0, 1.0),
    )
    flattest: float = setting(
        0.018, "least height of an object in such a pose [m]", bounds=(0.0, 1.0)
    )
    gap: tuple[float, float] = setting(
        (0.003, 0.012),
        "distance from the palm to an object beside it; a hand above an object is a quarter of it higher [m]",
        bounds=(0.0, 0.1),
    )
    place_error: tuple[float, float] = setting(
        (-0.012, 0.012),
        "position error of the wrist along both horizontal axes, and upwards for a hand beside an object [m]",
        bounds=(-0.1, 0.1),
    )
    yaw_error: tuple[float, float] = setting(
        (-0.2, 0.2), "yaw error of the wrist [rad]", bounds=(-np.pi, np.pi)
    )
    size: tuple[float, float] = setting(
        (1.0, 1.0),
        "factor of the object's size, within `width` and `flattest`; its mass grows with the cube",
        bounds=(0.5, 2.0),
    )
    mass: tuple[float, float] = setting(
        (0.7, 1.3), "factor of the object's mass", bounds=(0.1, 10.0)
    )
    friction: tuple[float, float] = setting(
        (0.8, 1.2), "factor of the friction of the object's surface", bounds=(0.1, 5.0)
    )
    thumb_preshape: float = setting(
        1.2, "initial CMC, at which the thumb opposes the fingers [rad]", bounds=(0.0, 1.57)
    )
    reach: float = setting(
        0.15,
        "an object whose centre is farther than this from `GRASP_CENTRE` is out of reach [m]",
        bounds=(0.01, 1.0),
    )
    side_time: float = setting(
        0.2, "duration of apparent gravity towards each side [s]", bounds=(0.05, 10.0)
    )
    ramp_time: float = setting(1.5, "duration of the force ramp [s]", bounds=(0.05, 10.0))
    ramp_force: float = setting(40.0, "final force of the ramp [N]", bounds=(0.0, 1e3), above=True)
    timetable: Timetable = field(
        default_factory=lambda: Timetable(close_time=3.0, clearance=Timetable().lift_height)
    )
    """Timetable of closing, lift and shake; the hand stays up afterwards, whatever its clearance."""
    weights: GraspAnyWeights = field(default_factory=GraspAnyWeights)

    def __post_init__(self) -> None:
        check_bounds(self, "config")
        shaken = self.timetable.ends[SHAKE]
        # Sides are counted at the end of control steps.
        for name, time in (
            ("side_time", self.side_time),
            ("timetable: the end of the shake", shaken),
        ):
            if round(time * CONTROL_HZ, 6) % 1:
                raise ParameterError(
                    f"config {name} = {time:g} s must be a multiple of {1 / CONTROL_HZ:g} s"
                )

    @property
    def ends(self) -> tuple[float, ...]:
        """End time of each of `PHASES` [s]."""
        sides = self.timetable.ends[SHAKE] + len(SIDE_DIRECTIONS) * self.side_time
        return (*self.timetable.ends[:SIDES], sides, sides + self.ramp_time)


@dataclass(frozen=True, slots=True)
class GraspAnySetup(SceneSetup):
    """A setup of `GraspAny`; without a pull, as in a plain `SceneSetup`, the force is downwards."""

    pull: Array | None = None
    """World direction of the force ramp, a unit vector, shape (3,)."""


DOWN = np.array([0.0, 0.0, -1.0])


def pull_of(setup: SceneSetup) -> Array:
    """World direction of the final force ramp of an episode, shape (3,)."""
    pull = getattr(setup, "pull", None)
    return DOWN if pull is None else pull


def _centre_of_mass(setup: SceneSetup) -> Array:
    model = setup.object.model
    return np.zeros(3) if model is None else setup.object.scale * model.center_of_mass / LENGTH_UNIT


HIDDEN_TERMS = (
    Term(
        "centre_of_mass",
        AXES,
        "0.05 m",
        -4.0,
        4.0,
        "of the object, from its centre along its own axes",
        _centre_of_mass,
        fixed=True,
    ),
    Term(
        "pull",
        AXES,
        "1",
        -1.0,
        1.0,
        "world direction of the final force ramp",
        pull_of,
        fixed=True,
    ),
)
"""Terms that only a critic may observe: where the object's mass is, and the final force."""


class Setups:
    """Draws episodes.

    Args:
        objects: split from which objects are drawn.
        hands: set from which hands are drawn; "nominal" keeps the given hand.
        config: sampling ranges.
        object: the object of every episode instead of a split's.

    Attributes:
        objects: the objects, with the poses that the ranges include.
        reach: reach of each drawn hand's geometry.

    Raises:
        ParameterError: Invalid object, or ranges that leave none.
    """

    def __init__(
        self,
        objects: str,
        hands: str,
        config: GraspAnyConfig,
        object: ObjectSpec | Mapping[str, Any] | None,
    ) -> None:
        if object is not None and objects != "train":
            raise ParameterError(f"object and objects {objects!r} were given: give either")
        self.config = config
        self.hands = () if hands == "nominal" else hand_set(hands)
        preshape = open_hand(config.thumb_preshape)
        self.reach = {
            variant.geometry: placing.reach_of(variant, preshape) for variant in self.hands
        }
        entries = object_set(objects) if object is None else (resting_object(as_object(object)),)
        if config.size != (1.0, 1.0) and any(entry.model.has_hulls for entry in entries):
            raise ParameterError(
                f"config size = {config.size}: a mesh of one's own has its own size"
            )
        poses = ((entry, tuple(filter(self._asked, entry.poses))) for entry in entries)
        self.objects = tuple(replace(entry, poses=kept) for entry, kept in poses if kept)
        if not self.objects:
            ranges = f"width = {config.width} m and flattest = {config.flattest} m"
            sides = (" x ".join(f"{side:.3g}" for side in pose.size) for pose in entries[0].poses)
            left = f"every pose of the object, {'; '.join(sides)} m"
            left = f"all {objects} objects" if object is None else left
            raise ParameterError(f"config {ranges} exclude {left}")

    def _asked(self, pose: RestingPose) -> bool:
        """True if the task includes objects in this pose."""
        narrowest, widest = self.config.width
        return narrowest <= pose.width <= widest and pose.size[2] >= self.config.flattest

    def draw(self, rng: np.random.Generator, hand: Hand = HPAC) -> SceneSetup:
        """Draw one episode: object, pose, mass, friction, wrist pose with errors, and direction of
        the pull.
        """
        config = self.config
        entry = self.objects[rng.integers(len(self.objects))]
        pose = entry.poses[rng.integers(len(entry.poses))]
        model = entry.model
        mass = rng.uniform(*config.mass) * model.mass
        friction = rng.uniform(*config.friction) * entry.friction
        scale = self._scale(pose, rng)
        pose = replace(
            pose, size=tuple(scale * side for side in pose.size), height=scale * pose.height
        )
        extents = tuple(scale * extent for extent in model.half_extents)
        spec = ObjectSpec(model.shape, extents, scale**3 * mass, friction, model, scale)
        # The longer horizontal side lies across the fingers, either way round.
        turn = (0.0 if pose.size[1] >= pose.size[0] else np.pi / 2) + np.pi * rng.integers(2)
        # Gripped from the side is what is not long, and on the table what is tall.
        tall = entry.stand or pose.size[2] >= placing.TALL
        beside = tall and max(pose.size[:2]) <= placing.LONG * pose.size[2]
        pull = rng.standard_normal(3)
        setup = GraspAnySetup(
            spec,
            yaw=turn,
            synergy=open_hand(config.thumb_preshape),
            hand=hand,
            object_quaternion=pose.quaternion,
            rest_height=pose.height,
            hand_quaternion=placing.SIDE if beside else placing.ABOVE,
            pull=pull / np.linalg.norm(pull),
        )
        error = rng.uniform(*config.place_error, 3) * [1.0, 1.0, beside]
        gap = rng.uniform(*config.gap)
        yaw = rng.uniform(*config.yaw_error)
        if self.hands:
            variant = self.hands[rng.integers(len(self.hands))]
            setup = replace(
                setup,
                hand=variant.hand,
                geometry=variant.geometry,
                hand_settings=variant.over(setup.hand_settings),
            )
        reach = self.reach_of(setup)
        return placing.moved(placing.placed(setup, gap, entry.stand, reach), error, yaw, reach)

    def _scale(self, pose: RestingPose, rng: np.random.Generator) -> float:
        """Factor of an object's size, with which its pose is still one that the task includes."""
        if self.config.size == (1.0, 1.0):
            return 1.0  # without a draw, so that episodes are the same as without this range
        narrowest, widest = self.config.width
        least = max(narrowest / pose.width, self.config.flattest / pose.size[2])
        return float(rng.uniform(*np.clip(self.config.size, least, widest / pose.width)))

    def reach_of(self, setup: SceneSetup) -> placing.Reach:
        """The reach of the hand of a setup."""
        return self.reach.get(setup.geometry, placing.NOMINAL_REACH)
