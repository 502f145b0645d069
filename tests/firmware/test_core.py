"""The C core held against the Python codec, with Hypothesis, in this process."""

import numpy as np
from hypothesis import given, strategies as st

from hpac_gym.bridge import Action, HandLink, Reason, VirtualHand, pulses_from_servo
from hpac_gym.bridge.limits import servo_limits
from hpac_gym.model import HPAC


@given(st.integers(10, 10_000), st.tuples(*[st.integers(-100, 14_000)] * 6))
def test_the_core_reads_a_move_as_python_wrote_it(duration_ms, servo):
    outside = [
        i
        for i, limits in enumerate(servo_limits())
        if not limits.min_urad <= servo[i] * 100 <= limits.max_urad
    ]
    hand = VirtualHand()
    with HandLink(hand.connect) as link:
        link.arm(Action.hold)
        ack = link.exchange.request("move", {"duration_ms": duration_ms, "servo": servo})
        if ack.number("reason") == Reason.ok:
            assert not outside
            link.sleep(duration_ms * 1e-3 + 0.01)
            # A tie, rounded.
            np.testing.assert_allclose(
                hand.pulses(), pulses_from_servo(np.array(servo) * 1e-4), rtol=0, atol=1
            )
        elif ack.number("reason") == Reason.angle:
            assert ack.number("servo") in outside
        else:
            assert ack.number("reason") == Reason.rate
            assert max(servo) * 1e-4 / (duration_ms * 1e-3) > min(HPAC.servo_rate_limit)
