"""The files of the held-out hands are what the command makes, and near the simulated hands."""

import numpy as np
import pytest

from experiments.held_out import calibrated, file_error_deg
from hpac_gym.body.hands import hand_set
from hpac_gym.calibration.record import RecordError
from hpac_gym.envs.commands import FILES
from hpac_gym.model import HPAC, load_hand
from hpac_gym.model.settled import settled_joints_from_servo

HANDS = {variant.name: variant for variant in hand_set("test")}
DEAD = "test_03"


def test_seven_of_eight_hands_have_a_file_within_a_tenth_of_a_degree():
    """The nominal hand is up to 22° off; the hand with a dead finger has no file."""
    assert {path.stem for path in FILES.glob("*.toml")} == HANDS.keys() - {DEAD}
    for name in HANDS.keys() - {DEAD}:
        assert file_error_deg(load_hand(FILES / f"{name}.toml"), HANDS[name]).max() < 0.1
        assert file_error_deg(HPAC, HANDS[name]).max() > 10


@pytest.mark.slow
@pytest.mark.pybullet
def test_the_command_makes_these_files_again_and_refuses_a_dead_finger():
    """On the machine that made them, to the bit; elsewhere the engine's last bits differ."""
    servo = np.linspace(HPAC.servo_min, HPAC.servo_max, 17)
    again, file = (
        settled_joints_from_servo(servo, hand)
        for hand in (calibrated(HANDS["test_00"], 0), load_hand(FILES / "test_00.toml"))
    )
    assert again == pytest.approx(file, abs=1e-5)
    with pytest.raises(RecordError, match=r"pinky_dip turns 0\.00 of the design's travel"):
        calibrated(HANDS[DEAD], 3)
