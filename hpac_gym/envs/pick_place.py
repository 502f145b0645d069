"""HPAC-PickPlace-v0: the paper's four phases. The wrist is scripted; when and how to close and to open is the policy's."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from hpac_gym.envs.grasp import PALM_SURFACE
from hpac_gym.envs.grip import Grip
from hpac_gym.envs.observation import AXES, GRASP_CENTRE, LENGTH_UNIT, Field
from hpac_gym.envs.phases import minimum_jerk
from hpac_gym.envs.task import Outcome
from hpac_gym.model import FINGERS, HPAC, SERVO_INDEX, Hand
from hpac_gym.model.checks import Array
from hpac_gym.sim import Camera, ObjectSpec, Scene, SceneSetup, Vector
from hpac_gym.sim.truth import hand_from_world, tilt

PHASES = ("reach", "close", "lift", "place")
REACH, CLOSE, LIFT, PLACE = range(4)


@dataclass(frozen=True, slots=True)
class PickPlaceTimetable:
    """How long each part takes, and the way of the wrist: sideways to the object, up, across, down, and back.

    Raises:
        ValueError: A duration that is not positive.
    """

    carry: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """From the object's first place to the target, in the world [m]."""
    reach_time: float = 0.6
    close_time: float = 1.2
    lift_time: float = 0.6
    carry_time: float = 0.8
    lower_time: float = 0.5
    release_time: float = 0.8
    retreat_time: float = 0.6
    rest_time: float = 0.4
    reach: tuple[float, float, float] = (0.04, 0.12, 0.0)
    """The way to the object, and back in the end, in the world [m]."""
    lift_height: float = 0.10
    """[m]"""
    clearance: float = 0.003
    """How far above its target the object is let go [m]."""

    def __post_init__(self) -> None:
        if not min(self.durations) > 0:
            raise ValueError(f"durations of {self} must be greater than 0 s")

    @property
    def durations(self) -> tuple[float, ...]:
        """Of reach, close, lift, carry, lower, release, retreat and rest [s]."""
        return (
            self.reach_time, self.close_time, self.lift_time, self.carry_time,
            self.lower_time, self.release_time, self.retreat_time, self.rest_time,
        )  # fmt: skip

    @property
    def ends(self) -> tuple[float, ...]:
        """When each of `durations` is over [s]."""
        return tuple(np.cumsum(self.durations).tolist())

    @property
    def phases(self) -> tuple[str, ...]:
        """Names, in order; what comes after the lift is the place."""
        return PHASES

    @property
    def duration(self) -> float:
        """Length of an episode [s]."""
        return self.ends[-1]

    def phase(self, time: float) -> int:
        """Index into `PHASES` of the phase that runs, or begins, at a time [s]; the last one stays."""
        return min(sum(time > end - 1e-9 for end in self.ends[: LIFT + 1]), PLACE)

    def wrist_path(self, time: float) -> Vector:
        """Offset of the wrist in the world [m]: one minimum jerk a move."""
        offset = np.zeros(3)
        for begin, duration, way in self._moves():
            offset += minimum_jerk((time - begin) / duration) * way
        return tuple(offset.tolist())

    def _moves(self) -> list[tuple[float, float, Array]]:
        """When each move begins [s], how long it takes [s], and its way, shape (3,) [m]."""
        ends = self.ends
        reach, up = np.array(self.reach), np.array([0.0, 0.0, self.lift_height])
        return [
            (0.0, self.reach_time, reach),
            (ends[1], self.lift_time, up),
            (ends[2], self.carry_time, np.array(self.carry)),
            (ends[3], self.lower_time, np.array([0.0, 0.0, self.clearance]) - up),
            (ends[5], self.retreat_time, -reach),
        ]


@dataclass(frozen=True, slots=True)
class PickPlaceConfig:
    """The ranges that an episode is drawn from, uniformly, and what counts as placed."""

    radius: tuple[float, float] = (0.020, 0.028)
    """Of the cylinder, or half width of the box [m]."""
    half_height: tuple[float, float] = (0.068, 0.080)
    """Tall enough for the hand to stay clear of what the object stands on [m]."""
    mass: tuple[float, float] = (0.05, 0.20)
    """[kg]"""
    friction: tuple[float, float] = (0.6, 1.0)
    """Of the object's surface; the hand's skin multiplies it by 0.9."""
    gap: tuple[float, float] = (0.006, 0.015)
    """From the palm to the object, once the wrist has reached it [m]."""
    towards_thumb: tuple[float, float] = (-0.005, 0.010)
    """Place of the object's centre along y of the hand frame [m]."""
    beyond_wrist: tuple[float, float] = (0.105, 0.125)
    """Place of the object's centre along z of the hand frame, once the wrist has reached it [m]."""
    carry_forward: tuple[float, float] = (-0.04, 0.08)
    """Way to the target along the fingers [m]."""
    carry_aside: tuple[float, float] = (0.16, 0.24)
    """Way to the target along the palm's normal [m]."""
    thumb_preshape: float = 1.2
    """CMC at the start: the thumb stands opposite to the fingers [rad]."""
    drop_distance: float = 0.06
    """An object that moved farther than this from where it belongs is dropped [m]."""
    tolerance: float = 0.03
    """From the target, across it [m]."""
    upright: float = 0.05
    """Largest tilt of an object that stands [rad]."""
    timetable: PickPlaceTimetable = field(default_factory=PickPlaceTimetable)


class PickPlace:
    """Draws episodes, judges them, and shapes the reward: a `hpac_gym.envs.task.Task`."""

    fields = (Field("target_pos", AXES, "0.05 m", -10.0, 10.0, "where the object shall stand, as `object_pos`"),)
    viewpoint = Camera(distance=0.62, yaw_deg=115.0, pitch_deg=-25.0)

    def __init__(self, config: PickPlaceConfig = PickPlaceConfig()) -> None:
        self.config = config
        self.timetable = config.timetable

    def setup(self, rng: np.random.Generator, hand: Hand = HPAC) -> SceneSetup:
        """Draw one episode: the object, its place ahead of the hand, its target, and the open hand."""
        config = self.config
        shape = ("cylinder", "box")[rng.integers(2)]
        width, height = rng.uniform(*config.radius), rng.uniform(*config.half_height)
        spec = ObjectSpec(shape, (width, width, height), rng.uniform(*config.mass), rng.uniform(*config.friction))
        place = np.array(
            [
                PALM_SURFACE + width + rng.uniform(*config.gap),
                rng.uniform(*config.towards_thumb),
                rng.uniform(*config.beyond_wrist),
            ]
        )
        forward, aside, up = self.timetable.reach
        place += [aside, up, forward]
        target = place + np.array([rng.uniform(*config.carry_aside), 0.0, rng.uniform(*config.carry_forward)])
        synergy = np.zeros(len(SERVO_INDEX))
        synergy[SERVO_INDEX["thumb_cmc"]] = config.thumb_preshape
        return SceneSetup(spec, place, 0.0, synergy, hand, target=target)

    def start(self, setup: SceneSetup) -> None:
        """Begin to judge an episode; the wrist's way leads from the object to its target."""
        if setup.target is None:
            raise ValueError("a setup of PickPlace needs a target")
        aside, up, forward = setup.target - setup.position
        self.timetable = replace(self.config.timetable, carry=(float(forward), float(aside), float(up)))
        self._place, self._target = setup.position, setup.target
        self._grasped_at: Array | None = None
        self.grip = Grip()

    def values(self, scene: Scene) -> Array:
        """Where the target is in the hand frame, in the units of `object_pos`."""
        return (hand_from_world(scene, scene.target) - GRASP_CENTRE) / LENGTH_UNIT

    def judge(self, scene: Scene, object_pos: Array, forces: dict[str, float], dt: float) -> Outcome:
        """Advance by one control step and judge the episode.

        It fails as soon as the object is knocked over on the way to it, or is lost between lift and release. It succeeds
        at the end of the timetable, when the object stands at its target and the hand does not touch it.
        """
        forward, aside, up = scene.palm_offset
        away = object_pos + np.array([aside, up, forward])  # along the axes of the hand, from where the hand was at first
        self.grip.follow(object_pos, bool(forces), scene.on_support, dt)
        close, lowered = self.timetable.ends[1], self.timetable.ends[4]
        self._lowered = scene.time > lowered - dt / 2
        self._standing = scene.on_target and tilt(scene) < self.config.upright
        self._distance = float(np.linalg.norm((away - self._target)[[0, 2]]))
        if scene.time < close - dt / 2:
            self._lost = float(np.linalg.norm(away - self._place))
            self._grasped_at = object_pos
        elif scene.time < lowered - dt / 2:
            self._lost = float(np.linalg.norm(object_pos - self._grasped_at))
        else:
            self._lost = float(np.linalg.norm(away - self._target))
        if self._lost > self.config.drop_distance:
            return Outcome.FAILURE
        if scene.time < self.timetable.duration - dt / 2:
            return Outcome.RUNNING
        placed = self._standing and not forces and self._distance < self.config.tolerance
        return Outcome.SUCCESS if placed else Outcome.FAILURE

    def reward_terms(
        self, outcome: Outcome, phase: int, object_pos: Array, forces: dict[str, float], action_change: Array
    ) -> dict[str, float]:
        """The dense reward of one control step, term by term; the reward is their sum.

        * `contact`, while closing: 0.1 for the thumb and 0.05 for each finger that touches the object, 0.2 when they oppose
          each other.
        * `push`, while reaching and closing: −0.3 for an object moved away from where it stood by `drop_distance`, its share
          before.
        * `carry`, from the lift until the hand is lowered: 0.5 for carrying the object free of its support. Longer, and never to
          let go would pay.
        * `place`, while placing: 0.5 for an object that stands at its target, 0.5 more when the hand has let it go.
        * `effort`: −0.01 of the sum of the squared changes of the action.
        * `outcome`: 20 for success or −5 for failure, once.
        """
        fingers = sum(name in forces for name in FINGERS)
        thumb = "thumb" in forces
        opposed = float(thumb and fingers > 0)
        before = phase in (REACH, CLOSE)
        stands = phase == PLACE and self._standing
        return {
            "contact": (0.1 * thumb + 0.05 * fingers + 0.2 * opposed) if phase == CLOSE else 0.0,
            "push": -0.3 * min(self._lost / self.config.drop_distance, 1.0) if before else 0.0,
            "carry": 0.5 * float(self.grip.time > 0) if not (before or self._lowered) else 0.0,
            "place": (0.5 + 0.5 * float(not forces)) if stands else 0.0,
            "effort": -0.01 * float(np.square(action_change).sum()),
            "outcome": {Outcome.SUCCESS: 20.0, Outcome.FAILURE: -5.0, Outcome.RUNNING: 0.0}[outcome],
        }
