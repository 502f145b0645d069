"""The README's programs run as they stand."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PROGRAMS = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)


def test_there_are_programs():
    assert len(PROGRAMS) == 5


@pytest.mark.parametrize(
    "place",
    [
        0,
        pytest.param(1, marks=pytest.mark.slow),
        2,
        3,
        4,  # loading PyTorch for the second one alone takes seconds
    ],
    ids=["environment", "training", "engines", "model", "wire"],
)
def test_a_program_runs_and_prints(place):
    done = subprocess.run(
        [sys.executable, "-c", PROGRAMS[place]],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()
    assert done.stderr == ""


def test_every_link_leads_somewhere():
    links = [link for link in re.findall(r"\]\(([^)#]+)", README) if not link.startswith("http")]
    assert links
    missing = [link for link in links if not (ROOT / link).exists()]
    assert not missing


def test_every_command_names_a_module_that_is_there():
    modules = re.findall(r"python -m ([\w.]+)", README)
    assert modules
    for name in modules:
        assert (ROOT / (name.replace(".", "/") + ".py")).exists(), name
