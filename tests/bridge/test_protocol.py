"""The protocol has one owner: what is generated from it is up to date, and the servo table is the
model's.
"""

import dataclasses

import numpy as np
import pytest

from hpac_gym.bridge import protocol
from hpac_gym.bridge.hands import Config, config_of, load_library
from hpac_gym.bridge.limits import limits_hash, servo_limits
from hpac_gym.errors import ParameterError
from hpac_gym.model import HPAC, SERVOS, hand_to_toml
from tools import generate


def test_generated_files_are_up_to_date(capsys, tmp_path):
    (tmp_path / "hand.toml").write_text(hand_to_toml(HPAC))
    assert generate.main(["--check", "--hand", str(tmp_path / "hand.toml")]) == 0
    (tmp_path / "hand.toml").write_text(
        hand_to_toml(dataclasses.replace(HPAC, rate_limit=HPAC.rate_limit / 2))
    )
    assert generate.main(["--check", "--hand", str(tmp_path / "hand.toml")]) == 1
    assert "firmware/core/hpac_protocol.h: out of date" in capsys.readouterr().out


def test_servo_limits_are_the_models_to_half_a_step_of_the_wire():
    limits = servo_limits()
    assert [servo.name for servo in limits] == list(SERVOS)
    half_step = 0.5 * protocol.ANGLE_UNIT + 1e-12
    np.testing.assert_allclose([s.min_urad * 1e-6 for s in limits], HPAC.servo_min, atol=half_step)
    np.testing.assert_allclose([s.max_urad * 1e-6 for s in limits], HPAC.servo_max, atol=half_step)
    np.testing.assert_allclose([s.rate_urad_s * 1e-6 for s in limits], HPAC.servo_rate_limit)


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"rate_limit": 1e-7}, "1e-07 rad/s; a board knows none below 1e-06 rad/s"),
        (
            {"workspace": HPAC.workspace | {"thumb_cmc": (-1.0, 2.3)}},
            "servo thumb_cmc: a range of 3.3 rad; the pulses of a servo reach 3.142 rad",
        ),
    ],
)
def test_a_hand_that_no_board_can_drive_has_no_servo_table(changed, named):
    with pytest.raises(ParameterError, match=named):
        servo_limits(dataclasses.replace(HPAC, **changed))


def test_firmware_was_compiled_with_this_servo_table():
    table = (Config * 2)()  # one more, to see where the first ends
    load_library().hpac_config_default(table)
    assert bytes(table) == bytes(config_of(HPAC)) + bytes(Config())


def test_limits_hash_changes_with_any_limit(monkeypatch):
    before = limits_hash()
    hashes = set()
    for i in range(len(SERVOS)):
        table = list(servo_limits())
        table[i] = dataclasses.replace(table[i], max_urad=table[i].max_urad - 100)
        monkeypatch.setattr("hpac_gym.bridge.limits.servo_limits", lambda _hand, table=table: table)
        hashes.add(limits_hash())
    assert len(hashes) == len(SERVOS)
    assert before not in hashes


def test_codes_tell_host_from_hand():
    assert all((message.code < 0x80) == message.from_host for message in protocol.MESSAGES.values())
    assert len(protocol.MESSAGE_BY_CODE) == len(protocol.MESSAGES)
