"""The gentle task: hold an object through lift and shake without ever crushing it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from hpac_gym.body.objects import ObjectSpec
from hpac_gym.errors import ParameterError
from hpac_gym.model import HPAC, Hand
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import SceneSetup, SceneState
from hpac_gym.settings import setting
from hpac_gym.tasks.cameras import CameraNoise
from hpac_gym.tasks.grasp import OBJECT_OPTION, Grasp, GraspConfig, GraspWeights
from hpac_gym.tasks.phases import Timetable
from hpac_gym.tasks.privileged import PRIVILEGED_TERMS
from hpac_gym.tasks.senses import LOAD_TERMS, Senses, ServoSenses
from hpac_gym.tasks.task import (
    FAILURE,
    Option,
    config_option,
)
from hpac_gym.tasks.terms import Moment, RewardTerm, Term, column

LIMIT_UNIT = 5.0
"""Unit of the crush limit in the observation [N]."""


@dataclass(frozen=True, slots=True)
class GentleWeights(GraspWeights):
    """Weights of the dense reward terms."""

    squeeze: float = -0.5


@dataclass(frozen=True, slots=True)
class GentleConfig(GraspConfig):
    """As `GraspConfig`, with easier places, lighter objects, and a limit of what they bear.

    Raises:
        ParameterError: A number or a range leaves its bounds.
    """

    radius: tuple[float, float] = setting(
        (0.015, 0.030), "half width of a box, radius of a cylinder [m]", bounds=(0.002, 0.06)
    )
    sphere_radius: tuple[float, float] = field(  # there are none
        default=(0.02, 0.033), metadata={"bounds": (0.002, 0.06)}
    )
    mass: tuple[float, float] = setting((0.02, 0.15), "mass of the object [kg]", bounds=(1e-3, 2.0))
    friction: tuple[float, float] = setting(
        (0.5, 1.0),
        "Coulomb coefficient of the object's surface; the hand's skin multiplies it by 0.9",
        bounds=(0.05, 3.0),
    )
    gap: tuple[float, float] = setting(
        (0.005, 0.020), "distance from the palm to the object [m]", bounds=(0.0, 0.1)
    )
    towards_thumb: tuple[float, float] = setting(
        (-0.010, 0.020),
        "place of the object's centre along y of the hand frame [m]",
        bounds=(-0.1, 0.1),
    )
    beyond_wrist: tuple[float, float] = setting(
        (0.100, 0.125),
        "place of the object's centre along z of the hand frame [m]",
        bounds=(0.02, 0.25),
    )
    box_yaw: tuple[float, float] = setting(
        (-0.4, 0.4), "yaw of a box about the vertical [rad]", bounds=(-np.pi, np.pi)
    )
    crush_limit: tuple[float, float] = setting(
        (2.5, 5.0), "squeeze beyond which the object is crushed [N]", bounds=(0.1, 1e3)
    )
    squeeze_time: float = setting(
        0.05, "time constant of the squeeze's low pass [s]", bounds=(1e-4, 1.0)
    )
    timetable: Timetable = field(
        default_factory=lambda: Timetable(close_time=2.4, shake_distance=0.01)
    )
    weights: GentleWeights = field(default_factory=GentleWeights)


@dataclass(frozen=True, slots=True)
class GentleSetup(SceneSetup):
    """A setup with an object that can be crushed."""

    crush_limit: float = setting(LIMIT_UNIT, bounds=(0.1, 1e3), unit="N")
    """Squeeze beyond which it is [N]."""


class _Camera(Senses):
    """`Senses` of a camera that always sees the object, as that of `Grasp`."""

    def _surface(self, spec: ObjectSpec) -> tuple[Array, Array]:
        return np.zeros((2, 1, 3))

    def _share(self, state: SceneState, rows: NDArray[np.int_]) -> Array:
        return np.ones(1)


TOLD_OPTION = Option("whether the observation tells the crush limit", (True, False))


class Gentle(Grasp):
    """`Grasp` of cylinders and boxes that a hand crushes when it squeezes them too hard.

    The squeeze is half of the sum of the hand's normal forces on the object, so what either side of
    a pinch presses with, after a first-order low pass over the physics steps.

    Args:
        config: as for `Grasp`, with the range of the crush limit and the time constant.
        told: whether the observation tells the crush limit.
        object: as for `Grasp`.

    Raises:
        ParameterError: As from `Grasp`, or `told` is not a truth value.

    Attributes:
        squeeze: filtered squeeze, shape (n,) [N].
        peak: its largest value in the episode, shape (n,) [N].
        crush_limit: shape (n,) [N].
    """

    shapes = ("cylinder", "box")
    changing = (*Grasp.changing, "squeeze", "peak")
    config_class = GentleConfig
    every_step = True
    sensed_terms: ClassVar = {"load": LOAD_TERMS}

    def __init__(
        self,
        config: Annotated[
            GentleConfig | Mapping[str, Any] | None, config_option(GentleConfig)
        ] = None,
        told: Annotated[bool, TOLD_OPTION] = True,
        object: Annotated[ObjectSpec | Mapping[str, Any] | None, OBJECT_OPTION] = None,
    ) -> None:
        if not isinstance(told, bool):
            raise ParameterError(f"told {told!r} must be True or False")
        super().__init__(config, object)
        self._refuse_ranges(("sphere_radius",), "there are no spheres")
        limit = Term(
            "crush_limit",
            ("limit",),
            f"{LIMIT_UNIT:g} N",
            0.0,
            10.0,
            "squeeze beyond which the object is crushed",
            lambda setup: [self._limit_of(setup) / LIMIT_UNIT],
            fixed=True,
        )
        squeeze = Term(
            "squeeze",
            ("squeeze",),
            f"{LIMIT_UNIT:g} N",
            0.0,
            10.0,
            "half of the hand's normal forces on the object, after the low pass",
            lambda now: column(self.squeeze / LIMIT_UNIT),
        )
        self.terms = (*self.terms, limit) if told else self.terms
        self.privileged_terms = (*PRIVILEGED_TERMS, squeeze, *(() if told else (limit,)))

    def _rewards(self) -> tuple[RewardTerm, ...]:
        weight = self.config.weights.squeeze

        def value(now: Moment) -> Array:
            return weight * np.maximum(self.squeeze / self.crush_limit - 0.5, 0.0)

        meaning = f"{weight:g} · (squeeze / crush limit − 0.5), where that is positive"
        return (*super()._rewards(), RewardTerm("squeeze", meaning, value))

    def _limit_of(self, setup: SceneSetup) -> float:
        """The crush limit of a setup; one of a plain scene has the middle of the range."""
        if isinstance(setup, GentleSetup):
            return setup.crush_limit
        return float(np.mean(self.config.crush_limit))

    def prepare(self, num_worlds: int, noise: CameraNoise) -> Senses:
        super().prepare(num_worlds, noise)
        self.squeeze = np.zeros(num_worlds)
        self.peak = np.zeros(num_worlds)
        self.crush_limit = np.zeros(num_worlds)
        servos = ServoSenses() if self.obs == "load" else None
        return _Camera(num_worlds, noise, self.viewpoint, servos)

    def setup(self, rng: np.random.Generator, hand: Hand = HPAC) -> GentleSetup:
        """Draw one episode: as for `Grasp`, and the crush limit."""
        scene = super().setup(rng, hand)
        return scene.to(GentleSetup, crush_limit=rng.uniform(*self.config.crush_limit))

    def start(self, worlds: Sequence[int], setups: Sequence[SceneSetup]) -> None:
        super().start(worlds, setups)
        index = np.asarray(worlds)
        self.squeeze[index] = self.peak[index] = 0.0
        self.crush_limit[index] = [self._limit_of(setup) for setup in setups]

    def judge(self, state: SceneState, dt: float) -> NDArray[np.int_]:
        """As `Grasp.judge`; an episode also fails as soon as the squeeze exceeds the limit."""
        outcome = super().judge(state, dt)
        share = -np.expm1(-dt / state.force_steps.shape[1] / self.config.squeeze_time)
        for force in state.force_steps.T:
            self.squeeze = self.squeeze + share * (force / 2 - self.squeeze)
            self.peak = np.maximum(self.peak, self.squeeze)
        return np.where(self.crushed, FAILURE, outcome)

    @property
    def crushed(self) -> NDArray[np.bool_]:
        """True where the squeeze has exceeded the limit in this episode, shape (n,)."""
        return self.peak > self.crush_limit

    def report(self, now: Moment) -> Mapping[str, Any]:
        """As `Task.report`, with the squeeze, its peak, the crush limit [N], and whether it was
        exceeded.
        """
        return {
            **super().report(now),
            "squeeze": self.squeeze.copy(),
            "peak_squeeze": self.peak.copy(),
            "crush_limit": self.crush_limit.copy(),
            "is_crushed": self.crushed,
        }
