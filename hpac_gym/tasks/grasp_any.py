"""HPAC-GraspAny: any object in any of its stable poses. Unobserved properties make feedback
useful.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from hpac_gym.body.hands import hand_set
from hpac_gym.body.object_sets import SPLITS, RestingPose, object_set
from hpac_gym.body.objects import ObjectSpec
from hpac_gym.body.own_objects import as_object
from hpac_gym.errors import ParameterError
from hpac_gym.model import HPAC, Hand
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import SceneSetup, SceneState, Viewpoint
from hpac_gym.physics.settings import GRAVITY
from hpac_gym.physics.simulation import resting_object
from hpac_gym.settings import check_bounds, setting, settings_from
from hpac_gym.tasks import placing
from hpac_gym.tasks.cameras import CameraNoise
from hpac_gym.tasks.grip import Grip, lengths
from hpac_gym.tasks.options import Option, check_choice, config_option
from hpac_gym.tasks.phases import Timetable, phase_at, wrist_table
from hpac_gym.tasks.scripted import ScriptedGraspAny
from hpac_gym.tasks.senses import LOAD_TERMS, Senses, ServoSenses
from hpac_gym.tasks.task import (
    CONTROL_HZ,
    FAILURE,
    RUNNING,
    SUCCESS,
    Task,
    contact_score,
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
    PRIVILEGED_TERMS,
    Moment,
    RewardTerm,
    Term,
    column,
    progress_terms,
)

PHASES = ("close", "lift", "shake", "sides", "ramp")
CLOSE, LIFT, SHAKE, SIDES, RAMP = range(len(PHASES))
WRISTS = ("script", "free")
HANDS = ("nominal", "train", "test")
WRIST_ACTIONS = ("wrist_x", "wrist_y", "wrist_z", "wrist_yaw")
WRIST_REACH = np.array([0.03, 0.03, 0.03, 0.5])
"""Wrist motion for an action of 1: along the world's axes [m], and about the vertical [rad]."""
SIDE_DIRECTIONS = np.array(
    [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float
)
"""Successive directions of apparent gravity in the world, shape (6, 3)."""
DOWN = np.array([0.0, 0.0, -1.0])


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
    ramp_force: float = setting(40.0, "final force of the ramp [N]", bounds=(0.0, 1e3))
    timetable: Timetable = field(
        default_factory=lambda: Timetable(close_time=3.0, clearance=Timetable().lift_height)
    )
    """Timetable of closing, lift and shake; the hand stays up afterwards."""
    weights: GraspAnyWeights = field(default_factory=GraspAnyWeights)

    def __post_init__(self) -> None:
        check_bounds(self, "config")
        if (
            round(self.side_time * CONTROL_HZ, 6) % 1
        ):  # sides are counted at the end of control steps
            raise ParameterError(
                f"config side_time = {self.side_time} s must be a multiple of {1 / CONTROL_HZ:g} s"
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


def _pull_of(setup: SceneSetup) -> Array:
    pull = getattr(setup, "pull", None)
    return DOWN if pull is None else pull


OBJECTS_OPTION = Option(
    "split from which objects are drawn; the other two must not be used in training", SPLITS
)
WRIST_OPTION = Option(
    "*script* leaves the wrist where the sampler put it; *free* lets the first action of an "
    "episode move it, by four numbers more",
    WRISTS,
)
OBJECT_OPTION = Option(
    "object of every episode instead of a split's, in the stable poses that drops find; a dictionary "
    "has the arguments of `own_object`",
    (None,),
    "`hpac_gym.body.objects.ObjectSpec`, dictionary",
)
HANDS_OPTION = Option(
    "*nominal* is `hand`; *train* draws one of 32 hands of other lengths, tendons and servos "
    "for every episode, *test* one of 8 others; no policy is told which, and nothing may be trained on the latter",
    HANDS,
)


class GraspAny(Task):
    """Draws episodes, judges them, and shapes the reward: a `hpac_gym.tasks.task.Task`.

    Args:
        objects: split from which objects are drawn.
        wrist: "script" keeps the wrist where the sampler puts it; "free" lets an episode's first
            action move it.
        hands: "nominal" keeps the given hand; "train" and "test" draw one from that set of hands,
            without telling the policy.
        config: sampling ranges, success criteria and reward weights, or a mapping of some of them.
        object: the object of every episode instead of a split's, in stable poses that are found by
            dropping it; a dictionary holds the arguments of `own_object`.

    Raises:
        ParameterError: Invalid config or object, or unknown split, wrist or set of hands.
    """

    phases = PHASES
    changing = (
        *("grip", "holding_force", "turn", "sides", "_place", "_phase", "_grasped"),
        *("_touch", "_gained", "_distance", "_pushed"),
    )
    viewpoint = Viewpoint(yaw_deg=120.0)
    sensed_terms: ClassVar = {"load": LOAD_TERMS, "points": ()}

    def __init__(
        self,
        objects: Annotated[str, OBJECTS_OPTION] = "train",
        wrist: Annotated[str, WRIST_OPTION] = "script",
        hands: Annotated[str, HANDS_OPTION] = "nominal",
        config: Annotated[
            GraspAnyConfig | Mapping[str, Any] | None, config_option(GraspAnyConfig)
        ] = None,
        object: Annotated[ObjectSpec | Mapping[str, Any] | None, OBJECT_OPTION] = None,
    ) -> None:
        check_choice("objects", objects, SPLITS)
        check_choice("wrist", wrist, WRISTS)
        check_choice("hands", hands, HANDS)
        config = settings_from(GraspAnyConfig(), config, "config")
        self.hands = hands
        self._hands = () if hands == "nominal" else hand_set(hands)
        self.config = config
        preshape = open_hand(config.thumb_preshape)
        self._reach = {
            variant.geometry: placing.reach_of(variant, preshape) for variant in self._hands
        }
        if object is not None and objects != "train":
            raise ParameterError(f"object and objects {objects!r} were given: give either")
        entries = object_set(objects) if object is None else (resting_object(as_object(object)),)
        poses = ((entry, tuple(filter(self._asked, entry.poses))) for entry in entries)
        self.objects = tuple(replace(entry, poses=kept) for entry, kept in poses if kept)
        if not self.objects:
            ranges = f"width = {config.width} m and flattest = {config.flattest} m"
            poses = "; ".join(
                " x ".join(f"{side:.3g}" for side in pose.size) for pose in entries[0].poses
            )
            left = (
                f"all {objects} objects"
                if object is None
                else f"every pose of the object, {poses} m"
            )
            raise ParameterError(f"config {ranges} exclude {left}")
        self.wrist_actions = WRIST_ACTIONS if wrist == "free" else ()
        self.duration = config.ends[-1]
        seen = Term(
            "object_seen",
            ("seen",),
            "0/1",
            0.0,
            1.0,
            "whether the camera sees the object now; if not, the fields above "
            "hold its last measurement",
            lambda now: column(now.seen["visible"]),
        )
        self.terms = (*COMMAND_TERMS, *OBJECT_TERMS, seen, *progress_terms(PHASES, self.duration))
        self.privileged_terms = (*PRIVILEGED_TERMS, *self._hidden_terms())
        self.reward_terms = self._rewards()

    def _asked(self, pose: RestingPose) -> bool:
        """True if the task includes objects in this pose."""
        narrowest, widest = self.config.width
        return narrowest <= pose.width <= widest and pose.size[2] >= self.config.flattest

    def _hidden_terms(self) -> tuple[Term, ...]:
        def centre_of_mass(setup: SceneSetup) -> Array:
            model = setup.object.model
            return (
                np.zeros(3)
                if model is None
                else setup.object.scale * model.center_of_mass / LENGTH_UNIT
            )

        return (
            Term(
                "centre_of_mass",
                AXES,
                "0.05 m",
                -4.0,
                4.0,
                "of the object, from its centre along its own axes",
                centre_of_mass,
                fixed=True,
            ),
            Term(
                "pull",
                AXES,
                "1",
                -1.0,
                1.0,
                "world direction of the final force ramp",
                _pull_of,
                fixed=True,
            ),
        )

    def _rewards(self) -> tuple[RewardTerm, ...]:
        weights = self.config.weights
        config = self.config
        return (
            RewardTerm(
                "contact",
                f"while closing, change of the contact score in this step: {weights.thumb:g} for the thumb, "
                f"{weights.finger:g} for each finger, {weights.opposed:g} when they oppose each other",
                lambda now: np.where(now.began == CLOSE, self._gained, 0.0),
            ),
            RewardTerm(
                "push",
                f"while closing: {weights.push:g} · growth of the object's displacement as a fraction of `reach`",
                lambda now: np.where(now.began == CLOSE, weights.push * self._pushed, 0.0),
            ),
            RewardTerm(
                "carry",
                f"afterwards: {weights.carry:g} · (1 − slip / MAX_SLIP) for an object that the hand carries free of its support",
                lambda now: np.where(now.began == CLOSE, 0.0, weights.carry * now.grip.firmness),
            ),
            RewardTerm(
                "force",
                f"{weights.force:g} · holding force / {config.ramp_force:g} N, once, at the end of a successful episode",
                self._paid_force,
            ),
            effort_term(weights),
            outcome_term(weights),
        )

    def _paid_force(self, now: Moment) -> Array:
        share = self.holding_force / self.config.ramp_force
        return np.where(now.outcome == SUCCESS, self.config.weights.force * share, 0.0)

    # Episodes
    # ------------------------------------------------------------------------------------------------------

    def prepare(self, num_worlds: int, noise: CameraNoise) -> Senses:
        self.grip = Grip(num_worlds)
        self._mass = np.zeros((num_worlds, 1))
        self._pull = np.zeros((num_worlds, 3))
        self._place = np.zeros((num_worlds, 3))
        self._pushed = np.zeros(num_worlds)
        self._distance = np.zeros(num_worlds)
        self._touch = np.zeros(num_worlds)
        self._gained = np.zeros(num_worlds)
        self._phase = np.zeros(num_worlds, dtype=int)
        self._grasped = np.zeros((num_worlds, 3, 3))
        self._names = np.full(num_worlds, "", dtype=object)
        self.holding_force = np.zeros(num_worlds)
        self.turn = np.zeros(num_worlds)
        self.sides = np.zeros(num_worlds, dtype=int)
        servos = ServoSenses() if self.obs == "load" else None
        return Senses(num_worlds, noise, self.viewpoint, CAMERA_TARGET, servos)

    def setup(self, rng: np.random.Generator, hand: Hand = HPAC) -> SceneSetup:
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
        turn = placing.best_turn(pose.size) + np.pi * rng.integers(2)
        pull = rng.standard_normal(3)
        setup = GraspAnySetup(
            spec,
            yaw=turn,
            synergy=open_hand(config.thumb_preshape),
            hand=hand,
            object_quaternion=pose.quaternion,
            rest_height=pose.height,
            hand_quaternion=placing.SIDE
            if placing.from_side(entry.stand, pose.size)
            else placing.ABOVE,
            pull=pull / np.linalg.norm(pull),
        )
        error = rng.uniform(*config.place_error, 3) * [
            1.0,
            1.0,
            setup.hand_quaternion == placing.SIDE,
        ]
        gap = rng.uniform(*config.gap)
        yaw = rng.uniform(*config.yaw_error)
        if self._hands:
            variant = self._hands[rng.integers(len(self._hands))]
            setup = replace(
                setup,
                hand=variant.hand,
                geometry=variant.geometry,
                hand_settings=variant.over(setup.hand_settings),
            )
        reach = self._reach_of(setup)
        return placing.moved(placing.placed(setup, gap, entry.stand, reach), error, yaw, reach)

    def _scale(self, pose: RestingPose, rng: np.random.Generator) -> float:
        """Factor of an object's size, with which its pose is still one that the task includes."""
        low, high = self.config.size
        if low == high == 1.0:
            return 1.0  # without a draw, so that episodes are the same as without this range
        (narrowest, widest) = self.config.width
        flattest = self.config.flattest
        low = max(low, narrowest / pose.width, flattest / pose.size[2])
        high = min(high, widest / pose.width)
        return float(rng.uniform(min(low, 1.0), max(high, 1.0)))

    def _reach_of(self, setup: SceneSetup) -> placing.Reach:
        return self._reach.get(setup.geometry, placing.NOMINAL_REACH)

    def chosen(self, setup: SceneSetup, action: Array) -> SceneSetup:
        """The setup with the wrist moved by the last four numbers of an episode's first action."""
        way = WRIST_REACH * action[-len(WRIST_REACH) :]
        return (
            placing.moved(setup, way[:3], float(way[3]), self._reach_of(setup))
            if way.any()
            else setup
        )

    def start(self, worlds: Sequence[int], setups: Sequence[SceneSetup]) -> None:
        index = np.asarray(worlds)
        self._mass[index, 0] = [setup.object.mass for setup in setups]
        self._pull[index] = [_pull_of(setup) for setup in setups]
        self._place[index] = [setup.position for setup in setups]
        self._names[index] = [
            spec.model.name if spec.model else spec.shape
            for spec in (setup.object for setup in setups)
        ]
        for values in (
            self._pushed,
            self._distance,
            self._touch,
            self._gained,
            self.holding_force,
            self.turn,
        ):
            values[index] = 0.0
        self._phase[index] = self.sides[index] = 0
        self.grip.start(index)

    def wrist_path(self, setup: SceneSetup, times: tuple[float, ...]) -> Array:
        return wrist_table(self.config.timetable, times)

    def phase(self, time: Array) -> NDArray[np.int_]:
        return phase_at(time, self.config.ends)

    def push(self, times: Array) -> Array | None:
        begin = self.config.ends[SHAKE]
        middle = self.config.ends[SIDES]
        if times.max() <= begin:
            return None
        side = np.clip(
            (times - begin) / self.config.side_time - 1e-9, 0, len(SIDE_DIRECTIONS) - 1
        ).astype(int)
        weight = (self._mass * GRAVITY)[:, :, None] * (SIDE_DIRECTIONS[side] - DOWN)
        pull = self._ramp(times)[:, :, None] * self._pull[:, None]
        return np.where(
            times[:, :, None] > middle, pull, np.where(times[:, :, None] > begin, weight, 0.0)
        )

    def _ramp(self, time: Array) -> Array:
        """Magnitude of the final force ramp [N] at times [s]."""
        share = (time - self.config.ends[SIDES]) / self.config.ramp_time
        return self.config.ramp_force * np.minimum(np.maximum(share, 0.0), 1.0)

    def judge(self, state: SceneState, dt: float) -> NDArray[np.int_]:
        """Advance by one control step and judge the episodes.

        An episode fails as soon as the object is out of reach while the hand closes, or the hand
        does not hold it (`Grip`) between the end of the lift and the end of the shake. An episode
        in which the object is held through the shake succeeds, and ends when the object slips or
        the force ramp ends. Knocking an object over is no failure."""
        config = self.config
        grip = self.grip
        ran = self._phase
        grip.follow(state.object_pos, state.touching.any(axis=1), state.supported, dt)
        # Phase of the next step.
        self._phase = phase_at(state.time + dt / 2, (*config.ends[:-1], np.inf))
        begins = self._phase != ran
        grip.settle(begins & (self._phase == SHAKE))
        held = grip.holds
        grip.settle(begins & (self._phase > SHAKE))
        closing = self._phase == CLOSE
        judged = ran <= SHAKE
        self._watch_closing(state)
        self._grasped[closing] = state.object_rotation[closing]
        cosine = (np.einsum("nij,nij->n", self._grasped, state.object_rotation) - 1) / 2
        self.turn = np.where(judged, np.arccos(np.clip(cosine, -1.0, 1.0)), self.turn)
        beyond = lengths(state.object_pos - GRASP_CENTRE) > config.reach
        failed = np.where(closing, beyond, judged & (self._phase >= SHAKE) & ~held)
        side = np.round((state.time - config.ends[SHAKE]) / config.side_time, 6)
        self.sides += (ran == SIDES) & held & (side == np.floor(side))
        self.holding_force = np.where(
            (ran == RAMP) & held, self._ramp(state.time), self.holding_force
        )
        over = ~judged & (~held | (state.time >= self.duration - dt / 2))
        return np.where(failed, FAILURE, np.where(over, SUCCESS, RUNNING))

    def _watch_closing(self, state: SceneState) -> None:
        """Record the last step's gain in touch, and growth of the object's displacement as a
        fraction of `reach`.
        """
        touch = contact_score(self.config.weights, state.touching)
        self._gained = touch - self._touch
        self._touch = touch
        distance = np.minimum(lengths(state.object_pos - self._place) / self.config.reach, 1.0)
        self._pushed = distance - self._distance
        self._distance = distance

    # Outputs
    # -------------------------------------------------------------------------------------------------------

    def report(self, now: Moment) -> dict[str, Any]:
        return super().report(now) | {
            "holding_force": np.where(now.outcome == FAILURE, 0.0, self.holding_force),
            "sides": self.sides.copy(),
            "turn": self.turn.copy(),
            "object": self._names.copy(),
        }

    def script(self) -> ScriptedGraspAny:
        return ScriptedGraspAny(self.terms, len(self.wrist_actions))


CAMERA_TARGET = np.array([0.03, 0.0, 0.10])
"""Point in the hand frame at which the camera looks [m]."""
