"""The safety case: claims about hand and host, each measured together with a negative control that
must fail.

Firmware time is the core's own clock in the virtual hand, exact to a tick; there an `Oracle` checks
the hand, knowing only the document and not the core. Wall-clock figures come from the host board, a
process under this machine's scheduler, and thus also depend on the machine. A control breaks the
hand between core and oracle, or omits the protection that the claim is about: a claim holds only if
something was tried, the figure is within its limit, and the control's is not."""

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from hpac_gym.bridge import BridgeError, FaultError, HandLink, HostBoard
from hpac_gym.bridge.commands import verdict
from hpac_gym.bridge.firmware import firmware_file
from hpac_gym.bridge.protocol import CONSTANTS, Action
from hpac_gym.command import add_counts, command_parser, run
from tools.evidence import hostile, scenarios
from tools.evidence.judged_hand import (
    AlwaysOn,
    Babbling,
    Coarse,
    DeafToEstop,
    Forgiving,
    JudgedHand,
    MovesOn,
    NoWatchdog,
    Renumbering,
    Shifted,
    StartsAtOnce,
)
from tools.evidence.sessions import BOUND, run_sessions


@dataclass(frozen=True, slots=True)
class Claim:
    """One row of the safety case."""

    claim: str
    figure: float
    limit: float
    unit: str
    tried: int
    """Number of opportunities to break the claim."""
    control: float
    """Figure of the negative control; NaN without one."""

    @property
    def holds(self) -> bool:
        """Whether it was tried, the figure is within its limit, and the control's is not."""
        return self.tried > 0 and self.figure <= self.limit and self.control > self.limit

    def __str__(self) -> str:
        figure = f"{self.figure:9.4g} ≤ {self.limit:<5g} {self.unit:<11}"
        return f"{figure} tried {self.tried:<9,} control {self.control:<9.4g} {self.claim}"


def _sessions(count: int, seed: int) -> Iterator[Claim]:
    """Random sessions; those whose link to the hand has failed are counted separately, since only
    the firmware can act there. Controls: links that do not release the hand, and hands without a
    watchdog."""
    seen = run_sessions(count, seed)
    mute = run_sessions(max(10, count // 50), seed, release=False)
    broken, control = (s.powered + s.untold + s.swallowed for s in (seen, mute))
    text = f"{seen.sessions:,} random sessions over bad links, interrupted anywhere: left powered over a living link, or untold"
    yield Claim(text, broken, 0, "sessions", seen.with_pulses, control)
    fed = run_sessions(150, seed, release=False, kind=partial(NoWatchdog, scenarios.BOARD_TICK_US))
    for action, limit in BOUND.items():
        text = f"of them over links dead towards the hand, {action.name}: longest with pulses after the watchdog"
        yield Claim(
            text,
            seen.longest_cut_off[action],
            limit,
            "s",
            seen.cut_off[action],
            fed.longest_cut_off[action],
        )


def measure(
    frames: int = 10_000_000, trials: int = 20, sessions: int = 10_000, seed: int = 1
) -> Iterator[Claim]:
    """Measure every claim and its control, one after the other.

    Args:
        frames: number of hostile frames, and of damaged ones, from the C driver.
        trials: repetitions of wall-clock measurements.
        sessions: number of random sessions over bad links.
        seed: of the frames and the sessions.

    Raises:
        FirmwareMissing: The host build is missing.
    """
    yield from (_played(*row) for row in _PLAYED)
    yield from _driver(frames, seed)
    yield from _sessions(sessions, seed)
    yield from _wall_clock(trials)


def _played(
    claim: str,
    limit: float,
    unit: str,
    control: type[JudgedHand],
    play: Callable[..., scenarios.Played],
    *words: object,
) -> Claim:
    figure, tried = play(JudgedHand, *words)
    return Claim(claim, float(figure), limit, unit, int(tried), float(play(control, *words)[0]))


_PLAYED = [
    (
        "host silent → hold for 30 s, then relax",
        0,
        "complaints",
        MovesOn,
        scenarios.silence,
        Action.hold,
    ),
    (
        "host silent → relax, then no pulses",
        0,
        "complaints",
        NoWatchdog,
        scenarios.silence,
        Action.relax,
    ),
    ("host silent → detach", 0, "complaints", NoWatchdog, scenarios.silence, Action.detach),
    (
        "host silent → no pulses after the watchdog, on a board that ticks every 20 ms",
        20,
        "ms",
        NoWatchdog,
        scenarios.silence_time,
    ),
    (
        "neither STATUS nor strangers feed the watchdog",
        0,
        "complaints",
        Forgiving,
        scenarios.fed_by_strangers,
    ),
    (
        "every pulse within the servo's limits",
        0,
        "complaints",
        Shifted,
        scenarios.random_moves,
        "range",
    ),
    (
        "no servo beyond its rate limit by more than 1 % and 1 ms; late ticks too",
        0,
        "complaints",
        Coarse,
        scenarios.random_moves,
        "rate",
    ),
    (
        "arming: one servo after the other, from the last pose, slowly to rest",
        0,
        "complaints",
        StartsAtOnce,
        scenarios.starts,
    ),
    ("no pulse before ARM, nor after CLEAR or HELLO", 0, "complaints", AlwaysOn, scenarios.unarmed),
    (
        "e-stop of any flags, payload and version → no pulses",
        20,
        "ms",
        DeafToEstop,
        scenarios.estops,
    ),
    (
        "a fault is latched: messages other than CLEAR that leave it",
        0,
        "messages",
        Forgiving,
        scenarios.ways_out_of_a_fault,
    ),
    (
        "a MOVE that comes again, or late, moves nothing",
        0,
        "moves",
        Renumbering,
        scenarios.old_moves,
    ),
    ("no damaged frame is carried out", 0, "frames", Forgiving, hostile.damaged),
    ("a hostile host: all of the above", 0, "complaints", Shifted, hostile.hostile, 20_000),
    (
        "boot text and restarts, at opening and in the session: lost or left with pulses",
        0,
        "sessions",
        Babbling,
        hostile.boots,
    ),
    (
        "a fully closed hand opens by itself (chosen load model)",
        300,
        "s",
        AlwaysOn,
        hostile.overload,
    ),
]
"""Claim, limit, unit, faulty hand of the negative control, scenario and its arguments."""


_PREDICTED = ("broken", "outside_limits", "too_fast", "pulses_unarmed", "estop_ignored")


def _driver(frames: int, seed: int) -> Iterator[Claim]:
    """Figures of the C driver: more frames than Python could send, checked by a second oracle,
    which predicts every answer and every pulse. Its controls tamper with the input of oracle and
    hand."""
    good = _drive(frames, seed)
    tampered = _drive(frames, seed, "tampered")
    text = f"every answer and every pulse as the document says ({good['frames']:,} hostile frames)"
    broken, control = (sum(figures[name] for name in _PREDICTED) for figures in (good, tampered))
    yield Claim(text, broken, 0, "differences", good["moves"], control)
    good = _drive(frames, seed + 1, "damaged")
    tampered = _drive(frames, seed + 1, "damaged", "tampered")
    for text, figure, unit, tried in (
        (
            "one lost byte costs at most one frame",
            "frames_lost_beyond_one",
            "more frames",
            "lost_bytes",
        ),
        ("no damaged frame is taken for a good one", "damaged_accepted", "frames", "damaged"),
    ):
        yield Claim(
            f"{text} ({good[tried]:,} tried)", good[figure], 0, unit, good[tried], tampered[figure]
        )


def _drive(frames: int, seed: int, *mode: str) -> dict[str, int]:
    command = [firmware_file("hpac_driver"), str(frames), str(seed), *mode]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    if answer.returncode not in (0, 1):  # 1: a rule was broken, as the figures show
        raise BridgeError(
            f"{command[0]} ended with status {answer.returncode}: {answer.stderr.strip() or 'no message'}"
        )
    return {
        name: int(value) for name, value in (line.split() for line in answer.stdout.splitlines())
    }


def _real_ms_until_silent(
    board: HostBoard, start: float, keep_alive: HandLink | None = None
) -> float:
    while board.pulses().any():
        if time.monotonic() - start > scenarios.PATIENCE:
            return scenarios.PATIENCE * 1e3
        if keep_alive is not None:
            keep_alive.heartbeat()
        time.sleep(1e-4)
    return (time.monotonic() - start) * 1e3


def _wall_clock(trials: int) -> Iterator[Claim]:
    silence = []
    estop = []
    watchdog = CONSTANTS["watchdog_ms"] * 1e-3

    def begin(tries: int = 20) -> float:
        try:
            link.arm(Action.detach)
            link.heartbeat()
        except FaultError:  # on a busy machine the watchdog may trip during arming
            if tries == 1:
                raise
            link.clear()
            return begin(tries - 1)
        return time.monotonic()

    with HostBoard() as board, HandLink(board.connect) as link:
        for _ in range(trials):
            start = begin()
            link.estop()
            estop.append(_real_ms_until_silent(board, start))
            link.clear()
        for _ in range(max(1, trials // 5)):
            silence.append(_real_ms_until_silent(board, begin()))
            link.clear()
        without = _real_ms_until_silent(board, begin(), keep_alive=link)
    limit = watchdog * 1e3 + 100
    worst = max(silence)
    p99 = float(np.percentile(estop, 99))
    yield Claim(
        "host silent → no pulses, wall clock on this machine, worst",
        worst,
        limit,
        "ms",
        len(silence),
        without,
    )
    yield Claim(
        "e-stop → no pulses, wall clock on this machine, p99", p99, 100, "ms", len(estop), without
    )


def main(argv: list[str] | None = None) -> int:
    """Measure the claims and print each as soon as it is known."""
    parser = command_parser("tools.evidence.safety", __doc__)
    parser.add_argument(
        "--json",
        action="store_true",
        help="print a list of claim, figure, limit, unit, tried, control, holds",
    )
    add_counts(
        parser,
        frames=(1, 10_000_000, "hostile frames"),
        trials=(1, 20, "wall-clock repetitions"),
        sessions=(1, 10_000, "random sessions"),
        seed=(1, 1, "of frames and sessions"),
    )
    arguments = parser.parse_args(argv)
    claims = measure(arguments.frames, arguments.trials, arguments.sessions, arguments.seed)
    names = ("claim", "figure", "limit", "unit", "tried", "control", "holds")
    return verdict(claims, arguments.json, *names)


if __name__ == "__main__":
    sys.exit(run(main))
