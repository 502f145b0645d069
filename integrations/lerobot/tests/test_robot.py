"""The hand as a LeRobot robot, through the firmware in a process of its own: its pulses are the judge."""

import importlib.metadata
import json
import socket
import time

import numpy as np
import pytest
from lerobot.robots import RobotConfig, make_robot_from_config
from lerobot.utils.errors import DeviceNotConnectedError
from lerobot.utils.import_utils import register_third_party_plugins
from lerobot_robot_hpac import Hpac, HpacConfig
from lerobot_robot_hpac.features import (
    ACTIONS,
    POSE,
    PREDICTED,
    ActionError,
    Commands,
    named,
    shared_source,
)

from hpac_gym.bridge import BridgeError, HandLink, HostBoard, open_transport, servo_from_pulses
from hpac_gym.bridge.stop import stop
from hpac_gym.errors import HpacError
from hpac_gym.model import HPAC, elastic_joints_from_servo, servo_from_action


@pytest.fixture
def board():
    with HostBoard() as running:
        yield running


@pytest.fixture
def robot(board):
    made = Hpac(HpacConfig(port=board.port, patience=1.0))
    made.connect()
    yield made
    made.disconnect()


def action(*values):
    return named(ACTIONS, np.broadcast_to(values, 6))


def off_within(board, seconds):
    """Whether the pulses end within some time [s]."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        if not board.pulses().any():
            return True
        time.sleep(0.05)
    return False


def test_lerobot_finds_the_hand_by_the_raw_name_of_its_distribution(board):
    names = [found.metadata["Name"] for found in importlib.metadata.distributions()]
    assert "lerobot_robot_hpac" in names  # with hyphens LeRobot would pass it over
    register_third_party_plugins()
    config = RobotConfig.get_choice_class("hpac")(port=board.port)
    assert isinstance(make_robot_from_config(config), Hpac)


def test_the_features_are_known_without_a_connection_and_are_what_is_observed(robot):
    unconnected = Hpac(HpacConfig(port="/dev/none"))
    assert list(unconnected.action_features) == list(ACTIONS)
    assert list(unconnected.observation_features) == [*ACTIONS, *PREDICTED]
    assert list(robot.get_observation()) == [*ACTIONS, *PREDICTED]
    with pytest.raises(DeviceNotConnectedError):
        unconnected.get_observation()


def test_an_action_is_clipped_sent_observed_and_in_the_end_the_hand_is_open_and_off(board, robot):
    assert robot.get_observation()["index_mcp.pos"] == pytest.approx(-1)
    first = robot.send_action(action(0.0))
    assert list(first.values()) == pytest.approx([0.0] * 6, abs=1e-3)  # at its goal: a slow move
    assert 0 < robot.send_action(action(1.0))["index_mcp.pos"] < 0.3  # 0.09 rad in a period
    for _ in range(20):
        sent = robot.send_action(action(3.0))
    assert list(sent.values()) == pytest.approx([1.0] * 6, abs=1e-3)
    time.sleep(0.1)
    servo = servo_from_pulses(board.pulses())
    assert servo == pytest.approx(servo_from_action(np.ones(6)), abs=1e-3)
    seen = robot.get_observation()
    assert seen["predicted_index_pip.pos"] == pytest.approx(
        elastic_joints_from_servo(np.clip(servo, HPAC.servo_min, HPAC.servo_max))[3], abs=1e-2
    )
    robot.disconnect()
    widths = board.pulse_changes()[:, 1:]
    assert not widths[-1].any()
    assert servo_from_pulses(widths[widths.all(axis=1)][-1]) == pytest.approx(np.zeros(6), abs=1e-2)


def test_names_without_a_suffix_are_understood_and_a_bad_action_is_refused(robot):
    bare = {name.removesuffix(".pos"): -0.9 for name in ACTIONS}
    assert robot.send_action(bare)["ring_mcp.pos"] == pytest.approx(-0.9, abs=1e-3)
    for bad in ({}, action(np.nan), dict.fromkeys(ACTIONS[:5], 0.0)):
        with pytest.raises(ActionError, match="six finite numbers"):
            robot.send_action(bad)


def test_an_action_and_its_servo_angles_lead_to_each_other():
    commands = Commands()
    for values in np.random.default_rng(0).uniform(-1, 1, (50, 6)):
        assert commands.action(commands.servo(values)) == pytest.approx(values, abs=1e-9)


def test_without_a_bound_of_patience_the_hand_keeps_its_pulses(board):
    """The control of the test below."""
    robot = Hpac(HpacConfig(port=board.port, patience=1e9))
    robot.connect()
    robot.send_action(action(-0.8))
    assert not off_within(board, 4.0)
    robot.disconnect()
    assert not board.pulses().any()


def test_after_a_pause_that_was_too_long_the_hand_is_armed_again_and_led_slowly(board, robot):
    robot.send_action(action(0.0))
    time.sleep(0.5)
    assert board.pulses().all()  # kept alive
    assert off_within(board, 5.5)
    assert robot.get_observation()["index_mcp.pos"] == pytest.approx(-1)
    board.pulse_changes()
    sent = robot.send_action(action(0.5))
    assert list(sent.values()) == pytest.approx([0.5] * 6, abs=1e-3)
    rows = board.pulse_changes()
    rows = rows[rows[:, 1:].all(axis=1)]
    servo = np.array([servo_from_pulses(row) for row in rows[:, 1:]])
    # Over tenths of a second: single ticks round.
    rate = np.abs(servo[100:] - servo[:-100]).max(axis=1) / (
        1e-6 * (rows[100:, 0] - rows[:-100, 0])
    )
    assert 0.1 < rate.max() < 0.6  # of 2 rad/s: a quarter, as in `hpac deploy`


def test_the_way_to_the_start_is_behind_the_robot_when_it_is_connected(board):
    start = [-1.0, -1.0, -1.0, -1.0, -1.0, -0.6]
    robot = Hpac(HpacConfig(port=board.port, start=start))
    robot.connect()
    assert list(robot.get_observation().values())[:6] == pytest.approx(start, abs=1e-3)
    robot.disconnect()


@pytest.mark.parametrize(
    ("setting", "told"),
    [
        ({"start": [0.5] * 5}, r"start = .* must be 6 values within \[-1, 1\]"),
        ({"start": []}, r"start = \[\] must be 6 values"),
        ({"start": [0.5, np.nan, 0.5, 0.5, 0.5, 0.5]}, r"start = \[0.5, nan, .* must be 6 values"),
        ({"start": [45.0] * 6}, r"start = \[45.0, .* must be 6 values within \[-1, 1\]"),
        ({"patience": np.nan}, r"patience = nan s must be a number within \]0, inf\[ s"),
        ({"patience": 0.0}, "patience = 0.0 s"),
    ],
)
def test_settings_that_no_hand_can_have_are_refused_before_anything_is_opened(setting, told):
    with pytest.raises(HpacError, match=f"robot {told}"):
        Hpac(HpacConfig(port="/dev/none", **setting))


def test_the_object_is_observed_and_its_source_closed(board):
    with shared_source("udp:0", None) as source:
        robot = Hpac(HpacConfig(port=board.port, pose="udp:0"))
        assert list(robot.observation_features) == [*ACTIONS, *PREDICTED, *POSE]
        sent = {"hpac_pose": 1, "position": [0.05, 0.0, 0.1]}
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as camera:
            camera.sendto(json.dumps(sent).encode(), ("127.0.0.1", source.port))
        robot.connect()
        assert [robot.get_observation()[name] for name in POSE[:3]] == sent["position"]
        robot.disconnect()
        assert source._thread.is_alive()  # it has another user
    assert not source._thread.is_alive()
    with shared_source("udp:0", None) as other:
        assert other.latest() is None


def test_a_stop_from_elsewhere_is_raised_and_the_hand_stays_off(board, robot):
    robot.send_action(action(-0.8))
    transport = open_transport(board.port, lock=False)
    stop(transport)
    transport.close()
    time.sleep(0.3)
    with pytest.raises(BridgeError, match="estop"):
        robot.send_action(action(-0.8))
    assert not board.pulses().any()
    robot.disconnect()
    assert not board.pulses().any()


def test_a_port_that_is_in_use_is_one_error(board):
    with HandLink(board.connect), pytest.raises(BridgeError):
        Hpac(HpacConfig(port=board.port)).connect()
