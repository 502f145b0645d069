import json
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest

from agents import demo
from agents.demo import RESULTS, steps
from agents.recipes import RECIPES

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("recipe", ["grasp", "grasp-robust"])
def test_a_policy_is_judged_and_filmed_on_the_engine_and_body_of_its_training(recipe):
    engine, body = RECIPES[recipe].set_ups[0].split("/")
    commands = {words[1]: words for _, words in steps(recipe, Path("runs/demo"), 10.0, 400, 0)}
    for name in ("evaluate", "show"):
        given = dict(pairwise(commands[name]))
        assert (given.get("--engine"), given.get("--body")) == (engine, body), name


@pytest.mark.parametrize("status", [0, 2])
def test_the_results_before_are_kept_until_there_is_another_policy(tmp_path, monkeypatch, status):
    for name in RESULTS:
        (tmp_path / name).touch()
    done = [subprocess.CompletedProcess([], code) for code in (status, 2)]
    monkeypatch.setattr(subprocess, "run", lambda *words, **named: done.pop(0))
    assert demo.main(["--out", str(tmp_path)]) == 2
    assert {path.name for path in tmp_path.iterdir()} == set(RESULTS if status else RESULTS[:1])


@pytest.mark.slow
def test_the_demo_goes_from_random_weights_to_the_wire(tmp_path):
    line = [
        sys.executable,
        "-m",
        "agents.demo",
        "--out",
        str(tmp_path),
        "--minutes",
        "0.4",
        "--episodes",
        "3",
    ]
    done = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert all((tmp_path / name).stat().st_size for name in RESULTS)
    results = json.loads((tmp_path / "results.json").read_text())
    assert [numbers["episodes"] for numbers in results["policies"].values()] == [3, 3, 3]
    assert list(results["policies"]) == ["learned", "scripted", "random"]
    assert "is missing" not in done.stdout
