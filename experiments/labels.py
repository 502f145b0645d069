"""Exchanged labels of joints in the records of hidden hands, and which of them are refused."""

import itertools

import numpy as np

from experiments.bench import Protocol, metal_sweeps
from experiments.hidden import CAMERA, LAWS, hidden_hands, measured_in_physics, without_frames
from experiments.results import Column, Part, part_of
from hpac_gym.calibration.judging import judged
from hpac_gym.calibration.record import EXTENDING, RecordError, Sweep, joints_of_servo
from hpac_gym.model import HPAC, JOINT_INDEX, JOINTS, SERVOS
from hpac_gym.progress import progress

KINDS = ("as labelled", "MCP and DIP", "another pair of a digit", "joints of two digits")
"""Kinds of exchange of two joints' labels."""


def exchanged(record: Sweep, first: int, second: int) -> Sweep:
    """The record with the columns of two joints exchanged."""
    joint_pos = record.joint_pos.copy()
    joint_pos[:, [first, second]] = joint_pos[:, [second, first]]
    return record.with_joint_pos(joint_pos)


def verdict(record: Sweep) -> str:
    """Whether the checks of `hpac sweep` and `hpac calibrate` refuse a record, remark on it or take
    it.
    """
    try:
        return "remark" if judged(record, HPAC) else "taken"
    except RecordError:
        return "refused"


def verdicts(record: Sweep, rng: np.random.Generator) -> dict[str, list[str]]:
    """Verdicts on every segment by kind of exchange: all pairs of a digit, and each joint with a
    random one of another digit.
    """
    told: dict[str, list[str]] = {kind: [] for kind in KINDS}
    as_labelled, mcp_and_dip, of_a_digit, of_two_digits = told.values()
    for rows in record.segments():
        segment = record[rows]
        own = joints_of_servo(int(record.swept[rows[0]]))
        others = [
            joint for joint in range(len(JOINTS)) if joint not in (*own, JOINT_INDEX["thumb_cmc"])
        ]
        as_labelled.append(verdict(segment))
        for pair in itertools.combinations(own, 2):
            parts = {JOINTS[joint].partition("_")[2] for joint in pair}
            (mcp_and_dip if parts == {"mcp", "dip"} else of_a_digit).append(
                verdict(exchanged(segment, *pair))
            )
        of_two_digits += [
            verdict(exchanged(segment, joint, int(rng.choice(others)))) for joint in own
        ]
    return told


def _shares(kind: str, result: str) -> Column:
    return Column(
        f"{kind}, {result}",
        f"{kind}: {result}",
        lambda found: found[kind].count(result) / len(found[kind]),
        "{:.1%}",
    )


LABEL_COLUMNS = (
    Column("digits", "digits", lambda found: len(found[KINDS[0]])),
    *(_shares(kind, result) for kind in KINDS[:2] for result in ("refused", "remark")),
    *(_shares(kind, "refused") for kind in KINDS[2:]),
)


def labels(count: int, seed: int, in_physics: int = 0) -> Part:
    """Check records with and without exchanged labels: `count` hidden hands of each law,
    `in_physics` in the physics engine.
    """
    records: dict[str, list[Sweep]] = {}
    for laws, metal in LAWS.items():
        both = metal_sweeps(
            hidden_hands(count, seed, metal),
            seed,
            CAMERA,
            Protocol(both_directions=True),
            SERVOS[:-1],
        )
        both = [without_frames(record, seed, number) for number, record in enumerate(both)]
        records[f"{laws}, points both ways"] = both
        records[f"{laws}, flexion alone"] = [record[record.phase != EXTENDING] for record in both]
    if in_physics:
        records["physics engine, the return filmed"] = [
            record for _, record, *_ in measured_in_physics(in_physics, seed)
        ]
    judgements = {}
    for name, sweeps in records.items():
        parts = [
            verdicts(record, np.random.default_rng([seed, i]))
            for i, record in enumerate(progress(sweeps, name))
        ]
        judgements[name] = {
            kind: [result for part in parts for result in part[kind]] for kind in KINDS
        }
    title = f"Exchanged labels of joints, hidden hands, seed {seed}"
    return part_of(title, "hidden", LABEL_COLUMNS, judgements)
