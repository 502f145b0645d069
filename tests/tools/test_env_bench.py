"""The benchmark of the environments: what its figures are, not how high."""

import json

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


def test_a_row_tells_rate_share_reset_and_how_many_times_the_faster_peer():
    text = bench.text_of(REPORT)
    assert "| pybullet, n = 1 | 130 | 60% | 0.30 | × 1.30 (goal 1.3) |" in text
    assert "| mujoco, n = 64 | 300 | 90% | 0.30 | × 3.00 |" in text
    assert "| PandaPickAndPlace-v3, 25 Hz | 80 |" in text
    assert text.endswith("× 1.80; two processes of plain arithmetic × 1.90")


def test_what_is_not_measured_is_not_printed():
    text = bench.text_of(REPORT | {"peers": {}, "two_threads": None})
    assert "| pybullet, n = 1 | 130 | 60% | 0.30 |  |" in text
    assert "Panda" not in text
    assert "threads over" not in text


@pytest.mark.parametrize("engine", [pytest.param("pybullet", marks=pytest.mark.slow), "mujoco"])
def test_an_engine_is_measured(engine, capsys, monkeypatch):
    monkeypatch.setattr(bench, "STEPS", 8)
    monkeypatch.setattr(bench, "RESETS", 6)
    words = ["--num-envs", "1", "2", "--rounds", "1", "--no-peers", "--json"]
    bench.main(["--engine", engine, *words])
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
