"""Sensing with a camera and low-cost servos: the camera loses an occluded object, and servos report
their load.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from hpac_gym.body.objects import ObjectSpec
from hpac_gym.model import DIGITS, SERVOS
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import SceneSetup, SceneState, Viewpoint
from hpac_gym.physics.tendons import ROOTS, Drive
from hpac_gym.tasks.cameras import CameraNoise, ObjectCamera
from hpac_gym.tasks.occlusion import Skeleton, covered, dots, surface
from hpac_gym.tasks.terms import GRASP_CENTRE, LENGTH_UNIT, Term

POINTS = 64
"""Largest number of surface points in an observation."""
_SPREAD = 160
"""Number of points sampled on an object's surface; less than half of them face the camera."""
_PROBED = 48
"""Number of those points that decide whether the object is seen."""
_LAW = attrgetter("servo_radius", "alpha", "squares", "product", "length", "stiffness", "limit")
"""Fields of a `Drive` that its tension at rest depends on."""
_OF_CAMERA = ("position", "up", "side", "half_extents")
"""What `ObjectCamera.look` measures."""
SEEN_SHARE = 0.7
"""Least visible fraction of the camera-facing points of a seen object; chosen: a tracker needs most
of the outline.
"""


@dataclass(frozen=True, slots=True)
class ServoSenses:
    """Feedback of a low-cost servo.

    The nearest servo to this hand's with a published data sheet is the DYNAMIXEL XL-320 (see
    `physics.settings.BODIES`). Its manual gives the stall torque, a position of 10 bits over 300°
    and a present load; it does not specify the load's noise."""

    stall_torque: float = 0.39
    """Stall torque at 7.4 V; XL-320's manual [N·m]."""
    stiffness: float = 24.0
    """Torque per angle by which a horn stays behind its command, at the horn [N·m/rad]; chosen: with
    it two thirds of the drive's compliance are the servo's, one third the tendon's, and their sum,
    which the physics knows, stays as it is.
    """
    horn_step: float = np.deg2rad(300.0) / 1023
    """Resolution of the horn's angle; XL-320's manual: 1023 steps over 300° [rad]."""
    load_step: float = 1 / 128
    """Resolution of the load as a fraction of the stall torque; chosen: 8 bits with sign, as from a
    shunt and a small ADC.
    """
    load_noise: float = 0.02
    """Standard deviation of the load in every reading, as a fraction of the stall torque; chosen.
    """
    load_bias: float = 0.03
    """Standard deviation of a servo's load bias per episode, as a fraction of the stall torque;
    chosen: friction of its gears.
    """
    period: int = 2
    """Control steps between readings; chosen: six servos are polled in turn on one bus, 10 readings
    per second.
    """


LOAD_TERMS = (
    Term(
        "load",
        SERVOS[:-1],
        "1",
        -1.0,
        1.0,
        "load of the servo that pulls the digit's tendon, as a share of its stall torque",
        lambda now: now.seen["load"],
    ),
    Term(
        "horn_lag",
        SERVOS,
        "0.1 rad",
        -5.0,
        5.0,
        "commanded servo angle less the horn's as the servo tells it",
        lambda now: (now.commanded - now.seen["horn"]) / 0.1,
    ),
)
"""Terms that `obs="load"` adds. The servo of the CMC, which pulls no tendon, has no load in the
simulation.
"""


class Senses:
    """`ObjectCamera` with occlusion by the hand, and the servos' feedback, for n worlds.

    Args:
        num_worlds: n.
        noise: noise of the camera.
        view: viewpoint of the camera, from `VIEW_TARGET`; it follows the wrist.
        servos: feedback of the servos; None reads none.
        points: whether `points` is asked for, which takes more points of an object's surface.
    """

    changing = ("_camera", "_rng", "_count", "_seen")

    def __init__(
        self,
        num_worlds: int,
        noise: CameraNoise,
        view: Viewpoint,
        servos: ServoSenses | None = None,
        points: bool = False,
    ) -> None:
        self._camera = ObjectCamera(num_worlds, noise)
        self._view = view
        self._servos = servos
        self._skeleton = Skeleton(num_worlds)
        self._eye = np.zeros((num_worlds, 3))
        self._spread = _SPREAD if points else _PROBED
        self._points = np.zeros((num_worlds, self._spread, 3))
        self._normals = np.zeros((num_worlds, self._spread, 3))
        self._drives = np.zeros((num_worlds, 7, len(DIGITS)))
        self._rng: list[np.random.Generator | None] = [None] * num_worlds
        self._bias = np.zeros((num_worlds, len(DIGITS)))
        self._zero = np.zeros((num_worlds, len(SERVOS)))
        self._count = np.zeros(num_worlds, dtype=int)
        self._seen = {name: np.zeros((num_worlds, 3)) for name in _OF_CAMERA} | {
            "load": np.zeros((num_worlds, len(DIGITS))),
            "horn": np.zeros((num_worlds, len(SERVOS))),
            "visible": np.zeros(num_worlds),
        }

    def start(self, world: int, setup: SceneSetup, factor: float, rng: np.random.Generator) -> None:
        """Begin an episode of a setup, with `factor` times the camera's noise and the load's bias,
        drawn from `rng`.
        """
        camera_rng, self._rng[world] = rng.spawn(2)
        self._camera.start(world, setup, factor, camera_rng)
        self._skeleton.fit(world, setup.geometry)
        self._points[world], self._normals[world] = self._surface(setup.object)
        self._eye[world] = VIEW_TARGET + setup.hand_rotation.T @ eye_offset(self._view)
        if self._servos is not None:
            settings = setup.hand_settings
            self._zero[world] = settings.servo_zero
            digits = zip(setup.hand.digits.values(), settings.slack, settings.strength, strict=True)
            self._drives[world] = np.transpose([_LAW(Drive.of(*values)) for values in digits])
            deviation = self._servos.load_bias * factor
            self._bias[world] = deviation * self._rng[world].standard_normal(len(DIGITS))
        self._count[world] = 0

    def _surface(self, spec: ObjectSpec) -> tuple[Array, Array]:
        model = spec.model or spec.solid_model
        name = spec.shape if spec.model is None else model.name
        points, normals = surface(name, model.solids, self._spread)
        return spec.scale * points, normals

    def look(self, state: SceneState, worlds: Iterable[int]) -> dict[str, Array]:
        """Measure some worlds anew; the others keep their last measurement.

        Returns:
            Output of `ObjectCamera.look` when the object was last seen; `visible` (n,), 1 where it
            is seen now; the servos' `load` (n, 5), as a fraction of the stall torque, and `horn`
            angles (n, 6) [rad], at the last reading.
        """
        rows = np.fromiter(worlds, int)
        rows.sort()
        seen = self._camera.look(state, rows)
        first = self._count[rows] == 0
        visible = self._share(state, rows) >= SEEN_SHARE
        self._seen["visible"][rows] = visible
        taken = rows[visible | first]  # in the first look the hand is not there yet
        for name in _OF_CAMERA:
            self._seen[name][taken] = seen[name][taken]
        if self._servos is not None:
            self._read_servos(state, rows[self._count[rows] % self._servos.period == 0])
        self._count[rows] += 1
        return {name: values.copy() for name, values in self._seen.items()}

    def _read_servos(self, state: SceneState, rows: NDArray[np.int_]) -> None:
        servos = self._servos
        noise = np.array([self._rng[row].standard_normal(len(DIGITS)) for row in rows]).reshape(
            -1, len(DIGITS)
        )
        load = (
            state.tension[rows] * self._drives[rows, 0] / servos.stall_torque
            + self._bias[rows]
            + servos.load_noise * noise
        )
        self._seen["load"][rows] = np.round(load / servos.load_step) * servos.load_step
        horn = state.horn[rows] - self._zero[rows]  # a servo knows its encoder alone
        horn[:, : len(DIGITS)] -= self._behind(state, rows)
        self._seen["horn"][rows] = np.round(horn / servos.horn_step) * servos.horn_step

    def _behind(self, state: SceneState, rows: NDArray[np.int_]) -> Array:
        """Angles by which pulling horns stay behind, shape (len(rows), 5) [rad].

        At rest the tension is that of `Drive`, T = min(k s, limit) for a stretch s of a drive whose
        servo follows its command. A servo gives way by T r / `stiffness`, and once it stalls by all
        that the limit leaves of the stretch.
        """
        radius, alpha, squares, product, length, stiffness, limit = self._drives[rows].swapaxes(
            0, 1
        )
        chord = np.sqrt(squares - product * np.cos(alpha - state.joint_pos[rows][:, ROOTS]))
        pulls = radius * state.horn[rows, : len(DIGITS)] + chord - length
        stretch = np.maximum(pulls, 0.0)
        tension = np.minimum(stiffness * stretch, limit)
        stalled = stretch - tension / stiffness
        return stalled / radius + tension * radius / self._servos.stiffness

    def _share(self, state: SceneState, rows: NDArray[np.int_]) -> Array:
        """Visible fraction of the points that face the camera, shape (len(rows),)."""
        facing, hidden, _ = self._sight(state, rows, _PROBED)
        facing = facing.sum(axis=1)
        return (facing - hidden.sum(axis=1)) / np.maximum(facing, 1)

    def _sight(
        self, state: SceneState, rows: NDArray[np.int_], count: int
    ) -> tuple[NDArray, NDArray, Array]:
        """Masks of the points that face the camera and of those of them that are occluded, and all
        points in the hand frame [m].
        """
        rotation = state.object_rotation[rows].swapaxes(1, 2)
        points = self._points[rows, :count] @ rotation + state.object_pos[rows, None]
        normals = self._normals[rows, :count] @ rotation
        eye = self._eye[rows]
        facing = dots(normals, eye[:, None] - points) > 0
        bones = self._skeleton.segments(state.joint_pos[rows], rows)
        hidden = covered(eye, points, facing, *bones, self._skeleton.radius[rows])
        return facing, hidden, points

    def points(self, state: SceneState) -> NDArray[np.float32]:
        """Visible points, shape (n, POINTS, 4): x, y, z from `GRASP_CENTRE` in `LENGTH_UNIT`, and
        1; unused rows are zero.
        """
        facing, hidden, points = self._sight(state, np.arange(len(self._count)), _SPREAD)
        shift = self._camera.error[:, :3]  # one for all points
        seen = facing & ~hidden
        found = np.zeros((len(points), POINTS, 4), np.float32)
        order = np.argsort(~seen, axis=1, kind="stable")[:, :POINTS]
        mask = np.take_along_axis(seen, order, axis=1)
        places = (
            np.take_along_axis(points, order[:, :, None], axis=1) + shift[:, None] - GRASP_CENTRE
        )
        found[..., :3] = places / LENGTH_UNIT * mask[:, :, None]
        found[..., 3] = mask
        return np.clip(found, -POINTS_BOUND, POINTS_BOUND)


POINTS_BOUND = 10.0
"""Bound of a point's coordinates, in multiples of `LENGTH_UNIT`."""
VIEW_TARGET = np.array([0.03, 0.0, 0.10])
"""Point in the hand frame at which the camera looks, and on which images are centred [m]."""


def eye_offset(view: Viewpoint) -> Array:
    """Vector from the target of a viewpoint to the camera, along the world's axes, shape (3,)
    [m].
    """
    yaw = np.deg2rad(view.yaw_deg)
    pitch = np.deg2rad(view.pitch_deg)
    return view.distance * np.array(
        [np.sin(yaw) * np.cos(pitch), -np.cos(yaw) * np.cos(pitch), -np.sin(pitch)]
    )
