"""`hpac calibrate` on two sweeps of each of some hands that lack nothing of what a workshop's hand may
have: ``python -m experiments.imperfect``."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from experiments.imperfect_hands import SEED, ImperfectHand, Session, swept
from experiments.results import Column, Interval, add_out, range_of, rows_of, table, write_results
from hpac_gym.calibration.fitting import IdentificationError
from hpac_gym.calibration.identification import doubts, identify
from hpac_gym.calibration.judging import judged
from hpac_gym.calibration.record import RecordError
from hpac_gym.calibration.report import BOUND, check_errors, expected_worst_deg, file_errors
from hpac_gym.command import command_parser, run, whole_number
from hpac_gym.evaluation.statistics import wilson_interval
from hpac_gym.model import HPAC, JOINT_INDEX, SERVOS, Array, Hand
from hpac_gym.model.files import hand_from_toml, hand_to_toml
from hpac_gym.model.settled import settled_joints_from_servo, settled_servo_from_synergy
from hpac_gym.progress import progress

CHOSEN_ON = 1000
JUDGED_ON = 2000
"""First hands on which the bound and the thresholds of `hpac calibrate` were chosen, and judged."""
POSTURES = 40
"""Number of held-out postures that are commanded."""


def true_errors_deg(hand: ImperfectHand, session: Session, file: Hand, seed: int) -> Array:
    """Mean absolute difference between the angles that a file promises for its commands and the true
    ones, by joint, over held-out postures; NaN where a joint never leaves a stop [°].

    Each posture is approached from the open hand, and is free if no joint of the digit is at a stop.
    """
    rng = np.random.default_rng([SEED, seed, 9])
    share = rng.uniform(0.05, 0.95, (POSTURES, len(SERVOS)))
    synergy = HPAC.synergy_min + share * (HPAC.synergy_max - HPAC.synergy_min)
    servo = np.clip(settled_servo_from_synergy(synergy, file), HPAC.servo_min, HPAC.servo_max)
    time = rng.uniform(0, 600, POSTURES)
    reached = np.concatenate(
        [hand.course(u[None], t[None], session) for u, t in zip(servo, time, strict=True)]
    )
    off = np.degrees(np.abs(settled_joints_from_servo(servo, file) - reached))
    for digit, built in zip(hand.hand.digits.values(), hand.digits, strict=True):
        joints = [JOINT_INDEX[joint] for joint in digit.joints]
        stopped = (reached[:, joints] > np.array(built.more.stop) - 1e-6).any(axis=1)
        off[np.ix_(stopped, joints)] = np.nan
    return np.nanmean(off, axis=0)


@dataclass(frozen=True, slots=True)
class Judged:
    """What `hpac calibrate` says of one hand, and the truth."""

    seed: int
    refused: str = ""
    alone_deg: float = np.nan
    """The first line's error of the worst joint without a second sweep [°]."""
    told_deg: float = np.nan
    """The same with a second sweep."""
    true_deg: float = np.nan
    """True error of the worst joint."""
    median_deg: float = np.nan
    """True error of the median joint."""
    nominal_deg: float = np.nan
    """True error of the median joint with the nominal hand."""
    remarks: int = 0

    @property
    def fold(self) -> float:
        """Factor between the told error and the true one, at least 1."""
        return max(self.told_deg / self.true_deg, self.true_deg / self.told_deg)


def judge(seed: int, both_ways: bool) -> Judged:
    """Sweep a hand in two sessions, calibrate it as `hpac calibrate sweep.csv --check sweep2.csv`
    does, and command it in a third.
    """
    hand = ImperfectHand.drawn(seed)
    first, second, third = (Session.drawn(seed, number) for number in range(3))
    record, again = (swept(hand, session, both_ways) for session in (first, second))
    try:
        remarks = judged(record, HPAC) + judged(again, HPAC)
        identified = identify(record, hold_out=True)
        remarks += doubts(identified, HPAC)
    except (RecordError, IdentificationError) as error:
        return Judged(seed, str(error))
    file = hand_from_toml(hand_to_toml(identified.hand), "the calibrated hand")
    alone = max(error.mean_abs_deg for error in file_errors(identified, file).values())
    told = expected_worst_deg(check_errors(again, file, HPAC))
    true, nominal = (true_errors_deg(hand, third, model, seed) for model in (file, HPAC))
    ends = (np.nanmax(true), np.nanmedian(true), np.nanmedian(nominal))
    return Judged(seed, "", alone, told, *map(float, ends), len(remarks))


def _bound_holds(hands: Sequence[Judged]) -> Interval:
    """Share of the hands within the stated bound, with its Wilson interval."""
    held = sum(hand.true_deg <= BOUND * hand.told_deg for hand in hands)
    return Interval(held / len(hands), *wilson_interval(held, len(hands)))


COLUMNS = (
    Column("hands", "hands", len),
    *(
        Column(
            key, heading, lambda hands, key=key: range_of([getattr(h, key) for h in hands]), form
        )
        for key, heading, form in (
            ("nominal_deg", "nominal hand, median joint [°]", "{:.1f}"),
            ("median_deg", "file, median joint", "{:.2f}"),
            ("true_deg", "file, worst joint", "{:.2f}"),
        )
    ),
    Column(
        "understates",
        "true / told without a second sweep",
        lambda hands: range_of([hand.true_deg / hand.alone_deg for hand in hands]),
        "{:.2f}",
    ),
    Column(
        "ratio",
        "true / told with it",
        lambda hands: range_of([hand.true_deg / hand.told_deg for hand in hands]),
        "{:.2f}",
    ),
    Column("fold", "off by a factor", lambda hands: range_of([h.fold for h in hands]), "{:.2f}"),
    Column("bound_holds", "95 % bound holds", _bound_holds, "{:.0%}"),
)


def main(argv: list[str] | None = None) -> None:
    """Judge the hands with either protocol, print the table and write it."""
    parser = command_parser("experiments.imperfect", __doc__)
    parser.add_argument("--hands", type=whole_number(2), default=40, help="hands")
    add_out(parser)
    arguments = parser.parse_args(argv)
    judged_by = {}
    for name, both_ways in (("flexion alone", False), ("points both ways", True)):
        seeds = progress(range(JUDGED_ON, JUDGED_ON + arguments.hands), name)
        judged_by[name] = [judge(seed, both_ways) for seed in seeds]
    taken = {
        name: [hand for hand in hands if not hand.refused] for name, hands in judged_by.items()
    }
    rows = rows_of(COLUMNS, taken)
    refused = [
        f"{name} {hand.seed}" for name in judged_by for hand in judged_by[name] if hand.refused
    ]
    words = f"imperfect --hands {arguments.hands}"
    write_results(arguments.out, words, bound=BOUND, refused=refused, rows=rows, hands=judged_by)
    print(f"{table('protocol', COLUMNS, rows)}\n\nrefused: {', '.join(refused) or 'none'}")
    print(f"written to {arguments.out}")


if __name__ == "__main__":
    sys.exit(run(main))
