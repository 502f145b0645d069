import json
import threading
from pathlib import Path

import pytest

from agents.curves import read_curve, report
from agents.progress import Progress, drop_rows_after
from hpac_gym.output import OutputError


@pytest.fixture
def curve(tmp_path):
    """Of 5000 trials, a thousand at a time, of which half hold."""
    progress = Progress(tmp_path, 5_000, 10**9)
    while progress.going:
        progress.add([True, False] * 500, 20_000, lambda: {"entropy": -0.5})
    progress.close()
    return tmp_path / "progress.csv"


def test_the_last_row_counts_no_trial_for_which_the_run_has_no_room(tmp_path):
    progress = Progress(tmp_path, 600, 10**9)
    progress.add([True] * 600 + [False] * 100, 1, lambda: {"entropy": -0.5})
    assert not progress.going
    columns = read_curve(tmp_path / "progress.csv")
    assert (columns["episodes"], columns["success_rate"], columns["window"]) == (600, 1.0, 600)


@pytest.mark.parametrize(("done", "share"), [(0, 0.5), (150, 0.25)])
def test_a_time_limit_does_not_end_the_exploration_of_a_resumed_run(done, share, tmp_path):
    progress = Progress(
        tmp_path,
        600,
        10**9,
        done,
        seconds_before=done,
        time_limit=60.0,
        clock=iter((0.0, 30.0)).__next__,
    )
    assert progress.share == share
    progress.close()


@pytest.mark.parametrize("half", ["", "episodes,sec", "episodes,seconds,success_rate,window,en"])
def test_a_curve_whose_head_a_full_disk_cut_begins_anew_when_it_is_resumed(half, tmp_path):
    (tmp_path / "progress.csv").write_text(half)
    drop_rows_after(tmp_path / "progress.csv", 400)
    progress = Progress(tmp_path, 600, 10**9, done=400)
    progress.add([True] * 200, 1, lambda: {"entropy": -0.5})
    progress.write_row({})
    progress.close()
    assert read_curve(tmp_path / "progress.csv")["episodes"] == [600]


@pytest.mark.filterwarnings("error")  # of a thread that ends with an exception
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_disk_that_is_full_under_tensorboard_is_told_in_one_error(tmp_path):
    threads = set(threading.enumerate())
    progress = Progress(tmp_path, 600, 10**9)
    (events,) = (tmp_path / "tensorboard").iterdir()
    events.unlink()
    events.symlink_to("/dev/full")
    with pytest.raises(OutputError, match=r"cannot write '.*tensorboard': No space left on device"):
        progress.add([True] * 600, 1, lambda: {"entropy": -0.5})
    for thread in set(threading.enumerate()) - threads:
        thread.join()


def test_a_report_draws_what_there_is(curve):
    assert [path.name for path in report(curve.parent)] == ["learning_curve.png"]
    numbers = {
        "episodes": 10,
        "success_rate": 0.5,
        "interval_95": [0.24, 0.76],
        "return_mean": 1.0,
        "failures_by_phase": {},
    }
    results = {
        "env_id": "a:B-v0",
        "first_seed": 1,
        "last_seed": 10,
        "policies": {"random": numbers},
        "differences": [],
    }
    results["policy"] = {"file": "clone/policy.hpac", "sha256": "12ab" * 16}
    (curve.parent / "results.json").write_text(json.dumps(results))
    written = report(curve.parent)
    assert {path.name for path in written} == {"learning_curve.png", "results.md"}
    assert all(path.stat().st_size for path in written)
    assert "| random | 10 | 50.0% | 24.0% … 76.0% |" in (curve.parent / "results.md").read_text()
    assert (
        "Learned: clone/policy.hpac, weights SHA-256 `12ab12ab12ab12ab…`"
        in (curve.parent / "results.md").read_text()
    )
