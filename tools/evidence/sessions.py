"""Random sessions over bad links, interrupted anywhere, to check that none ends with the hand
powered.

Everything runs in virtual time against the firmware core. The check uses the pulses and the bytes
that reached the hand, not the link's own knowledge."""

import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from hpac_gym.bridge import BridgeError, HandLink, PortError, UnconfirmedWarning
from hpac_gym.bridge.hands import VirtualHand, VirtualTransport
from hpac_gym.bridge.protocol import CONSTANTS, Action
from hpac_gym.model import HPAC, ServoCommand, move_duration

_SLACK = 0.03
_RELAX_TIME = 1e3 / CONSTANTS["relax_permille"] * move_duration(HPAC.servo_min, HPAC.servo_max)
"""Longest motion to rest at the relax rate [s]."""

BOUND = {
    Action.detach: _SLACK,
    Action.relax: _RELAX_TIME + _SLACK,
    Action.hold: CONSTANTS["hold_max_ms"] * 1e-3 + _RELAX_TIME + _SLACK,
}
"""Longest time with pulses after the watchdog if the link has failed and only the firmware can act
[s].
"""


class Interrupted(KeyboardInterrupt):
    """Simulated Ctrl-C of a random session."""


class BadTransport(VirtualTransport):
    """A link that loses and damages bytes, fails in one or both directions, and is interrupted at
    chosen calls and bytes.

    Attributes:
        calls: number of reads and writes so far.
        dead: how the link has failed: towards the hand (out), back (in), both, or gone; empty while
            it works.
        reached_us: time of the last bytes that reached the hand [µs, its clock].
    """

    def __init__(self, hand: VirtualHand, rng: np.random.Generator) -> None:
        super().__init__(hand)
        self._rng = rng
        self.calls = self.reached_us = 0
        self.loss_out, self.loss_in = rng.choice([0.0, 0.0, 0.1, 0.4], 2).tolist()
        self.dead = ""
        self.dies_at = int(rng.integers(3, 300))
        self.death = str(rng.choice(["", "", "out", "in", "both", "gone"]))
        first = int(rng.integers(0, 250))
        self.interrupt_at = (
            {first, first + int(rng.integers(1, 6))} if rng.random() < 0.6 else set()
        )
        self.interrupted = 0

    def _spoil(self, data: bytes, loss: float) -> bytes:
        if not data or self._rng.random() >= loss:
            return data
        if self._rng.random() < 0.5:
            return b""
        at = int(self._rng.integers(len(data)))
        return data[:at] + bytes([data[at] ^ 1 << int(self._rng.integers(8))]) + data[at + 1 :]

    def _count(self) -> bool:
        self.calls += 1
        if self.calls == self.dies_at:
            self.dead = self.death
        if self.dead == "gone":
            raise PortError("the link has died")
        return self.calls in self.interrupt_at

    def write(self, data: bytes) -> None:
        """Write bytes; an interrupt may occur between any two of them."""
        interrupt = self._count()
        passed = data[: self._rng.integers(len(data) + 1)] if interrupt else data
        arriving = b"" if self.dead in ("out", "both") else self._spoil(passed, self.loss_out)
        if arriving:
            self.reached_us = self._hand.now_us
            super().write(arriving)
        if interrupt:
            self.interrupted += 1
            raise Interrupted

    def read(self, timeout: float) -> bytes:
        interrupt = self._count()
        data = super().read(timeout * self._rng.random() if interrupt else timeout)
        if interrupt:
            self.interrupted += 1
            raise Interrupted
        return b"" if self.dead in ("in", "both") else self._spoil(data, self.loss_in)


@dataclass(slots=True)
class Sessions:
    """Counts over random sessions."""

    sessions: int = 0
    with_pulses: int = 0
    """Sessions whose program ended while the hand had pulses."""
    interrupted: int = 0
    interrupted_twice: int = 0
    unconfirmed: int = 0
    """Sessions that ended with an `UnconfirmedWarning` or note."""
    lossy: int = 0
    """Sessions over a link that lost or damaged frames towards the hand."""
    powered: int = 0
    """Hands powered after the end although the link to them worked. Must be 0."""
    cut_off: Counter[Action] = field(default_factory=Counter)
    """Hands powered after the end whose link had failed, by their safe action: only their firmware
    could act.
    """
    untold: int = 0
    """Hands powered at the end without a warning to the user. Must be 0."""
    swallowed: int = 0
    """Interrupts and exceptions of the program that were lost. Must be 0."""
    longest_cut_off: dict[Action, float] = field(default_factory=lambda: dict.fromkeys(Action, 0.0))
    """Longest time with pulses of a cut-off hand, from one watchdog period after the last bytes
    that reached it, by its safe action; must be at most `BOUND` [s]."""


def _program(
    link: HandLink, hand: VirtualHand, rng: np.random.Generator, action: Action, watchdog: float
) -> None:
    """A random user program, which returns or raises."""
    link.arm(action, watchdog)
    for _ in range(int(rng.integers(0, 12))):
        target = HPAC.servo_max * rng.random(6)
        step = rng.random()
        if step < 0.5:
            link.move(
                ServoCommand(target, 1.1 * move_duration(HPAC.servo_min, HPAC.servo_max)),
                pace=rng.random() < 0.3,
            )
        elif step < 0.6:
            link.stream().send(target)
        elif step < 0.7:
            link.wait()
        elif step < 0.85:
            link.sleep(0.3 * rng.random())
        elif step < 0.92:
            hand.run(rng.choice([0.1, 0.7, 2.5]))  # thinking, without a heartbeat
        elif step < 0.96:
            link.clear()
            link.arm(action, watchdog)
        else:
            link.estop()
    ending = rng.random()
    if ending < 0.2:
        raise ZeroDivisionError("a mistake of the user")
    if ending < 0.3:
        raise SystemExit(3)


def _one(
    rng: np.random.Generator, total: Sessions, release: bool, kind: Callable[[], VirtualHand]
) -> None:
    """Run one session and count its result."""
    hand = kind()
    action = Action(int(rng.integers(3)))
    watchdog = float(rng.choice([0.1, 0.25, 0.5, 2.0]))
    timeout = float(rng.choice([0.02, 0.1]))
    bad = BadTransport(hand, rng)
    link = HandLink(lambda: bad, handshake_timeout=0.5, timeout=timeout)
    raised = None
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            with link:
                try:
                    _program(link, hand, rng, action, watchdog)
                finally:
                    total.with_pulses += bool(hand.pulses().any())
                    if not release:
                        link._connection.known.may_have_power = False
        except (BridgeError, ZeroDivisionError, SystemExit, Interrupted) as error:
            raised = error
    told = any(isinstance(w.message, UnconfirmedWarning) for w in caught) or bool(
        getattr(raised, "__notes__", ())
    )
    total.sessions += 1
    total.lossy += bool(bad.loss_out > 0)
    total.interrupted += bad.interrupted > 0
    total.interrupted_twice += bad.interrupted > 1
    total.unconfirmed += told
    total.swallowed += bad.interrupted > 0 and not isinstance(raised, Interrupted | SystemExit)
    powered = bool(hand.pulses().any())
    reachable = bad.dead not in ("out", "both", "gone")
    total.untold += powered and not told
    total.powered += powered and reachable
    if powered and not reachable:
        total.cut_off[action] += 1
        seconds_with_pulses(hand, watchdog + BOUND[action] + 1.0)
        lasted = (hand.now_us - bad.reached_us) * 1e-6 - watchdog
        total.longest_cut_off[action] = max(total.longest_cut_off[action], lasted)


def seconds_with_pulses(hand: VirtualHand, patience: float, step: float = 0.01) -> float:
    """Time until a hand has no pulses, at most about `patience` [s], sampled every `step` [s]."""
    start_us = hand.now_us
    while hand.pulses().any() and hand.now_us - start_us < patience * 1e6:
        hand.run(step)
    return (hand.now_us - start_us) * 1e-6


def run_sessions(
    count: int, seed: int = 1, release: bool = True, kind: Callable[[], VirtualHand] = VirtualHand
) -> Sessions:
    """Run random sessions and check how each one leaves the hand.

    Args:
        release: False is a negative control: the links end without releasing the hand.
        kind: makes a hand; one without a watchdog is another control.
    """
    total = Sessions()
    for number in range(count):
        _one(np.random.default_rng([seed, number]), total, release, kind)
    return total
