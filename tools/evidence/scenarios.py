"""The scenarios of the safety case: each plays the virtual hand of one kind, sound or broken, and
returns the figure and the number of opportunities to break the claim."""

import struct
from contextlib import suppress
from functools import cache

import numpy as np

from hpac_gym.bridge import BridgeError, HandLink, VirtualHand
from hpac_gym.bridge.evidence import codec as wire
from hpac_gym.bridge.protocol import CONSTANTS, Action
from hpac_gym.model import HPAC, SERVOS, ServoCommand, move_duration
from tools.evidence.judged_hand import JudgedHand
from tools.evidence.oracle import Oracle
from tools.evidence.sessions import seconds_with_pulses

BOARD_TICK_US = 20_000
"""Tick period of the slowest permitted board, one tick per servo period [µs]."""
PATIENCE = 1.0
"""How long a hand may take to fall silent before the wait for it ends [s]."""
HALF = HPAC.servo_max / 2
TIME = 1.1 * move_duration(HALF, HPAC.servo_max)
Played = tuple[float, int]
Hands = type[JudgedHand]


def linked(
    hand: JudgedHand, action: Action = Action.relax, watchdog: float = 0.25
) -> tuple[JudgedHand, HandLink]:
    """The hand, and a link that has armed it and started a move."""
    link = HandLink(hand.connect)
    link.connect()
    link.arm(action, watchdog)
    link.move(ServoCommand(HALF, TIME))
    return hand, link


def _move(session: bytes, pose: int, duration_ms: int = 1000) -> bytes:
    """Payload of a MOVE of all servos to the same angle [1e-4 rad]."""
    return session + struct.pack("<H6h", duration_ms, *[pose] * 6)


def silence(kind: Hands, action: Action) -> Played:
    """The host falls silent during a move: number of violations afterwards."""
    broken = tried = 0
    longest = 4.0 + (CONSTANTS["hold_max_ms"] * 1e-3 if action == Action.hold else 0.0)
    for number, watchdog in enumerate((0.1, 0.25, 2.0)):
        hand, link = linked(kind(BOARD_TICK_US, start_us=7_300 * number), action, watchdog)
        link.sleep(0.3 * TIME)
        let_pass(hand, watchdog + longest)
        broken += hand.oracle.broken.total()
        tried += hand.oracle.tried["silence"] > 0
    return broken, tried


def let_pass(hand: VirtualHand, seconds: float) -> None:
    """Advance the virtual clock, ignoring the hand's messages."""
    until_us = hand.now_us + seconds * 1e6
    while hand.now_us < until_us:
        hand.run((until_us - hand.now_us) * 1e-6)


def silence_time(kind: Hands) -> Played:
    """Worst time from the end of the watchdog period to the last pulse with the action `detach`
    [ms].
    """
    worst = 0.0
    tried = 0
    for watchdog in (0.1, 0.25, 0.5, 2.0):
        for offset_us in range(0, BOARD_TICK_US, 3_700):
            hand, link = linked(kind(BOARD_TICK_US, start_us=offset_us), Action.detach, watchdog)
            link.heartbeat()
            tried += 1
            worst = max(worst, _ms_until_silent(hand, watchdog + PATIENCE) - watchdog * 1e3)
    return worst, tried


def _ms_until_silent(hand: VirtualHand, patience: float) -> float:
    return 1e3 * seconds_with_pulses(hand, patience, BOARD_TICK_US * 1e-6)


def fed_by_strangers(kind: Hands) -> Played:
    """The controller is silent while others request STATUS and send HEARTBEAT, MOVE and CLEAR of
    other sessions.
    """
    hand, link = linked(kind(), Action.detach)
    session = struct.pack("<I", link.info.session ^ 1)
    others = [
        (wire.STATUS, bytes(2)),
        (wire.HEARTBEAT, session),
        (wire.MOVE, _move(session, 100, 500)),
        (wire.CLEAR, session),
        (wire.HEARTBEAT, bytes(4)),
        (wire.HELLO, bytes(4)),
    ]
    for number in range(30):
        message, payload = others[number % len(others)]
        hand.receive(wire.frame(message, 1000 + number, payload))
        let_pass(hand, 0.02)
    return hand.oracle.broken.total() + bool(hand.pulses().any()), 30


def random_moves(kind: Hands, rule: str, moves: int = 400) -> Played:
    """Valid and invalid moves of every kind at random times, on boards that stall for up to 0.4
    s.
    """
    oracle = _moved_at_random(kind, moves)
    return oracle.broken[rule], oracle.tried[rule]


@cache
def _moved_at_random(kind: Hands, moves: int) -> Oracle:
    """The oracle of a hand after these moves, for all the rules that they try."""
    rng = np.random.default_rng(4)
    hand, link = linked(kind(), Action.hold, 2.0)
    for number in range(moves):
        share = rng.random(len(SERVOS)) if rng.random() < 0.7 else rng.normal(0.5, 1.0, len(SERVOS))
        duration = float(rng.choice([0.01, 0.05, 0.3, 1.0])) * rng.random() + 0.01
        start = link.status().servo
        target = np.clip(start + (HPAC.servo_max * share - start) * min(duration, 1.0), -1.0, 2.0)
        with suppress(BridgeError):
            link.move(ServoCommand(target, duration), minimum_jerk=rng.random() < 0.4, pace=False)
        if number % 10 == 0:
            hand.now_us += int(rng.integers(0, 400_000))
        with suppress(BridgeError):
            link.sleep(duration * rng.random())
    return hand.oracle


def starts(kind: Hands) -> Played:
    """Arming at rest, and again at the pose in which CLEAR has left the hand."""
    hand, link = linked(kind())
    for _ in range(5):
        link.wait()
        link.clear()
        let_pass(hand, 0.2)
        link.arm()
        link.move(ServoCommand(HALF, TIME))
    return hand.oracle.broken["start"] + hand.oracle.broken["rate"], hand.oracle.tried["start"]


def unarmed(kind: Hands) -> Played:
    """Every message but ARM, before the first ARM and after CLEAR and HELLO."""
    hand = kind()
    session = struct.pack("<I", 5)
    move = (wire.MOVE, _move(session, 100))
    frames = [
        move,
        (wire.HELLO, session),
        (wire.HEARTBEAT, session),
        move,
        (wire.STATUS, struct.pack("<H", 20)),
        (wire.CLEAR, session),
    ]
    with suppress(BridgeError):
        for number, (message, payload) in enumerate(frames * 3):
            hand.receive(wire.frame(message, number + 1, payload))
            let_pass(hand, 0.1)
        _, link = linked(hand)
        link.clear()
        let_pass(hand, 0.5)
    return hand.oracle.broken["unarmed"], hand.oracle.tried["unarmed"]


def estops(kind: Hands) -> Played:
    """ESTOP at any time with any flags, payload, version and sequence number: worst time to the
    last pulse [ms].
    """
    rng = np.random.default_rng(3)
    worst = 0.0
    tried = 0
    for number in range(24):
        hand, link = linked(kind(BOARD_TICK_US, start_us=1_700 * number), Action(number % 3))
        link.sleep(TIME * rng.random())
        payload = rng.bytes(int(rng.integers(0, 12))) if number % 2 else b""
        frame = wire.frame(
            wire.ESTOP,
            int(rng.integers(0x10000)),
            payload,
            int(rng.integers(256)),
            int(rng.integers(256)),
        )
        tried += bool(hand.pulses().all())
        hand.receive(frame)
        worst = max(worst, _ms_until_silent(hand, PATIENCE))
    return worst, tried


def ways_out_of_a_fault(kind: Hands) -> Played:
    """After an e-stop, every message except the session's CLEAR: number of them that restore pulses
    or leave the fault.
    """
    hand, link = linked(kind(), Action.detach)
    link.estop()
    out = 0
    session = struct.pack("<I", link.info.session)
    arm = session + struct.pack("<IHB", link.info.limits_hash, 250, 0)
    move = _move(session, 100)
    frames = [
        (wire.ARM, arm),
        (wire.MOVE, move),
        (wire.HEARTBEAT, session),
        (wire.STATUS, bytes(2)),
        (wire.ESTOP, b""),
        (wire.CLEAR, struct.pack("<I", link.info.session ^ 1)),
        (wire.HELLO, bytes(4)),
        (wire.HELLO, session),
    ]
    for number, (message, payload) in enumerate(frames, 1000):
        hand.receive(wire.frame(message, number, payload))
        let_pass(hand, 0.1)
        out += link.status().state != "fault" or bool(hand.pulses().any())
    return out, len(frames)


def old_moves(kind: Hands) -> Played:
    """Repetition of the same MOVE and of older ones: after later ones, and after CLEAR and ARM."""
    hand, link = linked(kind(), Action.hold, 2.0)
    link.wait()
    session = struct.pack("<I", link.info.session)
    moves = [wire.frame(wire.MOVE, 30_000 + i, _move(session, 1000 * (i + 1))) for i in range(5)]
    for move in moves:
        hand.receive(move)
        link.sleep(1.1)
    moved = 0
    for old in (moves[:-1], moves):
        before = link.status().servo
        for move in old:
            hand.receive(move)
            link.sleep(0.1)
        moved += bool((link.status().servo != before).any())
        link.clear()
        link.arm(Action.hold, 2.0)
    return hand.oracle.broken["accept"] + moved, 2 * len(moves) - 1
