"""The C core held against the Python codec and its own promises, with Hypothesis, in this
process.
"""

import numpy as np
from hypothesis import given, settings, strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from hpac_gym.bridge.frame import Frame, FrameSplitter, encode
from hpac_gym.bridge.hands import VirtualHand
from hpac_gym.bridge.limits import limits_hash, pulses_from_servo, servo_limits
from hpac_gym.bridge.protocol import MESSAGES, Action, Reason, State
from hpac_gym.model import HPAC

LOW = pulses_from_servo([servo.min_urad * 1e-6 for servo in servo_limits()])
HIGH = pulses_from_servo([servo.max_urad * 1e-6 for servo in servo_limits()])
SESSION = {"session": 0xC0FFEE}
ARM = {**SESSION, "limits_hash": limits_hash(), "watchdog_ms": 1000, "action": int(Action.hold)}


def ask(hand, frame):
    """Send a frame; the hand's answers, decoded by the Python codec."""
    hand.transmit()
    hand.receive(encode(frame))
    splitter = FrameSplitter()
    answers = [answer for _, answer in splitter.push(hand.transmit())]
    assert splitter.rejected_frames == 0
    return answers


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


class HostileHost(RuleBasedStateMachine):
    """Any messages in any order at any time: the state machine of firmware/README.md, and no pulse
    outside of limits.
    """

    @initialize()
    def power_on(self):
        self.hand = VirtualHand()
        self.seq = 0
        self.greeted = False

    def _ask(self, name, fields=None, flags=0):
        self.seq = self.seq % 0xFFFF + 1
        before = self._state()
        answers = ask(self.hand, Frame(name, self.seq, flags, fields or {}))
        acks = [answer for answer in answers if answer.name == "ack"]
        accepted = bool(acks) and acks[-1].fields["reason"] == Reason.ok
        return before, accepted, self._state()

    def _state(self):
        return State(_status(self.hand)["state"])

    @rule()
    def hello(self):
        before, _, after = self._ask("hello", {"nonce": SESSION["session"]})
        self.greeted = True
        assert after == (State.fault if before == State.fault else State.idle)

    @rule(action=st.integers(0, 4), good=st.booleans())
    def arm(self, action, good):
        fields = {
            **ARM,
            "watchdog_ms": 500,
            "limits_hash": limits_hash() ^ (not good),
            "action": action,
        }
        before, accepted, after = self._ask("arm", fields)
        assert accepted == (
            self.greeted and good and action <= 2 and before in (State.idle, State.armed)
        )
        assert after == (State.armed if accepted else before)

    @rule(
        servo=st.tuples(*[st.integers(-50, 14_000)] * 6),
        duration_ms=st.integers(0, 11_000),
        minimum_jerk=st.integers(0, 1),
    )
    def move(self, servo, duration_ms, minimum_jerk):
        before, accepted, after = self._ask(
            "move", {**SESSION, "duration_ms": duration_ms, "servo": servo}, minimum_jerk
        )
        assert after == before
        assert not accepted or (before == State.armed and self.hand.pulses().all())

    @rule()
    def estop(self):
        _, accepted, after = self._ask("estop")
        assert accepted
        assert after == State.fault
        assert not self.hand.pulses().any()

    @rule()
    def clear(self):
        before, accepted, after = self._ask("clear", SESSION)
        assert accepted == self.greeted
        assert after == (State.idle if accepted else before)
        assert not self.hand.pulses().any()

    @rule(seconds=st.floats(0.001, 0.7))
    def time_passes(self, seconds):
        before = self._state()
        if before == State.armed:  # the silence begins here
            self._ask("heartbeat", SESSION)
        until = self.hand.now_us + seconds * 1e6
        while self.hand.now_us < until:
            self.hand.run((until - self.hand.now_us) * 1e-6)
        if before == State.armed:
            assert (
                self._state() == (State.armed if seconds < 0.499 else State.fault)
                or 0.499 <= seconds <= 0.501
            )
        else:
            assert self._state() == before

    @invariant()
    def pulses_are_within_limits(self):
        if hasattr(self, "hand"):
            pulses = self.hand.pulses()
            on = pulses != 0
            assert np.all(pulses[on] >= LOW[on])
            assert np.all(pulses[on] <= HIGH[on])


TestHostileHost = HostileHost.TestCase
TestHostileHost.settings = settings(max_examples=60, stateful_step_count=30, deadline=None)
