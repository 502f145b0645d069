"""hpac safety, wiggle and doctor."""

import argparse
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hpac_gym.bridge import HandLink, PortError, Reset, VirtualHand, safety
from hpac_gym.bridge.commands import add_commands
from hpac_gym.bridge.doctor import diagnose
from hpac_gym.bridge.firmware_files import BUILD_VARIABLE
from hpac_gym.bridge.frame import Frame, encode
from hpac_gym.bridge.virtual_hand import default_config
from hpac_gym.errors import WorkspaceError
from hpac_gym.model import SERVOS

FIRMWARE = Path(__file__).parents[2] / "firmware"


def run(*words):
    parser = argparse.ArgumentParser()
    add_commands(parser.add_subparsers(required=True))
    options = parser.parse_args(words)
    return options.func(options)


def test_every_safety_claim_holds_and_is_written_as_json(capsys):
    assert run("safety", "--json", "--frames", "50000", "--trials", "5") == 0
    claims = json.loads(capsys.readouterr().out)
    assert len(claims) >= 12
    assert all(set(claim) == {"claim", "figure", "limit", "unit", "holds"} for claim in claims)
    assert all(claim["holds"] and claim["figure"] <= claim["limit"] for claim in claims)


def test_a_broken_claim_is_told_and_ends_in_status_1(capsys, monkeypatch):
    monkeypatch.setattr(safety, "measure", lambda frames, trials: iter([safety.Claim("it is safe", 21.0, 20.0, "ms")]))
    assert run("safety") == 1
    assert "BROKEN" in capsys.readouterr().out


@pytest.mark.slow
def test_a_firmware_that_ignores_an_estop_breaks_the_safety_case(tmp_path):
    copy = tmp_path / "firmware"
    shutil.copytree(FIRMWARE, copy, ignore=shutil.ignore_patterns("build"))
    state = copy / "core" / "hpac_state.c"
    text = state.read_text()
    assert "} else if (action == HPAC_ACTION_DETACH) {" in text
    state.write_text(text.replace("} else if (action == HPAC_ACTION_DETACH) {", "} else if (false) {"))
    subprocess.run(["make", "-s", "-C", copy], check=True)
    program = "from hpac_gym.bridge import safety\nfor c in safety.measure(20000, 5): print(c.holds, c.claim)"
    environment = os.environ | {BUILD_VARIABLE: str(copy / "build")}
    answer = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True)
    broken = [line for line in answer.stdout.splitlines() if line.startswith("False")]
    assert sum("e-stop" in line for line in broken) == 3


def test_wiggle_moves_each_servo_alone_next_to_its_name(capsys, monkeypatch):
    trace = []
    hand = VirtualHand(on_pulses=lambda now_us, pulses: trace.append(pulses))
    monkeypatch.setattr("hpac_gym.bridge.commands.VirtualHand", lambda: hand)
    assert run("wiggle", "--port", "virtual") == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(": ")[1].split()[0] for line in lines] == list(SERVOS)
    pulses = np.array(trace)
    armed = pulses[pulses.all(axis=1)]
    moved = armed != armed[0]
    assert moved.sum(axis=1).max() == 1
    first_moves = [int(np.argmax(moved[:, i])) for i in range(6)]
    assert first_moves == sorted(first_moves)


def test_wiggle_refuses_an_angle_past_the_limits():
    with pytest.raises(WorkspaceError, match="rad"):
        run("wiggle", "--port", "virtual", "--angle", "3")


def test_wiggle_at_a_wrong_port_is_a_port_error():
    with pytest.raises(PortError, match="no such port"):
        run("wiggle", "--port", "/dev/does_not_exist")


def test_doctor_finds_a_healthy_hand(capsys):
    assert run("doctor", "--port", "virtual") == 0
    assert capsys.readouterr().out.startswith("ok ")


def test_doctor_without_any_port_says_what_to_do(capsys, monkeypatch):
    monkeypatch.setattr("hpac_gym.bridge.commands.find_ports", list)
    assert run("doctor", "--json") == 1
    (finding,) = json.loads(capsys.readouterr().out)
    assert not finding["healthy"]
    assert "plug" in finding["advice"]


def test_doctor_names_each_illness():
    shifted = default_config()
    shifted[0].trim_ns = 900_000
    ill = {
        "supply": VirtualHand(reset=Reset.brownout),
        "crashed": VirtualHand(reset=Reset.crash),
        "pins.h": VirtualHand(config=shifted),
    }
    for advice, hand in ill.items():
        finding = diagnose("here", hand.connect)
        assert not finding.healthy
        assert advice in finding.advice
    noisy = VirtualHand()
    for _ in range(30):
        noisy.receive(encode(Frame("heartbeat", 1))[:-2] + b"\x77\0")
    assert "line noise" in diagnose("here", noisy.connect).advice
    unplugged = VirtualHand()
    unplugged.plugged = False
    assert not diagnose("here", unplugged.connect).healthy


def test_doctor_sees_a_port_in_use_and_does_not_disturb_it(host_board):
    with HandLink(host_board.connect) as link:
        link.arm()
        finding = diagnose(host_board.port, host_board.port)
        assert "used by another program" in finding.what
        assert link.heartbeat() == "armed"
