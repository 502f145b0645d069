"""``hpac posture``: lists, shows, draws, sends; and in opposition the pads meet in the
simulation.
"""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from experiments.quasistatic import Built, Metal, hand_course
from hpac_gym import posture as posture_command
from hpac_gym.body.geometry import link_poses, load_geometry
from hpac_gym.bridge import HandLink, commands
from hpac_gym.model import HPAC, JOINT_INDEX, POSTURES, joints_from_synergy, posture, reach
from hpac_gym.model.calibration import Calibration, Friction
from tests.options import called

GEOMETRY = load_geometry()


def run(*words: str) -> int:
    return called(posture_command, *words)


def pad(digit: str, joint_pos: np.ndarray) -> np.ndarray:
    """Where a digit's pad is in the hand's frame, from its joint angles, shape (3,) [m]."""
    body = GEOMETRY.digit(digit)
    angles = np.array([joint_pos[JOINT_INDEX[phalanx.joint]] for phalanx in body.phalanges])
    position, rotation = link_poses(body, angles)[-1]
    return position + rotation @ body.pad


@pytest.mark.parametrize("finger", ["index", "middle", "ring"])
def test_in_opposition_the_pads_are_within_2_mm_of_touching(finger):
    """The servos take the open hand there; weight, stretch and contact included."""
    sim = posture_command.take(posture(f"oppose_{finger}"))
    joint_pos = sim.joint_pos
    sim.close()
    assert np.linalg.norm(pad("thumb", joint_pos) - pad(finger, joint_pos)) < 2e-3


def test_the_hand_that_is_drawn_has_the_servo_zeros_of_its_model():
    taken = []
    for zero in (0.0, -0.12):
        sim = posture_command.take(
            posture("digit_2"), replace(HPAC, calibration=Calibration((*(zero,) * 5, 0.0)))
        )
        taken.append(sim.joint_pos)
        sim.close()
    np.testing.assert_allclose(*taken, atol=0.04)  # servos stop within their dead band


@pytest.mark.parametrize("finger", ["index", "middle", "ring"])
def test_opposition_targets_are_those_of_the_body(finger):
    """The posture file repeats the synergies of geometry.toml as joint angles; this compares the
    two.
    """
    expected = joints_from_synergy(GEOMETRY.opposition[finger])
    assert posture(f"oppose_{finger}").target_joint_pos == pytest.approx(expected, abs=6e-4)


def test_list_names_every_posture_and_alias(capsys):
    assert run("list") == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(POSTURES)
    assert any("open_palm/digit_5" in line for line in lines)


def test_one_posture_shows_target_reach_distance_and_servos(capsys):
    assert run("fist") == 0
    text = capsys.readouterr().out
    assert "index_dip           1.050" in text
    assert "distance from the nearest reachable posture: 0." in text
    assert text.count("thumb_cmc") == 2
    assert "-0.000" not in text


def test_json_of_one_and_of_all(capsys):
    assert run("digit_5", "--json") == 0
    (found,) = json.loads(capsys.readouterr().out).values()
    assert found["aliases"] == ["digit_5"]
    assert found["distance_rad"] == pytest.approx(0, abs=1e-12)
    assert run("list", "--json") == 0
    assert list(json.loads(capsys.readouterr().out)) == list(POSTURES)


def test_a_calibrated_hand_is_commanded_with_what_was_learned():
    """A hand in metal, its zeros and friction known, takes the posture that is promised; with the
    paper's map it does not.
    """
    friction = Friction(1e-3, 0.03)
    metal = Metal(servo_zero=0.03, joint_friction=friction.joint, tendon_friction=friction.tendon)
    built = Built(HPAC, (metal,) * 5)
    calibrated = replace(HPAC, calibration=Calibration((*(0.03,) * 5, 0.0), (friction,) * 5))
    off = []
    for hand in (calibrated, HPAC):
        taken = reach(posture("fist").target_joint_pos, hand)
        reached = hand_course([built], np.linspace(0.0, 1.0, 12)[:, None] * taken.servo)[0, -1]
        off.append(
            np.degrees(np.abs(reached - taken.joint_pos)[posture("fist").target_joint_pos > 0.1])
        )
    assert off[0].max() < 0.05
    assert off[1][:-1].min() > 0.5  # all but the CMC, whose servo is exact


def test_a_posture_is_sent_to_the_port_that_is_named(monkeypatch):
    sent = []
    monkeypatch.setattr(commands, "send_and_hold", lambda *words: sent.append(words))
    assert run("fist", "--port", "/dev/hand") == 0
    ((port, (*_, command), hand),) = sent
    assert (port, hand) == ("/dev/hand", HPAC)
    assert command.servo == pytest.approx(reach(posture("fist").target_joint_pos).servo)
    assert command.duration == pytest.approx(max(command.servo - HPAC.servo_min) / HPAC.rate_limit)


@pytest.mark.parametrize(("name", "moves"), [("fist", [1, 4, 1]), ("oppose_index", [3])])
def test_in_a_sent_gesture_the_thumb_turns_first_and_closes_last(name, moves, monkeypatch):
    """A builder of a hand needs no plots."""
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    poses = [np.zeros(6)]
    monkeypatch.setattr(HandLink, "move", lambda self, command: poses.append(command.servo))
    assert run(name, "--port", "virtual") == 0
    assert np.count_nonzero(np.diff(poses, axis=0), axis=1).tolist() == moves


def test_a_posture_is_drawn(tmp_path, capsys):
    assert run("call", "--out", str(tmp_path / "call.png")) == 0
    assert (tmp_path / "call.png").read_bytes().startswith(b"\x89PNG")
    open_hand, closed = (
        posture_command.picture(posture(name)).astype(int) for name in ("open_palm", "fist")
    )
    assert np.abs(open_hand - closed).max() > 50
    assert "drawn to" in capsys.readouterr().out


@pytest.mark.slow
def test_the_contact_sheet_shows_all(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run("all") == 0
    assert (tmp_path / "runs" / "postures.png").stat().st_size > 50_000
