"""Populations of hands with manufacturing tolerances, and the contribution of each cause to the
error of Eqs. (12), (13).

The hands are simulated by `quasistatic`; the evaluated model is the nominal one, without any fit.
There is no camera."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from experiments.quasistatic import Built, Metal, hand_course
from experiments.results import Column, Part, part_of, range_of
from hpac_gym.calibration.accuracy import EVALUATED
from hpac_gym.model import (
    HPAC,
    JOINTS,
    Array,
    Digit,
    Hand,
    elastic_joints_from_servo,
    rigid_joints_from_servo,
)
from hpac_gym.model.variation import scaled_digit, scaled_hand
from hpac_gym.progress import progress

POINTS = 41
"""Number of servo angles at which a hand is evaluated, over the servos' range."""
ALL_BELOW_DEG = 0.23
"""The paper: "all nine evaluated joints achieve an MAE below 0.23°"."""
SERVO = np.linspace(HPAC.servo_min, HPAC.servo_max, POINTS)
NINE = [JOINTS.index(name) for name in EVALUATED]
_DRIVEN = [JOINTS.index(name) for name in JOINTS if name.endswith(("_mp", "_mcp"))]
_DIP = EVALUATED.index("index_dip")
_PIP = EVALUATED.index("index_pip")


# Hands -------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Workshop:
    """Deviations of manufactured hands from the drawing. All values are chosen."""

    tolerance: Mapping[str, float] = field(default_factory=dict)
    """Relative standard deviation by field name of `Digit`, independent for each digit and joint.
    """
    servo_zero: float = 0.0
    """Standard deviation of the servo zeros [rad]."""
    metal: Metal = field(default_factory=Metal)
    """Median of the effects that the model omits."""


SPREAD = 0.3
"""Standard deviation of the logarithm of servo stiffness and frictions."""
SERVO_STIFFNESS = 20.0
"""Chosen: the stiffness of the larger servo 6 in `hpac.toml` [N·m/rad]."""
ZERO = np.deg2rad(0.5)
FRICTION = Metal(joint_friction=1e-3, tendon_friction=0.03)
FIT_LAWS = replace(FRICTION, servo_stiffness=SERVO_STIFFNESS)
"""Effects that the model omits and the calibration fits."""
OTHER_LAWS = Metal(
    first_segment=1.0,
    servo_stiffness=SERVO_STIFFNESS,
    joint_friction=1e-3,
    cable_friction=0.05,
    guide_radius=0.5e-3,
    dead_band=1e-3,
)
"""Physics other than the fit's: EA/L in both segments, compliant servos with a dead band, a return
cable that loses tension at every joint, guide pins of 1 mm."""
STIFFNESS = {
    "path_length": 0.02,
    "spring_stiffness": 0.1,
    "tendon_stiffness": 0.2,
    "drive_stiffness": 0.2,
}


def geometry(tolerance: float) -> dict[str, float]:
    """The same tolerance on guides, included angle, hub and joint radii."""
    return dict.fromkeys(("d1", "d2", "alpha", "servo_radius", "joint_radius"), tolerance)


WORKSHOPS: dict[str, Workshop] = {
    "the drawing, nothing else": Workshop(),
    "geometry 0.1 %": Workshop(geometry(0.001)),
    "geometry 0.5 %": Workshop(geometry(0.005)),
    "geometry 1 %": Workshop(geometry(0.01)),
    "k_s 10 %, EA and k_d 20 %, L 2 %": Workshop(STIFFNESS),
    "servo zero 0.5°": Workshop(servo_zero=ZERO),
    "servos of 20 N·m/rad": Workshop(metal=Metal(servo_stiffness=SERVO_STIFFNESS)),
    "friction 1 mN·m and 3 % of the load": Workshop(metal=FRICTION),
    "all of these, geometry 0.5 %": Workshop({**STIFFNESS, **geometry(0.005)}, ZERO, FIT_LAWS),
    "all of these, geometry 1 %": Workshop({**STIFFNESS, **geometry(0.01)}, ZERO, FIT_LAWS),
}


def varied_digit(
    digit: Digit, reach: Mapping[str, float], draw: Callable[[tuple[int, ...]], Array]
) -> Digit:
    """A digit with parameters multiplied by 1 + reach · draw; `reach` is by field name, `draw`
    returns numbers of a shape.
    """
    return scaled_digit(
        digit,
        {name: 1 + size * draw(np.shape(getattr(digit, name))) for name, size in reach.items()},
    )


def varied_hand(hand: Hand, tolerance: Mapping[str, float], rng: np.random.Generator) -> Hand:
    """A random hand whose digits deviate from another's by relative standard deviations, by field
    name of `Digit`.
    """
    digits = {
        name: varied_digit(digit, tolerance, rng.standard_normal)
        for name, digit in hand.digits.items()
    }
    return replace(hand, digits=digits)


def varied_metal(middle: Metal, zero: float, factors: Array) -> Metal:
    """Metal with a shifted servo zero [rad], and with servo stiffness and frictions multiplied by
    factors.
    """
    names = ("servo_stiffness", "joint_friction", "tendon_friction", "cable_friction")
    scaled = {
        name: getattr(middle, name) * factor for name, factor in zip(names, factors, strict=False)
    }
    return replace(middle, servo_zero=middle.servo_zero + zero, **scaled)


def build(workshop: Workshop, count: int, seed: int) -> list[Built]:
    """`count` hands with given tolerances; hand i of a seed is the same for any count."""
    built = []
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        hand = varied_hand(HPAC, workshop.tolerance, rng)
        metal = [
            varied_metal(
                workshop.metal,
                workshop.servo_zero * rng.standard_normal(),
                np.exp(SPREAD * rng.standard_normal(3)),
            )
            for _ in hand.digits
        ]
        built.append(Built(hand, tuple(metal)))
    return built


# Their errors --------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class PopulationErrors:
    """Mean absolute error of every hand [°]."""

    uncompensated: Array
    """Error of Eq. (9) for the nine joints in the order of `EVALUATED`, shape (hands, 9)."""
    compensated: Array
    """Error of Eqs. (12), (13), shape (hands, 9)."""
    driven: Array
    """The same for MP and the four MCP, which the paper takes as undeformed, shape (hands, 5)."""


def errors_of(built: list[Built]) -> PopulationErrors:
    """Errors of the nominal model on built hands, over a slow flexion of the servos' range."""
    measured = hand_course(built, SERVO)
    rigid, elastic = (
        np.degrees(np.abs(measured - model(SERVO)).mean(axis=1))
        for model in (rigid_joints_from_servo, elastic_joints_from_servo)
    )
    return PopulationErrors(rigid[:, NINE], elastic[:, NINE], elastic[:, _DRIVEN])


COLUMNS = (
    Column(
        "uncompensated_index_dip",
        "index DIP without [°]",
        lambda found: range_of(found.uncompensated[:, _DIP]),
        "{:.2f}",
    ),
    Column(
        "index_dip", "index DIP with", lambda found: range_of(found.compensated[:, _DIP]), "{:.2f}"
    ),
    Column(
        "worst_joint",
        "worst of nine",
        lambda found: range_of(found.compensated.max(axis=1)),
        "{:.2f}",
    ),
    Column("driven", "MP and MCP", lambda found: range_of(found.driven.ravel()), "{:.2f}"),
    Column(
        "made_worse",
        "joints made worse",
        lambda found: float((found.compensated > found.uncompensated).mean()),
        "{:.0%}",
    ),
    Column(
        "all_below",
        f"hands with all nine below {ALL_BELOW_DEG}°",
        lambda found: float((found.compensated.max(axis=1) < ALL_BELOW_DEG).mean()),
        "{:.0%}",
    ),
)


def populations(count: int, seed: int) -> Part:
    """Errors of nominal compensation on hands with manufacturing tolerances."""
    errors = {
        name: errors_of(build(shop, count, seed))
        for name, shop in progress(WORKSHOPS.items(), "populations")
    }
    title = f"Populations: {count} hands each, seed {seed}; median and the middle 95 %"
    return part_of(title, "hands", COLUMNS, errors)


# Contribution of each cause ----------------------------------------------------------


CAUSE_COLUMNS = (
    Column("index_dip", "index DIP [°]", lambda found: float(found[0][_DIP]), "{:.2f}"),
    Column("index_pip", "index PIP", lambda found: float(found[0][_PIP]), "{:.2f}"),
    Column("worst_joint", "worst of nine", lambda found: float(found[0].max()), "{:.2f}"),
    Column("worst_driven", "worst of MP and MCP", lambda found: float(found[1].max()), "{:.2f}"),
)


def causes() -> Part:
    """Compensated errors on the nominal hand with one violated assumption of Eqs. (12), (13) at a
    time.
    """
    ideal = scaled_hand(HPAC, {"drive_stiffness": 1e4})

    def alone(hand: Hand = ideal, **metal: float) -> Built:
        return Built(hand, (Metal(**metal),) * len(hand.digits))

    built = {
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
    errors = errors_of(list(built.values()))
    found = dict(zip(built, zip(errors.compensated, errors.driven, strict=True), strict=True))
    title = "What each cause adds to the compensated error"
    return part_of(title, "cause, alone, on the nominal hand", CAUSE_COLUMNS, found)
