"""The `hpac` command as a person types it."""

import argparse
import json
import subprocess
import sys
from pathlib import Path

import pytest

from hpac_gym.cli import STUDY_COMMANDS
from hpac_gym.study.commands import add_commands

COMMANDS = (
    "bench", "calibrate", "clear", "conform", "doctor", "estop", "grasps", "posture", "safety", "study", "sweep", "wiggle"
)  # fmt: skip


def hpac(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "hpac_gym.cli", *words], capture_output=True, text=True, timeout=600)


def test_help_lists_every_command():
    said = hpac("--help").stdout.split()
    assert set(COMMANDS) <= set(said)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help(name):
    assert hpac(name, "--help").returncode == 0


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["nonsense"], "nonsense"),
        (["wiggle", "--port", "/dev/no-such-port"], "/dev/no-such-port"),
        (["posture", "nonsense"], "nonsense"),
        (["posture", "list", "--hand", "/no/such/hand.toml"], "/no/such/hand.toml"),
        (["calibrate", "/no/such/sweep.csv"], "sweep.csv"),
        (["bench", "--section", "nonsense"], "nonsense"),
    ],
)
def test_a_mistake_is_one_line_and_status_2(words, named):
    done = hpac(*words)
    assert done.returncode == 2
    lines = done.stderr.splitlines()
    assert len(lines) == 1
    assert named in lines[0]
    assert done.stdout == ""


def test_json_is_one_object_and_nothing_else():
    done = hpac("bench", "--section", "model", "--json")
    assert done.returncode == 0
    assert json.loads(done.stdout)["model"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
@pytest.mark.parametrize("words", [["posture", "list"], ["bench", "--section", "model", "--json"], ["--help"], ["--version"]])
def test_an_output_that_takes_no_more_is_one_line_and_status_2(words):
    with Path("/dev/full").open("w") as full:
        command = [sys.executable, "-m", "hpac_gym.cli", *words]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, timeout=600)
    assert done.returncode == 2
    assert done.stderr == "error: cannot write to standard output: No space left on device\n"


@pytest.mark.parametrize("words", ["posture list", "--help", "grasps --help"])
def test_a_closed_output_is_one_line_and_status_2(words):
    command = f"exec {sys.executable} -m hpac_gym.cli {words} >&-"
    done = subprocess.run(command, shell=True, stderr=subprocess.PIPE, text=True, timeout=600)
    assert done.returncode == 2
    assert done.stderr == "error: cannot write to standard output: it is closed\n"


@pytest.mark.parametrize("words", ["sweep", "calibrate --record x.csv y", "study --help", "posture"])
def test_without_its_packages_a_command_of_the_study_says_what_it_needs(words):
    start = "import sys; sys.modules['scipy'] = None; from hpac_gym.cli import main; sys.exit(main(sys.argv[1:]))"
    done = subprocess.run([sys.executable, "-c", start, *words.split()], capture_output=True, text=True, timeout=600)
    assert done.returncode == 2
    assert done.stderr == "error: this command needs more: pip install 'hpac_gym[study]' (no module scipy)\n"


def test_the_commands_that_need_packages_are_those_of_the_study():
    commands = argparse.ArgumentParser().add_subparsers()
    add_commands(commands)
    assert tuple(commands.choices) == STUDY_COMMANDS


def test_a_reader_that_leaves_early_is_no_error():
    done = subprocess.run(
        f"{sys.executable} -m hpac_gym.cli posture list | head -1", shell=True, capture_output=True, text=True, timeout=600
    )
    assert done.stdout.count("\n") == 1
    assert done.stderr == ""
