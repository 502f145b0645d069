"""Files that `hpac calibrate` makes of the held-out hands' own simulated sweeps: ``python -m
experiments.held_out --out hpac_gym/body/data/calibrated``.

A hand whose record is refused, the one with a dead finger, has no file."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from experiments.populations import POINTS
from experiments.rig import Rig
from hpac_gym.body.hands import HandVariant, hand_set
from hpac_gym.calibration.calibrate import named
from hpac_gym.calibration.identification import identify
from hpac_gym.calibration.judging import judged
from hpac_gym.calibration.record import RecordError
from hpac_gym.command import command_parser, run
from hpac_gym.model import HPAC, Array, Calibration, Hand, hand_to_toml
from hpac_gym.model.settled import settled_joints_from_servo
from hpac_gym.output import write_text
from hpac_gym.physics.stand import HAND
from hpac_gym.progress import progress


def main(argv: list[str] | None = None) -> None:
    """Sweep and calibrate every held-out hand, and print the error of its file."""
    parser = command_parser("experiments.held_out", __doc__)
    parser.add_argument(
        "--out", type=Path, default=Path("runs/held_out"), metavar="DIR", help="folder of the files"
    )
    arguments = parser.parse_args(argv)
    for number, variant in enumerate(progress(hand_set("test"), "held-out hands")):
        try:
            hand = calibrated(variant, number)
        except RecordError as error:
            print(f"{variant.name}: no file, {error}")
            continue
        write_text(arguments.out / f"{variant.name}.toml", hand_to_toml(hand))
        print(
            f"{variant.name}: mean error {file_error_deg(hand, variant).max():.3f}° at the worst "
            f"joint, {file_error_deg(HPAC, variant).max():.1f}° for the nominal hand"
        )


def calibrated(variant: HandVariant, seed: int) -> Hand:
    """The hand that `hpac calibrate` makes of one sweep, in PyBullet where it is installed.

    The simulated hand is that of the environments, on the stand; the seed is the camera's. At rest
    the joints are against their stops, whatever the servos' zeros.

    Raises:
        RecordError: The record is refused.
    """
    settings = replace(HAND, slack=variant.slack, strength=variant.strength)
    rig = Rig(variant.hand, settings, servo_zero=variant.servo_zero)
    record = rig.sweep(np.random.default_rng(seed))
    judged(record, HPAC)
    hand = named(identify(record), HPAC, f"the sweep of {variant.name} by experiments.held_out")
    return replace(hand, name=f"H-PAC {variant.name}, calibrated")


def truth(variant: HandVariant) -> Hand:
    """The numbers that a perfect calibration would find: slack and, in flexion, the dead band turn
    the horn like a zero.
    """
    zero = np.array(variant.servo_zero) - HAND.servo.dead_band
    return with_zeros(variant.hand, zero, variant.slack)


def with_zeros(hand: Hand, servo_zero: ArrayLike, slack: ArrayLike = 0.0) -> Hand:
    """A hand with zeros of its servos, shape (6,) [rad], and slack of its driving tendons, shape (5,)
    [m], which turns the horn like a zero.
    """
    zero = np.array(servo_zero)
    zero[:-1] -= np.divide(slack, [digit.servo_radius for digit in hand.digits.values()])
    return replace(hand, calibration=Calibration(tuple(zero.tolist())))


def file_error_deg(hand: Hand, variant: HandVariant) -> Array:
    """Mean absolute error of a hand's model over the servos' range, by joint [°]."""
    servo = np.linspace(HPAC.servo_min, HPAC.servo_max, POINTS)
    off = settled_joints_from_servo(servo, hand) - settled_joints_from_servo(servo, truth(variant))
    return np.degrees(np.abs(off)).mean(axis=0)


if __name__ == "__main__":
    sys.exit(run(main))
