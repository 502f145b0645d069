"""The replay over the wire: policy → frame → firmware → pulses → simulated servos."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from agents.replay import PULSE_TOLERANCE, Report, film, main
from hpac_gym.bridge import HostBoard
from hpac_gym.command import run
from hpac_gym.envs import HandEnv
from hpac_gym.physics.engine import PhysicsError


def replayed(out, *arguments: str) -> dict:
    """Replay one scripted episode, or as many as are asked for, and read the report."""
    assert main(["--policy", "scripted", "--out", str(out), "--episodes", "1", *arguments]) == 0
    return json.loads((out / "replay.json").read_text())


def film_the_beginning(policy, env_id, options, commands, *rest) -> None:
    """Instead of the whole film, which takes seconds; the test of the demo makes one."""
    film(
        policy, env_id, options, {seed: received[:3] for seed, received in commands.items()}, *rest
    )


SHORT = ("--engine", "mujoco", "--seed-start", "1000007")
"""An episode that ends in the lift, after 31 moves."""
GOALS = ("--virtual", "--policy", "posture", "--engine", "mujoco")
FREE_WRIST = ("--virtual", "--policy", "grasp-type", "--engine", "mujoco")


@pytest.mark.parametrize(
    "arguments",
    [SHORT, FREE_WRIST, GOALS],
    ids=["host process on a pty", "from a preshape", "goals"],
)
def test_every_frame_is_acknowledged_and_every_pulse_is_the_command(
    tmp_path, monkeypatch, arguments
):
    monkeypatch.setattr("agents.replay.film", film_the_beginning)
    report = replayed(tmp_path, *arguments)
    lines = [json.loads(line) for line in (tmp_path / "wire.jsonl").read_text().splitlines()]
    moves = dict.fromkeys(
        line["seq"] for line in lines if line["direction"] == "sent" and line["message"] == "move"
    )
    assert moves == dict.fromkeys(
        line["seq"] for line in lines if line.get("acked") == "move" and line["reason"] == "ok"
    )
    assert len(moves) == report["moves"]
    assert (
        report["frames_sent"] - report["frames_retried"]
        == report["frames_acked"]
        > report["moves"]
        >= 10
    )
    assert report["frames_rejected"] == 0
    assert 0 < report["worst_pulse_error_rad"] <= PULSE_TOLERANCE
    assert (tmp_path / "grasps.mp4").stat().st_size > 1_000
    assert (tmp_path / "grasps.png").stat().st_size > 10_000


def test_a_hand_at_a_port_of_its_own_is_driven_too(tmp_path, monkeypatch):
    monkeypatch.setattr("agents.replay.film", film_the_beginning)
    with HostBoard() as board:
        report = replayed(tmp_path, "--port", board.port, *SHORT)
        assert len(board.pulse_changes()) > 100, "the servos behind the port did not move"
    assert report["frames_acked"] == report["frames_sent"] - report["frames_retried"]


def test_where_an_engine_cannot_draw_the_wire_is_checked_all_the_same(
    tmp_path, monkeypatch, capsys
):
    def no_opengl(env):
        raise PhysicsError("no OpenGL for pictures")

    monkeypatch.setattr(HandEnv, "render", no_opengl)
    assert replayed(tmp_path, "--virtual", "--engine", "mujoco")["moves"] >= 10
    told, said = capsys.readouterr()
    assert "episodes succeeded over the wire" in told
    assert said.splitlines()[-1] == "no film: no OpenGL for pictures"


def test_a_wrong_port_is_one_line_and_status_2(tmp_path, capfd):
    assert (
        run(
            lambda: main(
                ["--policy", "scripted", "--out", str(tmp_path), "--port", "/dev/no-such-port"]
            )
        )
        == 2
    )
    said = capfd.readouterr().err.splitlines()
    assert len(said) == 1
    assert "/dev/no-such-port" in said[0]


@pytest.mark.filterwarnings("ignore:the wire log cannot be written")
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_full_disk_is_one_line_that_names_the_file(tmp_path, capfd):
    (tmp_path / "wire.jsonl").symlink_to("/dev/full")
    assert (
        run(
            lambda: main(
                ["--policy", "scripted", "--out", str(tmp_path), "--virtual", "--episodes", "1"]
            )
        )
        == 2
    )
    assert (
        capfd.readouterr().err.splitlines()[-1]
        == f"error: cannot write '{tmp_path}/wire.jsonl': No space left on device"
    )


def test_a_wire_that_breaks_its_promise_is_reported():
    report = Report(
        "scripted", "HPAC-Grasp-v0", 0, worst_pulse_error_rad=1e-3, frames_sent=10, frames_acked=9
    )
    assert len(report.faults) == 2
    assert not Report("scripted", "HPAC-Grasp-v0", 0).faults
    assert not replace(report, worst_pulse_error_rad=0.0, frames_retried=1).faults
