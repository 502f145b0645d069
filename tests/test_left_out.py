"""Where PyBullet is not installed, the tests that need it are left out by name and counted, and no
other.
"""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SCRIPT = """
import sys
if {without}:
    sys.modules["pybullet"] = None
import pytest
sys.exit(pytest.main(["-q", "-p", "no:cacheprovider", "--collect-only", *sys.argv[1:]]))
"""


def collected(*paths: str, without: bool) -> tuple[list[str], list[str]]:
    """Names of the tests that pytest would run, and the lines that it says at the end."""
    command = [sys.executable, "-c", SCRIPT.format(without=without), *paths]
    lines = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, timeout=120
    ).stdout.splitlines()
    assert not [line for line in lines if line.startswith("ERROR")], lines
    section = next((index for index, line in enumerate(lines) if "left out" in line), len(lines))
    return [line for line in lines[:section] if "::" in line], lines[section:]


PUSHES = "test_the_wrist_pushes_against_an_obstacle_with_its_force"


@pytest.mark.pybullet
def test_what_needs_pybullet_is_named_and_counted():
    with_it, nothing = collected("tests/physics", without=False)
    without_it, said = collected("tests/physics", without=True)
    assert nothing == []
    files = {line for line in said if line.endswith(".py")}
    gone = set(with_it) - set(without_it)
    assert "tests/physics/test_urdf.py" in files
    assert {name for name in gone if name.split("::")[0] not in files} == {
        line for line in said if "::" in line
    }
    assert without_it
    assert f"tests/physics/test_engine.py::{PUSHES}[100.0-mujoco]" in without_it
    assert f"tests/physics/test_engine.py::{PUSHES}[100.0-pybullet]" in said
    tests = len([line for line in said if "::" in line])
    assert f"{len(files)} files and {tests} tests left out" in said
