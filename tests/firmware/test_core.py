"""The C core held against the Python codec and its own promises, with Hypothesis, in this
process.
"""

import numpy as np
from hypothesis import given, settings, strategies as st

from hpac_gym.bridge.frame import Frame, decode, encode
from hpac_gym.bridge.hands import VirtualHand
from hpac_gym.bridge.limits import limits_hash, pulses_from_servo, servo_limits
from hpac_gym.bridge.protocol import MESSAGES, Action, Reason
from hpac_gym.model import HPAC

SESSION = {"session": 0xC0FFEE}
ARM = {**SESSION, "limits_hash": limits_hash(), "watchdog_ms": 1000, "action": int(Action.hold)}


def ask(hand, frame):
    """Send a frame; the hand's answers, decoded by the Python codec."""
    hand.transmit()
    hand.receive(encode(frame))
    return [decode(piece) for piece in hand.transmit().split(b"\0") if piece]


def armed_hand():
    hand = VirtualHand()
    ask(hand, Frame("hello", 1, 0, {"nonce": SESSION["session"]}))
    ask(hand, Frame("arm", 2, 0, ARM))
    while _status(hand)["moving"]:
        ask(hand, Frame("heartbeat", 3, 0, SESSION))
        hand.run(0.2)
    return hand


def _status(hand):
    return next(
        a.fields
        for a in ask(hand, Frame("status", 0, 0, {"period_ms": 0}))
        if a.name == "device_status"
    )


@given(st.integers(0, 0xFFFF), st.integers(10, 10_000), st.tuples(*[st.integers(-100, 14_000)] * 6))
def test_the_core_reads_a_move_as_python_wrote_it(seq, duration_ms, servo):
    hand = armed_hand()
    (ack,) = ask(
        hand, Frame("move", seq, 0, {**SESSION, "duration_ms": duration_ms, "servo": servo})
    )
    assert ack.seq == seq
    limits = servo_limits()
    outside = [
        i for i in range(6) if not limits[i].min_urad <= servo[i] * 100 <= limits[i].max_urad
    ]
    if ack.fields["reason"] == Reason.ok:
        assert not outside
        for _ in range(duration_ms // 400 + 1):
            ask(hand, Frame("heartbeat", 5, 0, SESSION))
            while hand.run(min(duration_ms * 1e-3, 0.4)):
                pass
        # A tie, rounded.
        np.testing.assert_allclose(
            hand.pulses(), pulses_from_servo(np.array(servo) * 1e-4), rtol=0, atol=1
        )
    elif ack.fields["reason"] == Reason.angle:
        assert ack.fields["servo"] in outside
    else:
        assert ack.fields["reason"] == Reason.rate
        assert max(servo) * 1e-4 / (duration_ms * 1e-3) > min(HPAC.servo_rate_limit)


@given(st.data())
def test_every_message_is_answered_in_the_layout_that_python_expects(data):
    hand = armed_hand()
    message = data.draw(st.sampled_from([m for m in MESSAGES.values() if m.from_host]))
    fields = {
        field.name: tuple(data.draw(st.integers(0, 127)) for _ in range(field.count))
        if field.count > 1
        else 99
        for field in message.fields
    }
    answers = ask(hand, Frame(message.name, 77, 0, fields))
    assert any(answer.seq == 77 for answer in answers)


@settings(max_examples=200)
@given(st.binary(max_size=300))
def test_no_bytes_make_pulses_before_arming(data):
    hand = VirtualHand()
    hand.receive(data)
    hand.run(1.0)
    assert not hand.pulses().any()


@settings(max_examples=200)
@given(st.binary(max_size=100))
def test_any_bytes_cost_at_most_the_frame_that_they_touch(data):
    hand = VirtualHand()
    hand.receive(data)
    answers = ask(hand, Frame("hello", 42, 0, {"nonce": 1}))
    assert [answer.name for answer in answers if answer.seq == 42] == ["device_hello"]
