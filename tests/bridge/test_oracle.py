"""The oracle alone, given bytes and pulses: it complains beyond each bound of docs/wire.md, and not
at it.
"""

import struct

import numpy as np
import pytest

from hpac_gym.bridge import pulses_from_servo
from hpac_gym.bridge.evidence import codec as wire
from hpac_gym.bridge.evidence.codec import Reader, seal, unseal
from hpac_gym.bridge.protocol import MESSAGES, Frame, decode, encode
from tools.evidence.oracle import Oracle

OURS = struct.pack("<I", 0x1234)
OTHER = struct.pack("<I", 0x1235)
REST = np.zeros(6)
HALF = np.full(6, 0.5)
WATCHDOG_MS = 250


LIMITS_HASH = 0xA6ACE921  # of the table in docs/wire.md


def arm(watchdog_ms=WATCHDOG_MS, action=wire.DETACH, session=OURS, limits_hash=LIMITS_HASH):
    return session + struct.pack("<IHB", limits_hash, watchdog_ms, action)


def move(duration_ms=1000, steps=(100,) * 6, session=OURS):
    return session + struct.pack("<H6h", duration_ms, *steps)


class Stage:
    """An oracle, and the host and the hand whose bytes and pulses it sees; `now` is in ms."""

    def __init__(self, *messages):
        self.oracle = Oracle()
        self.now = 0.0
        self.seq = 0
        for kind, payload in messages:
            self.say(kind, payload)

    def say(self, kind, payload=b"", seq=None, flags=0, version=2, reason=0):
        """The host says something, and the hand acknowledges all but HELLO with a reason; 0 is
        ok.
        """
        self.seq = self.seq + 1 if seq is None else seq
        self.oracle.said.host(self._us, wire.frame(kind, self.seq, payload, flags, version))
        if kind != wire.HELLO:
            self.oracle.said.device(
                self._us, wire.frame(wire.ACK, self.seq, bytes([kind, reason, 255, 0]))
            )

    @property
    def _us(self):
        return round(1e3 * self.now)

    def show(self, angles, after=1.0):
        """The hand's pulses so many ms later: an angle of each servo, or none."""
        self.now += after
        none = [angle is None for angle in angles]
        self.oracle.pulses(
            self._us,
            np.where(none, 0, pulses_from_servo(np.where(none, 0.0, angles).astype(float))),
        )
        return self

    def started(self, angles=REST):
        """Servos get pulses one by one."""
        for count in range(1, 7):
            self.show([*angles[:count], *[None] * (6 - count)], after=61.0)
            self.say(wire.HEARTBEAT, OURS)
        return self

    @property
    def broken(self):
        return set(self.oracle.broken)


HELLO = (wire.HELLO, OURS)
ARMED = (HELLO, (wire.ARM, arm()))


# --- messages
# -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "payload", "flags", "refused"),
    [
        (wire.HEARTBEAT, OURS, 0, False),
        (wire.HEARTBEAT, OURS[:3], 0, True),
        (wire.HEARTBEAT, OURS + b"\0", 0, True),
        (wire.HEARTBEAT, OTHER, 0, True),
        (wire.HEARTBEAT, bytes(4), 0, True),
        (wire.HEARTBEAT, OURS, wire.NO_ACK, False),
        (wire.HEARTBEAT, OURS, wire.MINIMUM_JERK, True),
        (wire.HEARTBEAT, OURS, 4, True),
        (wire.CLEAR, OURS, 0, False),
        (wire.CLEAR, OURS, wire.NO_ACK, True),
        (wire.CLEAR, OURS, wire.MINIMUM_JERK, True),
        (wire.CLEAR, OTHER, 0, True),
        (wire.STATUS, bytes(2), 0, False),
        (wire.STATUS, bytes(1), 0, True),
        (wire.STATUS, bytes(2), wire.NO_ACK, True),
        (9, OURS, 0, True),
        (wire.ARM, arm(), 0, False),
        (wire.ARM, arm(session=OTHER), 0, True),
        (wire.ARM, arm(watchdog_ms=99), 0, True),
        (wire.ARM, arm(watchdog_ms=100), 0, False),
        (wire.ARM, arm(watchdog_ms=2000), 0, False),
        (wire.ARM, arm(watchdog_ms=2001), 0, True),
        (wire.ARM, arm(action=3), 0, True),
        (wire.ARM, arm(limits_hash=LIMITS_HASH ^ 1), 0, True),
        (wire.MOVE, move(), wire.NO_ACK | wire.MINIMUM_JERK, False),
        (wire.MOVE, move(), 4, True),
        (wire.MOVE, move(session=OTHER), 0, True),
        (wire.MOVE, move(9), 0, True),
        (wire.MOVE, move(10), 0, False),
        (wire.MOVE, move(10_000), 0, False),
        (wire.MOVE, move(10_001), 0, True),
        (wire.MOVE, move(steps=(13_566, 13_860, 13_502, 13_608, 13_497, 15_700)), 0, False),
        (wire.MOVE, move(steps=(0, 0, 13_503, 0, 0, 0)), 0, True),
        (wire.MOVE, move(steps=(0, 0, 0, 0, 0, -1)), 0, True),
    ],
)
def test_what_an_armed_hand_must_refuse(kind, payload, flags, refused):
    stage = Stage(*ARMED)
    stage.say(kind, payload, flags=flags)
    assert stage.broken == ({"accept"} if refused else set())
    assert stage.oracle.tried["accept"] == 2


@pytest.mark.parametrize(
    ("messages", "refused"),
    [
        (((wire.MOVE, move()),), True),
        ((HELLO, (wire.MOVE, move())), True),
        ((*ARMED, (wire.CLEAR, OURS), (wire.MOVE, move())), True),
        ((*ARMED, HELLO, (wire.MOVE, move())), True),
        (((wire.HEARTBEAT, OURS),), True),
        (((wire.HELLO, bytes(4)), (wire.HEARTBEAT, bytes(4))), True),
        (((wire.HELLO, OURS[:3]), (wire.HEARTBEAT, OURS)), True),
        ((HELLO, (wire.HELLO, bytes(4)), (wire.HEARTBEAT, OURS)), False),
        ((HELLO, (wire.HELLO, OTHER), (wire.HEARTBEAT, OURS)), True),
        ((HELLO, (wire.HELLO, OTHER), (wire.HEARTBEAT, OTHER)), False),
        ((*ARMED, (wire.ESTOP, b""), (wire.ARM, arm())), True),
        ((*ARMED, (wire.ESTOP, b""), (wire.CLEAR, OURS), (wire.ARM, arm())), False),
        ((*ARMED, (wire.ARM, arm(100))), False),
    ],
)
def test_what_is_refused_depends_on_what_came_before(messages, refused):
    assert Stage(*messages).broken == ({"accept"} if refused else set())


@pytest.mark.parametrize(
    ("seq", "payload", "refused"),
    [
        (101, move(500), False),
        (100, move(), False),
        (100, move(500), True),
        (99, move(), True),
        (100 + 0x7FFF, move(), False),
        (100 + 0x8000, move(), True),
        (-5, move(), True),
    ],
)
@pytest.mark.parametrize("last", [100, 0xFFFF])
def test_which_sequence_numbers_a_move_may_have(seq, payload, refused, last):
    stage = Stage(*ARMED)
    stage.say(wire.MOVE, move(), seq=last)
    stage.say(wire.MOVE, payload, seq=(seq - 100 + last) % 0x10000)
    assert stage.broken == ({"accept"} if refused else set())


@pytest.mark.parametrize(
    ("between", "seq", "broken"),
    [
        ([(wire.CLEAR, OURS)], 100, {"accept"}),
        ([(wire.ESTOP, b""), (wire.CLEAR, OURS)], 100, {"accept"}),
        ([HELLO], 50, set()),  # numbers begin anew
    ],
)
def test_a_repeat_is_over_once_the_pulses_have_stopped(between, seq, broken):
    stage = Stage(*ARMED)
    stage.say(wire.MOVE, move(), seq=100)
    for kind, payload in [*between, (wire.ARM, arm())]:
        stage.say(kind, payload)
    assert not stage.broken
    stage.say(wire.MOVE, move(), seq=seq)
    assert stage.broken == broken


def test_what_is_carried_out_must_have_come():
    stage = Stage(*ARMED)
    for kind, broken in ((wire.ESTOP, 0), (wire.MOVE, 1)):
        stage.oracle.said.device(0, wire.frame(wire.ACK, 500, bytes([kind, 0, 255, 0])))
        assert stage.oracle.broken["accept"] == broken
    stage.oracle.said.host(0, wire.frame(wire.HEARTBEAT, 600, OURS, version=3))
    stage.oracle.said.device(0, wire.frame(wire.ACK, 600, bytes([wire.HEARTBEAT, 0, 255, 0])))
    assert stage.oracle.broken["accept"] == 2, "of another version"


# --- pulses
# ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("messages", [(), (HELLO,), (*ARMED, (wire.CLEAR, OURS)), (*ARMED, HELLO)])
def test_no_pulses_unless_armed(messages):
    stage = Stage(*messages).show([None] * 6)
    assert not stage.broken
    assert stage.oracle.tried["unarmed"] == 1
    assert stage.show([0.0, *[None] * 5]).broken == {"unarmed"}


def test_servos_start_one_by_one_where_they_were():
    assert not Stage(*ARMED).started().broken
    for first, second, after in (
        ([0, 0], [0, 0], 61.0),
        ([0, None], [0, 0], 58.0),
        ([0.002, None], [0.002, 0], 61.0),
    ):
        stage = (
            Stage(*ARMED)
            .show([*first, *[None] * 4], after=61.0)
            .show([*second, *[None] * 4], after=after)
        )
        assert stage.broken == {"start"}
    stage = Stage(*ARMED).started()
    stage.show([0.001] * 6)
    stage.say(wire.CLEAR, OURS)
    stage.show([None] * 6)
    stage.say(wire.ARM, arm())
    assert not stage.started([0.001] * 6).broken
    assert stage.oracle.tried["start"] == 12


def test_every_angle_is_within_its_range():
    low = REST
    high = np.array([1.3566, 1.386, 1.3502, 1.3608, 1.3497, 1.57])
    for angles, within in ((low, True), (low - 5e-6, False), (high, True), (high + 5e-6, False)):
        stage = Stage(*ARMED)
        stage.oracle._pose = list(angles)
        stage.oracle._holds = True
        assert (stage.started(angles).broken == set()) is within
        assert stage.oracle.tried["range"] == 21
        assert stage.oracle.broken["range"] == (0 if within else 21)


@pytest.mark.parametrize(
    ("step", "after", "count", "within"),
    [
        (0.0041, 1.0, 1, True),  # 2.02 rad/s for a tick, 2 rad/s for 1 ms of credit, and 1e-4 rad
        (0.0042, 1.0, 1, False),
        (0.00202, 1.0, 400, True),
        (0.00204, 1.0, 200, False),
        (0.0424, 100.0, 1, True),  # a late tick counts for 20 ms
        (0.0427, 100.0, 1, False),
    ],
)
def test_no_servo_is_faster_than_its_rate(step, after, count, within):
    stage = Stage(*ARMED).started()
    for number in range(1, count + 1):
        stage.say(wire.HEARTBEAT, OURS)
        stage.show([step * number, *[0.0] * 5], after=after)
    assert stage.broken == (set() if within else {"rate"})
    assert stage.oracle.tried["rate"] == count


def powered_until(stage, milliseconds, angles=REST):
    """Steady pulses until so many ms from now."""
    end = stage.now + milliseconds
    while stage.now < end:
        stage.show(angles, after=min(20.0, end - stage.now))
    return stage


RELAX_MS = 1.57 / 0.5 * 1e3


@pytest.mark.parametrize(
    ("action", "longest"),
    [(wire.DETACH, 0.0), (wire.RELAX, RELAX_MS), (wire.HOLD, 30_000 + RELAX_MS)],
    ids=str,
)
def test_the_watchdogs_action_ends_the_pulses_in_time(action, longest):
    longest += WATCHDOG_MS + 2
    for over, broken in ((0.0, set()), (2.0, {"silence"})):
        stage = Stage(HELLO, (wire.ARM, arm(action=action))).started()
        assert powered_until(stage, longest + over).broken == broken
        assert stage.oracle.tried["silence"] > 0


@pytest.mark.parametrize(
    ("kind", "payload", "reason", "feeds"),
    [
        (wire.HEARTBEAT, OURS, 0, True),
        (wire.HEARTBEAT, OTHER, 14, False),
        (wire.MOVE, move(), 0, True),
        (wire.MOVE, move(9), 6, False),
        (wire.ARM, arm(), 0, True),
        (wire.STATUS, bytes(2), 0, False),
    ],
)
def test_what_feeds_the_watchdog(kind, payload, reason, feeds):
    stage = powered_until(Stage(*ARMED).started(), WATCHDOG_MS - 10)
    stage.say(kind, payload, reason=reason)
    assert powered_until(stage, 200).broken == (set() if feeds else {"silence"})


def test_arming_again_changes_period_and_action():
    stage = Stage(*ARMED).started()
    stage.say(wire.ARM, arm(2000, wire.HOLD))
    assert not powered_until(stage, 20_000).broken


@pytest.mark.parametrize(
    ("after", "slow", "angle", "broken"),
    [
        (1.0, False, 0.499, {"silence"}),  # hold: no motion for 30 s
        (30_010.0, False, 0.499, set()),
        (30_010.0, False, 0.501, {"silence"}),  # and then towards rest only
        (2.0, True, 0.4996, set()),
        (2.0, True, 0.4985, {"rate"}),  # relax: at a quarter of the rate
        (2.0, True, 0.5004, {"silence"}),
    ],
)
def test_how_a_hand_moves_in_its_safe_action(after, slow, angle, broken):
    stage = Stage(HELLO, (wire.ARM, arm(action=wire.RELAX if slow else wire.HOLD)))
    stage.oracle._pose = list(HALF)
    stage.oracle._holds = True
    powered_until(stage.started(HALF), WATCHDOG_MS + 2.0, HALF)
    assert stage.show(HALF, after=after).show([angle] * 6).broken == broken


@pytest.mark.parametrize(("holds", "angles"), [(False, REST), (True, HALF)])
def test_a_first_pulse_finds_the_servo_where_it_stands(holds, angles):
    """At rest, to which the springs pull it, or where it holds by itself at its last angle."""
    for shown in (REST, HALF):
        stage = Stage(*ARMED)
        stage.oracle._pose = list(HALF)
        stage.oracle._holds = holds
        assert (stage.started(shown).broken == set()) is (shown is angles)


@pytest.mark.parametrize(
    ("flags", "payload", "version"), [(0, b"", 2), (255, b"x", 2), (0, b"", 9)]
)
def test_an_estop_ends_the_pulses_in_two_ticks(flags, payload, version):
    stage = Stage(*ARMED).started()
    stage.say(wire.ESTOP, payload, flags=flags, version=version)
    assert not stage.show(REST).show(REST).broken
    assert stage.show(REST).broken == {"estop"}
    assert stage.oracle.tried["estop"] == 4


@pytest.mark.parametrize(
    ("fault", "after", "broken"),
    [
        (3, RELAX_MS, set()),
        (3, RELAX_MS + 5, {"silence"}),
        (4, 2.0, set()),
        (4, 4.0, {"silence"}),
        (8, 4.0, {"silence"}),
    ],
)
def test_overload_relaxes_and_other_faults_end_the_pulses(fault, after, broken):
    stage = Stage(*ARMED).started()
    stage.oracle.said.device(stage._us, wire.frame(wire.FAULT, 0, bytes([fault, 255, 0, 0, 0, 0])))
    assert powered_until(stage, after).broken == broken
    stage.say(wire.ARM, arm())
    assert "accept" in stage.broken


def test_a_restart_forgets_session_pulses_and_waiting_messages():
    stage = Stage(*ARMED).started()
    stage.oracle.power_on()
    assert stage.oracle.said.session == 0
    assert stage.show([None] * 6).show([0.0, *[None] * 5]).broken == {"unarmed"}


def test_only_the_first_hundred_complaints_are_kept():
    stage = Stage()
    for _ in range(150):
        stage.show(REST)
    assert stage.oracle.broken["unarmed"] == 150
    assert len(stage.oracle.complaints) == 100
    assert stage.oracle.complaints[0][:2] == ("unarmed", 1000)


def test_an_oracle_that_saw_nothing_has_tried_nothing():
    assert Oracle().tried.total() == 0


# --- the codec
# ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", MESSAGES)
def test_the_oracles_codec_is_the_codec(name):
    fields = {
        field.name: (1, 0, 200, 3, 4, 5)[: field.count] if field.count > 1 else 77
        for field in MESSAGES[name].fields
    }
    data = encode(Frame(name, 0x1234, 1, fields))
    (message,) = Reader().push(data)
    assert (message.kind, message.seq, message.flags) == (MESSAGES[name].code, 0x1234, 1)
    assert wire.frame(message.kind, message.seq, message.payload, message.flags) == data
    assert decode(data[1:-1]).fields == fields


def test_the_oracle_tells_damage():
    body = bytes(range(20))
    sealed = seal(body)
    assert unseal(sealed[1:-1]) == (body, True)
    assert unseal(sealed[1:-2] + bytes([sealed[-2] ^ 1]))[1] is False
    assert unseal(b"\5abc") is None
    assert unseal(b"\3ab") is None
