"""Rival calibrations on the same data: what each makes of a few training samples, judged on another sweep.

Every rival maps one servo's angle to the angles of the joints that it moves, fitted to N sampling points of a training sweep.
The paper's model is fitted to nothing; `identified` is `hpac calibrate`.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from scipy import linalg, optimize

from hpac_gym.model import HPAC, JOINT_INDEX, elastic_joints_from_servo, rigid_joints_from_servo
from hpac_gym.model.checks import Array
from hpac_gym.progress import progress
from hpac_gym.study.accuracy import EVALUATED
from hpac_gym.study.identification import LEAST_POINTS, IdentificationError, identify, predicted_joints
from hpac_gym.study.intervals import Mean, mean_of
from hpac_gym.study.processing import points, without_drift
from hpac_gym.study.record import PHASES, Sweep, joints_of_servo

SAMPLES = (3, 4, 6, 8, 12, 16, 24, 31)
"""Training points of each servo."""
DEGREE = 4
UNITS = 6

Predictor = Callable[[Array], Array]
"""Servo angles (k,) to joint angles (k, joints)."""


def linear_scaling(servo: Array, joint_pos: Array, rng: np.random.Generator) -> Predictor:
    """One factor a joint through the rest pose: q = a u."""
    factor = servo @ joint_pos / (servo @ servo)
    return lambda angle: angle[:, None] * factor


def polynomial(servo: Array, joint_pos: Array, rng: np.random.Generator) -> Predictor:
    """A polynomial a joint, of degree 4 or as far as the points reach."""
    degree = min(DEGREE, len(servo) - 1)
    factors = np.polynomial.polynomial.polyfit(servo, joint_pos, degree)
    return lambda angle: np.polynomial.polynomial.polyval(angle, factors).T


def gaussian_process(servo: Array, joint_pos: Array, rng: np.random.Generator) -> Predictor:
    """A Gaussian process on top of linear scaling: squared exponential and white noise, by marginal likelihood."""
    base = linear_scaling(servo, joint_pos, rng)
    rest = joint_pos - base(servo)
    scale = max(float(rest.std()), 1e-6)
    gaps = (servo[:, None] - servo) ** 2

    def kernel(parameters: Array, squared: Array) -> Array:
        amplitude, length = np.exp(parameters[:2])
        return (amplitude * scale) ** 2 * np.exp(-0.5 * squared / length**2)

    def factorised(parameters: Array):
        covariance = kernel(parameters, gaps) + (np.exp(parameters[2]) * scale) ** 2 * np.eye(len(servo))
        return linalg.cho_factor(covariance + 1e-12 * scale**2 * np.eye(len(servo)), lower=True)

    def unlikelihood(parameters: Array) -> float:
        factor = factorised(parameters)
        return float(
            0.5 * np.sum(rest * linalg.cho_solve(factor, rest)) + rest.shape[1] * np.log(np.diag(factor[0])).sum()
        )

    start, bounds = np.log([1.0, 0.5, 0.05]), [(-3, 3), (-3, 2), (-7, 1)]
    parameters = optimize.minimize(unlikelihood, start, bounds=bounds, method="L-BFGS-B").x
    weight = linalg.cho_solve(factorised(parameters), rest)
    return lambda angle: base(angle) + kernel(parameters, (angle[:, None] - servo) ** 2) @ weight


def network(servo: Array, joint_pos: Array, rng: np.random.Generator) -> Predictor:
    """A network of one hidden layer of six tanh units on top of linear scaling, least squares with weight decay."""
    base = linear_scaling(servo, joint_pos, rng)
    rest, span = joint_pos - base(servo), servo.max()
    scale = max(float(np.abs(rest).max()), 1e-6)
    outputs = rest.shape[1]

    def output(weights: Array, angle: Array) -> Array:
        slope, shift = weights[:UNITS], weights[UNITS : 2 * UNITS]
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
    "Gaussian process": gaussian_process,
    "network": network,
}
UNTRAINED = {"rigid model": rigid_joints_from_servo, "paper's model": elastic_joints_from_servo}


@dataclass(frozen=True, slots=True)
class Rivalry:
    """Mean absolute error of the nine joints on the test sweep [°], by method and number of training points."""

    trained: dict[str, dict[int, Mean]]
    untrained: dict[str, float]


def run_rivals(
    train: Sweep, test: Sweep, count: int, seed: int, samples: tuple[int, ...] = SAMPLES, shown: bool = False
) -> Rivalry:
    """Fit every rival to random points of one sweep, judge it on all points of another.

    Args:
        train: a record, drift and noise in it.
        test: another one of the same hand.
        count: random choices of the training points for every number of them.
        seed: of the choices and of the network's first weights.
        samples: numbers of training points of each servo.
        shown: draw a progress bar.
    """
    known, asked = points(without_drift(train)), points(without_drift(test))
    truth = asked.joint_pos
    untrained = {name: _mae(model(asked.servo), truth, asked.swept) for name, model in UNTRAINED.items()}
    methods = [*RIVALS, "identified"]
    errors: dict[str, dict[int, list[float]]] = {name: {} for name in methods}
    for number, draw in progress([(n, d) for n in samples for d in range(count)], "rivals", shown):
        rng = np.random.default_rng([seed, number, draw])
        chosen = {servo: _chosen(int((known.swept == servo).sum()), number, rng) for servo in np.unique(known.swept)}
        for name, fit in RIVALS.items():
            predicted = np.zeros_like(truth)
            for servo, which in chosen.items():
                rows, joints = np.flatnonzero(known.swept == servo)[which], joints_of_servo(int(servo))
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", np.exceptions.RankWarning)
                    predictor = fit(known.servo[rows, servo], known.joint_pos[np.ix_(rows, joints)], rng)
                mine = np.flatnonzero(asked.swept == servo)
                predicted[np.ix_(mine, joints)] = predictor(asked.servo[mine, servo])
            errors[name].setdefault(number, []).append(_mae(predicted, truth, asked.swept))
        if number >= LEAST_POINTS:
            try:
                found = identify(_only(train, chosen))
            except IdentificationError:
                continue
            errors["identified"].setdefault(number, []).append(_mae(predicted_joints(asked.servo, found), truth, asked.swept))
    return Rivalry({name: {n: mean_of(values) for n, values in table.items()} for name, table in errors.items()}, untrained)


def _chosen(available: int, number: int, rng: np.random.Generator) -> np.ndarray:
    """Training points: both ends of the sweep and others at random."""
    inner = rng.permutation(np.arange(1, available - 1))[: max(number - 2, 0)]
    return np.sort(np.concatenate([[0, available - 1], inner]))


def _only(train: Sweep, chosen: dict[int, np.ndarray]) -> Sweep:
    flexion = (train.phase == PHASES.index("flexion")) & (train.point >= 0)
    wanted = np.zeros(len(train), dtype=bool)
    for servo, which in chosen.items():
        wanted |= (train.swept == servo) & np.isin(train.point, which)
    return train[~flexion | wanted]


def _mae(predicted: Array, truth: Array, swept: np.ndarray) -> float:
    """Mean over the nine joints of the mean absolute error at the points of their own servo [°]."""
    errors = []
    for name in EVALUATED:
        rows = swept == HPAC.servo_of_joint[JOINT_INDEX[name]]
        if rows.any():
            errors.append(np.abs(predicted[rows, JOINT_INDEX[name]] - truth[rows, JOINT_INDEX[name]]).mean())
    return float(np.degrees(np.mean(errors)))


def rivals_figure(found: Rivalry) -> Figure:
    """Error on the test sweep over the number of training points, with 95 % intervals."""
    figure = Figure(figsize=(9, 5), layout="constrained")
    axis = figure.subplots()
    for name, table in found.trained.items():
        numbers = list(table)
        means = np.array([table[n].mean for n in numbers])
        bounds = np.array([[table[n].low, table[n].high] for n in numbers]).reshape(-1, 2)
        (line,) = axis.plot(numbers, means, "o-", label=name)
        axis.fill_between(numbers, *bounds.T, color=line.get_color(), alpha=0.2, linewidth=0)
    for (name, value), style in zip(found.untrained.items(), (":", "--"), strict=True):
        axis.axhline(value, color="black", linestyle=style, label=f"{name}, untrained")
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_xticks(SAMPLES, [str(n) for n in SAMPLES])
    axis.minorticks_off()
    axis.set_xlabel("training points of each servo")
    axis.set_ylabel("mean absolute error of the nine joints [°]")
    figure.legend(loc="outside right center", frameon=False)
    return figure
