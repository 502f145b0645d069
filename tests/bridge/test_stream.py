"""Streams: no command is refused, whatever is lost, late or slow on the way."""

import numpy as np
import pytest

from hpac_gym.bridge import (
    FaultError,
    FrameError,
    HandLink,
    LinkTimeout,
    RejectedError,
    VirtualHand,
    servo_from_pulses,
)
from hpac_gym.bridge.link import open_hand
from hpac_gym.bridge.protocol import Frame, encode
from hpac_gym.errors import ShapeError
from hpac_gym.model import HPAC, ServoCommand
from hpac_gym.virtual.wire import Faults
from tests.bridge.devices import LOST, Overheard


@pytest.fixture
def stream(link):
    """A stream to `virtual_hand`, which is armed."""
    link.arm(watchdog=2.0)
    return link.stream()


def targets(count, seed=1):
    """Targets to which the whole range is run through again and again."""
    rng = np.random.default_rng(seed)
    for i in range(count):
        if i % 16 == 0:
            target = rng.uniform(HPAC.servo_min, HPAC.servo_max)
        yield target


def close(stream, count):
    """Send some commands towards the closed hand."""
    for _ in range(count):
        stream.send(HPAC.servo_max)


def streamed(count=400, early=0.005, seed=0, **bad):
    hand = VirtualHand()
    wire = Overheard(hand, seed)
    with HandLink(lambda: wire) as link:
        link.arm(watchdog=0.5)
        stream = link.stream(early=early)
        wire.spoil(**bad)
        for target in targets(count):
            sent = stream.send(target)
        link.listen(0.2, "end")
        reached = servo_from_pulses(hand.pulses())
        wire.spoil()
    return stream.counts, sent, reached


def test_every_command_is_acknowledged_and_the_last_one_reached():
    counts, sent, reached = streamed()
    assert (counts.sent, counts.acknowledged) == (400, 400)
    assert (counts.refused, counts.lost, counts.late, counts.skipped) == (0, 0, 0, 0)
    np.testing.assert_allclose(reached, sent, atol=1e-5)


@pytest.mark.parametrize(
    "bad",
    [
        {"loss": 0.05},
        {"loss": 0.3},
        {"jitter": 0.002},
        {"latency": 0.016},
        {"latency": 0.12},
        {"loss": 0.05, "jitter": 0.002, "latency": 0.016},
    ],
    ids=str,
)
@pytest.mark.parametrize("seed", range(2))
def test_no_command_is_refused_over_a_bad_link(bad, seed):
    counts, _, _ = streamed(seed=seed, **bad)
    assert (counts.sent, counts.refused) == (400, 0)
    assert (counts.lost > 0) == ("loss" in bad)


def test_without_a_margin_early_commands_are_refused():
    counts, _, _ = streamed(early=0.0, jitter=0.01)
    assert counts.refused > 0


@pytest.mark.parametrize("believes", [False, True])
def test_a_stream_that_continues_from_what_it_sent_is_refused_after_a_loss(
    overheard, stream, believes
):
    """The control: the hand refuses what is further than its rate allows."""
    for count in range(14):
        gone = 2 <= count < 7
        overheard.there.faults = LOST if gone else Faults()
        stream.send(HPAC.servo_max)
        if gone and believes:  # that they arrived
            stream._ramps = {0: list(stream._ramps.values())[-1]}
    assert (stream.counts.refused > 0) == believes


@pytest.mark.parametrize("lost", [0, 2])
def test_a_lost_command_costs_no_way(virtual_hand, overheard, link, stream, lost):
    """A third one does: the hand stops at the end of its move."""
    for count in range(8):
        overheard.there.faults = LOST if 3 <= count < 3 + lost else Faults()
        stream.send(HPAC.servo_max)
    link.listen(stream.period, "end")
    way = servo_from_pulses(virtual_hand.pulses()).max()
    assert way == pytest.approx(0.97 * 2.0 * 8 * stream.period, rel=0.01)


def test_a_target_is_approached_at_the_rate_that_is_left(stream):
    steps = [stream.send(HPAC.servo_max) for _ in range(3)]
    fastest = 2.0 * 0.05
    ways = np.diff(steps, axis=0).max(axis=1)
    assert (0.95 * fastest < ways).all()
    assert (ways <= fastest).all()
    assert stream.counts.limited == 3


def test_all_servos_arrive_together_as_in_every_move(stream):
    target = np.array([0.1, 1.0, 0.5, 0.0, 0.2, 0.9])
    way = np.array([stream.send(target) for _ in range(14)])
    np.testing.assert_allclose(way / target.max(), np.outer(way[:, 1], target), atol=2e-4)
    np.testing.assert_allclose(way[-1], target, atol=1e-4)


def test_a_busy_program_skips_periods_and_sends_no_burst(link, stream):
    stream.send(HPAC.servo_max)
    link.sleep(0.23)
    for _ in range(4):
        stream.send(HPAC.servo_max)
    assert (stream.counts.skipped, stream.counts.late, stream.counts.refused) == (3, 1, 0)


def test_a_hot_hand_slows_down_and_goes_on(link):
    link.arm(watchdog=2.0)
    link.move(ServoCommand(HPAC.servo_max, 1.0))
    link.sleep(140.0)  # at 0.8 of the heat that it may have, its rate begins to fall
    link.move(ServoCommand(HPAC.servo_min, 1.0))
    link.wait()
    stream = link.stream()
    speeds = []
    servo = np.zeros(6)
    for i in range(2_400):  # two minutes
        before = servo
        servo = stream.send(HPAC.servo_max if i // 40 % 3 else HPAC.servo_min)
        speeds.append(np.abs(servo - before).max() / stream.period)
    assert link.state == "armed"
    assert link.last_status.rate_share < 1.0
    assert np.median(speeds[42:50]) == pytest.approx(1.94, abs=0.02)
    assert max(speeds[-400:]) < 1.8
    assert (stream.counts.refused, stream.counts.lost) == (0, 0)


@pytest.mark.parametrize(
    ("frame", "error", "says"),
    [
        (Frame("estop", 7, 0, {}), FaultError, "estop"),
        (Frame("hello", 7, 0, {"nonce": 5}), RejectedError, "another program"),
    ],
    ids=["estop", "taken over"],
)
def test_another_program_ends_it(virtual_hand, stream, frame, error, says):
    stream.send(HPAC.servo_max)
    virtual_hand.receive(encode(frame))
    with pytest.raises(error, match=says):
        close(stream, 3)


def test_a_stream_of_the_longest_period_goes_on_though_it_is_a_little_late(link, stream):
    slow = link.stream(period=1.0)
    for _ in range(3):
        slow.send(HPAC.servo_max)
        link.listen(1.005, "late")
    assert (slow.counts.sent, slow.counts.late) == (3, 2)


def test_a_deaf_hand_ends_it_after_a_second(overheard, link, stream):
    overheard.there.faults = LOST
    with pytest.raises(LinkTimeout, match="no answer to a streamed move for 1 s"):
        close(stream, 40)
    with pytest.warns(UserWarning, match="has not confirmed"):
        link.close()
    assert 15 < stream.counts.sent < 25


def test_wrong_values_are_refused_before_anything_is_sent(link, stream):
    for wrong in (np.full(6, np.nan), np.zeros(5)):
        with pytest.raises(ShapeError, match="target"):
            stream.send(wrong)
    for wrong in ({"period": 0.01}, {"early": -0.001}, {"early": 0.06}, {"early": np.nan}):
        with pytest.raises(FrameError, match="allowed"):
            link.stream(**wrong)
    assert stream.counts.sent == 0


def test_moves_are_answered_again_after_a_stream(link, stream):
    stream.send(np.full(6, 0.05))
    link.sleep(0.1)
    stream.close()
    with pytest.raises(RejectedError, match="rad"):
        link.move(ServoCommand(HPAC.servo_max, 0.05))


@pytest.mark.parametrize("ended", [False, True])
def test_a_last_command_that_is_refused_late_is_the_stream_s_alone(overheard, link, stream, ended):
    overheard.spoil(latency=0.12)
    stream._share = 3.0
    stream.send(HPAC.servo_max)
    if ended:
        stream.close()
    open_hand(link)
    overheard.spoil()
    assert stream.counts.refused == ended


def test_a_hand_that_may_be_at_many_places_is_led_away_from_no_target(
    virtual_hand, overheard, stream
):
    """They may be further apart than a move leads, once a hot hand is slower."""
    close(stream, 2)
    overheard.there.faults = LOST
    close(stream, 5)
    stream._share = 0.05
    stream.send(np.where(np.arange(6) == 1, HPAC.servo_min, HPAC.servo_max))
    leads_to = list(stream._ramps.values())[-1].to
    overheard.spoil()
    pose = servo_from_pulses(virtual_hand.pulses())
    assert (np.delete(leads_to - pose, 1) > -0.02).all()
