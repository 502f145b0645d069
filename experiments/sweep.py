"""The paper's mapping-accuracy experiment on the simulated reference hand: ``python -m
experiments.sweep``.
"""

import sys

import numpy as np

from experiments.reference import Reference
from hpac_gym.calibration import sweep as of_record
from hpac_gym.calibration.accuracy import residuals
from hpac_gym.calibration.processing import points, processed
from hpac_gym.calibration.record import Sweep, write_sweep
from hpac_gym.command import command_parser, run
from hpac_gym.figures import label
from hpac_gym.model import JOINT_INDEX, Hand, load_hand
from hpac_gym.output import markdown, write_text

WORKSPACE_STREAM = 0
EVALUATION_STREAM = 1
"""Random streams of the camera's noise in the two sweeps."""
WORKSPACE_POINTS = 21


def workspace(points: Sweep) -> dict[str, tuple[float, float]]:
    """Table I from a sweep: smallest and largest angle of each joint while its servo moved
    [rad].
    """
    return {
        name: (float(found.measured.min()), float(found.measured.max()))
        for name, found in residuals(points).items()
    }


def main(argv: list[str] | None = None) -> None:
    """Simulate two sweeps, evaluate them, write records, figures and tables."""
    parser = command_parser("experiments.sweep", __doc__)
    of_record.add_common_arguments(parser)
    arguments = parser.parse_args(argv)
    hand = load_hand(arguments.model)
    out = arguments.out
    reference = Reference.of()
    record = simulate(reference, EVALUATION_STREAM, "evaluation sweep")
    write_sweep(out / "sweep.csv", record)
    first = simulate(reference, WORKSPACE_STREAM, "workspace sweep", points=WORKSPACE_POINTS)
    write_sweep(out / "workspace.csv", first)
    table = workspace(points(processed(first)))
    text = workspace_table(table, hand)
    write_text(out / "workspace.md", text)
    of_record.evaluate(
        record,
        hand,
        arguments,
        caption=f"reference hand, seed {reference.seed}, simulated, against {hand.name}",
        result={
            "hand": hand.name,
            "seed": reference.seed,
            "workspace_rad": {name: list(bounds) for name, bounds in table.items()},
        },
        remarks=[],
        text=text,
    )


def simulate(reference: Reference, stream: int, label: str = "", **protocol: object) -> Sweep:
    """Simulate one sweep of the reference hand, with its own stream of camera noise."""
    return reference.rig.with_protocol(**protocol).sweep(
        np.random.default_rng([reference.seed, stream]), label=label
    )


def workspace_table(table: dict[str, tuple[float, float]], hand: Hand) -> str:
    """Measured workspace in the form of Table I, compared with the paper's and with the rigid map
    of its driven joints.
    """
    head = (
        "finger joint",
        "label",
        "measured [q_min, q_max] (rad)",
        "Table I (rad)",
        "short of Table I [°]",
        "rigid map (rad)",
    )
    rigid = hand.synergy_max.take(hand.servo_of_joint) * hand.rigid_ratio
    rows = []
    for name, (low, high) in table.items():
        joint = JOINT_INDEX[name]
        (lower, upper) = hand.workspace[name]
        bounds = f"[{low:z.2f}, {high:z.2f}]", f"[{lower:.2f}, {upper:.2f}]"
        rows.append(
            (
                label(name),
                f"q{joint + 1}",
                *bounds,
                f"{np.degrees(upper - high):.1f}",
                f"{rigid[joint]:.3f}",
            )
        )
    return markdown(head, rows) + "\n"


if __name__ == "__main__":
    sys.exit(run(main))
