"""Signals that would end the program: they raise where a hand can still be released, and wait while one is."""

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
"""A second signal within this time of the first asks for the same thing [s]."""


class _Interrupts:
    """SIGINT, SIGTERM and SIGHUP of this process while links are open, where the program has no handler of its own.

    The first one raises (`KeyboardInterrupt`, or `SystemExit` with 128 + its number), so that every `with` releases its
    hand. While a link is being closed they wait until it is. One that follows within a second of the first is the same
    intent, and must not interrupt what the first began.
    """

    def __init__(self) -> None:
        self._links: WeakSet[object] = WeakSet()  # one that an interrupt lost while it was made drops out by itself
        self._raised_at = -_SAME_INTENT
        self._held: list[int] = []
        self._before: dict[int, object] = {}
        self._closing: set[CodeType] = set()
        self._owner = os.getpid()

    def closing(self, function: Callable) -> Callable:
        """Mark a function as one that signals must wait for."""
        self._closing.add(function.__code__)
        return function

    def link_opened(self, link: object) -> None:
        """Take the signals, with the first link. Only a program's main thread can."""
        if not self._links:
            self._raised_at = -_SAME_INTENT
        self._links.add(link)
        if threading.current_thread() is not threading.main_thread():
            return
        self._owner = os.getpid()
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
                self._before[number] = signal.signal(number, self._on_signal)

    def link_closed(self, link: object) -> None:
        """Give the signals back, with the last link."""
        self._links.discard(link)
        if not self._links:
            self._raised_at = -_SAME_INTENT
        if not self._links and threading.current_thread() is threading.main_thread():
            for number, before in self._before.items():
                if signal.getsignal(number) == self._on_signal:
                    signal.signal(number, before)

    def deliver(self, already_ending: bool) -> None:
        """Raise what had to wait, unless the program is ending because of an earlier one."""
        held, self._held = self._held, []
        if held and not already_ending:
            self._raise(held[0])

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if os.getpid() != self._owner:  # a fork's child
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
"""Signals belong to the process, and so does this."""
