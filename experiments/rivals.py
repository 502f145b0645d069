"""Comparison of calibration methods, fitted to a few points of a sweep and evaluated against the
true joint angles.

Every method maps one servo's angle to the angles of the joints that it moves, fitted to N sampling
points, on hands in metal whose physics none of the models contains (`OTHER_METAL`)."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from scipy import linalg, optimize

from experiments.bench import JointCamera, metal_sweeps
from experiments.populations import (
    NINE,
    OTHER_LAWS,
    SERVO,
    STIFFNESS,
    ZERO,
    Workshop,
    build,
    geometry,
)
from experiments.quasistatic import hand_course
from experiments.results import Interval, Part, log_ticks, mean_of
from hpac_gym.calibration.identification import identify
from hpac_gym.calibration.record import REST, Sweep
from hpac_gym.calibration.samples import digit_samples
from hpac_gym.figures import new_figure
from hpac_gym.model import (
    HPAC,
    JOINT_INDEX,
    SERVOS,
    Array,
    elastic_joints_from_servo,
    rigid_joints_from_servo,
)
from hpac_gym.model.settled import settled_joints_from_servo
from hpac_gym.output import markdown
from hpac_gym.progress import progress

SAMPLES = (3, 4, 6, 8, 16, 31)
"""Numbers of training points per servo."""
DEGREE = 4
UNITS = 6

TITLE = "physics that is not the model's"
OTHER_METAL = Workshop({**STIFFNESS, **geometry(0.005)}, ZERO, OTHER_LAWS)
"""Hands whose physics is not the model's. All values are chosen."""
COMMON_ERRORS = JointCamera(common_scale=0.002, common_wander=np.deg2rad(0.05), outliers=0.005)
"""A camera with errors common to all joints, 0.2 % of scale and a drift of 0.05° within seconds,
and 0.5 % outliers.
"""
Predictor = Callable[[Array], Array]
"""Function from servo angles (k,) to joint angles (k, joints)."""


def linear_scaling(
    servo: Array, joint_pos: Array, rng: np.random.Generator, model: Predictor
) -> Predictor:
    """One factor per joint, through the rest pose: q = a u."""
    factor = servo @ joint_pos / (servo @ servo)
    return lambda angle: angle[:, None] * factor


def polynomial(
    servo: Array, joint_pos: Array, rng: np.random.Generator, model: Predictor
) -> Predictor:
    """One polynomial per joint, of degree 4 or less for fewer than five points."""
    degree = min(DEGREE, len(servo) - 1)
    factors = np.polynomial.polynomial.polyfit(servo, joint_pos, degree)
    return lambda angle: np.polynomial.polynomial.polyval(angle, factors).T


def gaussian_process(servo: Array, joint_pos: Array, base: Predictor) -> Predictor:
    """Gaussian process with squared-exponential kernel and white noise on top of a base model, by
    marginal likelihood.
    """
    rest = joint_pos - base(servo)
    scale = max(float(rest.std()), 1e-6)
    gaps = (servo[:, None] - servo) ** 2

    def kernel(parameters: Array, squared: Array) -> Array:
        amplitude, length = np.exp(parameters[:2])
        return (amplitude * scale) ** 2 * np.exp(-0.5 * squared / length**2)

    def factorised(parameters: Array):
        covariance = kernel(parameters, gaps) + (np.exp(parameters[2]) * scale) ** 2 * np.eye(
            len(servo)
        )
        return linalg.cho_factor(covariance + 1e-12 * scale**2 * np.eye(len(servo)), lower=True)

    def unlikelihood(parameters: Array) -> float:
        factor = factorised(parameters)
        return float(
            0.5 * np.sum(rest * linalg.cho_solve(factor, rest))
            + rest.shape[1] * np.log(np.diag(factor[0])).sum()
        )

    start = np.log([1.0, 0.5, 0.05])
    bounds = [(-3, 3), (-3, 2), (-7, 1)]
    parameters = optimize.minimize(unlikelihood, start, bounds=bounds, method="L-BFGS-B").x
    weight = linalg.cho_solve(factorised(parameters), rest)
    return lambda angle: base(angle) + kernel(parameters, (angle[:, None] - servo) ** 2) @ weight


def network(
    servo: Array, joint_pos: Array, rng: np.random.Generator, model: Predictor
) -> Predictor:
    """A network with one hidden layer of six tanh units on top of linear scaling, by least squares
    with weight decay.
    """
    base = linear_scaling(servo, joint_pos, rng, model)
    rest = joint_pos - base(servo)
    span = servo.max()
    scale = max(float(np.abs(rest).max()), 1e-6)
    outputs = rest.shape[1]

    def output(weights: Array, angle: Array) -> Array:
        slope = weights[:UNITS]
        shift = weights[UNITS : 2 * UNITS]
        mixed = weights[2 * UNITS :].reshape(UNITS + 1, outputs)
        hidden = np.tanh(angle[:, None] / span * slope + shift)
        return hidden @ mixed[:-1] + mixed[-1]

    def misfit(weights: Array) -> Array:
        return np.concatenate([(output(weights, servo) - rest / scale).ravel(), 1e-2 * weights])

    start = rng.normal(0.0, 1.0, 2 * UNITS + (UNITS + 1) * outputs)
    weights = optimize.least_squares(misfit, start, max_nfev=100).x
    return lambda angle: base(angle) + scale * output(weights, angle)


RIVALS = {
    "linear scaling": linear_scaling,
    "polynomial": polynomial,
    "network": network,
    "Gaussian process": lambda servo, joint_pos, rng, model: gaussian_process(
        servo, joint_pos, linear_scaling(servo, joint_pos, rng, model)
    ),
    "Gaussian process on the paper's model": lambda servo, joint_pos, rng, model: gaussian_process(
        servo, joint_pos, model
    ),
}
UNTRAINED = {
    "rigid model, Eq. (9)": rigid_joints_from_servo,
    "paper's model, Eqs. (5), (12)": elastic_joints_from_servo,
}
IDENTIFIED = {"paper's model, its numbers fitted": True, "`hpac calibrate`": False}
"""Fitted physical models, and whether they are restricted to the paper's equations."""


@dataclass(frozen=True, slots=True)
class Race:
    """Mean absolute error of the nine joints [°], by method and number of training points."""

    trained: dict[str, dict[int, Interval]]
    untrained: dict[str, Interval]
    camera: Interval
    """Error caused by the camera's scale error alone."""


def run_race(hands: int, seed: int, samples: tuple[int, ...] = SAMPLES) -> Race:
    """Fit every method to random points of one sweep of each hand, and evaluate it against the true
    joint angles.

    Args:
        hands: number of hands; each has its own choice of training points.
        seed: seed of hands, camera, choices and the network's initial weights.
        samples: numbers of training points of each servo.
    """
    built = build(OTHER_METAL, hands, seed)
    records = metal_sweeps(built, seed, COMMON_ERRORS, servos=SERVOS[:-1])
    truths = list(hand_course(built, SERVO))
    untrained = {
        name: mean_of([_error(model(SERVO), truth) for truth in truths])
        for name, model in UNTRAINED.items()
    }
    errors: dict[str, dict[int, list[float]]] = {
        name: {n: [] for n in samples} for name in (*RIVALS, *IDENTIFIED)
    }
    for number, hand in progress([(n, h) for n in samples for h in range(hands)], "rivals"):
        rng = np.random.default_rng([seed, number, hand])
        for name, value in _errors_of_hand(records[hand], truths[hand], number, rng).items():
            errors[name][number].append(value)
    scale = [
        COMMON_ERRORS.common_scale * np.sqrt(2 / np.pi) * _error(np.zeros_like(truth), truth)
        for truth in truths
    ]
    trained = {
        name: {n: mean_of(values) for n, values in table.items()} for name, table in errors.items()
    }
    return Race(trained, untrained, mean_of(scale))


def _errors_of_hand(
    record: Sweep, truth: Array, number: int, rng: np.random.Generator
) -> dict[str, float]:
    """Errors of all methods for one hand. All get the same points: means of the samples without
    outliers.
    """
    few = record.phase == REST
    predicted = {name: np.zeros_like(truth) for name in RIVALS}
    for swept, digit in enumerate(HPAC.digits.values()):
        samples = digit_samples(record, swept)
        which = _chosen(len(samples.servo), number, rng)
        few |= (record.swept == swept) & np.isin(record.point, samples.point[which])
        joints = [JOINT_INDEX[joint] for joint in digit.joints]
        for name, fit in RIVALS.items():
            predictor = fit(
                samples.servo[which], samples.joint_pos[which], rng, _model_of(swept, joints)
            )
            predicted[name][:, joints] = predictor(SERVO[:, swept])
    for name, papers in IDENTIFIED.items():
        hand = identify(record[few], least_points=min(SAMPLES), papers_model=papers).hand
        predicted[name] = settled_joints_from_servo(SERVO, hand)
    return {name: _error(angles, truth) for name, angles in predicted.items()}


def _model_of(swept: int, joints: list[int]) -> Predictor:
    """The paper's nominal model of the joints that one servo moves."""
    return lambda angle: elastic_joints_from_servo(angle[:, None] * np.eye(len(SERVOS))[swept])[
        :, joints
    ]


def _chosen(available: int, number: int, rng: np.random.Generator) -> np.ndarray:
    """Training points: both ends of the sweep and others at random."""
    inner = rng.permutation(np.arange(1, available - 1))[: max(number - 2, 0)]
    return np.sort(np.concatenate([[0, available - 1], inner]))


def _error(predicted: Array, truth: Array) -> float:
    """Mean over the nine joints of the mean absolute error [°]."""
    return float(np.degrees(np.nanmean(np.abs(predicted - truth)[:, NINE])))


def rivals(count: int, seed: int, samples: tuple[int, ...] = SAMPLES) -> Part:
    """Run the comparison, with its figure."""
    race = run_race(count, seed, samples)
    body = [(name, *table.values()) for name, table in race.trained.items()]
    body += [
        (f"{name}, untrained", value, *[""] * (len(samples) - 1))
        for name, value in race.untrained.items()
    ]
    parts = [
        f"## Rival calibrations on {TITLE}: mean absolute error of the nine joints [°]",
        f"{count} hands, seed {seed}; mean and 95 % interval.",
        markdown(("method", *(f"{n} points" for n in samples)), body),
        f"The camera's scale error alone, which no method can observe, leaves {race.camera:.3f}°.",
    ]
    caption = f"{count} hands, {TITLE}, camera with common errors, seed {seed}"
    return Part("\n\n".join(parts) + "\n", race, {"rivals": race_figure(race)}, caption)


def race_figure(race: Race) -> Figure:
    """Error over the number of training points, with 95 % intervals."""
    figure = new_figure(10, 5.5)
    axis = figure.subplots()
    for (name, table), marker in zip(race.trained.items(), "os^DvPX", strict=True):
        numbers = list(table)
        bounds = np.array([[table[n].low, table[n].high] for n in numbers])
        (line,) = axis.plot(
            numbers,
            [table[n].middle for n in numbers],
            f"{marker}-",
            markersize=5,
            label=name.replace("`", ""),
        )
        low = np.maximum(bounds[:, 0], 1e-3)
        high = bounds[:, 1]
        color = line.get_color()
        axis.fill_between(numbers, low, high, color=color, alpha=0.1, linewidth=0)
    for (name, value), style in zip(race.untrained.items(), (":", "--"), strict=True):
        axis.axhline(value.middle, color="black", linestyle=style, label=f"{name}, untrained")
    log_ticks(axis.xaxis, numbers)
    log_ticks(axis.yaxis, (0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10))
    axis.set_ylim(0.05, 10)
    axis.set_xlabel("training points of each servo")
    axis.set_ylabel("mean absolute error of the nine joints [°]")
    figure.legend(loc="outside right center", frameon=False, fontsize=9)
    return figure
