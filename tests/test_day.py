"""The day of docs/a_day.md: its own commands, in its order, each in a process of its own."""

import json
import os
import re
import shlex
import signal
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hpac_gym.model import HPAC, load_hand
from tests.processes import wait_for

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "a_day.md"
LINES = re.findall(r"^hpac .*", PAGE.read_text(encoding="utf-8"), re.M)
STRAINS = 3
"""Times that a command is typed whose hand opened since the machine was too busy to feed it."""

pytest.importorskip("mujoco")


class Day:
    """Types the page's lines one after the other, in a folder."""

    def __init__(self, folder):
        self.folder = folder
        self.left = list(LINES)
        self.port = ""
        self.running = []
        self.ports = {fixed: _free_port() for fixed in ("47001", "47002")}

    def begin(self, command, takes=True):
        """Begin the next line, which is that of a command, as one does in another terminal."""
        line = self.left.pop(0) if takes else self.left[0]
        assert line.split()[1] == command, line
        for name, value in ({"PORT": self.port} | self.ports).items():
            line = re.sub(rf"(?<![\w.-]){name}\b|(?<=:){name}\b", value, line)
        output = self.folder / f"{len(self.running)}.txt"
        with output.open("w") as file:
            process = subprocess.Popen(
                [sys.executable, str(ROOT / "hpac.py"), *shlex.split(line)[1:]],
                cwd=self.folder,
                env=os.environ | {"PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"},
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
            )
        process.told = output.read_text
        self.running.append(process)
        return process

    def do(self, command, status=0):
        """Do the next line to its end; returns what it prints."""
        for _ in range(STRAINS):
            process = self.begin(command, takes=False)
            process.wait(120)
            if "watchdog" not in process.told() or "watchdog" in command:
                break
            # As one does before one tries again.
            words = [sys.executable, str(ROOT / "hpac.py"), "clear", "--port", self.port]
            subprocess.run(words, check=False, capture_output=True, timeout=60)
        self.left.pop(0)
        assert process.returncode == status, process.told()
        return process.told()

    def hand(self):
        """Begin the next virtual hand, and wait until it has a port."""
        process = self.begin("virtual")
        wait_for(lambda: "virtual hand at" in process.told() or process.poll() is not None)
        self.port = re.search(r"virtual hand at (\S+);", process.told())[1]
        return process

    def steps(self, log):
        """The steps of a log so far."""
        path = self.folder / log
        lines = path.read_text().splitlines()[1:] if path.exists() else []
        rows = [json.loads(line) for line in lines if line.endswith("}")]
        return [row for row in rows if "step" in row]

    def ends(self, log):
        """How a log ends."""
        return json.loads((self.folder / log).read_text().splitlines()[-1])["end"]


def _free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return str(probe.getsockname()[1])


def leave(process):
    """Ctrl-C."""
    process.send_signal(signal.SIGINT)
    process.wait(30)
    return process.told()


@pytest.fixture
def day(tmp_path):
    day = Day(tmp_path)
    yield day
    for process in reversed(day.running):
        process.kill()
        process.wait()


@pytest.mark.slow
def test_a_day(day):
    # morning
    hand = day.hand()
    assert "ok " in day.do("doctor")
    assert "index_mcp flexes" in day.do("wiggle")
    assert "Index MCP" in day.do("sweep")
    assert "servo_zero" in day.do("calibrate")
    zero = np.array(load_hand(day.folder / "hand.toml").calibration.servo_zero)
    assert zero[1] == pytest.approx(-0.37, abs=0.05)
    assert (np.delete(zero, 1) == HPAC.calibration.servo_zero[0]).all()
    told = leave(hand)
    slack = float(re.search(r"slack \[mm\]: .*index ([\d.]+)", told)[1]) * 1e-3
    off = np.radians(float(re.search(r"zero \[deg\]: .*index_mcp (-?[\d.]+)", told)[1]))
    assert zero[1] == pytest.approx(off - slack / HPAC.digits["index"].servo_radius, abs=0.03)

    # noon
    hand = day.hand()
    object_words = re.search(r"--object (\S+)", hand.told())[1]
    assert object_words in day.left[0]  # the page's object is the one that is there
    assert "done: 64 commands" in day.do("deploy")
    wait_for(lambda: "episode 1: " in hand.told())
    assert day.ends("noon.jsonl") == "done"
    assert "64 steps, ended: done" in day.do("replay")
    assert (day.folder / "noon.png").stat().st_size > 10_000

    # afternoon: stopped
    stopped = day.begin("deploy")
    wait_for(lambda: len(day.steps("stopped.jsonl")) > 4)
    assert "stopped: no pulses" in day.do("estop")
    assert stopped.wait(60) == 2
    assert "estop" in stopped.told().splitlines()[-1]
    assert "FaultError" in day.ends("stopped.jsonl")
    assert "state fault" in day.do("doctor", status=1)
    assert "left fault estop; state idle" in day.do("clear")

    # the cable
    cable = day.begin("deploy")
    wait_for(lambda: len(day.steps("cable.jsonl")) > 4)
    leave(hand)
    assert cable.wait(60) == 2
    last = cable.told().splitlines()[-2:]
    assert [line.split(":")[0] for line in last] == ["warning", "error"]
    assert "Error" in day.ends("cable.jsonl")
    assert "Error" in day.do("replay")

    # hot
    hand = day.hand()
    assert re.search(r"heat up to (8[5-9]|90)%", day.do("doctor", status=1))
    assert "allowed below 80%" in day.do("deploy", status=2)
    assert day.steps("hot.jsonl") == []
    leave(hand)

    # the object is lost
    day.hand()
    assert "the hand opens" in day.do("deploy", status=2)
    assert "PoseError" in day.ends("lost.jsonl")
    assert 5 < len(day.steps("lost.jsonl")) < 64
    assert day.left == []
