"""Accuracy of printed tags before a camera, on rendered pictures: ``python -m experiments.watched``.

The object's pose in the hand's frame, from one picture of 1280 × 720 pixels from 0.4 m; and whole
sweeps, in lock-step: `calibration.driver` → link → firmware in virtual time → pulses → a MuJoCo hand →
pictures of the tags on its links from 0.3 m → angles → record → `hpac calibrate`. The pictures are
pieces of the print of the sheet (`experiments.pictures`) where the simulated links are, blurred by 0.6
pixels, with noise of 3 grey values and an uneven light; the hand itself is not drawn."""

import sys
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.hidden import LAWS, hidden_hands
from experiments.pictures import Piece, Pinhole
from experiments.quasistatic import Built
from experiments.results import add_out, write_results
from experiments.rig import rig_of
from experiments.strips import PROTOCOL, RATE_HZ, TOOTH, watched_sweep
from hpac_gym.calibration.identification import identify
from hpac_gym.calibration.judging import judged
from hpac_gym.calibration.report import check_errors
from hpac_gym.camera import CameraError
from hpac_gym.camera.detection import Lens, detect
from hpac_gym.camera.poses import object_place
from hpac_gym.command import add_counts, command_parser, run
from hpac_gym.model import HPAC, Array
from hpac_gym.progress import progress

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


def object_scene(rng: np.random.Generator) -> tuple[np.ndarray, Array, Array]:
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
        (OBJECT_CARD, on_object, rotation[:, 0], rotation[:, 1]),
        (HAND_CARD, on_hand, np.array([-1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])),
    ]
    return camera.picture(pieces, rng), position, rotation


def object_errors(count: int, seed: int, lens: Lens = TRUE) -> Array:
    """Errors of the object's position [mm] and rotation [°] in some pictures, shape (count, 2); NaN
    where no pose is found.
    """
    errors = np.full((count, 2), np.nan)
    for number in progress(range(count), "pictures"):
        picture, position, rotation = object_scene(np.random.default_rng([seed, number]))
        try:
            place = object_place(detect(picture), lens, TOP)
        except CameraError:
            continue
        turned = Rotation.from_matrix(place.rotation.T @ rotation).magnitude()
        errors[number] = 1e3 * np.linalg.norm(place.position - position), np.degrees(turned)
    return errors


def quantiles(errors: Array) -> dict[str, float]:
    """Median, 95th percentile and maximum of what is not NaN."""
    low, high, most = np.nanquantile(errors, (0.5, 0.95, 1.0))
    return {"p50": float(low), "p95": float(high), "max": float(most)}


def main(argv: list[str] | None = None) -> None:
    parser = command_parser("experiments.watched", __doc__)
    add_counts(
        parser,
        pictures=(0, 500, "pictures of an object"),
        hands=(0, 2, "hands that are swept"),
        seed=(0, 0, "of pictures and hands"),
    )
    add_out(parser)
    arguments = parser.parse_args(argv)
    seed = arguments.seed
    objects = []
    for name, lens in LENSES.items() if arguments.pictures else ():
        errors = object_errors(arguments.pictures, seed, lens)
        objects.append(
            {
                "lens": name,
                "pictures": len(errors),
                "missed": int(np.isnan(errors[:, 0]).sum()),
                "position_mm": quantiles(errors[:, 0]),
                "rotation_deg": quantiles(errors[:, 1]),
            }
        )
    hidden = list(enumerate(hidden_hands(arguments.hands, seed, LAWS["laws of the fit"]), seed))
    write_results(
        arguments.out,
        f"watched --pictures {arguments.pictures} --hands {arguments.hands} --seed {seed}",
        objects=objects,
        hands=[swept_hand(built, number) for number, built in hidden],
        thumbs=[thumb_set_back(built, number) for number, built in hidden],
    )
    print(arguments.out)


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
    sys.exit(run(main))
