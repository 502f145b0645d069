"""The conformance suite: the firmware passes it, and every rule and every check of it is failed by
a wrong device.
"""

import json
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import cache

import pytest

from hpac_gym.bridge import HostBoard, VirtualHand
from hpac_gym.bridge.evidence import codec, device as device_module
from hpac_gym.bridge.evidence.codec import unseal
from hpac_gym.bridge.evidence.conform import RULES, conform
from hpac_gym.bridge.evidence.device import OURS, BrokenRule, Device
from hpac_gym.bridge.hands import VirtualTransport, config_of
from hpac_gym.bridge.protocol import Fault, State
from hpac_gym.model import HPAC
from tests.bridge.test_commands import run
from tools.evidence import judged_hand


class LosesStep(judged_hand.JudgedHand):
    """A hand that misses the frame after a damaged one."""

    lost = False

    def heard(self, data):
        pieces = list(filter(None, data.split(b"\0")))[self.lost :]
        self.lost = any(unseal(piece) is None for piece in pieces)
        return b"".join(b"\0" + piece + b"\0" for piece in pieces)


def rewriting(name, heard=lambda body: body, said=lambda body: body):
    """A hand that changes the frames that it hears or says: header and payload of each, without its
    CRC.
    """

    class Hand(judged_hand.JudgedHand):
        def heard(self, data):
            return judged_hand._rewritten(data, heard)

        def transmit(self):
            return judged_hand._rewritten(super().transmit(), said)

    Hand.__name__ = name
    return Hand


def put(body, when, at, value):
    """Put a byte into a frame's payload if a condition holds."""
    if when:
        body[5 + at] = value
    return body


def field(kind, at, value):
    """A hand that says one byte of the payload of a type wrong."""
    return rewriting(
        f"Says{value}At{at}Of{kind:02x}", said=lambda body: put(body, body[1] == kind, at, value)
    )


class Late(judged_hand.JudgedHand):
    """A hand that tells a fault after the ACK of the ESTOP that caused it."""

    def transmit(self):
        pieces = list(filter(None, super().transmit().split(b"\0")))
        pieces.sort(key=lambda piece: unseal(piece)[0][1] == codec.FAULT)
        return b"".join(b"\0" + piece + b"\0" for piece in pieces)


class OneZero(judged_hand.JudgedHand):
    """A hand that ends its frames with a zero, and does not begin them with one."""

    def transmit(self):
        return super().transmit().replace(b"\0\0", b"\0").removeprefix(b"\0")


class ArmsOnce(judged_hand.JudgedHand):
    """A hand that takes no second ARM while it is armed."""

    def heard(self, data):
        armed = self.pulses().any()
        return judged_hand._rewritten(data, lambda body: put(body, armed and body[1] == 2, 10, 9))


class EndsItsHold(judged_hand.JudgedHand):
    """A hand whose pulses stop at a HELLO in a fault."""

    def heard(self, data):
        pieces = [unseal(piece) for piece in filter(None, data.split(b"\0"))]
        greeted = any(piece and piece[0][1] == 1 and any(piece[0][5:9]) for piece in pieces)
        stop = codec.frame(codec.ESTOP, 0xFFFF) if greeted and self.oracle.said.ending == 0 else b""
        return stop + data


HELLO = "HELLO is answered with session and the limits' hash"
ESTOP = "ESTOP is accepted from any sender, with any contents"
SILENCE = {"silence: detach", "silence: relax", "silence: hold, then relax"}
REPEATS = {"a MOVE comes once; old numbers are refused", "a MOVE from before CLEAR is refused"}
WRONG = {
    judged_hand.DeafToEstop: {
        ESTOP,
        "a fault is latched until CLEAR",
    },
    judged_hand.NoWatchdog: SILENCE
    | {
        "HELLO ends neither a fault nor its hold",
        "ARM while armed replaces watchdog and safe action",
        "counters",
        "messages that feed the watchdog, and others",
    },
    judged_hand.Renumbering: REPEATS,
    judged_hand.Forgiving: {
        "a damaged frame is counted and not answered",
        "ARM, MOVE, HEARTBEAT and CLEAR belong to the session",
        "order of the checks of a frame",
    },
    LosesStep: {"junk does not affect later frames", "a lost byte costs at most one frame"},
    rewriting(
        "Chatty",
        heard=lambda body: put(body, body[1] in (codec.MOVE, codec.HEARTBEAT), -1, body[4] & ~2),
    ): {"no ACK where none is wanted, refusals always"},
    rewriting(
        "ChattyInMoves", heard=lambda body: put(body, body[1] == codec.MOVE, -1, body[4] & ~2)
    ): {"no ACK where none is wanted, refusals always"},
    rewriting(
        "GoesOnTelling",
        heard=lambda body: put(body, body[1] == codec.STATUS and not any(body[5:]), 0, 50),
    ): {"periodic STATUS"},
    rewriting(
        "TakenOverByALook", heard=lambda body: put(body, body[1] == 1 and not any(body[5:9]), 0, 1)
    ): {"HELLO 0 is answered and changes nothing"},
    rewriting(
        "Faithful",
        heard=lambda body: body[:5] + bytes(4) if body[1] == 1 and body[5:] != OURS else body,
    ): {"HELLO of another controller disarms and takes over"},
    rewriting(
        "HearsItself", heard=lambda body: body[:1] + b"\4" + body[2:] if body[1] >= 0x80 else body
    ): {"messages of the hand's own types are ignored"},
    rewriting(
        "StartsFive", said=lambda body: put(body, body[1] == 0x83, 6, body[11 % len(body)] & 0x1F)
    ): {"servos start one after the other; MOVE waits for them"},
    rewriting("NeverAtRest", said=lambda body: put(body, body[1] == 0x83, 7, 1)): {
        "MOVE arrives; minimum jerk"
    },
    rewriting("Detaches", heard=lambda body: put(body, body[1] == 2, 10, 2)): SILENCE
    - {"silence: detach"},
    rewriting("Holds", heard=lambda body: put(body, body[1] == 2, 10, 0)): SILENCE
    - {"silence: hold, then relax"},
    rewriting("GoesOn", heard=lambda body: body[:1] + b"\4" + body[2:] if body[1] == 6 else body): {
        "CLEAR stops motion and pulses"
    },
    rewriting("Linear", heard=lambda body: put(body, body[1] == codec.MOVE, -1, body[4] & ~1)): {
        "MOVE arrives; minimum jerk",
        "MOVE out of limits, too fast, too short, too long is refused",
    },
    rewriting("Flags", said=lambda body: put(body, True, -1, 0xFF)): {HELLO},
    field(codec.ACK, 0, 0): {"a fault is latched until CLEAR"},
    field(codec.ACK, 2, 0): {"a fault is latched until CLEAR"},
    field(codec.ACK, 3, State.boot): {"a fault is latched until CLEAR"},
    field(codec.DEVICE_HELLO, 24, 0): {HELLO, "HELLO 0 is answered and changes nothing"},
    field(codec.DEVICE_HELLO, 26, 99): {HELLO},
    rewriting(
        "Timeless",
        said=lambda body: (
            body[:5] + bytes(4) + body[9:] if body[1] == codec.DEVICE_STATUS else body
        ),
    ): {"counters"},
    field(codec.DEVICE_STATUS, 20, 255): {"counters"},
    field(codec.DEVICE_STATUS, 27, 0): {"counters"},
    field(codec.FAULT, 1, 3): {*SILENCE, ESTOP},
    field(codec.FAULT, -3, 9): {*SILENCE, ESTOP},  # its number
    Late: {ESTOP},
    OneZero: {HELLO},
    ArmsOnce: {"ARM while armed replaces watchdog and safe action"},
    EndsItsHold: {"HELLO ends neither a fault nor its hold"},
}


@pytest.mark.parametrize("rate", [HPAC.rate_limit, 0.4, 9.5, 100.0])
def test_the_firmware_conforms(rate):
    hand = replace(HPAC, rate_limit=rate)
    rows = list(conform(VirtualHand(config=config_of(hand)).connect(), hand))
    assert [row.rule for row in rows] == list(RULES)
    assert all(row.holds for row in rows), [row for row in rows if not row.holds]


class Restarts(VirtualTransport):
    """A board that restarts when its port opens."""

    def __init__(self, hand):
        super().__init__(hand)
        self.text = b"rst:0x1 (POWERON_RESET),boot:0x13\r\n"
        self.hears_from = self.now() + 1.5

    def write(self, data):
        if self.now() >= self.hears_from:
            super().write(data)

    def read(self, timeout):
        text = self.text
        self.text = b""
        return text or super().read(timeout)


def test_a_device_that_starts_when_its_port_opens_conforms():
    rows = list(conform(Restarts(VirtualHand())))
    assert all(row.holds for row in rows), [row for row in rows if not row.holds]


@pytest.mark.slow
def test_the_host_board_conforms():
    with HostBoard() as board:
        assert run("conform", "--port", board.port) == 0


PERIOD_US = 5000
"""Of the wrong hands' ticks; fewer of them take less time to judge."""


@pytest.mark.parametrize(
    "wrong", [{"state": State.armed}, {"fault": Fault.estop}, {"powered": True}], ids=str
)
def test_a_device_in_another_state_breaks_the_rule(wrong):
    device = Device(VirtualHand().connect(), HPAC, patience=0.1)
    device.idle()
    right = {"state": State.idle, "when": "now", "fault": Fault.none, "powered": False}
    device.must_be(**right)
    with pytest.raises(BrokenRule, match="now idle, fault none, servos 000000, must be"):
        device.must_be(**right | wrong)
    with pytest.raises(BrokenRule, match=r"FAULT messages \[\], must be one of estop"):
        device.must_have_told(Fault.estop)


def test_conform_finds_renumbered_moves_leaves_the_hand_without_pulses_and_tells_its_status(
    capsys, monkeypatch
):
    hand = judged_hand.Renumbering(PERIOD_US)
    monkeypatch.setattr("hpac_gym.bridge.commands.VirtualHand", lambda config: hand)
    assert run("conform", "--port", "virtual", "--json") == 1
    rows = json.loads(capsys.readouterr().out)
    assert {row["rule"] for row in rows if not row["holds"]} == WRONG[judged_hand.Renumbering]
    assert not hand.pulses().any()


# --- every check
# ----------------------------------------------------------------------------------------------------


class Liar(VirtualHand):
    """A hand that says something else while it is `lying`."""

    lying = False

    def __init__(self, lie: Callable[[bytes], bytes]) -> None:
        super().__init__(PERIOD_US)
        self._lie = lie

    def transmit(self) -> bytes:
        said = super().transmit()
        return self._lie(said) if self.lying else said


LATEST = 20
"""Checks after a lie by which a rule has noticed it, or never does."""


class Unnoticed(Exception):
    """A rule goes on after a lie."""


class Watched(Device):
    """The device under test, which notes the line of each check and the type of the message before
    it.

    The hand behind it lies from check number `begin` of the rule on, counted from 0, until check
    number `end` is done."""

    def __init__(self, lie: Callable[[bytes], bytes] = bytes, begin: int = 0, end: int = 0) -> None:
        self._hand = Liar(lie)
        self._span = range(begin, end)
        super().__init__(self._hand.connect(), HPAC, patience=0.05)
        self.checks: list[tuple[str, int]] = []
        self.kinds: list[int] = []
        self._kind = 0

    def run(self, rule: str) -> bool:
        """Whether the hand keeps a rule."""
        with suppress(BrokenRule):
            self.hash = self.hello(0).limits_hash
        self.tried = 0
        self.checks = []
        self.kinds = []
        self._hand.lying = 0 in self._span
        try:
            with suppress(Unnoticed):
                RULES[rule](self)
        except BrokenRule:
            return False
        return True

    def ask(self, *args, **how):
        answer = super().ask(*args, **how)
        self._kind = answer.kind if answer else 0
        return answer

    def expect(self, kept: bool, what: str) -> None:
        frame = sys._getframe(1)
        while frame.f_code.co_name.startswith("must"):  # a helper that checks for its caller
            frame = frame.f_back
        self.checks.append((frame.f_code.co_filename, frame.f_lineno))
        self.kinds.append(self._kind)
        super().expect(kept, what)
        if self._span and self.tried > self._span.stop + LATEST:
            raise Unnoticed
        self._hand.lying = self.tried in self._span


def silent(_: bytes) -> bytes:
    """A lie: nothing."""
    return b""


def turned(kind: int, at: int, bits: int) -> Callable[[bytes], bytes]:
    """A lie: some bits of a byte of the frames of a type."""

    def lie(body: bytearray) -> bytearray:
        if body[1] == kind:
            body[at] ^= bits
        return body

    return lambda said: judged_hand._rewritten(said, lie)


def test_a_mute_device_breaks_every_rule():
    hand = Liar(silent)
    hand.lying = True
    for row in conform(hand.connect(), patience=0.1):
        assert row.failure
        assert row.tried


READ = (0, 2, 4, 5, 6, 7, 8, 9, 10, 30, 32, 36, 38, 42, 48)
"""Bytes of STATUS's payload that the suite reads, the lowest of each field, and the first servo's
two.
"""
LIES = {
    0: [silent, turned(codec.FAULT, 5, 1)],
    codec.DEVICE_HELLO: [
        turned(codec.DEVICE_HELLO, *where) for where in ((1, 3), (5, 1), (12, 1), (29, 1), (34, 1))
    ],
    codec.ACK: [turned(codec.ACK, at, 1) for at in (1, 6, 7)],
    codec.DEVICE_STATUS: [
        turned(codec.DEVICE_STATUS, at, bits)
        for at in (1, *(5 + at for at in READ))
        for bits in (1, 2, 7)
    ],
}
"""Lies after a message of a type: a wrong version, type or field; 0: after any message."""


@cache
def honest(rule: str) -> Watched:
    """A device that has kept a rule."""
    device = Watched()
    assert device.run(rule)
    return device


def failed(rule: str, check: tuple[str, int]) -> bool:
    """Whether a check is failed by a hand that tells one kind of lie shortly before it."""
    end = honest(rule).checks.index(check) + 1

    def fails(lie: Callable[[bytes], bytes], before: int) -> bool:
        device = Watched(lie, end - before, end)
        return not device.run(rule) and device.checks[-1:] == [check]

    befores = range(1, min(7, end + 1))
    tries = [(lie, before) for before in befores for lie in LIES[0]]
    likely = sorted(
        befores, key=lambda before: before not in (3, 4)
    )  # what it is about is asked there
    for before in likely:
        kinds = {*honest(rule).kinds[end - before : end]} - {0}
        tries += [(lie, before) for kind in kinds for lie in LIES[kind]]
    return any(fails(*each) for each in tries)


@pytest.mark.parametrize("rule", RULES)
def test_every_check_is_failed_by_a_wrong_device(rule):
    found = set()
    for kind in (kind for kind in WRONG if rule in WRONG[kind]):
        device = Watched()
        device.transport = kind(PERIOD_US).connect()
        assert not device.run(rule)
        found.update(device.checks[-1:])
    # That one needs all of `Device`'s.
    helpers = device_module.__file__ if rule != "MOVE arrives; minimum jerk" else ""
    checks = [
        check
        for check in dict.fromkeys(honest(rule).checks)
        if check not in found and check[0] != helpers
    ]
    assert not [check for check in checks if not failed(rule, check)]


def test_no_check_has_been_removed():
    assert len({check for rule in RULES for check in honest(rule).checks}) == 119
