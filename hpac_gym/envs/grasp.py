"""The grasp task: close on an object, lift it, keep it through a shake, and bring it down again."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hpac_gym.envs.grip import Grip
from hpac_gym.envs.observation import Field
from hpac_gym.envs.phases import PHASES, Timetable
from hpac_gym.envs.task import Outcome
from hpac_gym.model import FINGERS, HPAC, SERVO_INDEX, Hand
from hpac_gym.model.checks import Array
from hpac_gym.sim import SHAPES, Camera, ObjectSpec, Scene, SceneSetup

PALM_SURFACE = 0.0125
"""Distance of the palm's surface from the yz-plane of the hand frame [m]."""

CLOSE = PHASES.index("close")


@dataclass(frozen=True, slots=True)
class GraspConfig:
    """The ranges that an episode is drawn from, uniformly, and what counts as dropped."""

    radius: tuple[float, float] = (0.010, 0.030)
    """Half width of a box, radius of a cylinder [m]."""
    sphere_radius: tuple[float, float] = (0.020, 0.033)
    """From a golf ball's to a tennis ball's; smaller ones roll off their post before a finger and the thumb meet [m]."""
    half_height: tuple[float, float] = (0.030, 0.060)
    """Of a box or cylinder [m]."""
    mass: tuple[float, float] = (0.05, 0.25)
    """[kg]"""
    friction: tuple[float, float] = (0.6, 1.0)
    """Of the object's surface; the hand's skin multiplies it by 0.9."""
    gap: tuple[float, float] = (0.003, 0.030)
    """From the palm to the object [m]."""
    towards_thumb: tuple[float, float] = (-0.030, 0.035)
    """Place of the object's centre along y of the hand frame [m]."""
    beyond_wrist: tuple[float, float] = (0.095, 0.140)
    """Place of the object's centre along z of the hand frame [m]."""
    box_yaw: tuple[float, float] = (-0.8, 0.8)
    """Turn of a box about the vertical [rad]."""
    thumb_preshape: float = 1.2
    """CMC at the start: the thumb stands opposite to the fingers [rad]."""
    drop_distance: float = 0.06
    """An object that moved farther than this in the hand is dropped [m]."""
    timetable: Timetable = field(default_factory=Timetable)


class Grasp:
    """Draws episodes, judges them, and shapes the reward: a `hpac_gym.envs.task.Task`."""

    fields: tuple[Field, ...] = ()
    viewpoint = Camera()

    def __init__(self, config: GraspConfig = GraspConfig()) -> None:
        self.config = config
        self.timetable = config.timetable

    def setup(self, rng: np.random.Generator, hand: Hand = HPAC) -> SceneSetup:
        """Draw one episode: the object, its place in front of the palm, and the open hand."""
        config = self.config
        shape = SHAPES[rng.integers(len(SHAPES))]
        width, depth, height = rng.uniform(*config.radius), rng.uniform(*config.radius), rng.uniform(*config.half_height)
        yaw, ball = rng.uniform(*config.box_yaw), rng.uniform(*config.sphere_radius)
        extents = {"cylinder": (width, width, height), "box": (width, depth, height), "sphere": (ball, ball, ball)}[shape]
        spec = ObjectSpec(shape, extents, rng.uniform(*config.mass), rng.uniform(*config.friction))
        reach = width * abs(np.sin(yaw)) + depth * np.cos(yaw) if shape == "box" else extents[0]
        place = [
            PALM_SURFACE + reach + rng.uniform(*config.gap),
            rng.uniform(*config.towards_thumb),
            rng.uniform(*config.beyond_wrist),
        ]
        synergy = np.zeros(len(SERVO_INDEX))
        synergy[SERVO_INDEX["thumb_cmc"]] = config.thumb_preshape
        return SceneSetup(spec, np.array(place), yaw, synergy, hand)

    def start(self, setup: SceneSetup) -> None:
        """Begin to judge an episode."""
        self._place = setup.position
        self.grip, self._lifted = Grip(), False

    def values(self, scene: Scene) -> Array:
        """The task adds nothing to the observation."""
        return np.empty(0)

    def judge(self, scene: Scene, object_pos: Array, forces: dict[str, float], dt: float) -> Outcome:
        """Advance the hold timer by one control step and judge the episode.

        It fails as soon as the object is knocked away, or once it is lifted and the hand does not hold it (`Grip`). It
        succeeds at the end of the timetable: lifted, held through the shake in six directions, and not dropped on the way
        down.
        """
        self.grip.follow(object_pos, bool(forces), scene.on_support, dt)
        lifted = scene.time > self.timetable.ends[1] - dt / 2
        if lifted and not self._lifted:
            self.grip.settle()
        self._lifted = lifted
        knocked_away = np.linalg.norm(object_pos - self._place) > self.config.drop_distance
        if knocked_away or (lifted and not self.grip.holds):
            return Outcome.FAILURE
        return Outcome.RUNNING if scene.time < self.timetable.duration - dt / 2 else Outcome.SUCCESS

    def reward_terms(
        self, outcome: Outcome, phase: int, object_pos: Array, forces: dict[str, float], action_change: Array
    ) -> dict[str, float]:
        """The dense reward of one control step, term by term; the reward is their sum.

        * `contact`, while closing: 0.1 for the thumb and 0.05 for each finger that touches the object, 0.2 when they oppose
          each other.
        * `push`, while closing: −0.3 for an object moved away from where it stood by `drop_distance`, its share before.
        * `carry`, afterwards: 0.5 for carrying the object free of its support, less by the share of `MAX_SLIP` that it has
          slipped.
        * `effort`: −0.01 of the sum of the squared changes of the action.
        * `outcome`: 10 for success or −5 for failure, once.
        """
        closing = phase == CLOSE
        fingers = sum(name in forces for name in FINGERS)
        thumb = "thumb" in forces
        opposed = float(thumb and fingers > 0)
        moved = float(np.linalg.norm(object_pos - self._place)) / self.config.drop_distance
        return {
            "contact": (0.1 * thumb + 0.05 * fingers + 0.2 * opposed) if closing else 0.0,
            "push": -0.3 * min(moved, 1.0) if closing else 0.0,
            "carry": 0.5 * self.grip.firmness if not closing else 0.0,
            "effort": -0.01 * float(np.square(action_change).sum()),
            "outcome": {Outcome.SUCCESS: 10.0, Outcome.FAILURE: -5.0, Outcome.RUNNING: 0.0}[outcome],
        }
