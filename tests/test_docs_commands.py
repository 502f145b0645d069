"""The commands of the pages run as they are written, in the order of the page, in a folder of their
own; what does not run is told with its reason, and counted.
"""

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from experiments.bench import metal_sweeps
from experiments.hidden import LAWS, hidden_hands
from hpac_gym.bridge import HostBoard
from hpac_gym.calibration.record import write_sweep
from tests.test_docs import PAGES, PROGRAMS, ROOT, name_of, run_programs, shell_lines

GRASP = ROOT / "hpac_gym" / "policies" / "trained" / "grasp.hpac"

OTHER_TESTS = {"docs/a_day.md": "tests/test_day.py", "docs/own_task.md": "tests/test_own_task.py"}
"""Pages whose commands belong together and are run by a test of their own."""
NOT_RUN = {
    r"make |pip |uv |git |cd |python3|\.venv|ray |IDF|idf|\.\S*bin/": "sets up or tests an installation",
    r"tensorboard ": "a server without an end",
    r"python -m agents\.(train|race|clone|reproduce)": "trains for minutes to hours",
    r"hpac benchmark (?!--check)": "evaluates for many minutes",
    r".*…": "leaves something out",
}
"""Beginnings of the lines that do not run, and why."""
ENDLESS = r"hpac (show(?!.*--episodes)(?!.*--record)|play|virtual)\b"
"""Commands that run until Ctrl-C, which they get after `SHORTLY`."""
SHORTLY = 6.0
NOTHING_FOUND = ("hpac doctor",)
"""Commands that end with status 1 on a machine without a hand."""
MOST = 600.0
"""Longest time of a command [s]."""
PORTS = r"\bPORT\b|/dev/ttyUSB0"


def lines_of(page: Path) -> list[str]:
    """The commands in the shell blocks of a page."""
    programs = r"(?:hpac|python|python3|make|pip|uv|git|ray|tensorboard)\b|\S*bin/"
    return [line for line in shell_lines(page) if re.match(programs, line)]


def reason_of(line: str) -> str | None:
    """Why a line does not run; None: it runs."""
    return next((why for begin, why in NOT_RUN.items() if re.match(begin, line)), None)


RUN = [
    page
    for page in PAGES
    if name_of(page) not in OTHER_TESTS and any(not reason_of(line) for line in lines_of(page))
]


def prepare(folder: Path) -> None:
    """The files that the pages take for given: what earlier steps of other pages, or long ones,
    have written.
    """
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecNormalize

    from hpac_gym.envs.sb3 import HandVecEnv

    hidden = hidden_hands(1, 43, LAWS["laws of the fit"])[0]
    for seed, name in enumerate(("sweep.csv", "sweep2.csv")):
        write_sweep(folder / name, metal_sweeps([hidden], seed)[0])
    for run in ("mine", "clone"):
        (folder / "runs" / run).mkdir(parents=True)
        shutil.copy(GRASP, folder / "runs" / run / "policy.hpac")
    shutil.copy(ROOT / "docs" / "results" / "posture_scripted.json", folder / "results.json")
    (folder / "runs" / "sb3").mkdir()
    envs = VecNormalize(HandVecEnv("HPAC-Grasp-v0", num_envs=1, engine="mujoco"))
    PPO("MlpPolicy", envs, device="cpu").save(folder / "runs" / "sb3" / "model.zip")
    envs.save(folder / "runs" / "sb3" / "vecnormalize.pkl")
    envs.close()


def do(line: str, folder: Path, port: str) -> str:
    """Run a line to its end, or to Ctrl-C; returns what is wrong, or nothing."""
    words = shlex.split(re.sub(PORTS, port, line))
    program = [str(ROOT / "hpac.py")] if words[0] == "hpac" else []
    running = subprocess.Popen(
        [sys.executable, *program, *words[1:]],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT), "BROWSER": "true"},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    endless = re.match(ENDLESS, line)
    try:
        said, _ = running.communicate("\n" * 50, timeout=SHORTLY if endless else MOST)
    except subprocess.TimeoutExpired:
        running.send_signal(signal.SIGINT)
        said, _ = running.communicate(timeout=30)
    # 130: it was still starting.
    expected = (0, 130) if endless else (0, int(line in NOTHING_FOUND))
    wrong = running.returncode not in expected or "Traceback" in said
    return f"{line}: status {running.returncode}: {said[-600:]}" if wrong else ""


@pytest.mark.slow
@pytest.mark.parametrize("page", RUN, ids=name_of)
def test_the_commands_of_a_page_run(page, tmp_path):
    prepare(tmp_path)
    if page in PROGRAMS:
        run_programs([page], tmp_path)
    with HostBoard() as board:
        lines = [line for line in lines_of(page) if not reason_of(line)]
        wrong = [told for line in lines if (told := do(line, tmp_path, board.port))]
    assert not wrong, "\n".join(wrong)


def test_what_does_not_run_is_told_and_counted(capsys):
    lines = [line for page in PAGES if name_of(page) not in OTHER_TESTS for line in lines_of(page)]
    left = [why for line in lines if (why := reason_of(line))]
    with capsys.disabled():
        print(f"\n{len(lines) - len(left)} of {len(lines)} commands of the pages run; not run:")
        for why in NOT_RUN.values():
            print(f"{left.count(why):4} {why}")
    assert set(left) == set(NOT_RUN.values())
    assert len(lines) - len(left) >= 30


@pytest.mark.slow
def test_a_command_that_fails_is_told(tmp_path):
    assert "no policy file" in do("hpac evaluate --policy none.hpac", tmp_path, "")
