"""The measured gap: the batch's ramp is the firmware's, and each row does what its name says."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from experiments import (
    chain,
    deployed,
    forecast,
    gap,
    held_out,
    imperfect,
    shapes,
    study,
    watched,
)
from hpac_gym.bridge import HandLink, VirtualHand, servo_from_pulses
from hpac_gym.model import HPAC, SERVOS, ServoCommand, streamed_servo
from hpac_gym.output import OutputError
from hpac_gym.physics.servos import Servos
from hpac_gym.physics.settings import ServoSettings

DT = 1 / 120
PERIOD = 0.05


def commands(count):
    """Commands 20 a second, as an environment gives them: never faster than the rate limit."""
    rng = np.random.default_rng(1)
    servo = np.zeros((1, len(SERVOS)))
    for step in range(count):
        if step % 8 == 0:
            target = rng.uniform(HPAC.servo_min, HPAC.servo_max)
        servo = streamed_servo(servo, target[None], PERIOD, HPAC)
        yield servo


@pytest.mark.parametrize("late", [0.0, 0.02])
def test_the_ramp_of_the_batch_is_that_of_the_firmwares_pulses(late):
    """The control: 20 ms later they are not."""
    servos = Servos(1, DT)
    servos.reset([0], np.zeros((1, 6)), [ServoSettings()])
    hand = VirtualHand()
    off = []
    with HandLink(hand.connect) as link:
        link.arm()
        start = hand.now_us
        for step, servo in enumerate(commands(80)):
            link.move(ServoCommand(servo[0], PERIOD))
            servos.command(servo, PERIOD)
            for part in range(1, 7):
                servos.advance(1)
                wanted = start + round(1e6 * (step * PERIOD + part * DT - late))
                if wanted > hand.now_us:
                    link.listen((wanted - hand.now_us) * 1e-6, "test")
                off.append(np.abs(servo_from_pulses(hand.pulses()) - servos.commanded[0]).max())
    tick = 2.0 * 1e-3
    assert (max(off) < 1.5 * tick) == (late == 0.0)


class Simulated:
    """A simulation that moves its servos alone."""

    def __init__(self):
        self.engine = SimpleNamespace(dt=DT)
        self.servos = Servos(1, DT)
        self.angles = []

    def reset(self, worlds, setups):
        self.servos.reset(worlds, np.zeros((1, 6)), [ServoSettings()])

    def command(self, servo, duration):
        self.servos.command(servo, duration)

    def advance(self, wrist, push=None):
        angle, _ = self.servos.advance(wrist.shape[1])
        self.angles += [*angle[0]]


def test_latched_servos_move_in_steps_of_the_pulses_and_arrive():
    alone = Simulated()
    latched = gap.Latched(Simulated(), step_ns=10 * gap.STEP_NS)
    for simulation in (alone, latched):
        simulation.reset([0], [None])
        for servo in commands(40):
            simulation.command(servo, PERIOD)
            simulation.advance(np.zeros((1, 6, 3)))
    angles = np.array(latched.angles)
    away = np.abs(angles - np.array(alone.angles)).max()
    assert 0.02 < away < 2.0 * (gap.LATCH + 2 * DT) + 0.01
    still = (np.abs(np.diff(angles[:, 0])) < 1e-12).mean()
    assert 0.4 < still < 0.75  # 2.4 physics steps a pulse
    assert len(np.unique(np.round(angles[:, 0], 9))) < 0.6 * len(angles)


def test_a_camera_that_is_off_misleads_by_as_much_in_a_drawn_direction():
    seen = []
    policy = SimpleNamespace(predict=lambda observation, *given: (seen.append(observation), None))
    misled = gap.Misled(policy, slice(3, 6), 0.006)
    for seed in (1, 2):
        misled.set_random_seed(seed)
        misled.predict(np.zeros(8))
    assert np.linalg.norm(np.array(seen), axis=1) == pytest.approx(0.006 / gap.LENGTH_UNIT)
    assert (np.array(seen)[:, [0, 1, 2, 6, 7]] == 0).all()
    assert np.abs(seen[0] - seen[1]).max() > 0.01


def test_a_row_is_the_nominal_hand_but_for_its_cause(monkeypatch):
    """A pose that is far off fails where the nominal hand holds; one that is not off at all does
    not.
    """
    monkeypatch.setitem(gap.OFF, "far", 0.06)
    monkeypatch.setitem(gap.OFF, "not off", 0.0)
    seeds = range(gap.HELD_OUT_SEED, gap.HELD_OUT_SEED + 8)
    held = {row: gap.episodes("grasp", row, 0, seeds) for row in (gap.NOMINAL, "not off", "far")}
    assert held["not off"] == held[gap.NOMINAL]
    assert sum(held["far"]) < sum(held[gap.NOMINAL]) - 2


@pytest.mark.parametrize("experiment", [deployed, forecast, gap, shapes, study, watched])
def test_results_that_cannot_be_written_are_told_before_hours_of_work(
    experiment, monkeypatch, tmp_path
):
    for work in ("shared", "progress", "object_errors"):
        monkeypatch.delattr(experiment, work, raising=False)
    monkeypatch.setattr(experiment, "PARTS", {"causes": None}, raising=False)
    (tmp_path / "file").touch()
    out = tmp_path / "file" if experiment is study else tmp_path
    with pytest.raises(OutputError, match=f"'{out}'"):
        experiment.main(["--out", str(out)])


@pytest.mark.parametrize(
    "experiment", [chain, deployed, forecast, gap, held_out, imperfect, shapes, watched]
)
def test_a_quick_look_replaces_no_committed_file(experiment, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    with pytest.raises(SystemExit):
        experiment.main(["--help"])
    name = experiment.__name__.removeprefix("experiments.")
    assert re.search(rf"--out .*\(default: runs/.*{name}", capsys.readouterr().out)


def test_the_board_row_is_latched(monkeypatch):
    made = []
    latch = gap.Latched.advance
    monkeypatch.setattr(
        gap.Latched, "advance", lambda self, *given: (made.append(1), latch(self, *given))
    )
    gap.episodes("grasp", gap.BOARD, 0, [gap.HELD_OUT_SEED, gap.HELD_OUT_SEED + 1])
    assert made
