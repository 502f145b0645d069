"""hpac wiggle and doctor."""

import dataclasses
import json
import subprocess
import sys
import time
from contextlib import ExitStack, nullcontext
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from hpac_gym.bridge import (
    Action,
    HandLink,
    HandshakeError,
    LinkTimeout,
    PortError,
    RejectedError,
    Reset,
    UnconfirmedWarning,
    VirtualHand,
    commands,
    servo_from_pulses,
    stop,
)
from hpac_gym.bridge.commands import connector, send_and_hold
from hpac_gym.bridge.doctor import diagnose
from hpac_gym.bridge.hands import config_of, default_config
from hpac_gym.bridge.protocol import Fault, Frame, State, encode
from hpac_gym.model import HPAC, SERVOS, ServoCommand, hand_to_toml
from tests.bridge.devices import (
    Device,
    hello_alone,
    of_another_version,
    of_zeros,
    refusing,
    without_status,
)
from tests.options import called
from tests.processes import python, started, wait_for


@pytest.fixture
def slower_hand(tmp_path):
    """A hand of half the rate limit, and its file."""
    hand = dataclasses.replace(HPAC, rate_limit=HPAC.rate_limit / 2)
    path = tmp_path / "slower.toml"
    path.write_text(hand_to_toml(hand))
    return hand, path


def run(name, *words):
    command = SimpleNamespace(add_arguments=getattr(commands, f"add_{name}", stop.add_arguments))
    return called(command, *words)


def test_wiggle_moves_each_servo_alone_next_to_its_name(capsys, monkeypatch):
    trace = []
    hand = VirtualHand(10_000, on_pulses=lambda now_us, pulses: trace.append(pulses))
    monkeypatch.setattr("hpac_gym.bridge.commands.VirtualHand", lambda config: hand)
    assert run("wiggle", "--port", "virtual") == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(": ")[1].split()[0] for line in lines] == list(SERVOS)
    pulses = np.array(trace)
    armed = pulses[pulses.all(axis=1)]
    moved = armed != armed[0]
    assert moved.sum(axis=1).max() == 1
    first_moves = [int(np.argmax(moved[:, i])) for i in range(6)]
    assert first_moves == sorted(first_moves)


@pytest.mark.parametrize(
    ("servo", "angle", "move"),
    [("index_mcp", "0.3", 0.8), ("index_mcp", "1.2", 1.2), ("thumb_cmc", "1.5", 1.5)],
)
def test_wiggle_takes_its_time(servo, angle, move, monkeypatch):
    hand = VirtualHand()
    monkeypatch.setattr("hpac_gym.bridge.commands.VirtualHand", lambda config: hand)
    with HandLink(hand.connect) as link:
        link.arm()
        link.clear()
    begun = hand.now_us
    assert run("wiggle", "--port", "virtual", "--servo", servo, "--angle", angle) == 0
    # After the start from rest.
    assert (hand.now_us - begun) * 1e-6 == pytest.approx(0.4 + 2 * (move + 0.2), abs=0.15)


def test_doctor_without_any_port_says_what_to_do(capsys, monkeypatch):
    monkeypatch.setattr("hpac_gym.bridge.commands.find_ports", list)
    assert run("doctor", "--json") == 1
    (finding,) = json.loads(capsys.readouterr().out)
    assert not finding["healthy"]
    assert "plug" in finding["advice"]


def test_doctor_names_each_illness():
    shifted = default_config()
    shifted[0].trim_ns = 900_000
    ill = {
        "supply": VirtualHand(reset=Reset.brownout),
        "crashed": VirtualHand(reset=Reset.crash),
        "pins.h": VirtualHand(config=shifted),
    }
    for advice, hand in ill.items():
        finding = diagnose("here", hand.connect)
        assert not finding.healthy
        assert advice in finding.advice
    noisy = VirtualHand()
    for _ in range(30):
        noisy.receive(encode(Frame("heartbeat", 1, 0, {"session": 1}))[:-2] + b"\x77\0")
    assert "line noise" in diagnose("here", noisy.connect).advice
    unplugged = VirtualHand()
    unplugged.plugged = False
    assert not diagnose("here", unplugged.connect).healthy


def test_a_hot_hand_is_told_with_its_heat_and_the_limit():
    hand = VirtualHand()
    with HandLink(hand.connect) as link:
        link.arm()
        for _ in range(400):
            link.move(ServoCommand(HPAC.servo_max, 1.0))
            if link.status().heat.max() >= 0.89:
                break
        link.clear()
        with pytest.raises(RejectedError, match=r"thumb_mp: heat 8\d%, allowed below 80% \(state"):
            link.arm()
    finding = diagnose("here", hand.connect)
    assert not finding.healthy
    assert "heat up to 8" in finding.what
    assert "cool below 80%" in finding.advice


def test_doctor_does_not_touch_an_armed_hand(virtual_hand, armed):
    armed.status(period=0.02)
    before = virtual_hand.pulses()
    finding = diagnose("here", virtual_hand.connect)
    assert finding.healthy is True
    assert "armed by session" in finding.what
    assert "estop" in finding.advice
    np.testing.assert_array_equal(virtual_hand.pulses(), before)
    assert armed.heartbeat() == "armed"
    received = armed.statistics.received
    armed.sleep(0.2)
    assert armed.statistics.received - received >= 10, (
        "the other program's periodic STATUS has ended"
    )


def test_doctor_names_the_hand_that_a_firmware_was_built_for(slower_hand, tmp_path):
    hand, _ = slower_hand
    finding = diagnose("here", VirtualHand().connect, hand)
    assert not finding.healthy
    assert "--hand" in finding.advice
    assert diagnose("here", VirtualHand(config=config_of(hand)).connect, hand).healthy


@pytest.mark.parametrize(
    ("reply", "what", "advice"),
    [
        (lambda data: b"", "silence", "powered"),
        (lambda data: data, "echo", "jumper"),
        (
            lambda data: b"Grbl 1.1\r\n" * 200,
            "text instead of frames (4096 bytes, such as 'Grbl 1.1')",
            "another firmware",
        ),
        (lambda data: bytes(range(1, 255, 7)), "neither frames nor text", "baud"),
        (of_another_version, "protocol 9", "flash"),
        (refusing, "HELLO with an ACK (length)", "flash"),
        (without_status, "STATUS with an ACK (type)", "flash"),
        (hello_alone, "answers only some messages", "line noise"),
    ],
    ids=["silence", "echo", "text", "noise", "version", "ack", "status", "some"],
)
def test_doctor_tells_devices_apart_and_names_the_first_step(reply, what, advice):
    finding = diagnose("here", lambda: Device(VirtualHand(), reply))
    assert not finding.healthy
    assert what in finding.what
    assert advice in finding.advice


def test_doctor_sees_a_port_in_use_and_does_not_disturb_it(host_board):
    with HandLink(host_board.connect) as link:
        link.arm()
        finding = diagnose(host_board.port, host_board.port)
        assert "used by another program" in finding.what
        assert link.heartbeat() == "armed"


# --- clear, estop, --hand
# -------------------------------------------------------------------------------------------


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_an_estop_is_sent_and_told_whatever_standard_output_is(host_board):
    said = "stopped: no pulses, fault estop; `hpac clear` leaves it\n"
    with HandLink(host_board.connect) as link:
        link.arm(Action.hold)
        for output, told in ((">&-", said), ("> /dev/full", said), ("> /dev/full 2>&1", "")):
            command = f"exec {sys.executable} -m hpac estop --port {host_board.port} {output}"
            done = subprocess.run(command, shell=True, stderr=subprocess.PIPE, text=True)
            assert (done.returncode, done.stderr) == (0, told)
            assert not host_board.pulses().any()


RUNNING = {
    "posture": "import hpac; hpac.main(['posture', 'fist', '--port', PORT])",
    "moves": """
from hpac_gym.bridge import HandLink
from hpac_gym.model import ServoCommand
import numpy as np
with HandLink(PORT) as link:
    link.arm()
    while True:
        for angle in (0.3, 0.0):
            link.move(ServoCommand(np.full(6, angle), 0.3))
""",
}


@pytest.mark.parametrize("program", RUNNING)
def test_estop_from_a_second_terminal_stops_a_running_program(program, host_board):
    script = f"PORT = {host_board.port!r}\n{RUNNING[program]}"
    with started("-c", script) as running:
        wait_for(lambda: host_board.pulses().all(), 30)
        done = python("-m", "hpac", "estop", "--port", host_board.port)
        assert (done.returncode, done.stdout[:7]) == (0, "stopped"), done.stderr
        assert not host_board.pulses().any()
        assert "estop" in running.communicate(timeout=30)[1]
        assert not host_board.pulses().any()
        assert "fault estop" in diagnose(host_board.port, host_board.port).what


def test_a_stop_loads_neither_numpy_nor_gymnasium(tmp_path):
    """It must not wait for them: the first byte leaves within some hundredths of a second."""
    script = f"""
import sys, hpac
status = hpac.main(["estop", "--port", {str(tmp_path / "none")!r}])
print(status, sorted({{"numpy", "gymnasium", "scipy"}} & set(sys.modules)))
"""
    done = python("-c", script)
    assert done.stdout == "2 []\n"
    assert "switch the servo supply off" in done.stderr


def test_clear_leaves_a_fault_that_holds(host_board, capsys, monkeypatch):
    monkeypatch.setattr("hpac_gym.bridge.connection.LAST_WORDS_TIME", 0.1)
    with pytest.warns(UnconfirmedWarning), HandLink(host_board.connect) as link:  # noqa: PT031
        link.arm(Action.hold)
        link.exchange.transport.write = lambda data: None
    time.sleep(0.6)
    assert host_board.pulses().all()
    assert run("clear", "--port", host_board.port) == 0
    assert capsys.readouterr().out == "left fault watchdog; state idle, pulses on 0 servos\n"
    assert not host_board.pulses().any()


def test_an_estop_that_nobody_confirms_says_what_to_do(monkeypatch):
    monkeypatch.setattr(
        "hpac_gym.bridge.commands.VirtualHand.connect", lambda self: Device(self, lambda data: b"")
    )
    with pytest.raises(
        LinkTimeout, match=r"switch the servo supply off: no answer to estop for 3 s"
    ):
        run("estop", "--port", "virtual")
    with pytest.raises(PortError, match="switch the servo supply off: /dev/does_not_exist"):
        run("estop", "--port", "/dev/does_not_exist")


@pytest.mark.parametrize(
    ("attached", "fault", "confirms"),
    [
        (0, Fault.none, False),
        (0, Fault.watchdog, False),
        (1, Fault.estop, False),
        (0, Fault.estop, True),
    ],
)
def test_a_status_confirms_an_estop_by_its_fault_and_no_pulses(attached, fault, confirms):
    """Nothing else of the hand arrives; an idle hand whose ESTOP is lost has no pulses either."""
    state = State.fault if fault else State.idle
    said = encode(of_zeros("device_status", state=state, fault=fault, attached=attached))
    device = Device(VirtualHand(), lambda data: said)
    refused = pytest.raises(LinkTimeout, match="no answer to estop for 3 s")
    with nullcontext() if confirms else refused:
        stop.stop(device)


def test_a_hand_file_that_cannot_be_read_does_not_disturb_an_estop(host_board, tmp_path):
    assert run("estop", "--port", host_board.port, "--hand", str(tmp_path / "no.toml")) == 0
    assert not host_board.pulses().any()


def test_the_port_host_starts_a_board_for_as_long_as_the_command_runs(capsys):
    assert run("doctor", "--port", "host") == 0
    assert "ok  host: hand with firmware" in capsys.readouterr().out
    with ExitStack() as stack:
        board = connector("host", stack).__self__
        assert board.process.poll() is None
    assert board.process.poll() is not None
    assert connector("/dev/ttyUSB0", stack) == "/dev/ttyUSB0"


@pytest.mark.parametrize("command", ["wiggle", "doctor", "clear", "estop", "conform"])
def test_every_command_takes_the_hand_of_a_file(command, slower_hand, capsys):
    _, path = slower_hand
    assert run(command, "--port", "virtual", "--hand", str(path)) == 0
    assert "BROKEN" not in capsys.readouterr().out


def test_limits_of_another_hand_are_refused_by_name(slower_hand, host_board):
    _, path = slower_hand
    with pytest.raises(HandshakeError, match="--hand FILE"):
        run("wiggle", "--port", host_board.port, "--hand", str(path))


def test_a_posture_is_sent_with_the_limits_of_its_own_hand(slower_hand, monkeypatch, capsys):
    hand, _ = slower_hand
    virtual = VirtualHand(config=config_of(hand))
    send_and_hold("virtual", [ServoCommand(np.full(6, 0.5), 0.1)], hand)
    assert capsys.readouterr().err == "arrived\n"
    monkeypatch.setattr("hpac_gym.bridge.commands.connector", lambda *_: virtual.connect)
    monkeypatch.setattr(HandLink, "sleep", interrupt_once_there(virtual, HandLink.sleep))
    send_and_hold("here", [ServoCommand(np.full(6, 0.5), 0.1)], hand)
    assert not virtual.pulses().any()
    with pytest.raises(HandshakeError, match="limits"):
        send_and_hold("here", [ServoCommand(np.full(6, 0.5), 0.1)], HPAC)


def interrupt_once_there(virtual, sleep):
    def interrupted(self, seconds):
        if seconds == 1.0:
            np.testing.assert_allclose(servo_from_pulses(virtual.pulses()), 0.5, atol=2e-4)
            raise KeyboardInterrupt
        sleep(self, seconds)

    return interrupted
