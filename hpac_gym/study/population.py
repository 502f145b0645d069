"""Populations of hands as a workshop makes them, and what each cause adds to the error of Eqs. (12), (13).

The hands are metal (`quasistatic`); the model that is judged is the nominal one, to which nothing of them is fitted. No camera.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.figure import Figure

from hpac_gym.model import HPAC, JOINTS, Hand, elastic_joints_from_servo, rigid_joints_from_servo, scaled_hand
from hpac_gym.model.checks import Array
from hpac_gym.progress import progress
from hpac_gym.study.accuracy import ALL_BELOW_DEG, EVALUATED
from hpac_gym.study.quasistatic import Metal, hand_course

POINTS = 41
"""Servo angles at which a hand is judged, over the servos' range."""
_NINE = [JOINTS.index(name) for name in EVALUATED]
_DRIVEN = [JOINTS.index(name) for name in JOINTS if name.endswith(("_mp", "_mcp"))]
_INDEX_DIP = EVALUATED.index("index_dip")

PLAIN = Metal()
"""What the model knows and nothing else."""
GEOMETRY = ("d1", "d2", "alpha", "servo_radius", "joint_radius")
SERVO_STIFFNESS = 20.0
"""Chosen: what the larger servo 6 has in `hpac.toml` [N·m/rad]."""


@dataclass(frozen=True, slots=True)
class Workshop:
    """How the hands of a workshop differ from the drawing. All of it is chosen."""

    tolerance: Mapping[str, float]
    """Relative standard deviation by field name of `Digit`, each digit and joint on its own."""
    servo_zero: float = 0.0
    """Standard deviation [rad]."""
    metal: Metal = PLAIN
    """The middle of what the model leaves out."""
    spread: float = 0.3
    """Standard deviation of the logarithm of servo stiffness and frictions."""


def geometry(tolerance: float) -> dict[str, float]:
    """The same tolerance on guides, included angle, hub and joint radii."""
    return dict.fromkeys(GEOMETRY, tolerance)


STIFFNESS = {"path_length": 0.02, "spring_stiffness": 0.1, "tendon_stiffness": 0.2, "drive_stiffness": 0.2}
FRICTION = Metal(joint_friction=1e-3, tendon_friction=0.03)
ZERO = np.deg2rad(0.5)
_MIXED = replace(FRICTION, servo_stiffness=SERVO_STIFFNESS)

WORKSHOPS: dict[str, Workshop] = {
    "the drawing, nothing else": Workshop({}),
    "geometry 0.1 %": Workshop(geometry(0.001)),
    "geometry 0.5 %": Workshop(geometry(0.005)),
    "geometry 1 %": Workshop(geometry(0.01)),
    "k_s 10 %, EA and k_d 20 %, L 2 %": Workshop(STIFFNESS),
    "servo zero 0.5°": Workshop({}, ZERO),
    "servos of 20 N·m/rad": Workshop({}, metal=Metal(servo_stiffness=SERVO_STIFFNESS)),
    "friction 1 mN·m and 3 % of the load": Workshop({}, metal=FRICTION),
    "all of these, geometry 0.5 %": Workshop({**STIFFNESS, **geometry(0.005)}, ZERO, _MIXED),
    "all of these, geometry 1 %": Workshop({**STIFFNESS, **geometry(0.01)}, ZERO, _MIXED),
}


@dataclass(frozen=True, slots=True)
class Built:
    """One hand in metal."""

    hand: Hand
    metal: tuple[Metal, ...]
    """Of each digit."""


def varied_hand(hand: Hand, tolerance: Mapping[str, float], rng: np.random.Generator) -> Hand:
    """A hand whose numbers are drawn about those of another, each digit's on its own.

    Args:
        hand: the centre.
        tolerance: relative standard deviation by field name of `Digit`; what is not named stays.
        rng: the draw.
    """
    digits = {}
    for name, digit in hand.digits.items():
        changed = {}
        for field, sigma in tolerance.items():
            value = getattr(digit, field)
            factor = 1 + sigma * rng.standard_normal(np.shape(value))
            changed[field] = tuple((factor * value).tolist()) if isinstance(value, tuple) else float(factor * value)
        digits[name] = replace(digit, **changed)
    return replace(hand, digits=digits)


def build(workshop: Workshop, count: int, seed: int, base: Hand = HPAC) -> list[Built]:
    """`count` hands of a workshop; hand i of a seed is the same for any count."""
    built = []
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        hand = varied_hand(base, workshop.tolerance, rng)
        metal = []
        for _ in base.digits:
            zero = workshop.servo_zero * rng.standard_normal()
            stiff, joint, tendon = np.exp(workshop.spread * rng.standard_normal(3))
            middle = workshop.metal
            metal.append(replace(
                middle,
                servo_zero=middle.servo_zero + zero,
                servo_stiffness=middle.servo_stiffness * stiff,
                joint_friction=middle.joint_friction * joint,
                tendon_friction=middle.tendon_friction * tendon,
            ))  # fmt: skip
        built.append(Built(hand, tuple(metal)))
    return built


@dataclass(frozen=True, slots=True)
class PopulationErrors:
    """Mean absolute error of every hand [°]."""

    uncompensated: Array
    """Against Eq. (9), of the nine joints in the order of `EVALUATED`, shape (hands, 9)."""
    compensated: Array
    """Against Eqs. (12), (13), shape (hands, 9)."""
    driven: Array
    """Of MP and the four MCP, which the paper takes as undeformed, shape (hands, 5)."""


def errors_of(built: list[Built]) -> PopulationErrors:
    """Errors of the nominal model on built hands, over a slow flexion of the servos' range."""
    servo = np.linspace(HPAC.servo_min, HPAC.servo_max, POINTS)
    measured = hand_course([item.hand for item in built], [item.metal for item in built], servo)
    rigid, elastic = (
        np.degrees(np.abs(measured - model(servo)).mean(axis=1)) for model in (rigid_joints_from_servo, elastic_joints_from_servo)
    )
    return PopulationErrors(rigid[:, _NINE], elastic[:, _NINE], elastic[:, _DRIVEN])


@dataclass(frozen=True, slots=True)
class Range:
    """Median and the middle 95 % of a population."""

    median: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.median:.2f} [{self.low:.2f}, {self.high:.2f}]"


def range_of(values: Array) -> Range:
    """The range of a population, shape (n,)."""
    return Range(*(float(x) for x in np.quantile(values, (0.5, 0.025, 0.975))))


@dataclass(frozen=True, slots=True)
class PopulationRow:
    """What the compensation is worth on one workshop's hands."""

    uncompensated_index_dip: Range
    index_dip: Range
    worst_joint: Range
    """Of the nine joints of each hand."""
    driven: Range
    """Of MP and MCP, all digits."""
    made_worse: float
    """Share of the joints that are further off with compensation than without."""
    all_below: float
    """Share of the hands with all nine joints below the paper's 0.23°."""


def population_row(errors: PopulationErrors) -> PopulationRow:
    """The figures of one population."""
    return PopulationRow(
        range_of(errors.uncompensated[:, _INDEX_DIP]),
        range_of(errors.compensated[:, _INDEX_DIP]),
        range_of(errors.compensated.max(axis=1)),
        range_of(errors.driven.ravel()),
        float((errors.compensated > errors.uncompensated).mean()),
        float((errors.compensated.max(axis=1) < ALL_BELOW_DEG).mean()),
    )


def population_errors(count: int, seed: int, shown: bool = False) -> dict[str, PopulationErrors]:
    """Errors of every workshop's hands, by the workshop's name."""
    workshops = progress(list(WORKSHOPS.items()), "populations", shown)
    return {name: errors_of(build(workshop, count, seed)) for name, workshop in workshops}


def population_figure(found: Mapping[str, PopulationErrors]) -> Figure:
    """Share of hands whose worst of nine joints is below an error, by workshop."""
    figure = Figure(figsize=(9, 5), layout="constrained")
    axis = figure.subplots()
    for name, errors in found.items():
        worst = np.sort(errors.compensated.max(axis=1))
        axis.step(worst, np.arange(1, len(worst) + 1) / len(worst), where="post", label=name)
    axis.axvline(ALL_BELOW_DEG, color="black", linestyle="--", label=f"the paper's hand: all nine below {ALL_BELOW_DEG}°")
    axis.set_xscale("log")
    axis.set_xticks([0.1, 0.2, 0.5, 1, 2, 5], ["0.1", "0.2", "0.5", "1", "2", "5"])
    axis.minorticks_off()
    axis.set_xlabel("mean absolute error of a hand's worst of nine joints, compensated [°]")
    axis.set_ylabel("share of the hands")
    figure.legend(loc="outside right center", frameon=False, fontsize=9)
    return figure


# What each cause adds ----------------------------------------------------------------

_STIFF_DRIVE = {"drive_stiffness": 1e4}


def causes() -> dict[str, Built]:
    """Hands that differ from the assumptions of Eqs. (12), (13) in one thing each, all with the nominal numbers."""
    ideal = scaled_hand(HPAC, _STIFF_DRIVE)

    def alone(hand: Hand = ideal, **metal: float) -> Built:
        return Built(hand, (Metal(**metal),) * len(hand.digits))

    return {
        "none: the assumptions of Eqs. (12), (13)": alone(),
        "drive stretch, k_d = 2.5·10⁵ N/m": alone(HPAC),
        "servo stiffness, 20 N·m/rad": alone(servo_stiffness=SERVO_STIFFNESS),
        "coupling law, EA/L in both segments": alone(first_segment=1.0),
        "joint friction, 1 mN·m": alone(joint_friction=1e-3),
        "tendon friction, 3 % of the load": alone(tendon_friction=0.03),
        "return cable sliding, μ = 0.05": alone(cable_friction=0.05),
        "servo zero, +0.5°": alone(servo_zero=ZERO),
        "servo dead band, 2 mrad": alone(dead_band=2e-3),
        "guide pins of 2 mm": alone(guide_radius=1e-3),
    }


@dataclass(frozen=True, slots=True)
class Cause:
    """What one cause alone makes of the compensated error [°]."""

    index_dip: float
    index_pip: float
    worst_joint: float
    worst_driven: float


def run_causes() -> dict[str, Cause]:
    """Every cause alone."""
    names = list(causes())
    errors = errors_of(list(causes().values()))
    dip, pip = EVALUATED.index("index_dip"), EVALUATED.index("index_pip")
    return {
        name: Cause(float(nine[dip]), float(nine[pip]), float(nine.max()), float(driven.max()))
        for name, nine, driven in zip(names, errors.compensated, errors.driven, strict=True)
    }
