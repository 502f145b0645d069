"""What cannot be a record of this hand is refused with its reason, by `hpac sweep` and `hpac
calibrate` alike.
"""

from dataclasses import replace

import numpy as np
import pytest

from experiments import labels
from hpac_gym.calibration import calibrate, sweep
from hpac_gym.calibration.judging import judged, lag_behind
from hpac_gym.calibration.record import REST, RecordError, Sweep, write_sweep
from hpac_gym.model import HPAC, JOINT_INDEX, JOINTS, SERVOS
from tests.options import parsed


def exchanged(record: Sweep, first: str, second: str) -> Sweep:
    return labels.exchanged(record, JOINT_INDEX[first], JOINT_INDEX[second])


def fingers_exchanged(record: Sweep) -> Sweep:
    for part in ("mcp", "pip", "dip"):
        record = exchanged(record, f"index_{part}", f"ring_{part}")
    return record


def with_joint(record: Sweep, name: str, angles: np.ndarray) -> Sweep:
    joint_pos = record.joint_pos.copy()
    joint_pos[:, JOINT_INDEX[name]] = angles
    return record.with_joint_pos(joint_pos)


def garbage(record: Sweep, share: float) -> Sweep:
    rng = np.random.default_rng(0)
    hit = rng.random(len(record)) < share
    joint_pos = record.joint_pos.copy()
    joint_pos[hit] = rng.uniform(0.0, 1.5, (hit.sum(), len(JOINTS)))
    return record.with_joint_pos(joint_pos)


def blurred(record: Sweep) -> Sweep:
    noise = np.random.default_rng(0).normal(0.0, np.deg2rad(3), record.joint_pos.shape)
    return record.with_joint_pos(record.joint_pos + noise)


REFUSED = [
    (
        lambda record: exchanged(record, "index_pip", "index_dip"),
        r"index_dip turns 1\.\d+ rad for each rad of index_mcp",
    ),
    (
        lambda record: exchanged(record, "index_pip", "index_mcp"),
        "are labels exchanged, or is this another hand",
    ),
    (
        fingers_exchanged,
        r"index_dip turns 0\.0\d of the design's travel, but ring_dip, ring_pip, ring_mcp moved",
    ),
    (
        lambda record: replace(record, swept=np.array([0, 2, 1, 3, 4, 5])[record.swept]),
        r"sweep of middle_mcp: servo middle_mcp moves 0\.00 rad, but index_mcp 1\.\d+ rad; are labels exchanged\?",
    ),
    (
        lambda record: with_joint(
            record, "ring_dip", np.random.default_rng(0).normal(0.0, 2e-3, len(record))
        ),
        r"ring_dip turns 0\.00 of the design's travel; does it rest, or count the other way",
    ),
    (
        lambda record: record.with_joint_pos(-record.joint_pos),
        r"thumb_ip turns -0\.9\d of the design's travel; .* count the other way, or are labels exch",
    ),
    (
        lambda record: garbage(record, 0.3),
        r"\d\d% of the samples of thumb_ip lie more than .*° from the others",
    ),
    (
        lambda record: replace(record, servo=0 * record.servo),
        r"servo thumb_mp moves 0\.00 rad; .*; and \d more$",
    ),
    (
        lambda record: replace(record, point=0 * record.point - 1),
        r"column point: no row of a flexion is at a sampling point",
    ),
    (
        lambda record: replace(record, servo=-record.servo),
        r"thumb_mp moves from 0\.00 to -1\.\d+ rad, outside of the design's \[0\.00, 1\.\d+\] rad",
    ),
    (
        lambda record: record[record.phase != 0],
        "0 samples are marked 'rest', at least 5 are needed",
    ),
    (
        lambda record: with_joint(
            record, "middle_dip", 1.25 * record.joint_pos[:, JOINT_INDEX["middle_dip"]]
        ),
        r"middle_dip turns 1\.\d+ rad for each rad of middle_mcp",
    ),
    (
        lambda record: with_joint(
            record,
            "index_pip",
            np.where(record.phase == REST, np.nan, record.joint_pos[:, JOINT_INDEX["index_pip"]]),
        ),
        "sweep of index_mcp: index_pip is measured in 0 samples at rest, at least 5 are needed",
    ),
    (blurred, r"thumb_ip is measured to .*°, 1° is needed"),
]


@pytest.mark.parametrize(("spoil", "reason"), REFUSED)
def test_a_record_that_cannot_be_of_this_hand_is_refused_with_its_reason(record, spoil, reason):
    with pytest.raises(RecordError, match=reason):
        judged(spoil(record), HPAC)


def test_both_commands_refuse_alike_and_write_nothing(record, tmp_path):
    """Garbage, which the filter of `hpac sweep` would refuse with another reason."""
    good = tmp_path / "good.csv"
    write_sweep(good, record[record.swept == 1])
    path = tmp_path / "sweep.csv"
    write_sweep(path, garbage(record[record.swept == 1], 0.3))
    messages = []
    runs = (
        (calibrate, (path, "--out", tmp_path / "hand.toml")),
        (calibrate, (good, "--check", path, "--out", tmp_path / "hand.toml")),
        (sweep, ("--record", path, "--out", tmp_path / "out")),
    )
    for command, words in runs:
        with pytest.raises(RecordError) as caught:
            command.run(parsed(command, *words))
        messages.append(str(caught.value))
    assert set(messages) == {messages[0]}
    assert messages[0].startswith(f"sweep {path} is refused: sweep of index_mcp: ")
    assert {item.name for item in tmp_path.iterdir()} == {"good.csv", "sweep.csv"}


def test_good_records_with_a_few_faults_are_taken(record):
    """5 % garbage, 2 % of the frames dropped, cells missing, a joint without measurement, one digit
    alone.
    """
    rng = np.random.default_rng(1)
    assert not judged(record, HPAC)
    (remark,) = judged(
        record[(record.swept == 1) & (record.time < record.time[record.phase == 1].max() + 1e-9)],
        HPAC,
    )
    assert (
        "rest poses at one end only: the camera's offset is taken out, its drift is not" in remark
    )
    judged(garbage(record, 0.05), HPAC)
    judged(record[rng.random(len(record)) > 0.02], HPAC)
    holes = record.joint_pos.copy()
    holes[rng.random(holes.shape) < 0.05] = np.nan
    holes[:, JOINT_INDEX["index_pip"]] = np.nan
    judged(record.with_joint_pos(holes), HPAC)
    judged(record[record.swept == SERVOS.index("ring_mcp")], HPAC)


def test_exchanged_mcp_and_dip_cannot_be_told_from_flexion_alone_and_that_is_said(nominal_record):
    """Their radii are equal by design: only the elasticity, 2.5 %, makes a difference, and so do
    radii off by some percent.
    """
    assert not judged(nominal_record, HPAC)
    (remark,) = judged(exchanged(nominal_record, "index_mcp", "index_dip"), HPAC)
    assert "exchanged labels of the two look like this" in remark
    assert "a record that also has frames of the digit's return tells which" in remark


@pytest.fixture
def spotted(both_ways) -> Sweep:
    """The index with friction, with points in both directions and 3 % outliers."""
    return garbage(both_ways, 0.03)


def test_in_both_directions_the_joint_that_the_tendon_pulls_moves_first(spotted):
    """Exchanged MCP and DIP are refused and the right labels are taken; where nothing lags, neither
    is certain.
    """
    assert not judged(spotted, HPAC)
    with pytest.raises(
        RecordError,
        match=r"index_mcp, which the tendon pulls, lags behind index_dip by 0\.\d\d ± 0\.\d\d°",
    ):
        judged(exchanged(spotted, "index_mcp", "index_dip"), HPAC)
    mcp = JOINT_INDEX["index_mcp"]
    dip = JOINT_INDEX["index_dip"]
    flexion = spotted[spotted.phase != 2]
    assert lag_behind(flexion, mcp, dip) == (0.0, np.inf)
    free = 0.98 * spotted.joint_pos[:, mcp] + np.random.default_rng(0).normal(
        0.0, 2e-3, len(spotted)
    )
    lag, error = lag_behind(with_joint(spotted, "index_dip", free), mcp, dip)
    assert abs(lag) < 4 * error < 1e-3


def test_frames_in_motion_are_judged_where_there_are_any(spotted):
    """A DIP that overshoots where the servo stops looks as if it led there; in motion it lags."""
    held = np.arange(len(spotted)) % 2 == 0
    overshoot = np.deg2rad(0.5) * np.array([0, 1, -1])[spotted.phase] * held
    stopping = with_joint(
        spotted, "index_dip", spotted.joint_pos[:, JOINT_INDEX["index_dip"]] + overshoot
    )
    with pytest.raises(RecordError, match="lags behind"):
        judged(stopping, HPAC)
    assert not judged(replace(stopping, point=np.where(held, stopping.point, -1)), HPAC)


@pytest.mark.slow
@pytest.mark.pybullet  # MuJoCo knows no friction by load
def test_exchanged_labels_are_refused_and_right_ones_are_not():
    """Flexion alone does not tell MCP from DIP: the negative control."""
    rows = labels.labels(2, 7, in_physics=1).data
    for name, row in rows.items():
        assert row["as labelled, refused"] == 0.0, name
        assert (
            row["another pair of a digit, refused"] == row["joints of two digits, refused"] == 1.0
        ), name
        assert row["MCP and DIP, refused"] == (0.0 if name.endswith("flexion alone") else 1.0), name
