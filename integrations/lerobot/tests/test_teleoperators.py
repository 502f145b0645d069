"""The teleoperators: each gives six numbers within −1…1, which LeRobot stores as they are."""

import json
import logging
import socket
import time
from contextlib import nullcontext

import numpy as np
import pytest
from lerobot.teleoperators import TeleoperatorConfig, make_teleoperator_from_config
from lerobot_robot_hpac import Hpac, HpacConfig, teleoperators
from lerobot_robot_hpac.features import ACTIONS
from lerobot_robot_hpac.landmarks import synergy_from_landmarks

from hpac_gym.body.geometry import HPAC_GEOMETRY, link_poses, rotation_about
from hpac_gym.bridge import HostBoard
from hpac_gym.deploy import poses
from hpac_gym.deploy.commands import object_of
from hpac_gym.deploy.errors import DeployError, PoseError
from hpac_gym.deploy.observer import Observer
from hpac_gym.deploy.poses import Fixed, pose_of
from hpac_gym.envs.commands import FILES
from hpac_gym.errors import HpacError, ShapeError
from hpac_gym.model import (
    DIGITS,
    HPAC,
    JOINT_INDEX,
    action_from_synergy,
    elastic_joints_from_servo,
    load_hand,
    servo_from_synergy,
    streamed_servo,
    synergy_from_action,
)
from hpac_gym.policies.loading import load_policy

CAN = "cylinder:0.02,0.05"
PLACE = "0.0485,0,0.12"
CALIBRATED = str(FILES / "test_00.toml")


def made(kind, **settings):
    """A teleoperator, made as LeRobot makes it."""
    config = TeleoperatorConfig.get_choice_class(kind)(**settings)
    return make_teleoperator_from_config(config)


def values(teleoperator):
    given = teleoperator.get_action()
    assert list(given) == list(teleoperator.action_features) == list(ACTIONS)
    return np.array(list(given.values()))


def landmarks(synergy):
    """The landmarks of the H-PAC hand itself, as the elastic model predicts it."""
    joints = elastic_joints_from_servo(servo_from_synergy(synergy))
    points = [np.zeros(3)]
    for digit in map(HPAC_GEOMETRY.digit, DIGITS):
        angles = [joints[JOINT_INDEX[phalanx.joint]] for phalanx in digit.phalanges]
        poses = link_poses(digit, angles)
        tip, turn = poses[-1]
        points += [place for place, _ in poses] + [tip + turn[:, 2] * digit.phalanges[-1].length]
    return np.array(points)


# --- landmarks


@pytest.mark.parametrize("seed", range(20))
def test_the_own_landmarks_of_the_hand_give_its_synergies_back(seed):
    rng = np.random.default_rng(seed)
    synergy = synergy_from_action(rng.uniform(-1, 1, 6))
    turn = rotation_about((0.6, 0.0, 0.8), rng.uniform(0, 6))
    points = 7 * landmarks(synergy) @ turn.T + rng.normal(size=3)
    found = synergy_from_landmarks(points)
    assert found == pytest.approx(synergy, abs=0.06)
    mirrored = synergy_from_landmarks(points * [-1, 1, 1])  # a left hand: the control
    assert np.abs(mirrored - synergy).max() > 0.2


def test_what_is_no_hand_is_refused():
    good = landmarks(HPAC.synergy_min)
    for bad in (good[:20], good * np.nan, good * 0, np.tile(np.arange(21.0)[:, None], 3)):
        with pytest.raises(ShapeError, match="landmarks"):
            synergy_from_landmarks(bad)


def test_landmarks_come_by_udp_and_a_silent_tracker_opens_the_hand():
    hand = made("hpac_landmarks", port=0, oldest=0.3)
    hand.connect()
    assert values(hand) == pytest.approx(-np.ones(6))
    with pytest.raises(DeployError, match=f"UDP port {hand.port}"):
        made("hpac_landmarks", port=hand.port).connect()
    synergy = synergy_from_action(np.array([0.5, 0.2, -0.3, 0.9, 0.0, 0.4]))
    packet = {"hpac_landmarks": 1, "points": landmarks(synergy).tolist()}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as tracker:
        tracker.connect(("127.0.0.1", hand.port))
        tracker.send(json.dumps(packet).encode())
        time.sleep(0.05)
        seen = values(hand)
        for bad in (
            b"\xff",
            b"[]",
            b'{"hpac_landmarks": 2}',
            b'{"hpac_landmarks": 1, "points": 3}',
            b"[" * 8000,
            b'{"hpac_landmarks": 1, "points": [[1%s, 0, 0]]}' % (b"0" * 400),
        ):
            tracker.send(bad)
        time.sleep(0.05)
        assert np.array_equal(values(hand), seen)
    assert seen == pytest.approx(action_from_synergy(synergy), abs=0.1)
    assert hand.refused == 6
    time.sleep(0.4)
    assert values(hand) == pytest.approx(-np.ones(6))
    hand.disconnect()


@pytest.mark.parametrize(
    ("kind", "setting"),
    [
        ("hpac_landmarks", {"oldest": np.nan}),
        ("hpac_landmarks", {"oldest": 0.0}),
        ("hpac_keyboard", {"step": np.nan}),
        ("hpac_policy", {"policy": "grasp", "object": CAN, "pose": PLACE, "hold": np.nan}),
    ],
)
def test_numbers_that_mean_nothing_are_refused(kind, setting):
    name = list(setting)[-1]
    with pytest.raises(ValueError, match=rf"teleop {name} = .* must be a number within"):
        made(kind, **setting)


# --- keys


def test_keys_close_and_open(monkeypatch):
    heard = []
    listener = type("Listener", (), {"stop": lambda self: None})()
    monkeypatch.setattr(
        teleoperators, "create_key_listener", lambda press, **_: heard.append(press) or listener
    )
    keys = made("hpac_keyboard", step=0.25)
    keys.connect()
    (press,) = heard
    for pressed, wanted in (
        ("sshwwwwX", [0.0, 0.5, 0.0, 0.0, 0.0, -0.75]),
        ((*"SSWWWWWWWWWWWWWWWWW", "up", "n"), [-1, -1, -1, -1, -1, -0.75]),
        ("h" * 20, [-1, -1, -1, -1, -1, 1]),  # clipped
        (("space",), [-1] * 6),
    ):
        for key in pressed:
            press(key)
        assert values(keys) == pytest.approx(wanted)
    keys.disconnect()


def test_where_there_are_no_keys_it_is_said(monkeypatch):
    monkeypatch.setattr(teleoperators, "create_key_listener", lambda *_, **__: None)
    with pytest.raises(HpacError, match="no keys"):
        made("hpac_keyboard").connect()


# --- sliders


def test_the_sliders_of_the_page_are_the_actions():
    sliders = made("hpac_sliders", browser=False)
    sliders.connect()
    assert values(sliders) == pytest.approx(-np.ones(6))
    sliders._page.sliders[1].value = sliders._page.sliders[1].max
    sliders._page.sliders[5].value = sliders._page.sliders[5].max / 2
    found = values(sliders)
    assert found[1] == pytest.approx(1.0, abs=0.02)
    assert found[5] == pytest.approx(0.0, abs=0.02)
    assert found[[0, 2, 3, 4]] == pytest.approx([-1] * 4)
    sliders.disconnect()


# --- a policy


@pytest.mark.parametrize(("name", "file"), [("scripted", None), ("grasp", CALIBRATED)])
def test_a_policy_gives_what_it_gives_in_a_deployment_and_one_episode_for_each_of_lerobots(
    name, file
):
    hand = load_hand(file)
    seen = Observer("HPAC-Grasp-v0", object_of(CAN), hand)
    policy = load_policy(name, seen)
    pose, _ = Fixed(pose_of([0.0485, 0, 0.12], "here")).latest()
    expected = []
    memory = None
    for step in range(seen.steps):
        given, memory = policy.predict(seen.see(pose), memory, np.array([step == 0]))
        expected.append(np.clip(given, -1, 1))
        seen.sent(streamed_servo(seen.servo, seen.command(expected[-1]), 0.05))
    hand = made("hpac_policy", policy=name, object=CAN, pose=PLACE, hold=0.1, hand=file)
    hand.connect()
    found = [values(hand) for _ in range(seen.steps)]
    assert np.array(found) == pytest.approx(np.array(expected), abs=1e-6)
    held = np.array([values(hand) for _ in range(2)])
    assert held == pytest.approx(np.array([found[-1]] * 2))
    waits = values(hand)
    assert waits == pytest.approx(action_from_synergy(seen.setup.synergy))
    assert values(hand) == pytest.approx(waits)
    logging.getLogger("lerobot").warning("Recording episode 1")
    assert values(hand) == pytest.approx(found[0])  # begins anew
    hand.disconnect()
    logging.getLogger("lerobot").warning("Recording episode 2")  # nobody listens any more


def test_an_action_that_is_no_number_ends_it(monkeypatch):
    hand = made("hpac_policy", policy="scripted", object=CAN, pose=PLACE)
    hand.connect()
    monkeypatch.setattr(hand._policy, "predict", lambda *_: (np.full(6, np.nan), None))
    with pytest.raises(ShapeError, match=r"the policy's action\[0\] = nan must be a finite"):
        hand.get_action()
    hand.disconnect()


@pytest.mark.parametrize("policy", ["grasp-type", "grasp-any-wrist"])
def test_a_policy_that_places_the_wrist_is_refused(policy):
    with pytest.raises(DeployError, match="places the wrist"):
        made("hpac_policy", policy=policy, object=CAN, pose=PLACE).connect()


@pytest.mark.parametrize("first", ["robot", "teleoperator"])
@pytest.mark.parametrize(("seen", "height"), [(CAN, [0.05]), (None, []), ("sphere:0.03", [0.03])])
def test_robot_and_teleoperator_share_a_camera_and_the_object_before_it(
    monkeypatch, first, seen, height
):
    tops = []

    def tags(device, lens, top):
        tops.append(top)
        return Fixed(pose_of([0.0485, 0, 0.12], "here"))

    monkeypatch.setattr(poses, "Device", lambda *_: None)
    monkeypatch.setattr(poses, "Tags", tags)
    with HostBoard() as board:
        robot = Hpac(HpacConfig(port=board.port, pose="camera:0", object=seen))
        both = [robot, made("hpac_policy", policy="scripted", object=CAN, pose="camera:0")]
        refused = nullcontext() if seen == CAN else pytest.raises(PoseError, match="one object for")
        with refused:
            for one in both if first == "robot" else both[::-1]:
                one.connect()
        for one in both:
            one.disconnect()
    assert tops == (height if first == "robot" else [0.05])
