"""The safety case: claims about the firmware, each with the figure that was measured just now.

Firmware time is the core's own clock in the virtual hand, exact to a tick. Wall-clock figures come from the host board
on this machine: a process under a scheduler, so they tell of this machine too.
"""

from __future__ import annotations

import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hpac_gym.bridge.errors import BridgeError
from hpac_gym.bridge.firmware_files import firmware_file
from hpac_gym.bridge.frame import Frame, encode
from hpac_gym.bridge.host_board import HostBoard
from hpac_gym.bridge.link import HandLink
from hpac_gym.bridge.protocol import CONSTANTS, Action
from hpac_gym.bridge.virtual_hand import VirtualHand
from hpac_gym.model import HPAC, ServoCommand, move_duration

BOARD_TICK_US = 20_000
"""A board that ticks only once a servo period: the slowest that is allowed [µs]."""

_WATCHDOG_MS = CONSTANTS["watchdog_ms"]
_PATIENCE = 5.0
_HALF = HPAC.servo_max / 2
_TIME = 1.1 * move_duration(_HALF, HPAC.servo_max)


@dataclass(frozen=True, slots=True)
class Claim:
    """One row of the safety case."""

    claim: str
    figure: float
    limit: float
    unit: str

    @property
    def holds(self) -> bool:
        """Whether the figure is within its limit."""
        return self.figure <= self.limit


def measure(frames: int = 10_000_000, trials: int = 20, seed: int = 1) -> Iterator[Claim]:
    """Measure every claim, one after the other.

    Args:
        frames: hostile frames, and as many damaged ones, that the C driver plays.
        trials: repetitions of what is measured on the wall clock.

    Raises:
        FirmwareMissing: The host build is not there.
    """
    yield from _hostile_frames(frames, seed)
    yield _pulses_before_arming()
    yield _silence_in_firmware_time()
    yield _estop_in_firmware_time()
    yield _ways_out_of_a_fault()
    yield _replayed_moves()
    yield _overload()
    yield from _wall_clock(trials)
    yield _boot_text(trials)


def _drive(frames: int, seed: int, *mode: str) -> dict[str, int]:
    command = [firmware_file("hpac_driver"), str(frames), str(seed), *mode]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    if answer.returncode not in (0, 1):  # 1: a promise was broken, and the figures say which
        raise BridgeError(f"{command[0]} ended with status {answer.returncode}: {answer.stderr.strip() or 'no message'}")
    return {name: int(value) for name, value in (line.split() for line in answer.stdout.splitlines())}


def _hostile_frames(frames: int, seed: int) -> Iterator[Claim]:
    figures = _drive(frames, seed)
    count = f"{frames:,} hostile frames"
    yield Claim(f"no pulse outside of the servo limits, whatever arrives ({count})", figures["outside_limits"], 0, "pulses")
    yield Claim(f"no servo commanded faster than its rate limit and tolerance ({count})", figures["too_fast"], 0, "ticks")
    yield Claim(f"no pulse unless armed or in a fault that holds or relaxes ({count})", figures["pulses_unarmed"], 0, "pulses")
    yield Claim(f"no pulse right after an accepted e-stop ({count})", figures["estop_ignored"], 0, "e-stops")
    lost = f"one lost byte costs at most one frame ({figures['lost_bytes']:,} lost bytes)"
    yield Claim(lost, figures["frames_lost_beyond_one"], 0, "more frames")
    figures = _drive(frames + frames // 20, seed + 1, "damaged")
    yield Claim(
        f"no damaged frame is taken for a good one ({figures['damaged']:,} damaged)", figures["damaged_accepted"], 0, "frames"
    )


def _pulses_before_arming() -> Claim:
    hand = VirtualHand()
    seen = 0
    frames = [Frame("move", 1, 0, {"duration_ms": 1000, "servo": (100,) * 6}), Frame("hello", 2), Frame("heartbeat", 3)]
    for frame in [*frames, frames[0], Frame("status", 4, 0, {"period_ms": 20}), Frame("clear", 5), frames[0]]:
        hand.receive(encode(frame))
        for _ in range(100):
            hand.run(0.01)
            seen += int(np.count_nonzero(hand.pulses()))
    return Claim("no pulse before the first accepted ARM", seen, 0, "pulses")


def _armed(hand: VirtualHand, action: Action) -> HandLink:
    link = HandLink(hand.connect)
    link.connect()
    link.arm(action)
    link.move(ServoCommand(_HALF, _TIME))
    return link


def _virtual_ms_until_silent(hand: VirtualHand) -> float:
    start_us = hand.now_us
    while hand.pulses().any():
        if hand.now_us - start_us > _PATIENCE * 1e6:
            return _PATIENCE * 1e3
        hand.run(BOARD_TICK_US * 1e-6)
    return (hand.now_us - start_us) * 1e-3


def _real_ms_until_silent(board: HostBoard, start: float) -> float:
    while board.pulses().any():
        if time.monotonic() - start > _PATIENCE:
            return _PATIENCE * 1e3
        time.sleep(1e-4)
    return (time.monotonic() - start) * 1e3


def _silence_in_firmware_time() -> Claim:
    worst = 0.0
    for offset_us in range(0, BOARD_TICK_US, 1_700):
        hand = VirtualHand(period_us=BOARD_TICK_US, start_us=offset_us)
        _armed(hand, Action.detach)
        worst = max(worst, _virtual_ms_until_silent(hand))
    limit = _WATCHDOG_MS + 20
    return Claim("host silent → safe, firmware time, a board that ticks every 20 ms", worst, limit, "ms")


def _estop_in_firmware_time() -> Claim:
    worst = 0.0
    for offset_us in range(0, BOARD_TICK_US, 1_700):
        hand = VirtualHand(period_us=BOARD_TICK_US, start_us=offset_us)
        _armed(hand, Action.hold)
        hand.receive(encode(Frame("estop", 999)))
        worst = max(worst, _virtual_ms_until_silent(hand))
    return Claim("e-stop → no pulses, firmware time", worst, 20, "ms")


def _ways_out_of_a_fault() -> Claim:
    out = 0
    hand = VirtualHand()
    link = _armed(hand, Action.detach)
    link.estop()
    arm = {"limits_hash": link.info.limits_hash, "action": 0}
    move = {"duration_ms": 1000, "servo": (100,) * 6}
    for seq, (name, fields) in enumerate(
        [("hello", {}), ("arm", arm), ("move", move), ("heartbeat", {}), ("status", {"period_ms": 0}), ("estop", {})], 1000
    ):
        hand.receive(encode(Frame(name, seq, 0, fields)))
        out += link.status().state != "fault" or bool(hand.pulses().any())
    return Claim("a fault is latched: messages other than CLEAR that leave it", out, 0, "messages")


def _replayed_moves() -> Claim:
    hand = VirtualHand()
    link = _armed(hand, Action.hold)
    old = encode(Frame("move", 1, 0, {"duration_ms": 1000, "servo": (0,) * 6}))
    link.wait()
    before = hand.pulses()
    hand.receive(old)
    link.sleep(1.5)
    return Claim("an old MOVE that comes again moves nothing", int(np.count_nonzero(hand.pulses() != before)), 0, "servos")


def _overload() -> Claim:
    hand = VirtualHand()
    link = _armed(hand, Action.hold)
    link.move(ServoCommand(HPAC.servo_max, _TIME))
    start = hand.now_us
    try:
        while hand.now_us - start < 1e9:
            link.sleep(1.0)
    except BridgeError:
        pass
    while hand.pulses().any() and hand.now_us - start < 1e9:
        hand.run(0.1)
    return Claim("a fully closed hand opens by itself (chosen load model)", (hand.now_us - start) * 1e-6, 300, "s")


def _wall_clock(trials: int) -> Iterator[Claim]:
    silence, estop = [], []
    with HostBoard() as board, HandLink(board.connect) as link:
        for _ in range(trials):
            link.arm(Action.detach)
            link.move(ServoCommand(_HALF, _TIME))
            start = time.monotonic()
            link.estop()
            estop.append(_real_ms_until_silent(board, start))
            link.clear()
        for _ in range(max(1, trials // 5)):
            link.arm(Action.detach)
            link.heartbeat()
            silence.append(_real_ms_until_silent(board, time.monotonic()))
            link.clear()
    limit = _WATCHDOG_MS + 100
    yield Claim("host silent → safe, wall clock on this machine, worst", max(silence), limit, "ms")
    yield Claim("e-stop → no pulses, wall clock on this machine, p99", float(np.percentile(estop, 99)), 100, "ms")


def _boot_text(trials: int) -> Claim:
    failed = 0
    for _ in range(max(1, trials // 5)):
        with HostBoard(("--boot-text",)) as board:
            try:
                with HandLink(board.connect) as link:
                    link.arm()
            except BridgeError:
                failed += 1
    return Claim("boot text and a reset at opening survive: handshakes lost", failed, 0, "handshakes")
