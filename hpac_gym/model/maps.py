"""The command map of a model, for any number of hands: from an action to servo angles, and from
servo angles to the joint angles that the model predicts.

A nominal hand commands with the paper's Eq. (15). A hand with a `[calibration]` is commanded by
inverting its whole file: servo zeros, stretch and slack of the driving tendons, and friction, which
depends on the direction of the motion. Both map synergies, so the same policy commands both.

The inverse is tabulated per servo and direction when a model is taken up, and then costs one lookup
a step."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hpac_gym.model.checks import Array
from hpac_gym.model.command import servo_from_action, synergy_from_action
from hpac_gym.model.files import HPAC
from hpac_gym.model.joints import JOINT_INDEX, JOINTS, SERVOS
from hpac_gym.model.parameters import Hand, unchecked_servo_from_synergy
from hpac_gym.model.settled import (
    EXTENSION,
    FLEXION,
    settled_joints_from_servo,
    settled_servo_from_synergy,
)
from hpac_gym.model.transmission import unchecked_synergy_from_servo

POINTS = 513
"""Points of a table; the interpolation is within 3e-5 rad of the exact map, and within 3e-3 rad where a
joint leaves its stop.
"""
_KNOWN_MAX = 256  # hands whose tables are kept
_DIRECTIONS = (FLEXION, EXTENSION)


class CommandMap:
    """The command maps of n models.

    Nominal models must be one and the same, and every number is then that of `servo_from_action`
    and `elastic_joints_from_servo`, to the bit. Calibrated models may differ from place to place.

    Args:
        hand: the model at every place.
        count: n.

    Attributes:
        inverts_files: whether commands come from the inverse of hand files instead of Eq. (15).
    """

    def __init__(self, hand: Hand = HPAC, count: int = 1) -> None:
        self.hands = [hand] * count
        self._known: dict[int, tuple[Hand, Array, Array]] = {}
        """Tables by the id of the hand, which is kept beside them, so that no other gets its id."""
        self.inverts_files = False
        if hand.is_calibrated:
            self.take(range(count), [hand] * count)

    @property
    def bounds(self) -> Hand:
        """The hand whose servo range and rate limit bound the commands."""
        return HPAC if self.inverts_files else self.hands[0]

    def take(self, places: Sequence[int], hands: Sequence[Hand]) -> None:
        """Give some of the n places other models, all of them calibrated or not; those that differ
        from each other are commanded by the inverse of their files.
        """
        if not self.inverts_files:
            placed = dict(enumerate(self.hands)) | dict(zip(places, hands, strict=True))
            places = list(placed)
            hands = list(placed.values())
            self._servo = np.empty((len(self.hands), 2, len(SERVOS), POINTS))
            self._joint_pos = np.empty((len(self.hands), 2, len(JOINTS), POINTS))
            self.inverts_files = True
        if len(self._known) > _KNOWN_MAX:
            self._known = {}
        for place, hand in zip(places, hands, strict=True):
            self.hands[place] = hand
            if id(hand) not in self._known:
                self._known[id(hand)] = hand, *_tables(hand)
            _, self._servo[place], self._joint_pos[place] = self._known[id(hand)]

    def servo_from_action(self, action: Array, flexing: Array) -> Array:
        """Servo angles for actions.

        Args:
            action: shape (n, 6), −1…1.
            flexing: whether each servo's joint comes to its target by flexion, shape (n, 6).

        Returns:
            Shape (n, 6) [rad], within the range of the board's table.

        Raises:
            ShapeError, WorkspaceError: As `hpac_gym.model.servo_from_action`.
        """
        if not self.inverts_files:
            return servo_from_action(_alone(action), self.hands[0]).reshape(len(action), -1)
        return self.servo_from_synergy(synergy_from_action(action, HPAC), flexing)

    def servo_from_synergy(
        self, synergy: Array, flexing: Array, places: Sequence[int] | slice = slice(None)
    ) -> Array:
        """Servo angles for synergies within Table I at some places, shape (k, 6) [rad]."""
        if not self.inverts_files:
            return unchecked_servo_from_synergy(np.asarray(synergy, dtype=float), self.hands[0])
        share = (synergy - HPAC.synergy_min) / (HPAC.synergy_max - HPAC.synergy_min)
        servo = _interpolated(self._servo[places], share, flexing, _SERVO_OF_SERVO)
        return np.clip(servo, HPAC.servo_min, HPAC.servo_max)

    def joints_from_servo(self, servo: Array, flexing: Array) -> Array:
        """Joint angles that the models predict for servo angles, shape (n, 6) → (n, 15) [rad]."""
        if not self.inverts_files:
            hand = self.hands[0]
            synergy = unchecked_synergy_from_servo(_alone(servo), hand)
            predicted = synergy.take(hand.servo_of_joint, axis=-1) * hand.elastic_ratio
            return predicted.reshape(len(servo), -1)
        share = (servo - HPAC.servo_min) / (HPAC.servo_max - HPAC.servo_min)
        return _interpolated(self._joint_pos, share, flexing, HPAC.servo_of_joint)

    def shown_servo(self, servo: Array, predicted: Array) -> Array:
        """Servo angles as a policy sees them: those of the nominal hand at the synergy that the
        models predict, since zeros and stretch of one hand mean nothing to a policy.

        Args:
            servo: commanded angles, shape (n, 6) [rad].
            predicted: `joints_from_servo` of them, shape (n, 15) [rad].
        """
        if not self.inverts_files:
            return servo
        synergy = np.clip(predicted[:, _ROOTS], HPAC.synergy_min, HPAC.synergy_max)
        return unchecked_servo_from_synergy(synergy, HPAC)


_SERVO_OF_SERVO = np.arange(len(SERVOS))
_ROOTS = [JOINT_INDEX[name] for name in SERVOS]


def _alone(rows: Array) -> Array:
    """The row itself of a single place, since NumPy takes twice as long for (1, 6) as for (6,)."""
    return rows[0] if len(rows) == 1 else rows


def _tables(hand: Hand) -> tuple[Array, Array]:
    """Tables of one calibrated hand, for both directions, flexion first: servo angle over the
    synergy's range, shape (2, 6, `POINTS`), and predicted joint angles over the servo's range,
    shape (2, 15, `POINTS`) [rad].
    """
    synergy = np.linspace(HPAC.synergy_min, HPAC.synergy_max, POINTS)
    servo = np.linspace(HPAC.servo_min, HPAC.servo_max, POINTS)
    return (
        np.stack([settled_servo_from_synergy(synergy, hand, way).T for way in _DIRECTIONS]),
        np.stack([settled_joints_from_servo(servo, hand, way).T for way in _DIRECTIONS]),
    )


def _interpolated(tables: Array, share: Array, flexing: Array, column: NDArray[np.intp]) -> Array:
    """Linear interpolation in tables over evenly spaced points.

    Args:
        tables: shape (n, 2, m, `POINTS`), flexion first.
        share: place in the range of every servo, 0…1, shape (n, 6).
        flexing: whether to take the first table, shape (n, 6).
        column: servo of each of the m columns, shape (m,).
    """
    place = np.minimum(np.maximum(share, 0.0), 1.0).take(column, axis=1) * (POINTS - 1)
    left = np.minimum(place.astype(int), POINTS - 2)
    world = np.arange(len(tables))[:, None]
    way = np.where(flexing, 0, 1).take(column, axis=1)
    row = np.arange(len(column))
    low = tables[world, way, row, left]
    between: Array = low + (place - left) * (tables[world, way, row, left + 1] - low)
    return between
