"""Interface between tasks and physics engines: the inputs of an engine, and the state arrays that
it returns.

Within a control step, servos and wrist run open loop. An engine therefore receives, for n worlds
and the k physics steps of one control step, tables of servo angles and wrist offsets, and returns
one `SceneState` of arrays with a leading axis n. This module is independent of any engine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from hpac_gym.body.geometry import HPAC_GEOMETRY, Geometry
from hpac_gym.body.objects import ObjectSpec, Support
from hpac_gym.errors import HpacError
from hpac_gym.model import DIGITS, HPAC, Hand
from hpac_gym.model.checks import Array
from hpac_gym.physics.settings import HandSettings
from hpac_gym.settings import check_bounds, setting

HAND_POSITION = np.array([0.0, 0.0, 0.25])
"""Initial wrist position in the world [m]."""
HAND_QUATERNION = (0.5, 0.5, 0.5, 0.5)
"""Default orientation of the hand, xyzw: fingers along the world's +x, palm facing +y, thumb up."""
OBJECT_COLORS = {
    "cylinder": (0.16, 0.50, 0.73, 1.0),
    "box": (0.80, 0.33, 0.23, 1.0),
    "sphere": (0.30, 0.62, 0.35, 1.0),
}
"""Colours of the primitive objects, RGBA."""

PARTS = ("palm", *DIGITS)
"""Parts of the hand whose contacts with the object are distinguished."""


class PhysicsError(HpacError, RuntimeError):
    """A simulation failed; the message names the world and the cause.

    Attributes:
        worlds: worlds that failed and are back at the start of their setups, while the others
            advanced; empty if the engine cannot continue.
    """

    def __init__(self, message: str, worlds: Sequence[int] = ()) -> None:
        super().__init__(message)
        self.worlds = tuple(worlds)


class PhysicsWarning(UserWarning):
    """A simulation failed, and its episode ended as a failure; or a hand is too stiff for PyBullet."""


Kind = TypeVar("Kind", bound="SceneSetup")


@dataclass(frozen=True, slots=True)
class SceneSetup:
    """Initial state of one episode: hand, object and their surroundings. A task whose episodes have
    more than a scene has a subclass of it.
    """

    object: ObjectSpec | None
    """Object to grasp; None for the hand alone, fixed at its palm, without object, support, table
    and wrist.
    """
    position: Array = field(default_factory=lambda: np.zeros(3))
    """Centre of the object in the hand frame, shape (3,) [m]."""
    yaw: float = setting(0.0, bounds=(-np.inf, np.inf), unit="rad")
    """Rotation of the object about the vertical [rad]."""
    synergy: Array = field(default_factory=lambda: np.zeros(6))
    """Initial synergy of the hand, shape (6,) [rad]."""
    hand: Hand = HPAC
    geometry: Geometry = HPAC_GEOMETRY
    """Geometry of the hand's body."""
    hand_settings: HandSettings = HandSettings()
    hand_quaternion: tuple[float, float, float, float] = HAND_QUATERNION
    """Orientation of the hand's frame in the world, xyzw."""
    object_quaternion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    """Orientation of the object in the world before its yaw, xyzw."""
    support: Support | None = None
    """Support of the object; None is `hpac_gym.physics.supports.POST`."""
    target: Array | None = None
    """Target position of the object's centre, on its own post, in the initial hand frame, shape
    (3,) [m]; None for no target.
    """
    fixed: bool = False
    """True fixes the object in the world, without a support, as an obstacle for measurements."""
    rest_height: float | None = setting(None, number=True, bounds=(0.0, 1.0), unit="m", above=True)
    """Height of the object's centre above its support [m]; None computes it from the bounding box.
    """

    def to(self, kind: type[Kind], **more: Any) -> Kind:
        """The same scene as a setup of a subclass, with `more` of its fields."""
        return kind(**{entry.name: getattr(self, entry.name) for entry in fields(self)} | more)

    @property
    def hand_rotation(self) -> Array:
        """Rotation of the hand's frame in the world, shape (3, 3)."""
        return matrix_from_quaternion(self.hand_quaternion)

    @property
    def stand_height(self) -> float:
        """Height of the object's centre above its support [m]."""
        if self.rest_height is not None:
            return self.rest_height
        return float(
            np.abs(matrix_from_quaternion(self.object_quaternion)[2]) @ self.object.half_extents
        )

    @property
    def object_turn(
        self,
    ) -> tuple[tuple[float, float, float, float], tuple[float, float, float, float]]:
        """Orientation of the object in the world, and the rotation by its yaw only, quaternions
        xyzw.
        """
        (x, y, z, w) = self.object_quaternion
        sine = np.sin(self.yaw / 2)
        cosine = np.cos(self.yaw / 2)
        turned = (
            cosine * x - sine * y,
            cosine * y + sine * x,
            cosine * z + sine * w,
            cosine * w - sine * z,
        )
        return turned, (0.0, 0.0, sine, cosine)


@dataclass(slots=True)
class SceneState:
    """State of n worlds as tasks, observations and rewards read it; arrays with a leading axis
    n.
    """

    time: Array
    """Time since the episode began, shape (n,) [s]."""
    joint_pos: Array
    """True joint angles, shape (n, 15) [rad]."""
    joint_vel: Array
    """True joint velocities, shape (n, 15) [rad/s]."""
    horn: Array
    """Angles of the servos' horns, shape (n, 6) [rad]; `Simulation` fills it in."""
    tension: Array
    """Tension of the driving tendons, shape (n, 5) [N]."""
    palm_offset: Array
    """Offset of the wrist from its start, along the world's axes, shape (n, 3) [m]."""
    object_pos: Array
    """Centre of the object in the hand frame, shape (n, 3) [m]."""
    object_rotation: Array
    """Rotation from the object's axes to the hand's, shape (n, 3, 3)."""
    object_vel: Array
    """Velocity of the object's centre, that of `object_pos`, relative to the world, along the axes
    of the hand frame, shape (n, 3) [m/s].
    """
    object_spin: Array
    """Angular velocity of the object relative to the world, along the axes of the hand frame, shape
    (n, 3) [rad/s].
    """
    touching: NDArray[np.bool_]
    """True where each of `PARTS` touches the object, shape (n, 6)."""
    contact_force: Array
    """Sum of the normal forces between each of `PARTS` and the object, shape (n, 6) [N]."""
    supported: NDArray[np.bool_]
    """True where the object touches its support, the table or the target's post, shape (n,)."""
    on_target: NDArray[np.bool_]
    """True where the object touches the target's post, shape (n,)."""
    force_steps: Array
    """Sum of the normal forces between hand and object in each physics step of the last control
    step, shape (n, k) [N]; shape (n, 0) unless `Engine.every_step` asks for them.
    """

    @classmethod
    def empty(cls, n: int) -> SceneState:
        """Zeros for n worlds."""
        return cls(*[np.zeros((n, *shape), kind) for shape, kind in _FIELDS])


_SHAPES = {
    "joint_pos": (15,),
    "joint_vel": (15,),
    "horn": (6,),
    "tension": (5,),
    "object_rotation": (3, 3),
    "touching": (6,),
    "contact_force": (6,),
    "time": (),
    "supported": (),
    "on_target": (),
    "force_steps": (0,),
}
_FIELDS = [
    (_SHAPES.get(entry.name, (3,)), bool if "bool" in entry.type else float)
    for entry in fields(SceneState)
]


@dataclass(frozen=True, slots=True)
class Contacts:
    """Contacts between the hand and the object of one world, in the world's frame."""

    point: Array
    """Points on the object, shape (m, 3) [m]."""
    normal: Array
    """Contact normals, unit vectors into the object, shape (m, 3)."""
    force: Array
    """Forces along the normals, shape (m,) [N]."""
    link: tuple[str, ...]
    """Links of the hand: "palm", or "{joint}_link"."""
    centre: Array
    """Centre of the object, shape (3,) [m]."""
    friction: float
    """Coulomb coefficient between skin and object."""


@dataclass(frozen=True, slots=True)
class Viewpoint:
    """Camera pose relative to its target, and image size.

    Raises:
        ParameterError: A size or distance that is not positive.
    """

    width: int = setting(480, bounds=(0, np.inf), above=True, unit="px")
    height: int = setting(360, bounds=(0, np.inf), above=True, unit="px")
    distance: float = setting(0.31, bounds=(0.0, np.inf), above=True, unit="m")
    """Distance from the target [m]."""
    yaw_deg: float = 160.0
    pitch_deg: float = -20.0
    field_of_view_deg: float = 42.0
    """Vertical field of view [deg]."""

    def __post_init__(self) -> None:
        check_bounds(self, "picture")


class Engine:
    """Physics of n worlds, one hand each. Results depend, to the bit, only on setup and tables, not
    on history or neighbours.

    Attributes:
        num_worlds: n.
        dt: physics step [s].
        every_step: whether `SceneState.force_steps` is wanted; False at first.
    """

    def __init__(self, num_worlds: int, dt: float) -> None:
        self.num_worlds = num_worlds
        self.dt = dt
        self.every_step = False
        self._force_steps = np.zeros((num_worlds, 0))

    def require(self, settings: HandSettings) -> None:
        """Refuse a hand that this engine cannot simulate.

        Raises:
            ParameterError: The engine does not support one of the settings.
        """

    def reset(self, worlds: Sequence[int], setups: Sequence[SceneSetup]) -> None:
        """Reset some worlds: hand at rest on its manifold, object on its support."""

    def advance(
        self, servo: Array, servo_vel: Array, wrist: Array, push: Array | None = None
    ) -> None:
        """Carry out k physics steps in every world.

        Args:
            servo: angles of the horns during each step, shape (n, k, 6) [rad].
            servo_vel: their speeds, shape (n, k, 6) [rad/s].
            wrist: offset of the palm from its start at the end of each step, along the world's
                axes, shape (n, k, 3) [m].
            push: force on the object at its centre of mass during each step, along the world's
                axes, shape (n, k, 3) [N]; None is no force. A world without a movable object
                ignores its rows.

        Raises:
            PhysicsError: A world's simulation failed; the message names the world.
        """

    def state(self) -> SceneState:
        """Current state of every world, in arrays that later calls do not modify."""

    def contacts(self, world: int) -> Contacts:
        """Current contacts between hand and object of one world."""

    def picture(self, world: int, viewpoint: Viewpoint, target: Array) -> NDArray[np.uint8]:
        """RGB image of one world, shape (height, width, 3), centred on `target`, a world point,
        shape (3,) [m].
        """

    def save(self, world: int) -> Any:
        """A snapshot of one world, which `restore` continues bit-exactly."""

    def restore(self, world: int, snapshot: Any) -> None:
        """Restore a world to a snapshot of that world."""

    def close(self) -> None:
        """Release the engine's resources. Closing twice is allowed."""

    def _forget_forces(self, worlds: Sequence[int]) -> None:
        """Episodes begin in some worlds, without forces of the ones before."""
        self._force_steps = self._force_steps.copy()  # an earlier state has this array
        self._force_steps[list(worlds)] = 0.0


def matrix_from_quaternion(quaternion: Sequence[float]) -> Array:
    """The rotation matrix of a unit quaternion xyzw, shape (3, 3), read-only."""
    return _matrix(*quaternion)


@lru_cache(maxsize=256)
def _matrix(x: float, y: float, z: float, w: float) -> Array:
    matrix = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    matrix.setflags(write=False)
    return matrix
