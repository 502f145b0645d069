"""However a program ends, the hand ends without pulses, or the program says that this is not
confirmed.
"""

# ruff: noqa: PT012, PT031 - what a session raises comes out of all of it, its end included

import gc
import io
import math
import os
import re
import signal
import sys
import textwrap
import time
import warnings
from asyncio import CancelledError
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from itertools import count
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

import hpac_gym.bridge
from hpac_gym.bridge import (
    Action,
    FaultError,
    HandLink,
    HandshakeError,
    HostBoard,
    LinkTimeout,
    PortError,
    StoppedError,
    UnconfirmedWarning,
    VirtualHand,
    WireLog,
)
from hpac_gym.bridge.errors import LogWarning
from hpac_gym.bridge.hands import VirtualTransport
from hpac_gym.bridge.interrupts import interrupts
from hpac_gym.bridge.link import open_hand
from hpac_gym.bridge.protocol import Frame, decode, encode
from hpac_gym.model import HPAC, ServoCommand
from hpac_gym.virtual.wire import Faults
from tests.bridge.devices import LOST
from tests.processes import python, started, wait_for
from tools.evidence import user_programs

BRIDGE = str(Path(hpac_gym.bridge.__file__).parent)
POSE = ServoCommand(np.full(6, 0.4), 0.5)


@pytest.fixture(autouse=True)
def own_signals():
    """A signal of another test, less than a second ago, would make this one's a repetition; the
    handlers of a test end with it.
    """
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGALRM)}
    interrupts.begin()
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


# --- signals
# --------------------------------------------------------------------------------------------------------


@pytest.fixture
def short_arming(monkeypatch):
    """Fewer requests of STATUS while the hand arms, each of which runs the same lines."""
    monkeypatch.setattr("hpac_gym.bridge.link._ARM_POLL", 0.4)


def session_with_ctrl_c(at_line, again_after=None):
    """Play a session that gets SIGINT when so many lines of the bridge have run, and again so many
    seconds later.

    Returns:
        The hand, the lines that ran until tracing ended, what came out, and whether the second
        signal came.
    """
    hand = VirtualHand()
    lines = 0
    came_again = False

    def trace(frame, event, _argument):
        nonlocal lines
        if not frame.f_code.co_filename.startswith(BRIDGE):
            return None
        if event in ("call", "line"):
            lines += 1
            if lines == at_line:
                if again_after is not None:
                    signal.setitimer(signal.ITIMER_REAL, again_after)
                signal.raise_signal(signal.SIGINT)  # what this raises ends the tracing
        return trace

    def again(*_):
        nonlocal came_again
        came_again = True
        if not over:  # an alarm that waited until then would end the tests themselves
            signal.raise_signal(signal.SIGINT)

    came_out = None
    over = False
    signal.signal(signal.SIGALRM, again)
    try:
        sys.settrace(trace)
        try:
            with HandLink(hand.connect) as link:
                link.arm(Action.hold)
                link.move(POSE)
        finally:
            sys.settrace(None)
            over = True
            signal.setitimer(signal.ITIMER_REAL, 0)
    except BaseException as error:
        over = True
        came_out = error.with_traceback(None)  # whose frames would keep the link
    return hand, lines, came_out, came_again


DELAYS = (None, 2e-5, 1e-4, 3e-4)


def check_ctrl_c(lines):
    interrupted = reached = twice = 0
    for number, at in enumerate(lines):
        hand, ran, came_out, came_again = session_with_ctrl_c(at, DELAYS[number % len(DELAYS)])
        assert not hand.pulses().any(), at
        assert came_out is None or isinstance(came_out, KeyboardInterrupt), at
        reached += ran >= at
        interrupted += came_out is not None
        twice += came_again
    assert interrupted > 0.9 * reached, "a Ctrl-C was swallowed"
    assert reached > 0.6 * len(lines)
    assert twice > 0.1 * len(lines)
    with pytest.raises(KeyboardInterrupt):  # without a link, too
        signal.raise_signal(signal.SIGINT)


def test_ctrl_c_at_any_line_and_again_leaves_no_pulses(short_arming):
    # The first session runs lines whose results are kept.
    _, last = (session_with_ctrl_c(0)[1] for _ in range(2))
    anywhere = np.random.default_rng(1).choice(np.arange(1, last - 400), 60, replace=False).tolist()
    check_ctrl_c(anywhere + list(range(last - 400, last, 4)))


@pytest.mark.slow
def test_ctrl_c_at_every_fourth_line_leaves_no_pulses(short_arming):
    check_ctrl_c(list(range(1, session_with_ctrl_c(0)[1], 4)))


class Signalling(VirtualTransport):
    """Raises SIGTERM while the link clears the hand."""

    def write(self, data):
        if decode(data[1:-1]).name == "clear":
            signal.raise_signal(signal.SIGTERM)
        super().write(data)


@pytest.mark.parametrize("ending", [None, GeneratorExit, CancelledError])
def test_a_signal_that_came_during_the_release_is_delivered_after_it(virtual_hand, ending):
    """Also where a closed generator or a cancelled task releases the hand."""
    with pytest.raises(SystemExit) as caught, HandLink(lambda: Signalling(virtual_hand)) as link:
        link.arm(Action.hold)
        if ending:
            raise ending
    assert caught.value.code == 128 + signal.SIGTERM
    assert not virtual_hand.pulses().any()


def test_a_second_ctrl_c_repeats_the_first_for_a_second(virtual_hand, monkeypatch):
    clock = [50.0]
    monkeypatch.setattr("hpac_gym.bridge.interrupts.monotonic", lambda: clock[0])

    def raises(at):
        clock[0] = at
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            return True
        return False

    with HandLink(virtual_hand.connect):
        assert [raises(at) for at in (50.0, 50.99, 51.0, 51.5)] == [True, False, True, False]
    with HandLink(virtual_hand.connect):
        assert raises(51.6), "a new link begins anew"


def test_a_program_keeps_its_own_signal_handlers(virtual_hand):
    seen = []
    signal.signal(signal.SIGTERM, lambda number, _frame: seen.append(number))
    with HandLink(virtual_hand.connect) as link:
        link.arm()
        signal.raise_signal(signal.SIGTERM)
        assert link.heartbeat() == "armed"
    assert seen == [signal.SIGTERM]


# --- processes
# ------------------------------------------------------------------------------------------------------

PROGRAM = """
import os, signal, sys, time, warnings
from hpac_gym.bridge import *
from hpac_gym.model import HPAC, ServoCommand
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGTERM, signal.SIG_DFL)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
link = HandLink(sys.argv[1])
"""
SESSION = """
with link:
    link.arm(Action.hold, watchdog=2.0)
    link.move(ServoCommand([0.4] * 6, 0.5))
    print("armed", flush=True)
"""


def session(body):
    """A program that arms the hand and goes on with `body`."""
    return SESSION + textwrap.indent(body, "    ")


def run_against(board, program, *signals):
    """A program of its own that arms the hand; gets the signals once it is armed."""
    with started("-c", PROGRAM + program, board.port) as process:
        assert process.stdout.readline().strip() == "armed"
        # So that all the signals find it in the session, however busy the machine is.
        process.send_signal(signal.SIGSTOP)
        os.waitid(os.P_PID, process.pid, os.WSTOPPED)
        for number in signals:
            process.send_signal(number)
        process.send_signal(signal.SIGCONT)
        _, complaint = process.communicate(timeout=60)
    return process.returncode, complaint


IN_A_THREAD = """
import threading

def drive():
    with HandLink(sys.argv[1]) as link:
        link.arm(Action.hold, watchdog=2.0)
        print("armed", flush=True)
        while True:
            link.sleep(0.1)

thread = threading.Thread(target=drive)
thread.start()
thread.join()
"""
IN_A_CHILD = """
import multiprocessing

def drive():
    global kept
    kept = HandLink(sys.argv[1])
    kept.connect()
    kept.arm(Action.hold, watchdog=2.0)
    print("armed", flush=True)

child = multiprocessing.get_context("fork").Process(target=drive)
child.start()
child.join()
"""
IN_A_TASK = """
import asyncio

async def drive():
    with HandLink(sys.argv[1]) as link:
        link.arm(Action.hold, watchdog=2.0)
        print("armed", flush=True)
        while True:
            link.sleep(0.1)  # blocks: the loop never sees a request to end the task

asyncio.run(drive())
"""


TO_ANOTHER_THREAD = session(
    """
import threading

def signalled():
    time.sleep(0.3)
    signal.pthread_kill(threading.get_ident(), signal.SIGTERM)

threading.Thread(target=signalled).start()
time.sleep(600)  # no signal ends this wait: the system has given it to the other thread
"""
)
UNCLOSED = "link.connect(); link.arm(Action.hold); print('armed', flush=True)"
OPENED_LATE = """
import atexit

def late():
    link.connect()
    link.arm(Action.hold)
    print("armed", flush=True)

atexit.register(late)
"""
SLEEPING = session("link.sleep(60)")
HUNG = session("time.sleep(60)")
ENDS = {
    "exit": (session("sys.exit(5)"), [], 5),
    "ctrl-c": (SLEEPING, [signal.SIGINT], -signal.SIGINT),
    "ctrl-c twice": (HUNG, [signal.SIGINT, signal.SIGINT], -signal.SIGINT),
    "sigterm": (SLEEPING, [signal.SIGTERM], 128 + signal.SIGTERM),
    "more": (SLEEPING, [signal.SIGHUP, signal.SIGTERM, signal.SIGINT], 128 + signal.SIGHUP),
    "thread, sigterm": (IN_A_THREAD, [signal.SIGTERM], 128 + signal.SIGTERM),
    "sigterm to another thread": (TO_ANOTHER_THREAD, [], 128 + signal.SIGTERM),
    "child process": (IN_A_CHILD, [], 0),
    "blocking task, ctrl-c": (IN_A_TASK, [signal.SIGINT], -signal.SIGINT),
    "nobody closes it": (UNCLOSED, [], 0),
    "opened while the program ends": (OPENED_LATE, [], 0),
}
"""Programs, the signals that they get once they are armed, and their exit statuses."""


def check_end(program, signals, status):
    with HostBoard() as board:
        returned, complaint = run_against(board, program, *signals)
        assert returned == status, complaint
        assert not board.pulses().any(), complaint
        assert "Unconfirmed" not in complaint
        with HandLink(board.connect) as link:
            assert link.state == "idle", complaint


def test_programs_that_end_leave_their_hands_without_pulses_and_their_ports_free():
    with ThreadPoolExecutor(3) as pool:  # they wait most of the time
        ended = {name: pool.submit(check_end, *ENDS[name]) for name in ENDS}
    wrong = {name: end.exception() for name, end in ended.items() if end.exception()}
    assert not wrong


def test_a_signal_ends_conform_without_pulses(host_board):
    with started("-m", "hpac", "conform", "--port", host_board.port) as process:
        wait_for(lambda: host_board.pulses().all())
        process.terminate()
        assert process.wait(60) == 128 + signal.SIGTERM
    wait_for(lambda: not host_board.pulses().any(), 3)


def test_a_system_without_fork_and_its_signals_has_links_too():
    program = """
import logging, os, random, signal, threading
del os.register_at_fork, signal.SIGURG, signal.SIGHUP, signal.pthread_kill
from hpac_gym.bridge import HandLink, VirtualHand
with HandLink(VirtualHand().connect) as link:
    print(link.state)
"""
    done = python("-c", program)
    assert done.stdout == "idle\n", done.stderr


def test_a_link_of_a_thread_is_ended_by_a_signal_though_the_main_thread_has_imported_it_alone():
    program = """
import signal, threading
from hpac_gym.bridge import Action, HandLink, VirtualHand
hand = VirtualHand()

def drive():
    with HandLink(hand.connect) as link:
        link.arm(Action.hold)
        signal.pthread_kill(threading.main_thread().ident, signal.SIGTERM)
        while True:
            link.sleep(0.1)

thread = threading.Thread(target=drive)
thread.start()
try:
    thread.join()
finally:
    print(hand.pulses().any())
"""
    done = python("-c", program)
    assert (done.returncode, done.stdout) == (128 + signal.SIGTERM, "False\n"), done.stderr


def test_an_error_of_the_port_s_close_hides_neither_the_user_s_nor_the_end(virtual_hand, overheard):
    overheard.close = Mock(side_effect=OSError("it does not close"))
    with pytest.raises(ZeroDivisionError), HandLink(lambda: overheard) as link:
        link.arm(Action.hold)
        raise ZeroDivisionError
    assert link._connection.ended
    assert not virtual_hand.pulses().any()


def test_a_blackout_at_the_end_does_not_leave_a_holding_hand_on(virtual_hand):
    """Half a second without a byte in either direction, as when a cable is pulled and put back."""

    class Dark(VirtualTransport):
        since = math.inf

        def write(self, data):
            if not self.since <= self.now() < self.since + 0.5:
                super().write(data)

    transport = Dark(virtual_hand)
    with HandLink(lambda: transport, timeout=0.02) as link:
        link.arm(Action.hold, watchdog=2.0)
        transport.since = transport.now()
    assert not virtual_hand.pulses().any()


@pytest.mark.parametrize(("latency", "fault"), [(0.12, "none"), (0.29, "none"), (0.4, "estop")])
def test_a_late_answer_confirms_and_a_stop_that_came_before_it_is_told(
    virtual_hand, overheard, latency, fault
):
    link = HandLink(lambda: overheard)
    link.connect()
    link.arm()
    overheard.spoil(latency=latency)
    late = pytest.warns(UserWarning, match="ESTOP was sent")
    with late if fault == "estop" else nullcontext():
        link.close()
    with HandLink(virtual_hand.connect) as after:
        assert after.status().fault == fault


@pytest.mark.parametrize("closed", [False, True])
def test_long_last_words_are_told_and_go_on_though_standard_error_is_closed(
    overheard, monkeypatch, closed
):
    monkeypatch.setattr("hpac_gym.progress.monotonic", count().__next__)
    stderr = io.StringIO()
    monkeypatch.setattr(sys, "stderr", stderr)
    with pytest.warns(UnconfirmedWarning, match=r"ESTOP × \d\d"):
        with HandLink(lambda: overheard, timeout=0.02) as link:
            link.arm(Action.hold)
            overheard.there.faults = LOST
            if closed:
                stderr.close()
    assert closed or stderr.getvalue() == "asking the hand to stop: no answer yet\n"


def test_a_link_that_was_taken_over_leaves_the_new_controller_its_hand(virtual_hand, link):
    link.arm(Action.hold)
    with HandLink(virtual_hand.connect) as new:
        new.arm(Action.hold, watchdog=2.0)
        with pytest.warns(UnconfirmedWarning, match="another program has greeted the hand"):
            link.close()
        assert new.heartbeat() == "armed"
        assert virtual_hand.pulses().all()


def test_a_killed_program_leaves_the_hand_safe_within_the_watchdog_time(host_board):
    move = "link.move(ServoCommand([0.5] * 6, 10.0))"
    program = f"link.connect(); link.arm(Action.detach); {move}; print('armed', flush=True); link.sleep(60)"
    assert run_against(host_board, program, signal.SIGKILL)[0] == -signal.SIGKILL
    # The hand's watchdog of 0.4 s, and a busy machine.
    wait_for(lambda: not host_board.pulses().any(), 20)
    with HandLink(host_board.connect) as link:
        with pytest.raises(FaultError, match="watchdog"):
            link.arm()


@pytest.mark.parametrize("streams", [False, True])
def test_a_link_that_is_forgotten_is_closed(virtual_hand, streams):
    link = HandLink(virtual_hand.connect)
    link.connect()
    link.arm(Action.hold)
    if streams:
        link.stream().send(POSE.servo)
    del link
    gc.collect()
    assert not virtual_hand.pulses().any()


def test_a_forks_child_neither_disarms_nor_closes_the_hand(host_board):
    body = """
warnings.simplefilter("ignore")
for ending in ("os._exit(0)", "sys.exit(0)", "raise ValueError", "signal.raise_signal(signal.SIGTERM)"):
    child = os.fork()
    if not child:
        try:
            link.estop()
        except PortError:
            exec(ending)
        os._exit(9)
    while not (ended := os.waitpid(child, os.WNOHANG))[0]:
        link.sleep(0.05)
    assert os.waitstatus_to_exitcode(ended[1]) != 9, ending
    assert link.heartbeat() == "armed", ending
link.sleep(0.3)
assert len(link.status().attached) == 6
"""
    returned, complaint = run_against(host_board, session(body))
    assert returned == 0, complaint
    assert not host_board.pulses().any()


@pytest.mark.parametrize(
    "call", [HandLink.estop, HandLink.heartbeat, HandLink.clear, HandLink.status]
)
def test_no_call_of_another_process_reaches_the_hand(virtual_hand, armed, call):
    armed._connection._owner += 1
    sent = armed.statistics.sent
    with pytest.raises(PortError, match="belongs to process"):
        call(armed)
    assert armed.statistics.sent == sent
    armed._connection._owner -= 1


# --- answers and links that are lost
# --------------------------------------------------------------------------------


@pytest.fixture
def left_holding(virtual_hand, overheard):
    """A hand that holds in a fault: an earlier session has lost it."""
    with pytest.warns(UnconfirmedWarning), HandLink(lambda: overheard) as link:
        link.arm(Action.hold)
        overheard.spoil(loss=1.0)
    virtual_hand.run(1.0)
    assert virtual_hand.pulses().all()
    return virtual_hand


def test_answers_lost_while_arming_leave_no_pulses(virtual_hand, overheard):
    with pytest.warns(UnconfirmedWarning, match="CLEAR × 1[0-9]"):
        with pytest.raises(LinkTimeout) as caught, HandLink(lambda: overheard) as link:
            overheard.back.faults = LOST
            link.arm(Action.hold)
    assert "not confirmed" in caught.value.__notes__[0]
    assert not virtual_hand.pulses().any()


def test_a_dead_link_is_told_of_and_the_users_exception_survives(overheard):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(ZeroDivisionError) as caught, HandLink(lambda: overheard) as link:
            link.arm(Action.detach)
            overheard.spoil(loss=1.0)
            raise ZeroDivisionError
    assert re.search(r"CLEAR × \d+, ESTOP × \d+", caught.value.__notes__[0])
    assert "supply" in caught.value.__notes__[0]


def test_a_fault_that_holds_ends_with_the_session(virtual_hand):
    with pytest.raises(FaultError), HandLink(virtual_hand.connect) as link:
        link.arm(Action.hold)
        virtual_hand.run(0.7)
        link.move(POSE)
    assert not virtual_hand.pulses().any()


def close_and_fall_silent(link, hand):
    """Leave a closed hand that begins to relax after the watchdog."""
    link.arm()
    link.move(POSE)
    link.wait()
    hand.run(0.5)


def require_relaxed(hand, fault):
    """The hand is at rest, where CLEAR would have left it closed, without pulses and in its fault."""
    assert not hand.pulses().any()
    link = HandLink(hand.connect)
    assert link.connect().state == "fault"
    status = link.status()
    assert status.fault == fault
    np.testing.assert_allclose(
        status.servo, np.clip(0.0, HPAC.servo_min, HPAC.servo_max), atol=1e-3
    )


def test_a_hand_that_relaxes_in_a_fault_is_waited_for_and_left_in_it(virtual_hand):
    with pytest.raises(FaultError, match="watchdog"), HandLink(virtual_hand.connect) as link:
        close_and_fall_silent(link, virtual_hand)
        link.move(POSE)
    require_relaxed(virtual_hand, "watchdog")


def test_who_opens_and_disarms_a_hand_in_a_fault_is_told_and_does_not_clear_it(virtual_hand):
    with pytest.raises(FaultError, match="watchdog"), HandLink(virtual_hand.connect) as link:
        close_and_fall_silent(link, virtual_hand)
        open_hand(link)
        link.clear()
    require_relaxed(virtual_hand, "watchdog")


def test_a_program_that_is_refused_lets_the_hand_of_another_relax(virtual_hand, link):
    close_and_fall_silent(link, virtual_hand)
    with pytest.raises(FaultError, match="watchdog"), HandLink(virtual_hand.connect) as other:
        assert virtual_hand.pulses().all()
        other.arm()
    link.close()
    require_relaxed(virtual_hand, "watchdog")


def test_the_next_session_ends_a_fault_that_holds(left_holding):
    with HandLink(left_holding.connect) as link:
        assert link.state == "fault"
    assert not left_holding.pulses().any()


def test_a_hand_that_nobody_can_hear_is_cleared_when_the_handshake_fails(left_holding, overheard):
    overheard.there.faults = Faults()
    with pytest.raises(HandshakeError) as caught:
        HandLink(lambda: overheard, handshake_timeout=0.3).connect()
    assert "not confirmed" in caught.value.__notes__[0]
    assert not left_holding.pulses().any()


def test_a_stop_of_which_another_program_has_read_all_is_left_for_somebody_to_clear(virtual_hand):
    with HandLink(virtual_hand.connect) as link:
        link.arm(Action.hold)
        virtual_hand.receive(encode(Frame("estop", 1)))
        virtual_hand.transmit()
    assert HandLink(virtual_hand.connect).connect().state == "fault"


# --- logs
# -----------------------------------------------------------------------------------------------------------


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_log_that_is_not_on_the_disk_is_an_error_of_its_own_block(virtual_hand):
    with pytest.raises(OSError, match="space"), WireLog("/dev/full") as log:
        log.record(0.0, "sent", b"\x01", Frame("estop", 7))


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_full_disk_neither_stops_an_estop_nor_hides_the_users_exception(virtual_hand):
    with pytest.warns(LogWarning, match="space"):
        with (
            pytest.raises(ZeroDivisionError),
            WireLog("/dev/full") as log,
            HandLink(virtual_hand.connect, log=log) as link,
        ):
            link.arm(Action.hold)
            for _ in range(300):
                link.estop()
            assert not virtual_hand.pulses().any()
            raise ZeroDivisionError


def test_a_log_that_fails_is_told_once_even_where_warnings_are_errors(virtual_hand, capsys):
    broken = Mock(record=Mock(side_effect=RuntimeError("broken log")))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with HandLink(virtual_hand.connect, log=broken) as link:
            told = capsys.readouterr().err
            link.arm(Action.hold)
    assert told.count("broken log") == 1, "the first frame tells"
    assert not capsys.readouterr().err


def test_an_end_that_is_not_confirmed_raises_nothing_though_standard_error_is_closed():
    program = """
import sys, warnings
from hpac_gym.bridge import HandLink, VirtualHand

for warns in ("default", "error"):
    warnings.simplefilter(warns)
    link = HandLink(VirtualHand().connect)
    link.connect()
    link.arm()
    link.exchange.transport.write = lambda data: None
    sys.stderr.close()
    link.close()
    print("closed")
"""
    assert python("-c", program).stdout == "closed\nclosed\n"


# --- e-stop from elsewhere
# ------------------------------------------------------------------------------------------


def test_estop_from_a_signal_handler_ends_the_interrupted_call(host_board):
    with HandLink(host_board.connect) as link:
        signal.signal(signal.SIGALRM, lambda *_: link.estop())
        told = 0
        for delay in np.linspace(0.002, 0.05, 4):
            link.clear()
            link.arm(Action.hold)
            signal.setitimer(signal.ITIMER_REAL, delay)
            try:
                while link.state != "fault":
                    link.status()
            except StoppedError as error:
                told += "stopped by estop()" in str(error)
            assert link.state == "fault"
            assert not host_board.pulses().any()
        assert told >= 2, (
            "an e-stop between two calls interrupts none of them, but most come during one"
        )


@pytest.mark.parametrize("stop", [HandLink.estop, HandLink.close])
def test_estop_and_close_from_another_thread_end_the_call_that_waits(host_board, stop):
    link = HandLink(host_board.connect)
    link.connect()
    link.arm(Action.hold)
    for wait in (
        lambda: link.sleep(30),
        lambda: link.sleep(math.inf),  # of a hand that is not armed
        lambda: [link.status() for _ in range(10**6)],
    ):
        start = time.monotonic()
        with ThreadPoolExecutor() as pool:
            stopped = pool.submit(lambda: time.sleep(0.05) or stop(link))
            with pytest.raises(StoppedError, match=rf"{stop.__name__}\(\)"):
                wait()
        assert time.monotonic() - start < 20.0
        stopped.result()  # raises what `stop` has raised
        assert not host_board.pulses().any()
        if stop is HandLink.estop:
            assert link.status().fault == "estop"
            link.clear()
        else:
            with pytest.raises(PortError, match="not connected"):
                link.heartbeat()
            link.connect()
    link.close()


def test_an_estop_that_is_not_confirmed_says_so(virtual_hand, overheard):
    with pytest.warns(UnconfirmedWarning), HandLink(lambda: overheard) as link:
        link.arm()
        overheard.back.faults = LOST
        with pytest.raises(LinkTimeout, match="estop"):
            link.estop()
        assert not virtual_hand.pulses().any()


def left_by(count, seed, control=""):
    """What the programs of users left, without those that left nothing."""
    verdicts = user_programs.run_programs(count, seed, control=control)
    assert sum("armed" in verdict.output for verdict in verdicts) > count / 3
    return [verdict.left for verdict in verdicts if verdict.left], user_programs.summary(verdicts)


def test_programs_of_users_leave_no_hand_on_and_no_port_locked():
    """A few of the 300 that `python -m tools.evidence.user_programs` draws."""
    assert left_by(4, seed=2)[0] == []


@pytest.mark.slow
def test_thirty_programs_of_users_leave_no_hand_on_and_no_port_locked():
    left, told = left_by(30, seed=3)
    assert left == [], told


@pytest.mark.slow
@pytest.mark.parametrize(
    ("control", "what"),
    [("handlers", "on"), ("release", "on"), ("finalizer", "on"), ("close", "locked")],
)
def test_without_a_part_of_the_ending_some_programs_leave_something(control, what):
    left, told = left_by(60, seed=4, control=control)
    assert what in left, told
