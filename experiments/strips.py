"""Hands that are swept before a rendered camera, in lock-step: `calibration.driver` → link → firmware in
virtual time → pulses → a MuJoCo hand with tags → pictures."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.pictures import Piece, Pinhole
from experiments.rig import Rig, upright
from hpac_gym.body.geometry import Phalanx, link_poses, load_geometry
from hpac_gym.bridge import HandLink, VirtualHand, servo_from_pulses
from hpac_gym.calibration.driver import Segment, sweep_servo
from hpac_gym.calibration.record import Protocol, Sweep, concatenate, rest_pose
from hpac_gym.camera.detection import Lens, Seen, detect
from hpac_gym.camera.sheet import CHAINS, STRIPS
from hpac_gym.model import HPAC, JOINT_INDEX, JOINTS, SERVO_INDEX, SERVOS, Array
from hpac_gym.physics.stand import HandOnStand
from hpac_gym.progress import progress

PROTOCOL = Protocol(points=13, seconds_per_point=1.0, both_directions=True)
RATE_HZ = 10.0
"""A shorter sweep than of a real hand, with fewer pictures (chosen)."""
LATCH_US = 20_000
"""Period of a servo's pulses [µs]."""
TOOTH = 2 * np.pi / 25
"""Of a horn's spline (chosen) [rad]."""
STRIP_DISTANCE = 0.3
STRIP_LENS = Lens(focal=(1000.0, 1000.0))
GLUED = np.radians(3.0)
"""Standard deviation with which tags are glued on, about each axis [rad]."""
STAND_OFF = 0.010
"""From the back of a link to the middle of its tag [m]."""
CARD_MM = 20.0
PALM = {
    "thumb_cmc": np.array([-0.010, 0.0, -0.010]),
    "index_mcp": np.array([-0.023, 0.036, 0.065]),
    "middle_mcp": np.array([-0.023, 0.036, 0.065]),
    "ring_mcp": np.array([-0.022, -0.036, 0.055]),
    "pinky_mcp": np.array([-0.022, -0.036, 0.055]),
}
"""Middle of the palm's tag [m], for the thumb's CMC at the wrist, where no other tag hides it."""


class Body:
    """A simulated hand that follows the pulses of the firmware, with tags on the links of one digit
    and a camera before them.

    Args:
        rig: hand, settings and stand.
        seed: of how the tags are glued on, of the camera's place, and of the pictures' noise.
    """

    def __init__(self, rig: Rig, seed: int) -> None:
        self._rig = rig
        self._rng = np.random.default_rng([seed, 7])
        self._sim: HandOnStand | None = None
        self.true: list[Array] = []
        """The true angles of each picture."""
        self.exchanged: dict[int, int] = {}
        """Tags that are glued where others belong, by the place of the strip."""

    def mount(self, servo: str) -> None:
        """Put the hand into the stand for a sweep, with its tags and the camera."""
        if self._sim is not None:
            self._sim.close()
        self._servo = servo
        rig = self._rig
        self._sim = HandOnStand(
            rig.hand, rig.settings, rig.world, tuple(upright(servo)), engine=rig.engine
        )
        self._sim.reset(np.zeros(len(SERVOS)))
        self._time_us: int | None = None
        self._resting = True
        rest = np.zeros(len(JOINTS))
        rest[JOINT_INDEX["thumb_cmc"]] = rest_pose(servo)[SERVO_INDEX["thumb_cmc"]]
        self._still = _links(servo, rest)
        _, rotation, phalanx = self._still[servo]
        side = -1.0 if servo.startswith(("ring", "pinky")) else 1.0
        out = side * rotation @ phalanx.axis  # of the swept joint, towards the camera
        top = np.array([0.0, 0.0, 1.0]) - out[2] * out
        top /= np.linalg.norm(top)
        square = np.stack([np.cross(top, out), top, out], axis=1)
        self._glued = [
            square @ Rotation.from_rotvec(self._rng.normal(0.0, GLUED, 3)).as_matrix()
            for _ in CHAINS[servo]
        ]
        places = self._places(rest)
        lean = Rotation.from_rotvec(np.radians(self._rng.uniform(-12.0, 12.0, 3))).as_matrix()
        target = np.mean([middle for middle, *_ in places], axis=0)
        *_, upward = places[0]
        self._camera = Pinhole(target + STRIP_DISTANCE * (lean @ out), target, upward)

    def on_pulses(self, now_us: int, pulses: np.ndarray) -> None:
        """Advance the simulated hand to the firmware's time."""
        if self._sim is None:
            return
        if not pulses.all():
            if not pulses.any() and not self._resting:
                self._sim.reset(np.zeros(len(SERVOS)))  # its springs have pulled it to its stops
                self._resting = True
            self._time_us = None
            return
        if self._time_us is None:
            self._time_us = now_us
            self._resting = False
        if now_us - self._time_us < LATCH_US:
            return
        dt = (now_us - self._time_us) * 1e-6
        servo = servo_from_pulses(pulses)
        self._sim.command(servo + np.array(self._rig.servo_zero), dt)
        self._sim.step(dt)
        self._time_us = now_us

    def look(self) -> Seen:
        """The tags in a picture of the present moment."""
        angles = self._sim.joint_pos
        self.true.append(angles)
        return detect(self.picture(angles))

    def picture(self, angles: Array) -> np.ndarray:
        """What the camera sees of a hand with some joint angles, shape (15,) [rad]."""
        tags = STRIPS[self._servo]
        pieces = []
        for place, where in enumerate(self._places(angles)):
            tag = tags[self.exchanged.get(place, place)]
            pieces.append((Piece(tag.centre, CARD_MM, CARD_MM), *where))
        return self._camera.picture(pieces, self._rng)

    def _places(self, angles: Array) -> list[tuple[Array, Array, Array]]:
        """Middle of each tag [m], and the directions of its print's right and top, of shape (3,)."""
        links = _links(self._servo, angles)
        places = []
        for name, glued in zip(CHAINS[self._servo], self._glued, strict=True):
            link = "thumb_cmc" if name == "metacarpal" else name
            if link in links:
                position, rotation, phalanx = links[link]
                glued = rotation @ self._still[link][1].T @ glued
                middle = position + rotation @ np.array(
                    [-(phalanx.capsule.radius + STAND_OFF), 0.0, phalanx.length / 2]
                )
            else:
                middle = PALM[self._servo]
            places.append((middle, glued[:, 0], glued[:, 1]))
        return places


def _links(servo: str, angles: Array) -> dict[str, tuple[Array, Array, Phalanx]]:
    """Position, rotation and phalanx of the links of a servo's digit by joint."""
    digit = load_geometry().digit(servo.partition("_")[0])
    own = np.array([angles[JOINT_INDEX[phalanx.joint]] for phalanx in digit.phalanges])
    poses = zip(digit.phalanges, link_poses(digit, own), strict=True)
    return {phalanx.joint: (*pose, phalanx) for phalanx, pose in poses}


def watched_sweep(
    rig: Rig, seed: int, protocol: Protocol, rate_hz: float, servos: Sequence[str] = SERVOS
) -> tuple[Sweep, Sweep, list[Segment]]:
    """The record of a sweep in lock-step that a camera watches, the same with the true angles, and its
    segments.
    """
    body = Body(rig, seed)
    seen = []
    exact = []
    segments = []
    with VirtualHand(on_pulses=body.on_pulses) as hand, HandLink(hand.connect) as link:
        for servo in progress(servos, f"hand {seed}", len(servos) > 1):
            body.mount(servo)
            body.true.clear()
            segment = Segment(servo)
            sweep_servo(link, body.look, segment, HPAC, protocol, rate_hz)
            segment.angles_from_tags(STRIP_LENS)
            segments.append(segment)
            seen.append(segment.sweep())
            columns = [JOINT_INDEX[name] for name in CHAINS[servo][1:]]
            true = np.full_like(segment.joint_pos, np.nan)
            true[:, columns] = np.array(body.true)[:, columns]
            exact.append(seen[-1].with_joint_pos(true))
    return concatenate(seen), concatenate(exact), segments
