"""The paper's 13 gestures and 16 grasp shapes, findable by name, and what six servos make of
them.
"""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from hpac_gym.errors import HpacError, ShapeError
from hpac_gym.model import (
    FINGERS,
    HPAC,
    JOINT_INDEX,
    JOINTS,
    POSTURES,
    joints_from_synergy,
    posture,
    reach,
    scaled_hand,
)
from hpac_gym.model.calibration import Calibration, Friction
from hpac_gym.model.postures import PostureError


def of(name: str, part: str) -> dict[str, float]:
    """The target of one kind of joint in each finger."""
    target = posture(name).target_joint_pos
    return {finger: target[JOINT_INDEX[f"{finger}_{part}"]] for finger in FINGERS}


def test_the_panels_are_the_paper_s():
    """ "13 target configurations shown in (1-13)": "thumb opposition to the index, middle, and ring
    fingers (1-3)", "digit gestures 1-8 (8-13)"; "an extended set of 16 representative grasps", panels
    14 to 29.
    """
    assert [item.panel for item in POSTURES.values()] == list(range(1, 30))
    kinds = [item.kind for item in POSTURES.values()]
    assert kinds == ["opposition"] * 3 + ["gesture"] * 10 + ["grasp"] * 16
    names = list(POSTURES)
    assert names[:3] == ["oppose_index", "oppose_middle", "oppose_ring"]
    assert all(name.startswith("digit_") for name in names[7:13])


@pytest.mark.parametrize("digit", range(1, 9))
def test_digit_gestures_1_to_8_are_all_there(digit):
    """ "digit gestures 1-8 (8-13)": as the six panels 8 to 13 and two of the multi-finger
    gestures.
    """
    item = posture(f"digit_{digit}")
    assert 4 <= item.panel <= 13
    straight = {1: 1, 2: 2, 3: 3, 4: 4, 5: 4, 6: 1, 7: 0, 8: 1}[digit]
    assert sum(angle == 0 for angle in of(f"digit_{digit}", "mcp").values()) == straight


@pytest.mark.parametrize(("panels", "least"), [(13, 0.2), (29, 0.05)])
def test_no_two_postures_are_alike(panels, least):
    """The nearest two of the 13 differ by more than 0.2 rad in some joint: `digit_3` and
    `oppose_index` once differed by 0.03.
    """
    targets = [item.target_joint_pos for item in POSTURES.values() if item.panel <= panels]
    assert min(np.abs(one - other).max() for one, other in combinations(targets, 2)) > least


@pytest.mark.parametrize("name", POSTURES)
def test_a_target_lies_in_table_1_and_the_hand_makes_of_it_what_its_manifold_and_servos_allow(name):
    target = POSTURES[name].target_joint_pos
    assert target.shape == (len(JOINTS),)
    assert (target >= HPAC.joint_min).all()
    assert (target <= HPAC.joint_max).all()
    taken = reach(target)
    again = reach(np.maximum(taken.joint_pos, 0.0))
    assert again.distance < 1e-9
    assert again.servo == pytest.approx(taken.servo, abs=1e-9)
    assert (taken.servo >= HPAC.servo_min).all()
    assert (taken.servo <= HPAC.servo_max).all()
    assert taken.distance == pytest.approx(np.linalg.norm(target - taken.joint_pos))
    assert taken.distance < 0.4


def test_a_posture_on_the_manifold_is_at_no_distance_and_one_off_it_is_not():
    on = joints_from_synergy(HPAC.synergy_max / 2)
    assert reach(on).distance < 1e-12
    off = on.copy()
    off[JOINT_INDEX["index_dip"]] += 0.1
    assert 0.05 < reach(off).distance < 0.1


def test_a_calibrated_hand_is_wound_up_as_far_as_the_nominal_board_allows():
    """Zeros may need more than the file's own range, which knows of none."""
    behind = replace(HPAC, calibration=Calibration((-0.05,) * 6, (Friction(0.0, 0.0),) * 5))
    narrow = scaled_hand(behind, {"servo_radius": 1.1})
    for hand in (behind, narrow):
        servo = reach(joints_from_synergy(HPAC.synergy_max), hand).servo
        assert (servo <= HPAC.servo_max).all()
        assert (servo[:5] > hand.servo_max[:5] - 1e-9).all()
    assert (servo[:5] > hand.servo_max[:5] + 0.01).all()


def test_an_unknown_posture_is_told_with_near_names():
    with pytest.raises(
        PostureError, match=r"no posture 'oppose_indx'; there are 29, among them .*oppose_index"
    ):
        posture("oppose_indx")
    with pytest.raises(PostureError, match="no posture ''"):
        posture("")
    assert issubclass(PostureError, HpacError)
    assert issubclass(PostureError, LookupError)


@pytest.mark.parametrize("target", [np.zeros(14), np.zeros((2, 15)), np.full(15, np.nan)])
def test_a_target_is_one_posture_of_fifteen_finite_angles(target):
    with pytest.raises(ShapeError, match="target_joint_pos"):
        reach(target)


def test_targets_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        posture("fist").target_joint_pos[0] = 1.0
