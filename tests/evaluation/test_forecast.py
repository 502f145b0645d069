"""`hpac forecast`: its interval, its virtual hands, its line, and what it refuses."""

import json
from dataclasses import replace

import numpy as np
import pytest

from experiments.bench import metal_sweeps
from experiments.hidden import LAWS, hidden_hands
from experiments.quasistatic import Built
from hpac import main
from hpac_gym.calibration.calibrate import named
from hpac_gym.calibration.identification import identify
from hpac_gym.calibration.posterior import (
    drawn_hands,
    draws_of,
    draws_text,
    read_draws,
    report_folder,
)
from hpac_gym.calibration.record import Protocol
from hpac_gym.evaluation.forecast import OF
from hpac_gym.evaluation.statistics import predicted_rate
from hpac_gym.model import HPAC, JOINT_INDEX, hand_to_toml, load_hand
from hpac_gym.model.settled import settled_joints_from_servo
from hpac_gym.output import write_text
from tests.options import refused

SHORT = Protocol(points=13)
"""A sweep with fewer points than usual."""


@pytest.fixture(scope="module")
def built() -> Built:
    """A hidden hand without stops, whose physics is that of the fit."""
    found = hidden_hands(1, 43, LAWS["laws of the fit"])[0]
    return Built(found.hand, tuple(replace(item, stop=()) for item in found.metal))


@pytest.fixture(scope="module")
def found(built):
    return identify(metal_sweeps([built], 5, protocol=SHORT)[0], hold_out=True, draws=12)


@pytest.fixture
def file(tmp_path, found):
    """What `hpac calibrate` writes."""
    path = tmp_path / "hand.toml"
    path.write_text(hand_to_toml(named(found, HPAC, "sweep.csv")))
    write_text(report_folder(path) / "draws.json", draws_text(load_hand(path), found))
    return path


# The interval -------------------------------------------------------------------------


def coverage(spread_known: bool, rng: np.random.Generator) -> float:
    """Share of hands whose 1,000 episodes lie in the interval that 40 others of their kind give."""
    inside = []
    for _ in range(40):
        mean = rng.uniform(0.2, 0.95)
        share = 0.02
        rates = rng.beta(mean * (1 / share - 1), (1 - mean) * (1 / share - 1), 41)
        won = rng.binomial(50, rates[:40])
        if not spread_known:  # as if all virtual hands were one
            won = np.full(40, round(won.mean()))
        _, low, high = predicted_rate(won, 50, 1000)
        inside.append(low <= rng.binomial(1000, rates[40]) / 1000 <= high)
    return float(np.mean(inside))


def test_the_interval_holds_the_spread_of_the_hands_and_the_luck_of_the_episodes():
    assert 0.90 <= coverage(True, np.random.default_rng(1)) <= 0.99


def test_without_the_spread_of_the_hands_it_does_not_hold():
    assert coverage(False, np.random.default_rng(1)) < 0.6


def test_hands_that_are_alike_get_the_interval_of_their_episodes():
    won = np.random.default_rng(2).binomial(50, 0.9, 50)
    rate, low, high = predicted_rate(won, 50, 1000)
    assert rate == pytest.approx(won.mean() / 50, abs=0.005)
    assert 0.044 < high - low < 0.075  # binomial alone: 0.044
    assert predicted_rate([50] * 40, 50, 1000)[1:] == pytest.approx((0.998, 1.0), abs=0.002)


@pytest.mark.parametrize("won", [[3], [3, -1], [3, 51]])
def test_counts_that_cannot_be_are_refused(won):
    with pytest.raises(ValueError, match="need the successes of at least two hands"):
        predicted_rate(won, 50, 1000)


# The virtual hands ----------------------------------------------------------------------


def test_virtual_hands_scatter_about_the_true_one_as_far_as_the_sweep_is_off(built, found):
    """Their angles: the numbers themselves are known much worse, and together make the angles."""
    servo = np.linspace(0.2, 0.8, 7)[:, None] * HPAC.servo_max
    columns = [JOINT_INDEX[name] for name in ("index_mcp", "index_pip", "index_dip")]
    hands = drawn_hands(found.hand, draws_of(found))
    angles, file = (
        np.degrees([settled_joints_from_servo(servo, hand)[:, columns] for hand in group])
        for group in (hands, [found.hand])
    )
    spread = angles.std(axis=0)
    assert 0.003 < spread.mean() < 0.05
    assert (np.abs(angles.mean(axis=0) - file[0]) < 0.05).all()
    hubs = [hand.digits["index"].servo_radius / hand.digits["index"].d1 for hand in hands]
    assert np.std(np.log(hubs)) > 2e-3


def test_draws_are_the_same_every_time_and_cost_nothing_if_not_asked_for(built, found):
    record = metal_sweeps([built], 5, protocol=SHORT, servos=("index_mcp",))[0]
    first, again = (identify(record, draws=4) for _ in range(2))
    assert len(identify(record).fits["index"].draws) == 0
    assert again.fits["index"].draws == pytest.approx(first.fits["index"].draws)
    assert again.cmc_draws is None
    assert drawn_hands(again.hand, draws_of(again))[3].digits["ring"] == HPAC.digits["ring"]


def test_the_file_beside_a_hand_gives_its_virtual_hands(file, found):
    hands = read_draws(file, load_hand(file))
    assert len(hands) == 12
    assert hands[7].digits["index"].alpha == pytest.approx(
        drawn_hands(found.hand, draws_of(found))[7].digits["index"].alpha
    )


# The command ----------------------------------------------------------------------------


WORDS = ("--grasp", "rod", "--hands", "2", "--episodes", "2", "--workers", "1")


def test_it_says_one_line(file, capsys):
    assert main(["forecast", str(file), *WORDS]) == 0
    said = capsys.readouterr().out
    assert said.count("\n") == 1
    assert "in 1000 episodes" in said
    assert "from 2 virtual hands with 2 episodes each" in said
    assert "friction, masses and contacts as simulated" in said


def test_its_json_has_the_counts_and_the_interval(file, capsys):
    assert main(["forecast", str(file), *WORDS, "--model", "nominal", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["model"] == "nominal"
    assert len(said["successes"]) == 2
    assert said["interval_95"] == list(predicted_rate(said["successes"], 2, OF)[1:])


def test_a_file_without_a_sweep_and_one_of_another_hand_are_refused(file, tmp_path, capsys):
    alone = tmp_path / "alone.toml"
    alone.write_text(file.read_text())
    said = refused(capsys, lambda: main(["forecast", str(alone)]))
    assert "which 'hpac calibrate' writes beside" in said
    file.write_text(hand_to_toml(HPAC))
    said = refused(capsys, lambda: main(["forecast", str(file)]))
    assert "is of another hand than" in said


def test_a_hand_that_was_swept_in_part_is_refused(file, capsys):
    """Its other digits are nobody's, and would be forecast as if they were known exactly."""
    draws = file.with_name("hand-report") / "draws.json"
    text = json.loads(draws.read_text())
    for name in ("middle", "thumb_cmc"):
        del text["draws"][name]
    draws.write_text(json.dumps(text))
    said = refused(capsys, lambda: main(["forecast", str(file)]))
    assert "has no draws of middle, thumb_cmc, whose numbers are the design's" in said


@pytest.mark.parametrize(
    "damaged", [{"draws": {}}, {"zero": "half"}, {"zero": None}, {"zero": [0, 0]}]
)
def test_damaged_draws_are_refused(file, capsys, damaged):
    draws = file.with_name("hand-report") / "draws.json"
    draws.write_text(json.dumps(json.loads(draws.read_text()) | damaged))
    assert "cannot be read" in refused(capsys, lambda: main(["forecast", str(file)]))


def test_draws_too_deep_or_too_large_are_refused(file, capsys):
    draws = file.with_name("hand-report") / "draws.json"
    text = json.loads(draws.read_text())
    text["draws"]["index"][0][0] = 10**400
    for damaged in (json.dumps(text), "[" * 100_000):
        draws.write_text(damaged)
        assert "cannot be read" in refused(capsys, lambda: main(["forecast", str(file)]))
