import json
import subprocess

import pytest

from agents import demo
from agents.demo import RESULTS
from tests.processes import python


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
    words = ("--out", str(tmp_path), "--minutes", "0.4", "--episodes", "3")
    done = python("-m", "agents.demo", *words)
    assert done.returncode == 0, done.stderr
    assert all((tmp_path / name).stat().st_size for name in RESULTS)
    results = json.loads((tmp_path / "results.json").read_text())
    assert [numbers["episodes"] for numbers in results["policies"].values()] == [3, 3, 3]
    assert list(results["policies"]) == ["learned", "scripted", "random"]
    assert "is missing" not in done.stdout
