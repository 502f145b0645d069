"""The benchmark of the environments: what its figures are, not how high."""

import json
from copy import deepcopy

import pytest

from tools import env_bench as bench


def engine(one: float, many: float, reset_ms: float) -> dict:
    rates = {"1": one, "64": many}
    outside = {"1": 0.4, "64": 0.1}
    resets = {"1": 0.3, "64": reset_ms}
    return {"env_steps_per_cpu_second": rates, "outside_engine": outside, "reset_ms": resets}


REPORT = {
    "engines": {"pybullet": engine(130.0, 100.0, 1.0), "mujoco": engine(200.0, 300.0, 0.3)},
    "two_threads": 1.8,
    "two_processes_of_arithmetic": 1.9,
    "peers": {"HandManipulateBlock-v1": 100.0, "PandaPickAndPlace-v3": 80.0},
    "peers_control_hz": {"HandManipulateBlock-v1": 25, "PandaPickAndPlace-v3": 25},
}
"""Figures that keep every mark, just."""


def changed(*path: str, value: float) -> dict:
    report = deepcopy(REPORT)
    place = report
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    return report


def test_every_mark_can_be_missed():
    assert [kept for *_, kept in bench.marks(REPORT)] == [True] * 8
    cases = [
        changed("engines", "pybullet", "env_steps_per_cpu_second", "1", value=129.0),
        changed("engines", "mujoco", "env_steps_per_cpu_second", "1", value=199.0),
        changed("engines", "pybullet", "env_steps_per_cpu_second", "64", value=143.0),
        changed("engines", "mujoco", "env_steps_per_cpu_second", "64", value=299.0),
        changed("two_threads", value=1.79),
        changed("engines", "mujoco", "outside_engine", "64", value=0.101),
        changed("engines", "mujoco", "reset_ms", "1", value=0.301),
        changed("engines", "mujoco", "reset_ms", "64", value=0.301),
    ]
    for index, report in enumerate(cases):
        assert [kept for *_, kept in bench.marks(report)] == [place != index for place in range(8)]
        assert "\n".join(bench.lines(report)).count("✗") == 1


def test_the_faster_peer_is_the_one_to_beat():
    report = changed("peers", "PandaPickAndPlace-v3", value=101.0)
    kept = {name: kept for name, *_, kept in bench.marks(report)}
    assert all(kept[name] != ("faster peer" in name) for name in kept)


def test_one_environment_is_printed_first_beside_the_peers():
    text = bench.lines(REPORT)
    assert text[1].startswith("one environment")
    for line, name in zip(text[2:6], (*REPORT["engines"], *REPORT["peers"]), strict=True):
        assert line.split()[0] == name
    assert "130   engine's share 60%" in text[2]


def test_a_machine_without_a_second_processor_gives_no_verdict_on_threads():
    report = changed("two_processes_of_arithmetic", value=1.89)
    assert [kept for *_, kept in bench.marks(report)].count(None) == 1
    assert "?" in "\n".join(bench.lines(report))


def test_what_is_not_measured_has_no_mark():
    report = deepcopy(REPORT) | {"peers": {}, "peers_control_hz": {}}
    del report["engines"]["pybullet"]
    assert len(bench.marks(report)) == 4
    del report["engines"]["mujoco"]
    assert bench.marks(report) == []


@pytest.mark.parametrize("engine", [pytest.param("pybullet", marks=pytest.mark.slow), "mujoco"])
def test_an_engine_is_measured(engine, capsys, monkeypatch):
    monkeypatch.setattr(bench, "STEPS", 8)
    monkeypatch.setattr(bench, "RESETS", 6)
    words = ["--num-envs", "1", "2", "--rounds", "1", "--no-peers", "--json"]
    assert bench.main(["--engine", engine, *words]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["two_processes_of_arithmetic"] > 0
    figures = found["engines"][engine]
    for n in ("1", "2"):
        assert figures["reset_ms"][n] > 0
        assert figures["env_steps_per_cpu_second"][n] > 0
        assert 0 < figures["outside_engine"][n] < 1


def test_an_environment_that_fails_is_one_line(monkeypatch):
    monkeypatch.setattr(bench, "find_spec", lambda name: name == "pybullet")
    with pytest.raises(bench.BenchError, match="engine 'mujoco' is not installed, only pybullet"):
        bench.main(["--engine", "mujoco"])
    worker = bench.Worker(bench.sys.executable, kind="arithmetic")
    with pytest.raises(
        bench.BenchError, match="an environment of the benchmark failed: AttributeError"
    ):
        worker.ask("nonsense")
    worker.close()


def a_python_whose_pip_fails(folder, **_) -> None:
    """Instead of a virtual environment, which takes seconds to make; its last argument is the
    package.
    """
    python = folder / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.write_text(
        "#!/bin/sh\nshift $(($# - 1))\necho trying >&2\necho ERROR: Invalid requirement: $1 >&2\nexit 1\n"
    )
    python.chmod(0o755)


def test_peers_that_cannot_be_installed_are_one_line(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(bench, "PEER_PACKAGES", ("/no/such/package",))
    monkeypatch.setattr(bench.venv, "create", a_python_whose_pip_fails)
    with pytest.raises(
        bench.BenchError, match=r"the peers cannot be installed in .*/no/such/package"
    ):
        bench.peers_python()
