"""HandLink against the firmware as a process: real pseudo-terminal, real clock, pyserial."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from types import SimpleNamespace
from unittest.mock import Mock, call

import numpy as np
import pytest

from hpac_gym.bridge import (
    HandLink,
    HandshakeError,
    HostBoard,
    PortError,
    open_transport,
    pulses_from_servo,
    servo_from_pulses,
)
from hpac_gym.bridge.firmware import BUILD_VARIABLE
from hpac_gym.model import HPAC, ServoCommand, stream_command
from tests.processes import wait_for_the_end

POSE = np.array([0.5, 0.4, 0.3, 0.2, 0.1, 0.6])


def test_streamed_commands_are_acknowledged_and_the_pulses_decode_to_them(host_board):
    servo = np.zeros(6)
    with HandLink(host_board.connect) as link:
        link.arm(watchdog=2.0)
        for _ in range(20):
            command = stream_command(servo, HPAC.servo_max, 0.05)
            servo = command.servo
            link.move(command)
            link.wait()
            np.testing.assert_allclose(servo_from_pulses(host_board.pulses()), servo, atol=2e-4)
        assert link.statistics.rejected == 0
        link.move(ServoCommand(np.full(6, 1.3), 0.5))
        link.wait()
        changes = host_board.pulse_changes()  # of all of the last move
    assert len(changes) > 50
    assert 0.4e6 < changes[-1, 0] - changes[0, 0] < 0.6e6
    assert np.all(np.diff(changes[:, 1:], axis=0) <= 0)
    np.testing.assert_allclose(servo_from_pulses(changes[-1, 1:]), 1.3, atol=1e-4)


def test_a_change_that_comes_while_the_log_begins_anew_is_told(host_board, monkeypatch):
    log = host_board._log
    late = [b"9,1,2,3,4,5,6\n"]

    def read():
        read = log.read()
        if late:
            os.pwrite(log.fileno(), late.pop(), log.tell())
        return read

    monkeypatch.setattr("hpac_gym.bridge.hands._LONGEST_LOG", 0)
    with HandLink(host_board.connect) as link:
        link.arm(watchdog=2.0)
        host_board._log = Mock(wraps=log, read=read)
        assert host_board.pulses().min() > 6
        np.testing.assert_array_equal(host_board.pulses(), range(1, 7))
    assert host_board._read_to == 0


def test_a_stopped_board_is_a_timeout_and_never_a_hang(host_board, monkeypatch):
    monkeypatch.setattr("hpac_gym.bridge.connection.LAST_WORDS_TIME", 0.1)
    with HandLink(host_board.connect, handshake_timeout=1.0) as link:
        host_board.process.send_signal(signal.SIGSTOP)
        try:
            start = time.monotonic()
            with pytest.raises(TimeoutError):
                link.heartbeat()
            assert time.monotonic() - start < 20.0
            with pytest.raises(HandshakeError):
                link.connect()
        finally:
            host_board.process.send_signal(signal.SIGCONT)


def test_the_board_ends_with_its_parent(tmp_path):
    program = (
        "import os, sys; from hpac_gym.bridge import HostBoard\n"
        "board = HostBoard().__enter__(); print(board.process.pid, flush=True); os._exit(1)"
    )
    answer = subprocess.run(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, text=True, check=False
    )
    wait_for_the_end([int(answer.stdout)], 20)


def test_a_board_that_does_not_end_is_killed_after_a_second():
    stuck = Mock()
    stuck.wait.side_effect = [subprocess.TimeoutExpired("hpac_host", 1.0), None]
    with HostBoard() as board:
        process = board.process
        board.process = stuck
        board.__exit__()
        ends = [call.terminate(), call.wait(1.0), call.kill(), call.wait(), call.stdout.close()]
        assert stuck.mock_calls == ends
        board.process = process


def test_a_board_that_says_nothing_is_given_up_after_five_seconds(monkeypatch):
    waits = []
    monkeypatch.setattr(
        "hpac_gym.bridge.hands.select.select", lambda *words: waits.append(words[3]) or ([], [], [])
    )
    with pytest.raises(PortError, match="did not open a pseudo-terminal"):
        HostBoard().__enter__()
    assert waits == [5.0]


def test_a_board_leaves_no_folder_behind_even_if_its_program_does_not_start(monkeypatch, tmp_path):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with HostBoard():
        assert not list(tmp_path.iterdir())
    not_executable = tmp_path / "hpac_host"
    not_executable.touch()
    monkeypatch.setenv(BUILD_VARIABLE, str(tmp_path))
    with pytest.raises(PermissionError):
        HostBoard().__enter__()
    assert list(tmp_path.iterdir()) == [not_executable]


def test_a_replugged_board_is_found_again_and_not_armed():
    board = HostBoard()
    link = HandLink(board.connect)
    with board:
        link.connect()
        link.arm(watchdog=2.0)
        assert board.pulses().all()
    with pytest.raises(PortError):
        link.sleep(1.0)
    with pytest.raises(PortError, match="no such port"):
        link.connect()
    with board, link:
        assert link.state == "idle"
        assert not board.pulses().any()
        link.arm(watchdog=2.0)
        assert board.pulses().all()


def test_trims_and_directions_move_the_pulses_of_their_servo_alone_and_boot_text_none():
    arguments = ("--boot-text", "--trim", "2", "20000", "--reverse", "0")
    with HostBoard(arguments) as board, HandLink(board.connect) as link:
        link.arm(watchdog=2.0)
        link.move(ServoCommand(POSE, 0.5))
        link.wait()
        turned = board.pulses()
    expected = pulses_from_servo(POSE)
    expected[0] = 3_000_000 - expected[0]
    expected[2] += 20_000
    np.testing.assert_allclose(turned, expected, rtol=0, atol=1)  # a tie, rounded


class FakeSerial(SimpleNamespace):
    """Keeps what it was opened with; refuses to be shared, as on Windows, where every port is
    locked.
    """

    timeout = 0

    def open(self):
        if self.exclusive is False:
            raise ValueError("win32 only supports exclusive access (not: False)")
        self.opened_with = dict(vars(self))

    def reset_input_buffer(self):
        self.flushed = True


@pytest.mark.parametrize("lock", [True, False])
def test_dtr_and_rts_are_low_before_the_port_opens_which_no_system_refuses(monkeypatch, lock):
    made = Mock(return_value=FakeSerial(flushed=False))
    monkeypatch.setattr("hpac_gym.bridge.transport.serial.serial_for_url", made)
    opened = open_transport("/dev/ttyUSB9", lock=lock)._serial
    how = {"do_not_open": True, "timeout": 0, "write_timeout": 1.0}
    assert made.mock_calls == [call("/dev/ttyUSB9", **how)]
    low = {"dtr": False, "rts": False}
    exclusive = True if lock else None
    assert opened.opened_with == {
        **low,
        "exclusive": exclusive,
        "baudrate": 460_800,
        "flushed": False,
    }
    assert opened.flushed == lock
