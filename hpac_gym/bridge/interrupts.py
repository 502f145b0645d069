"""Handling of signals that would end the program: they raise, so that the hand is released, and
wait during the release.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable
from time import monotonic
from types import CodeType, FrameType
from typing import NoReturn
from weakref import WeakSet

_SAME_INTENT = 1.0
"""A second signal within this time of the first counts as a repetition [s]."""


class _Interrupts:
    """Handles SIGINT, SIGTERM and SIGHUP while links are open, unless the program has its own
    handlers.

    The first signal raises (`KeyboardInterrupt`, or `SystemExit` with 128 + its number), so that
    every `with` releases its hand. Signals that arrive while a link is being closed are delayed
    until it is closed. A second signal within a second is a repetition, and must not interrupt the
    clean-up that the first started."""

    def __init__(self) -> None:
        self._links: WeakSet[object] = (
            WeakSet()
        )  # weak: a link lost to an interrupt in its constructor is dropped
        self._raised_at: float  # set with the first link
        self._held: list[int] = []
        self._before: dict[int, object] = {}
        self._closing: set[CodeType] = set()
        self._owner = 0  # the process that installed the handlers

    def closing(self, function: Callable) -> Callable:
        """Mark a function during which signals are delayed."""
        self._closing.add(function.__code__)
        return function

    def link_opened(self, link: object) -> None:
        """Install the handlers with the first link. This is possible only in the main thread."""
        if not self._links:
            self._raised_at = -_SAME_INTENT
        self._links.add(link)
        if threading.current_thread() is not threading.main_thread():
            return
        self._owner = os.getpid()
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) in (
                signal.SIG_DFL,
                signal.default_int_handler,
            ):
                self._before[number] = signal.signal(number, self._on_signal)

    def link_closed(self, link: object) -> None:
        """Restore the previous handlers with the last link."""
        self._links.discard(link)
        if not self._links and threading.current_thread() is threading.main_thread():
            for number, before in self._before.items():
                if signal.getsignal(number) == self._on_signal:
                    signal.signal(number, before)

    def deliver(self, already_ending: bool) -> None:
        """Raise the delayed signal, unless the program is already ending because of an earlier
        one.
        """
        held = self._held
        self._held = []
        if held and not already_ending:
            self._raise(held[0])

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if os.getpid() != self._owner:  # in a forked child
            signal.signal(number, self._before[number])
            signal.raise_signal(number)
            return
        while frame is not None:
            if frame.f_code in self._closing:
                self._held.append(number)
                return
            frame = frame.f_back
        if monotonic() - self._raised_at >= _SAME_INTENT:
            self._raise(number)

    def _raise(self, number: int) -> NoReturn:
        self._raised_at = monotonic()
        if number == signal.SIGINT:
            raise KeyboardInterrupt
        raise SystemExit(128 + number)


interrupts = _Interrupts()
"""The instance of this process, since signal handlers belong to the process."""
