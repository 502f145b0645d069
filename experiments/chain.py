"""What a model buys: named grasps on hands that differ, commanded with four models: ``python -m
experiments.chain``.

Every hand is swept once in simulation and calibrated by `hpac calibrate`'s own functions. Then the
scripted closure runs the same episodes with each model. The truth is simulated: slack counts as a
zero of the servo, the geometry of all hands is the nominal one, and camera and friction are those of
`experiments.sweep`."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np

from experiments.held_out import truth as held_out_truth, with_zeros
from experiments.populations import geometry, varied_hand
from experiments.results import add_workers_and_out, percent, read_results, write_results
from experiments.rig import Rig
from hpac_gym.body.hands import hand_set
from hpac_gym.calibration.identification import identify
from hpac_gym.calibration.judging import judged
from hpac_gym.calibration.record import RecordError, Sweep
from hpac_gym.command import command_parser, run, whole_number
from hpac_gym.envs import GRASPS
from hpac_gym.envs.commands import FILES
from hpac_gym.evaluation.evaluate import run_block
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.evaluation.statistics import paired_difference, success_counts
from hpac_gym.evaluation.workers import shared
from hpac_gym.figures import new_figure, save
from hpac_gym.model import HPAC, SERVOS, Calibration, Hand, joints_from_synergy, load_hand
from hpac_gym.model.maps import CommandMap
from hpac_gym.model.settled import settled_joints_from_servo
from hpac_gym.output import markdown
from hpac_gym.physics.stand import HAND
from hpac_gym.registration import GRASP

SEED = 33_000
"""First seed of the hands; no other experiment uses it."""
TYPES = (
    "tip_pinch",
    "three_finger_pinch",
    "lateral_pinch",
    "precision_box",
    "rod",
    "large_cylinder",
)
"""Grasps from the most to the least precise."""
ENGINES = ("mujoco", "pybullet")
MODELS = ("nominal map", "Eq. (15) with the file", "file inverted", "known exactly")
WORKSHOP = {**geometry(0.01), "drive_stiffness": 0.05, "tendon_stiffness": 0.05}
"""Relative standard deviations of a hand from a workshop (chosen)."""
WORKSHOP_ZERO = np.radians(0.5)
"""Standard deviation of a servo's zero after setting it by eye (chosen) [rad]."""
SLACK = 1e-3
"""Most slack of a driving tendon, drawn uniformly (chosen) [m]."""
COLOURS = ("#999999", "#e69f00", "#0072b2", "#56b4e9")
"""Of the models: told apart by colour-blind people too."""


def workshop_hand(seed: int) -> Hand:
    """A hand with the tolerances of a workshop."""
    rng = np.random.default_rng([SEED, seed])
    zero = WORKSHOP_ZERO * rng.standard_normal(len(SERVOS))
    hand = replace(varied_hand(HPAC, WORKSHOP, rng), name=f"workshop {seed}")
    return with_zeros(hand, zero)


def slack_hand(seed: int) -> Hand:
    """A workshop's hand whose driving tendons have slack."""
    hand = replace(workshop_hand(seed), name=f"slack {seed}")
    slack = np.random.default_rng([SEED, seed, 1]).uniform(0.0, SLACK, len(hand.digits))
    return with_zeros(hand, hand.calibration.servo_zero, slack)


HELD_OUT = [variant for variant in hand_set("test") if (FILES / f"{variant.name}.toml").exists()]
"""The seven held-out hands that can be calibrated."""
DRAWN = {"nominal hand": lambda _: HPAC, "workshop": workshop_hand, "workshop, slack": slack_hand}
POPULATIONS = (*DRAWN, "held-out hands")


def calibrated(population: str, seed: int) -> tuple[Hand, Hand]:
    """A true hand and the file of one simulated sweep of it.

    Raises:
        RecordError: `hpac calibrate` refuses the record.
    """
    if population in DRAWN:
        hand = DRAWN[population](seed)
        return hand, identify(swept(hand, seed)).hand
    variant = HELD_OUT[seed % len(HELD_OUT)]
    return held_out_truth(variant), load_hand(FILES / f"{variant.name}.toml")


def swept(hand: Hand, seed: int) -> Sweep:
    """The record of one simulated sweep of a hand.

    Raises:
        RecordError: `hpac calibrate` refuses it.
    """
    zero = hand.calibration.servo_zero
    rig = Rig(replace(hand, calibration=Calibration()), HAND, servo_zero=zero)
    record = rig.sweep(np.random.default_rng([SEED, seed, 2]))
    judged(record, HPAC)
    return record


def models(hand: Hand, file: Hand) -> dict[str, Hand]:
    """The four models of a hand, by the names of `MODELS`."""
    # The stops that a record shows do not bound the synergies that a closure asks for.
    papers = replace(file, calibration=Calibration(), workspace=HPAC.workspace)
    return dict(zip(MODELS, (HPAC, papers, file, hand), strict=True))


def posture_error_deg(hand: Hand, model: Hand, synergy: Sequence[float]) -> float:
    """Mean distance of the finger joints from the nominal hand's posture at a synergy, in free
    space [°].
    """
    flexing = np.ones((1, len(SERVOS)), dtype=bool)
    servo = CommandMap(model).servo_from_synergy(np.array([synergy]), flexing)
    servo = np.clip(servo, HPAC.servo_min, HPAC.servo_max)
    off = settled_joints_from_servo(servo, hand) - joints_from_synergy(np.array([synergy]), HPAC)
    return float(np.degrees(np.abs(off)).mean())


def trials(
    engine: str, population: str, seed: int, hand: Hand, file: Hand, grasp: str
) -> list[tuple[str, str, str, str, bool, float]]:
    """One episode of a grasp with every model on one hand."""
    rows = []
    for name, model in models(hand, file).items():
        options = {"grasp": grasp, "engine": engine, "hand": hand, "model": model}
        ((episode,),) = run_block(["scripted"], GRASP, options, [HELD_OUT_SEED + seed])
        error = posture_error_deg(hand, model, GRASPS[grasp].closed)
        rows.append((engine, population, grasp, name, episode.success, error))
    return rows


def summary(rows: Sequence[tuple]) -> list[dict]:
    """Success with its interval, difference to the nominal map, and posture error, for every engine,
    population, group of grasps and model. The rows of all models are of the same episodes.
    """
    cells = []
    groups = {"all": TYPES, **{grasp: (grasp,) for grasp in TYPES}}
    for engine, population, group in product(ENGINES, POPULATIONS, groups):
        found: dict[str, list[tuple[bool, float]]] = {}
        for at, of, grasp, model, held, error in rows:
            if at == engine and of == population and grasp in groups[group]:
                found.setdefault(model, []).append((held, error))
        for model, mine in found.items():
            held, errors = zip(*mine, strict=True)
            gain, *interval = paired_difference(held, (nominal for nominal, _ in found[MODELS[0]]))
            cells.append(
                {
                    "engine": engine,
                    "hands": population,
                    "grasp": group,
                    "model": model,
                    **success_counts(sum(held), len(held)),
                    "gain": gain,
                    "gain_95": interval,
                    "posture_error_deg": float(np.mean(errors)),
                }
            )
    return cells


def cell_table(cells: Sequence[Mapping], engine: str, group: str = "all") -> str:
    """One engine's cells as a table: populations by models."""
    rows = []
    for population in POPULATIONS:
        where = (engine, population, group)
        texts = [
            f"{cell['success_rate']:.0%} {percent(cell['interval_95'], '.0f')}, {cell['posture_error_deg']:.1f}°"
            for cell in cells
            if (cell["engine"], cell["hands"], cell["grasp"]) == where
        ]
        rows.append((population, *texts))
    return markdown(("hands", *MODELS), rows)


def draw(cells: Sequence[Mapping], path: Path) -> None:
    """Success of all grasps with its interval, and posture error below, one column an engine."""
    figure = new_figure(11, 5.6)
    axes = figure.subplots(2, len(ENGINES), sharex=True, sharey="row", height_ratios=(3, 2))
    for column, engine in enumerate(ENGINES):
        upper, lower = axes[:, column]
        for order, (model, colour) in enumerate(zip(MODELS, COLOURS, strict=True)):
            mine = [
                cell
                for cell in cells
                if (cell["engine"], cell["grasp"], cell["model"]) == (engine, "all", model)
            ]
            at = np.arange(len(mine)) + 0.2 * (order - 1.5)
            share = np.array([cell["success_rate"] for cell in mine])
            bounds = np.array([cell["interval_95"] for cell in mine]).T
            reach = np.clip([share - bounds[0], bounds[1] - share], 0, None)
            upper.bar(at, 100 * share, 0.18, color=colour, label=model)
            upper.errorbar(at, 100 * share, 100 * reach, fmt="none", ecolor="black", capsize=2)
            lower.bar(at, [cell["posture_error_deg"] for cell in mine], 0.18, color=colour)
        upper.set_title({"mujoco": "MuJoCo", "pybullet": "PyBullet"}[engine])
        lower.set_xticks(range(len(POPULATIONS)), list(POPULATIONS))
    axes[0, 0].set_ylabel("grasps held [%]")
    axes[1, 0].set_ylabel("posture error [°]")
    axes[0, 0].set_ylim(0, 104)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    save(figure, path)


def main(argv: list[str] | None = None) -> None:
    """Calibrate the hands, run the grasps, print a table an engine, write the cells; or draw them."""
    parser = command_parser("experiments.chain", __doc__)
    parser.add_argument("--hands", type=whole_number(1), default=42, help="hands of each kind")
    add_workers_and_out(parser)
    parser.add_argument("--draw", type=Path, metavar="PNG", help="only draw the cells of --out")
    arguments = parser.parse_args(argv)
    if arguments.draw:
        draw(read_results(arguments.out, "cells")["cells"], arguments.draw)
        return
    wanted = list(product(POPULATIONS, range(arguments.hands)))
    made = shared(_calibrated, wanted, arguments.workers, "calibrating")
    pairs = dict(zip(wanted, made, strict=True))
    hands = [(*one, *pair) for one, pair in pairs.items() if pair]
    refused = [f"{kind} {seed}" for (kind, seed), pair in pairs.items() if not pair]
    jobs = [(engine, *hand, grasp) for engine, hand, grasp in product(ENGINES, hands, TYPES)]
    rows = [row for found in shared(trials, jobs, arguments.workers, "grasping") for row in found]
    cells = summary(rows)
    write_results(arguments.out, f"chain --hands {arguments.hands}", refused=refused, cells=cells)
    for engine in ENGINES:
        print(f"{engine}\n\n{cell_table(cells, engine)}\n")
        for grasp in TYPES:
            print(f"{engine}, {grasp}\n\n{cell_table(cells, engine, grasp)}\n")
    print(f"refused: {', '.join(refused) or 'none'}; written to {arguments.out}")


def _calibrated(population: str, seed: int) -> tuple[Hand, Hand] | None:
    try:
        return calibrated(population, seed)
    except RecordError:
        return None


if __name__ == "__main__":
    sys.exit(run(main))
