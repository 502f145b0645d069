"""Accuracy of printed tags before a camera, on rendered pictures: ``python -m experiments.watched``.

The object's pose in the hand's frame, from one picture of 1280 × 720 pixels from 0.4 m; and whole
sweeps, in lock-step: `calibration.driver` → link → firmware in virtual time → pulses → a MuJoCo hand →
pictures of the tags on its links from 0.3 m → angles → record → `hpac calibrate`. The pictures are
pieces of the print of the sheet (`experiments.pictures`) where the simulated links are, blurred by 0.6
pixels, with noise of 3 grey values and an uneven light; the hand itself is not drawn."""

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.hidden import LAWS, hidden_hands
from experiments.pictures import Piece, Pinhole
from experiments.quasistatic import Built
from experiments.rig import Rig, rig_of, upright
from hpac_gym.body.geometry import Phalanx, link_poses, load_geometry
from hpac_gym.bridge import HandLink, VirtualHand, servo_from_pulses
from hpac_gym.calibration.driver import Driver
from hpac_gym.calibration.file_errors import check_errors
from hpac_gym.calibration.identification import identify
from hpac_gym.calibration.judging import judged
from hpac_gym.calibration.protocol import Protocol, rest_pose
from hpac_gym.calibration.record import Sweep, concatenate
from hpac_gym.calibration.segment import Segment
from hpac_gym.camera import CameraError
from hpac_gym.camera.detection import Lens, Seen, detect
from hpac_gym.camera.poses import object_place
from hpac_gym.camera.sheet import CHAINS, STRIPS
from hpac_gym.command import run_module, whole_number
from hpac_gym.model import HPAC, JOINT_INDEX, JOINTS, SERVO_INDEX, SERVOS
from hpac_gym.model.checks import Array
from hpac_gym.output import write_text
from hpac_gym.physics.stand import HandOnStand
from hpac_gym.progress import progress

OUT = Path("docs/results/experiments/watched.json")
OBJECT_CARD = Piece((50.0, 240.0), 33.0, 33.0)
HAND_CARD = Piece((115.0, 240.0), 51.0, 51.0)
"""The boards, where they are printed."""
TOP = 0.05
"""Half height of the object, on whose top its board lies [m]."""
DISTANCE = 0.4
TILT = np.radians(45.0)
"""Furthest direction of the camera from the normal of the hand's board [rad]."""
TRUE = Lens(focal=(1000.0, 1000.0))
LENSES = {
    "calibrated": TRUE,
    "focal length 2 % off": Lens(focal=(1020.0, 1020.0)),
    "focal length 20 % off": Lens(focal=(1200.0, 1200.0)),
}


def object_scene(
    rng: np.random.Generator, cards: tuple[Piece, Piece] = (OBJECT_CARD, HAND_CARD)
) -> tuple[np.ndarray, Array, Array]:
    """A picture of an upright object before the hand, and the object's true position (3,) [m] and
    rotation (3, 3) in the hand's frame.
    """
    position = np.array([0.05, 0.005, 0.11]) + rng.uniform(-0.02, 0.02, 3)
    # The hand's thumb is up: the object's x, y and z are the hand's z, x and y.
    upright = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    rotation = Rotation.from_rotvec(rng.normal(0.0, 0.15, 3)).as_matrix() @ upright
    on_object = position + TOP * rotation[:, 2]
    on_hand = np.array([0.0, 0.03, -0.03])
    tilt = rng.uniform(0.0, TILT)
    turn = rng.uniform(0.0, 2 * np.pi)
    direction = [np.sin(tilt) * np.cos(turn), np.cos(tilt), np.sin(tilt) * np.sin(turn)]
    middle = (on_object + on_hand) / 2
    across = np.array([rng.choice([-1.0, 1.0]), 0.0, rng.uniform(-0.3, 0.3)])
    camera = Pinhole(middle + DISTANCE * np.array(direction), middle, across)
    pieces = [
        (cards[0], on_object, rotation[:, 0], rotation[:, 1]),
        (cards[1], on_hand, np.array([-1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])),
    ]
    return camera.picture(pieces, rng), position, rotation


def object_errors(count: int, seed: int, lens: Lens = TRUE, shown: bool = False) -> Array:
    """Errors of the object's position [mm] and rotation [°] in some pictures, shape (count, 2); NaN
    where no pose is found.
    """
    errors = np.full((count, 2), np.nan)
    for number in progress(range(count), "pictures", shown):
        picture, position, rotation = object_scene(np.random.default_rng([seed, number]))
        try:
            found = object_place(detect(picture), lens, TOP)
        except CameraError:
            continue
        turned = Rotation.from_matrix(found.rotation.T @ rotation).magnitude()
        errors[number] = 1e3 * np.linalg.norm(found.position - position), np.degrees(turned)
    return errors


def quantiles(errors: Array) -> dict[str, float]:
    """Median, 95th percentile and maximum of what is not NaN."""
    low, high, most = np.nanquantile(errors, (0.5, 0.95, 1.0))
    return {"p50": float(low), "p95": float(high), "max": float(most)}


# The sweep of a hand ----------------------------------------------------------------

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
        side = -1.0 if servo.startswith(("ring", "pinky")) else 1.0
        rng = self._rng
        self._frames = []
        for name in CHAINS[servo]:
            turn = Rotation.from_rotvec(rng.normal(0.0, GLUED, 3)).as_matrix()
            self._frames.append((name, turn))
        self._side = side
        _, axes = self._places(rest_angles(servo))[0]
        middles = [middle for middle, _ in self._places(rest_angles(servo))]
        self._out = self._axis(rest_angles(servo))
        lean = Rotation.from_rotvec(np.radians(rng.uniform(-12.0, 12.0, 3))).as_matrix()
        direction = lean @ self._out
        target = np.mean(middles, axis=0)
        self._camera = Pinhole(target + STRIP_DISTANCE * direction, target, axes[1])

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
        for place, (middle, (right, top)) in enumerate(self._places(angles)):
            tag = tags[self.exchanged.get(place, place)]
            pieces.append((Piece(tag.centre, CARD_MM, CARD_MM), middle, right, top))
        return self._camera.picture(pieces, self._rng)

    def _axis(self, angles: Array) -> Array:
        """Axis of the swept joint in the hand's frame, towards the camera, shape (3,)."""
        _, rotation, phalanx = _links(self._servo.partition("_")[0], angles)[self._servo]
        return self._side * rotation @ phalanx.axis

    def _places(self, angles: Array) -> list[tuple[Array, tuple[Array, Array]]]:
        """Middle of each tag (3,) [m], and the directions of its print's right and top."""
        digit = self._servo.partition("_")[0]
        links = _links(digit, angles)
        out = self._axis(rest_angles(self._servo))
        still = _links(digit, rest_angles(self._servo))
        places = []
        for name, glued in self._frames:
            if name in links:
                position, rotation, phalanx = links[name]
                since = rotation @ still[name][1].T
                middle = position + rotation @ np.array(
                    [-(phalanx.capsule.radius + STAND_OFF), 0.0, phalanx.length / 2]
                )
            elif name == "metacarpal":
                position, since, phalanx = links["thumb_cmc"]
                since = since @ still["thumb_cmc"][1].T
                middle = position + links["thumb_cmc"][1] @ np.array(
                    [-(phalanx.capsule.radius + STAND_OFF), 0.0, phalanx.length / 2]
                )
            else:
                since = np.eye(3)
                middle = PALM[self._servo]
            top = np.array([0.0, 0.0, 1.0]) - out[2] * out
            top /= np.linalg.norm(top)
            square = np.stack([np.cross(top, out), top, out], axis=1) @ glued
            turned = since @ square
            places.append((middle, (turned[:, 0], turned[:, 1])))
        return places


def _links(digit: str, angles: Array) -> dict[str, tuple[Array, Array, Phalanx]]:
    """Position, rotation and phalanx of a digit's links by joint."""
    phalanges = load_geometry().digit(digit).phalanges
    own = np.array([angles[JOINT_INDEX[phalanx.joint]] for phalanx in phalanges])
    poses = link_poses(load_geometry().digit(digit), own)
    return {phalanx.joint: (*pose, phalanx) for phalanx, pose in zip(phalanges, poses, strict=True)}


def rest_angles(servo: str) -> Array:
    """Joint angles at rest of a sweep, shape (15,) [rad]."""
    angles = np.zeros(len(JOINTS))
    angles[JOINT_INDEX["thumb_cmc"]] = rest_pose(servo)[SERVO_INDEX["thumb_cmc"]]
    return angles


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
        driver = Driver(link, body.look, HPAC, protocol, rate_hz)
        for servo in progress(servos, f"hand {seed}", len(servos) > 1):
            body.mount(servo)
            body.true.clear()
            segment = Segment(servo)
            driver.sweep(segment)
            segment.angles_from_tags(STRIP_LENS)
            segments.append(segment)
            seen.append(segment.sweep())
            columns = [JOINT_INDEX[name] for name in CHAINS[servo][1:]]
            true = np.full_like(segment.joint_pos, np.nan)
            true[:, columns] = np.array(body.true)[:, columns]
            exact.append(seen[-1].with_joint_pos(true))
    return concatenate(seen), concatenate(exact), segments


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    parser.add_argument("--pictures", type=whole_number(0), default=500)
    parser.add_argument("--hands", type=whole_number(0), default=2)
    parser.add_argument("--seed", type=whole_number(0), default=0)
    parser.add_argument("--out", type=Path, default=OUT)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Render, measure, write the figures."""
    seed = arguments.seed
    objects = []
    for name, lens in LENSES.items() if arguments.pictures else ():
        errors = object_errors(arguments.pictures, seed, lens, shown=True)
        objects.append(
            {
                "lens": name,
                "pictures": len(errors),
                "missed": int(np.isnan(errors[:, 0]).sum()),
                "position_mm": quantiles(errors[:, 0]),
                "rotation_deg": quantiles(errors[:, 1]),
            }
        )
    hands = [
        swept_hand(built, seed + number)
        for number, built in enumerate(hidden_hands(arguments.hands, seed, LAWS["laws of the fit"]))
    ]
    options = f"--pictures {arguments.pictures} --hands {arguments.hands} --seed {seed}"
    text = {
        "command": f"python -m experiments.watched {options}",
        "objects": objects,
        "hands": hands,
        "thumbs": [
            thumb_set_back(built, seed + number)
            for number, built in enumerate(
                hidden_hands(arguments.hands, seed, LAWS["laws of the fit"])
            )
        ],
    }
    write_text(arguments.out, json.dumps(text, indent=1) + "\n")
    print(arguments.out)
    return 0


def swept_hand(built: Built, seed: int) -> dict[str, Any]:
    """Errors of the angles of a hidden hand's sweep, and of the files that calibration makes of the
    pictures and of the exact record, both judged on the exact record.
    """
    seen, exact, _ = watched_sweep(rig_of(built), seed, PROTOCOL, RATE_HZ)
    judged(seen, HPAC)
    off = np.degrees(np.abs(seen.joint_pos - exact.joint_pos))
    files = {}
    for name, record in (("exact_file_deg", exact), ("file_deg", seen)):
        errors = check_errors(exact, identify(record, HPAC).hand, HPAC)
        files[name] = float(np.mean([error.mean_abs_deg for error in errors.values()]))
    missing = np.isnan(off) & ~np.isnan(exact.joint_pos)
    return {
        "pictures": len(seen),
        "angles_missing": int(missing.sum()),
        "angle_deg": quantiles(off),
        **files,
    }


def thumb_set_back(built: Built, seed: int) -> dict[str, Any]:
    """Errors of the thumb's angles, and the slack that its sweep tells, as it is and with its horn set
    back by a tooth.
    """
    found: dict[str, Any] = {}
    for name, back in (("as it is", 0.0), ("a tooth back", TOOTH)):
        rig = rig_of(built)
        zero = (rig.servo_zero[0] - back, *rig.servo_zero[1:])
        seen, exact, (segment,) = watched_sweep(
            replace(rig, servo_zero=zero), seed, PROTOCOL, RATE_HZ, ("thumb_mp",)
        )
        found[name] = {
            "pictures": len(seen),
            "servo_zero_deg": float(np.degrees(zero[0])),
            "angle_deg": quantiles(np.degrees(np.abs(seen.joint_pos - exact.joint_pos))),
            "slack_deg": float(np.degrees(segment.slack(HPAC))),
        }
    return found


if __name__ == "__main__":
    sys.exit(run_module("experiments.watched", __doc__, add_arguments))
