"""Parameters of a hand: frozen, validated values, and the quantities derived from them.

A `Digit` holds one tendon's numbers, a `Hand` five digits, the directly driven CMC joint and Table
I. Everything else is derived from these once, by the paper's equations, as read-only arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields
from functools import cached_property, partial
from types import MappingProxyType
from typing import Any

import numpy as np

from hpac_gym.errors import ParameterError
from hpac_gym.model.calibration import Calibration
from hpac_gym.model.checks import Array, plain_list, read_only
from hpac_gym.model.guides import chord_from_included
from hpac_gym.model.joints import DIGITS, JOINT_INDEX, JOINTS, SERVO_INDEX, SERVOS, digit_joints
from hpac_gym.settings import are_numbers, check_bounds, setting

_CMC = len(SERVOS) - 1
_UNCALIBRATED = Calibration()


def _positive(unit: str, default: Any = MISSING, most: float = 1e15, **more: Any) -> Any:
    """A field for a positive number, by default of at most a stiffness that no hand has (chosen)."""
    return setting(default, number=True, bounds=(0.0, most), above=True, unit=unit, **more)


@dataclass(frozen=True, slots=True)
class Digit:
    """One digit's tendon, from the servo's hub to the fingertip.

    Lists run from the root joint (MCP, or the thumb's MP) to the fingertip.

    Raises:
        ParameterError: A number leaves its bounds, or a list has the wrong length.
    """

    name: str
    d1: float = _positive("m")
    """Distance of the fixed guide from the root joint's axis [m]."""
    d2: float = _positive("m")
    """Distance of the moving guide from the root joint's axis [m]."""
    alpha: float = _positive("rad", most=math.nextafter(math.pi, 0.0))
    """Included angle between the guides at rest [rad]."""
    servo_radius: float = _positive("m")
    """Radius r of the servo's hub [m]."""
    joint_radius: tuple[float, ...] = _positive("m", size=0)
    """Pulley radius R of each joint, root first [m]."""
    path_length: tuple[float, ...] = _positive("m", size=0)
    """Tendon path L between neighbouring joints, root first [m]."""
    spring_stiffness: float = _positive("N/m")
    """k_s of the restoring spring [N/m]."""
    tendon_stiffness: float = _positive("N")
    """EA of the coupling tendon [N]."""
    drive_stiffness: float = _positive("N/m")
    """Stiffness of the driving tendon between servo and root joint [N/m]; the model takes it as
    rigid.
    """
    tension_limit: float = _positive("N")
    """Largest tension that the servo can exert on the driving tendon [N]."""

    def __post_init__(self) -> None:
        owner = f"digit {self.name}"
        if self.name not in DIGITS:
            raise ParameterError(f"{owner} is not one of {', '.join(DIGITS)}")
        joints = len(self.joints)
        lengths = {"joint_radius": joints, "path_length": joints - 1}
        for name in lengths:
            object.__setattr__(self, name, plain_list(getattr(self, name)))
        check_bounds(self, owner)
        for name, length in lengths.items():
            if len(getattr(self, name)) != length:
                raise ParameterError(
                    f"{owner} {name} = {getattr(self, name)} must have {length} entries"
                )

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints that the tendon couples, root first."""
        return digit_joints(self.name)

    def chord(self, root: Array | float) -> Array:
        """Distance between the two guides [m] at angles of the root joint [rad], any shape. Eq. (3)."""
        squares = self.d1**2 + self.d2**2
        return chord_from_included(squares, 2 * self.d1 * self.d2, self.alpha - root)

    @property
    def rest_chord(self) -> float:
        """L₀, the distance between the two guides at full extension [m]."""
        return float(self.chord(0.0))

    @property
    def rigid_ratio(self) -> Array:
        """A: joint angles per radian of the root joint, tendon taken as rigid. Eqs. (1), (2), (6).

        Joint angles are inversely proportional to the radii: 5:4:5 radii give 4:5:4 angles, 5:4
        give 4:5."""
        return np.asarray(self.joint_radius[0] / np.array(self.joint_radius), dtype=float)

    @property
    def segment_stiffness(self) -> Array:
        """Stiffness of each coupling segment, root first: EA/L, and 2EA/L in a finger's first
        [N/m].

        The factor two is an assumption of this project; the paper does not state it. The restoring
        cable pulls on every joint, so by torque balance the first segment carries twice the spring
        tension T. With EA/L it would stretch by 2TL/EA, whereas Eq. (11) gives TL/EA: Eq. (12) is a
        static equilibrium only with 2EA/L. The thumb has one segment, which carries only T."""
        stiffness: Array = self.tendon_stiffness / np.array(self.path_length)
        if len(stiffness) > 1:
            stiffness[0] *= 2
        return stiffness

    @property
    def compliance(self) -> Array:
        """C of every joint, zero for the root [1/m]: k_s ΣL / (EA R), with ΣL the path up to the
        joint. Eqs. (12), (13).
        """
        path = np.concatenate([[0.0], np.cumsum(self.path_length)])
        return self.spring_stiffness * path / (self.tendon_stiffness * np.array(self.joint_radius))

    @property
    def elastic_ratio(self) -> Array:
        """M⁻¹A: joint angles per radian of the root joint, with the tendon's elasticity, from M q =
        A q_root. Eqs. (12), (13).
        """
        coupling = np.eye(len(self.joints)) + np.outer(self.compliance, self.joint_radius)
        return np.asarray(np.linalg.solve(coupling, self.rigid_ratio), dtype=float)


@dataclass(frozen=True)
class Hand:
    """A whole hand: five digits, the direct CMC drive, Table I and the servos' rate.

    Arrays that are derived from these numbers are cached and read-only.

    Raises:
        ParameterError: A digit is missing or named otherwise, a number leaves its bounds, a range is
            not ordered, or the servo range leaves the domain of Eq. (5).
    """

    name: str
    digits: Mapping[str, Digit]
    """The five digits by name."""
    workspace: Mapping[str, tuple[float, float]]
    """[q_min, q_max] of every joint by name [rad]. Table I."""
    rate_limit: float = _positive("rad/s", most=100.0)
    """Largest commanded servo speed, of all six [rad/s]."""
    cmc_gain: float = _positive("rad/rad", 1.0)
    """g_CMC, radians of CMC per radian of servo 6. Eq. (8)."""
    cmc_stiffness: float = _positive("N·m/rad", 20.0)
    """Stiffness between servo 6 and the CMC joint [N·m/rad]."""
    cmc_torque_limit: float = _positive("N·m", 0.8)
    """Stall torque of servo 6 [N·m]."""
    sources: Mapping[str, str] = field(default_factory=dict, compare=False)
    """Source of each number, by field name."""
    calibration: Calibration = _UNCALIBRATED
    """Parameters beyond the paper's model, identified from a sweep."""

    def __post_init__(self) -> None:
        for name, wanted in (("digits", DIGITS), ("workspace", JOINTS)):
            if wrong := sorted(set(getattr(self, name)) ^ set(wanted)):
                raise ParameterError(
                    f"hand {self.name}: {name} is missing or does not know {', '.join(wrong)}"
                )
        workspace = {}
        for joint in JOINTS:
            bounds = plain_list(self.workspace[joint])
            if not (are_numbers(bounds, 2) and -np.inf < bounds[0] < bounds[1] < np.inf):
                raise ParameterError(
                    f"hand {self.name}: workspace of {joint} = {bounds} rad must be [min, max]"
                )
            workspace[joint] = tuple(bounds)
        mappings: dict[str, dict[str, Any]] = {
            "digits": {name: self.digits[name] for name in DIGITS},
            "workspace": workspace,
            "sources": dict(self.sources),
        }
        for name, mapping in mappings.items():
            object.__setattr__(self, name, MappingProxyType(mapping))
        check_bounds(self, f"hand {self.name}")
        for name, digit in self.digits.items():
            if digit.name != name:
                raise ParameterError(
                    f"hand {self.name}: its {name} has the numbers of digit {digit.name}: replace their name, too"
                )
            lower, upper = self.workspace[digit.joints[0]]
            if lower <= digit.alpha - np.pi or upper >= digit.alpha:
                raise ParameterError(
                    f"digit {digit.name}: workspace [{lower}, {upper}] rad must lie within the guides' "
                    f"({digit.alpha - np.pi:.6g}, {digit.alpha:.6g}) rad"
                )

    def __reduce__(self) -> tuple[partial[Hand], tuple[()]]:
        plain = {f.name: getattr(self, f.name) for f in fields(self)}
        plain |= {name: dict(plain[name]) for name in ("digits", "workspace", "sources")}
        return partial(Hand, **plain), ()

    @property
    def is_calibrated(self) -> bool:
        """Whether its `[calibration]` is not all zero, so that commands invert the whole file."""
        return self.calibration != _UNCALIBRATED

    @cached_property
    def joint_min(self) -> Array:
        """q_min, shape (15,) [rad]. Table I."""
        return read_only(np.array([self.workspace[name][0] for name in JOINTS]))

    @cached_property
    def joint_max(self) -> Array:
        """q_max, shape (15,) [rad]. Table I."""
        return read_only(np.array([self.workspace[name][1] for name in JOINTS]))

    @cached_property
    def synergy_min(self) -> Array:
        """Lower limits of the six driven joints, Table I, shape (6,) [rad]."""
        return read_only(np.array([self.workspace[name][0] for name in SERVOS]))

    @cached_property
    def synergy_max(self) -> Array:
        """Upper limits of the six driven joints, Table I, shape (6,) [rad]."""
        return read_only(np.array([self.workspace[name][1] for name in SERVOS]))

    @cached_property
    def servo_min(self) -> Array:
        """Servo angles that put the driven joints at q_min, shape (6,) [rad]."""
        return read_only(unchecked_servo_from_synergy(self.synergy_min, self))

    @cached_property
    def servo_max(self) -> Array:
        """Servo angles that put the driven joints at q_max, shape (6,) [rad]."""
        return read_only(unchecked_servo_from_synergy(self.synergy_max, self))

    @cached_property
    def servo_rate_limit(self) -> Array:
        """Largest commanded speed of each servo, shape (6,) [rad/s]."""
        return read_only(np.full(len(SERVOS), self.rate_limit))

    @cached_property
    def guide_alpha(self) -> Array:
        """α of the five digits, shape (5,) [rad]."""
        return self._stack("alpha")

    @cached_property
    def guide_sum(self) -> Array:
        """d₁² + d₂², shape (5,) [m²]."""
        return read_only(self._stack("d1") ** 2 + self._stack("d2") ** 2)

    @cached_property
    def guide_product(self) -> Array:
        """2 d₁ d₂, shape (5,) [m²]."""
        return read_only(2 * self._stack("d1") * self._stack("d2"))

    @cached_property
    def rest_chord(self) -> Array:
        """L₀, shape (5,) [m]. Eq. (3)."""
        return self._stack("rest_chord")

    @cached_property
    def servo_radius(self) -> Array:
        """r, shape (5,) [m]."""
        return self._stack("servo_radius")

    def _stack(self, name: str) -> Array:
        return read_only(
            np.array([getattr(digit, name) for digit in self.digits.values()], dtype=float)
        )

    @cached_property
    def servo_of_joint(self) -> np.ndarray:
        """Index of the servo that moves each joint, shape (15,)."""
        root = {name: digit.joints[0] for digit in self.digits.values() for name in digit.joints}
        return read_only(np.array([SERVO_INDEX[root.get(name, name)] for name in JOINTS]))

    @cached_property
    def rigid_ratio(self) -> Array:
        """Joint angle per radian of its synergy coordinate, tendon rigid, shape (15,). Eqs. (2),
        (6).
        """
        return self._by_joint("rigid_ratio", cmc=1.0)

    @cached_property
    def elastic_ratio(self) -> Array:
        """Joint angle per radian of its synergy coordinate, tendon elastic, shape (15,). Eqs. (12),
        (13).
        """
        return self._by_joint("elastic_ratio", cmc=1.0)

    def _by_joint(self, name: str, cmc: float) -> Array:
        values = np.full(len(JOINTS), cmc)
        for digit in self.digits.values():
            values[[JOINT_INDEX[joint] for joint in digit.joints]] = getattr(digit, name)
        return read_only(values)

    @cached_property
    def deviation_matrix(self) -> Array:
        """B with b(q) = B q, shape (15, 15). Eqs. (10), (11)."""
        same_digit = self.servo_of_joint[:, None] == self.servo_of_joint
        products = np.outer(self._by_joint("compliance", cmc=0.0), self.joint_radius)
        return read_only(np.where(same_digit, products, 0.0))

    @cached_property
    def synergy_projection(self) -> Array:
        """G with synergy = G q = P [q + b(q)], P the least-squares inverse of every digit's A,
        shape (6, 15). Eq. (15).
        """
        inverse = np.zeros((len(SERVOS), len(JOINTS)))
        inverse[self.servo_of_joint, np.arange(len(JOINTS))] = self.rigid_ratio
        inverse /= (inverse**2).sum(axis=1, keepdims=True)
        return read_only(inverse @ (np.eye(len(JOINTS)) + self.deviation_matrix))

    @cached_property
    def joint_radius(self) -> Array:
        """R₁…R₁₄ by joint, 0 for the directly driven CMC, shape (15,) [m]."""
        return self._by_joint("joint_radius", cmc=0.0)


def unchecked_servo_from_synergy(synergy: Array, hand: Hand) -> Array:
    """Servo angles for driven-joint angles that are known to lie within Table I, shape (..., 6)
    [rad].

    Eqs. (5), (7), (8) solved for u.
    """
    chord = chord_from_included(
        hand.guide_sum, hand.guide_product, hand.guide_alpha - synergy[..., :_CMC]
    )
    servo = np.empty_like(synergy)
    servo[..., :_CMC] = (hand.rest_chord - chord) / hand.servo_radius
    servo[..., _CMC] = synergy[..., _CMC] / hand.cmc_gain
    return servo
