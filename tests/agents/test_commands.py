"""Every mistake on a command line ends in one line on standard error and exit status 2."""

import sys
from importlib import import_module
from pathlib import Path

import pytest

from agents.recipes import RECIPES
from hpac import main as hpac
from hpac_gym.command import run
from tests.options import refused
from tests.processes import python

TINY = "tests.tiny_task:Tiny-v0"
GRASP = "grasp --out {folder}/run"

MISTAKES = [
    ("train", "grasp", "--out"),
    ("train", "--out {folder}/run", "no recipe given: it must be one of grasp"),
    ("train", "grasp-ppo --out {folder}/run", "unknown recipe 'grasp-ppo'"),
    ("train", GRASP + " --episodes 0", "episodes is 0: it must lie in 1…1e+08"),
    ("train", GRASP + " --time-limit soon", "'soon' is not a positive number of minutes"),
    (
        "train",
        GRASP + " --env Nothing-v3",
        "no environment 'Nothing-v3': there are HPAC-Grasp-v0, HPAC-GraspAny-v1",
    ),
    ("train", GRASP + " --env HPAC-Posture-v1", "a closure cannot follow goals"),
    ("train", GRASP + " --set wing=3", "env is 'HPAC-Grasp-v0', and has no such option"),
    ("train", GRASP + " --set config.gap=3", "config gap = 3 must be a range"),
    ("train", GRASP + " --engine mujoco --set-ups mujoco/twin", "name one set-up"),
    ("train", GRASP + " --set obs=deploy", "obs is 'deploy': a training of closures has its own"),
    ("train", GRASP + " --set reward=sparse", "reward is 'sparse': a training of closures has"),
    ("train", GRASP + " --set render_mode=human", "render_mode is 'human': a training of closures"),
    ("race", "sac --env HPAC-Posture-v1 --out {folder}/race", "its observation is not a vector"),
    ("train", GRASP + " --gamma 0.9", "unrecognized arguments: --gamma"),
    ("train", "grasp --out {folder}/file/run", "cannot write to folder"),
    ("train", "grasp --out /proc/run", "cannot write to folder '/proc/run'"),
    ("train", "grasp --out {folder}/taken", "already holds a run"),
    ("train", "grasp --out {folder}/policy", "already holds a run"),
    (
        "train",
        GRASP + " --begin 5,6 --release 1,2",
        "begin is up to 6 steps, release from 1 on: it must come later",
    ),
    ("train", GRASP + " --trials-of {folder}/policy {folder}/policy", "it names a run twice"),
    ("train", "--out {folder}/run --resume", "no run in"),
    ("train", "--out {folder}/taken --resume", "cannot read the settings of"),
    ("train", "--out {folder}/taken --resume --dropout 0.2", "only --episodes can change"),
    ("train", "--out {folder}/taken --resume --set told=false", "only --episodes can change"),
    ("evaluate", "", "--policy"),
    ("evaluate", "--policy {folder}/none.hpac", "no policy file"),
    ("evaluate", "--policy {folder}/file", "is not a policy file"),
    ("evaluate", "--policy random --env Nothing-v3", "no environment 'Nothing-v3'"),
    (
        "evaluate",
        "--policy random --env nothing_here:Nothing-v3",
        "no environment 'nothing_here:Nothing-v3'",
    ),
    ("evaluate", "--policy random --episodes 0", "'0' is not a whole number of at least 1"),
    (
        "evaluate",
        "--policy random --seed-start 9223372036854775808",
        "is not a whole number of at least 0 and below 2⁶³",
    ),
    ("evaluate", "--policy random --workers none", "'none' is not a whole number of at least 1"),
    (
        "evaluate",
        f"--policy random --env {TINY} --episodes 1 --out /proc/no/results.json",
        "cannot write to folder",
    ),
    (
        "evaluate",
        f"--policy random --env {TINY} --episodes 1 --out {{folder}}/policy",
        "policy': it is a folder",
    ),
    ("evaluate", "--policy {folder}/file --out {folder}/file", "file', a policy to evaluate"),
    ("race", "sac --set tau2=1 --out {folder}/race", "unknown options tau2: there are"),
    ("race", "sac --out {folder}/bent", "already holds a run"),
    ("curves", "{folder}", "nothing to show"),
    ("curves", "{folder}/bent", "is not a learning curve"),
    ("demo", "--minutes 0", "'0' is not a positive number of minutes"),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("mistakes")
    (folder / "file").write_text("no policy")
    (folder / "taken").mkdir()
    (folder / "taken" / "run.json").write_text("{}")
    (folder / "bent").mkdir()
    (folder / "bent" / "progress.csv").write_text("steps\none\n")
    (folder / "policy").mkdir()
    (folder / "policy" / "policy.hpac").touch()
    return folder


@pytest.mark.parametrize(
    ("command", "words", "complaint"), MISTAKES, ids=[f"{c} {w}" for c, w, _ in MISTAKES]
)
def test_a_mistake_ends_in_one_line_and_status_2(
    folder, command, words, complaint, monkeypatch, capsys
):
    words = words.format(folder=folder).split()
    monkeypatch.setattr(sys, "argv", [command, *words])
    of_agents = command != "evaluate"
    main = import_module(f"agents.{command}").main if of_agents else lambda: hpac([command, *words])
    assert complaint in refused(capsys, lambda: run(main))


def test_the_whole_command_says_no_more_than_that_line(folder):
    done = python("-m", "agents.train", "grasp-ppo", "--out", str(folder / "run"))
    assert done.returncode == 2
    assert (
        done.stderr
        == f"error: unknown recipe 'grasp-ppo': known are {', '.join(sorted(RECIPES))}\n"
    )
    assert not (folder / "run").exists()
