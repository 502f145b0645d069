"""The README's programs run as they stand."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from hpac import COMMANDS

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
ENVIRONMENT, TRAINING = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)


@pytest.mark.parametrize(
    "program",
    [
        pytest.param(ENVIRONMENT, id="environment"),
        # loading PyTorch alone takes seconds
        pytest.param(TRAINING, id="training", marks=pytest.mark.slow),
    ],
)
def test_a_program_runs_and_prints(program):
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()
    assert done.stderr == ""


def test_every_command_names_a_module_that_is_there():
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    texts = [page.read_text(encoding="utf-8") for page in pages]
    own = r"python -m ((?:agents|experiments|tools|hpac_gym)\.[\w.]*\w)"
    modules = {name for text in texts for name in re.findall(own, text)}
    assert len(modules) > 10
    for name in modules:
        assert (ROOT / (name.replace(".", "/") + ".py")).exists(), name
    named = {name for text in texts for name in re.findall(r"^hpac ([a-z]+)", text, flags=re.M)}
    assert {"show", "deploy", "doctor"} <= named <= {command.name for command in COMMANDS}


def test_it_is_short():
    assert len(README.splitlines()) <= 120
    assert len(README.split()) <= 900
