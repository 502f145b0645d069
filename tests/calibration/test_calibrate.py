"""`hpac calibrate`: what its first line is about, what it doubts, and what it refuses."""

import json
from dataclasses import replace

import numpy as np
import pytest

import hpac
from experiments.bench import metal_sweeps
from hpac_gym.calibration.record import FLEXING, read_sweep, write_sweep
from hpac_gym.model import HPAC


@pytest.fixture
def calibrate(tmp_path, capsys):
    def run(record, *words):
        path = tmp_path / "sweep.csv"
        write_sweep(path, record)
        status = hpac.main(["calibrate", str(path), "--out", str(tmp_path / "hand.toml"), *words])
        return status, capsys.readouterr()

    return run


def test_without_a_second_sweep_the_first_line_says_what_it_is(record, calibrate):
    status, said = calibrate(record)
    assert (status, said.err) == (0, "")
    assert "at the held-out points of the same sweep (an error of camera or servos" in said.out
    assert "Remark" not in said.out


def test_a_second_sweep_is_what_the_first_line_is_about(record, hidden, calibrate, tmp_path):
    write_sweep(tmp_path / "second.csv", metal_sweeps([hidden], 2)[0])
    status, said = calibrate(record, "--check", str(tmp_path / "second.csv"))
    assert status == 0
    assert "of the written file in the independent sweep second.csv is" in said.out
    report = json.loads((tmp_path / "hand-report" / "report.json").read_text())
    assert report


def test_an_error_of_the_first_camera_shows_in_the_second_sweep_alone(
    record, hidden, calibrate, tmp_path
):
    """The reason for a second one: a camera whose scale is 3 % off fits itself."""
    write_sweep(tmp_path / "second.csv", metal_sweeps([hidden], 2)[0])
    wrong = record.with_joint_pos(1.03 * record.joint_pos)
    alone = _worst(calibrate(wrong)[1].out)
    checked = _worst(calibrate(wrong, "--check", str(tmp_path / "second.csv"))[1].out)
    assert alone < 0.15
    assert checked > 5 * alone


def _worst(out):
    return float(out.partition("on average and ")[2].partition("°")[0])


@pytest.mark.parametrize(("slip_deg", "status"), [(1.7, 0), (2.5, 2)])
def test_a_tendon_that_slips_half_way_is_doubted_or_refused(record, calibrate, slip_deg, status):
    joint_pos = record.joint_pos.copy()
    late = (record.swept == 1) & (record.servo[:, 1] > 0.5 * HPAC.servo_max[1])
    joint_pos[late] -= np.deg2rad(slip_deg)
    found, said = calibrate(record.with_joint_pos(joint_pos))
    assert found == status
    assert "index: the points scatter" in said.out + said.err
    assert ("at most 10 times is accepted" in said.err) == (status == 2)


def test_servo_angles_as_a_share_are_doubted(record, calibrate):
    status, said = calibrate(replace(record, servo=record.servo / HPAC.servo_max))
    assert status == 0
    assert "standard deviations from the design; are the servo's angles in radians" in said.out
    assert "off the design's 1.000, and no tendon is between" in said.out


def test_points_that_all_have_one_number_are_refused(record, calibrate):
    point = np.where((record.phase == FLEXING) & (record.point >= 0), 0, record.point)
    status, said = calibrate(replace(record, point=point))
    assert status == 2
    assert "column point numbers 1 points while servo thumb_mp moves" in said.err


def test_a_byte_order_mark_is_read(record, tmp_path):
    path = tmp_path / "sweep.csv"
    write_sweep(path, record)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert len(read_sweep(path)) == len(record)
