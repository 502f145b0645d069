"""How forecasts are counted, and the committed counts of 40 hands against their rows."""

import json

import pytest

from experiments import chain, forecast
from experiments.forecast import SWEEP, WIDTH, summary, table
from hpac_gym.command import run
from tests.options import refused
from tests.test_docs import DOCS, text_of


def row(seed, truth, low, high):
    return {"case": "a", "seed": seed, "truth": truth, "interval_95": [low, high]}


def test_an_interval_counts_if_it_holds_the_truth_and_is_narrow():
    rows = [
        row(0, 0.90, 0.88, 0.93),
        row(1, 0.90, 0.91, 0.95),  # misses
        row(2, 0.50, 0.40, 0.60),  # is wide
        row(3, 0.05, 0.00, WIDTH),
    ]
    without = {"a": {"all nominal": {"interval_95": [0.86, 0.92]}}}
    sweep, exchanged, nominal = summary(rows, without)
    assert (sweep["virtual_hands"], sweep["inside"], sweep["inside_and_narrow"]) == (SWEEP, 3, 2)
    assert (exchanged["inside"], exchanged["inside_and_narrow"]) == (0, 0)
    assert (nominal["inside"], nominal["inside_and_narrow"]) == (2, 2)
    assert "| a | all nominal | 2 of 4 | 2 | 6.0, 6.0 |" in table([sweep, nominal])


def test_the_committed_counts_are_those_of_the_rows():
    written = json.loads(text_of(DOCS / "results" / "experiments" / "forecast.json"))
    assert written["cells"] == json.loads(
        json.dumps(summary(written["rows"], written["without_a_sweep"]))
    )


@pytest.mark.parametrize("data", [b"", b'{"cells": [', b"[]", b'{"command": ""}', b"\xff"])
@pytest.mark.parametrize("experiment", [forecast, chain])
def test_a_damaged_file_is_refused_in_one_line_and_kept(experiment, data, tmp_path, capsys):
    path = tmp_path / "results.json"
    path.write_bytes(data)
    words = ["--out", str(path)]
    if experiment is chain:
        words += ["--draw", str(tmp_path / "chain.png")]
    assert "results.json" in refused(capsys, lambda: run(lambda: experiment.main(words)))
    assert (path.read_bytes(), list(tmp_path.iterdir())) == (data, [path])
