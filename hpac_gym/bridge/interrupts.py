"""Handling of signals that would end the program: they raise, so that the hand is released, and
wait during the release.
"""

import atexit
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from time import monotonic, sleep
from types import CodeType, FrameType
from typing import Any, NoReturn, ParamSpec, TypeVar
from weakref import WeakSet

_Given = ParamSpec("_Given")
_Result = TypeVar("_Result")
_SAME_INTENT = 1.0
"""A second signal within this time of the first counts as a repetition [s]."""
_TAKEN_WITHIN = 0.05
"""Time in which the main thread takes a signal, unless it waits in a call of the system [s]."""

_WAKE: int = getattr(signal, "SIGURG", 0)
"""A signal without an effect of its own; 0 where there is none."""


class _Interrupts:
    """Handles SIGINT, SIGTERM and SIGHUP from the import of the link on, unless the program has its
    own handlers. Without an open link each does what it did before.

    The first signal ends the links of other threads, which no exception would reach, and raises
    (`KeyboardInterrupt`, or `SystemExit` with 128 + its number), so that every `with` releases its
    hand. Signals that arrive while a link is being closed are delayed until it is closed. A second
    signal within a second is a repetition, and must not interrupt the clean-up that the first
    started.

    Python runs handlers in the main thread alone, but the system may give a signal to any thread,
    such as one of a BLAS library: all that come while the process is stopped (Ctrl-Z). Nothing then
    ends the main thread's wait, so a thread watches for such signals while there are links."""

    def __init__(self) -> None:
        self._closing: set[CodeType] = set()
        self._before: dict[int, Any] = {}
        self._came: socket.socket | None = None
        self._watched = False
        self.closing(type(self)._end_links)
        self.begin()
        atexit.register(self._end_links)  # at import: what a program registers later, runs before
        if hasattr(os, "register_at_fork"):  # not on Windows
            os.register_at_fork(after_in_child=self._begin_in_child)

    def begin(self) -> None:
        """Begin without links: in a new process, which a fork may have left its parent's."""
        # Weak: a link lost to an interrupt in its constructor is dropped.
        self._links: WeakSet[Any] = WeakSet()
        self._raised_at = -_SAME_INTENT
        self._held: list[int] = []
        self._ends_with_process = False

    def _begin_in_child(self) -> None:
        """Begin in a forked child, whose signals must not wake its parent."""
        if self._came is not None:
            signal.set_wakeup_fd(-1)
        self._came = None
        self._watched = False
        self.begin()

    def closing(self, function: Callable[_Given, _Result]) -> Callable[_Given, _Result]:
        """Mark a function during which signals are delayed."""
        self._closing.add(function.__code__)
        return function

    def install(self) -> None:
        """Install the handlers, in place of those of Python and of asyncio alone. This is possible
        only in the main thread.
        """
        if threading.current_thread() is not threading.main_thread():
            return
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)
            if number is not None and _is_default(handler := signal.getsignal(number)):
                self._before[number] = handler
                signal.signal(number, self._on_signal)
        if self._came is None and _WAKE and signal.getsignal(_WAKE) in (signal.SIG_DFL, _wake):
            self._came, self._wakes = socket.socketpair()
            self._wakes.setblocking(False)
            before = signal.set_wakeup_fd(self._wakes.fileno(), warn_on_full_buffer=False)
            if before != -1:  # of a loop that wakes up by itself
                signal.set_wakeup_fd(before)
            signal.signal(_WAKE, _wake)

    def link_opened(self, link: Any) -> None:
        """Take a link under protection.

        Args:
            link: has `end()` and the `thread` that opened it; it is ended also where a process of
                `multiprocessing` returns, which runs no other clean-up.
        """
        self.install()
        if not self._links:
            self._raised_at = -_SAME_INTENT
        if not self._ends_with_process and "multiprocessing.process" in sys.modules:
            from multiprocessing import parent_process, util

            if parent_process() is not None:
                util.Finalize(None, self._end_links, exitpriority=100)
                self._ends_with_process = True
        if self._came is not None and not self._watched:
            self._watched = True
            watcher = threading.Thread(target=_watch, args=(self._came, _WAKE), daemon=True)
            watcher.start()
        self._links.add(link)

    def link_closed(self, link: Any) -> None:
        """Take a link out of protection."""
        self._links.discard(link)

    def deliver(self, already_ending: bool) -> None:
        """Raise the delayed signal, unless the program is already ending because of an earlier
        one.
        """
        held = self._held
        self._held = []
        if held and not already_ending:
            self._raise(held[0])

    def _end_links(self, but_of: threading.Thread | None = None) -> None:
        """End the links of all threads but one; calls in progress end with `StoppedError`."""
        for link in list(self._links):
            if link.thread is not but_of:
                with suppress(Exception):
                    link.end()

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if not self._links:
            signal.signal(number, self._before[number])
            try:
                signal.raise_signal(number)
            finally:
                signal.signal(number, self._on_signal)
            return
        while frame is not None:
            if frame.f_code in self._closing:
                self._held.append(number)
                return
            frame = frame.f_back
        if monotonic() - self._raised_at >= _SAME_INTENT:
            self._end_links(but_of=threading.current_thread())
            self._raise(number)

    def _raise(self, number: int) -> NoReturn:
        self._raised_at = monotonic()
        if number == signal.SIGINT:
            raise KeyboardInterrupt
        raise SystemExit(128 + number)


def _watch(came: socket.socket, wake: int) -> None:
    """End the main thread's wait after each signal."""
    main = threading.main_thread().ident or 0
    while numbers := came.recv(4096):
        if set(numbers) != {wake}:
            sleep(_TAKEN_WITHIN)
            signal.pthread_kill(main, wake)


def _wake(_number: int, _frame: FrameType | None) -> None:
    """Handle a signal that only ends a wait."""


def _is_default(handler: Any) -> bool:
    """Whether a handler is Python's, or asyncio's, which only asks a task to end that may never
    listen.
    """
    if isinstance(handler, partial):
        return getattr(handler.func, "__qualname__", "") == "Runner._on_sigint"
    return handler in (signal.SIG_DFL, signal.default_int_handler)


interrupts = _Interrupts()
"""The instance of this process, since signal handlers belong to the process."""
interrupts.install()
