"""HandLink against the firmware core, in virtual time."""

import dataclasses
import json
import warnings

import numpy as np
import pytest
from hypothesis import given, strategies as st

from hpac_gym.bridge import (
    Action,
    ClippedWarning,
    FaultError,
    FrameError,
    HandLink,
    HandshakeError,
    LinkTimeout,
    PortError,
    RejectedError,
    Reset,
    VirtualHand,
    WireLog,
    pulses_from_servo,
    servo_from_pulses,
)
from hpac_gym.bridge.hands import (
    config_of,
    default_config,
)
from hpac_gym.bridge.limits import (
    limits_hash,
)
from hpac_gym.bridge.link import GENTLE, release
from hpac_gym.bridge.protocol import Frame, encode
from hpac_gym.errors import HpacError, ParameterError, ShapeError
from hpac_gym.model import (
    HPAC,
    SERVOS,
    ServoCommand,
    move_duration,
    stream_command,
)
from hpac_gym.model.calibration import Calibration
from tests.bridge.devices import Device, Overheard, of_another_version, refusing

POSE = np.array([0.5, 0.4, 0.3, 0.2, 0.1, 0.6])


def streamed(rng, count):
    """Commands as the environment makes them: 20 Hz, at the rate limit, towards a target that
    changes.
    """
    servo = np.zeros(6)
    for i in range(count):
        if i % 10 == 0:
            target = rng.uniform(HPAC.servo_min, HPAC.servo_max)
        command = stream_command(servo, target, 0.05)
        servo = command.servo
        yield command


# --- refusals
# -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "error", "says"),
    [
        (
            lambda link: link.move(ServoCommand([0, 1.4] + [0] * 4, 2.0)),
            RejectedError,
            "index_mcp: 1.4 rad, allowed 0 to 1.386",
        ),
        (
            lambda link: link.move(ServoCommand([0] * 5 + [-0.001], 2.0)),
            RejectedError,
            "angle at servo thumb_cmc: -0.001 rad",
        ),
        (
            lambda link: link.move(ServoCommand([0, 0, 1, 0, 0, 0], 0.1)),
            RejectedError,
            "rate at servo middle_mcp: 1 rad within",
        ),
        (
            lambda link: link.move(ServoCommand(np.full(6, 1.0), 0.1)),
            RejectedError,
            "1 rad within 100 ms, allowed 2 rad/s",
        ),
        (
            lambda link: link.move(ServoCommand(POSE, 10.001)),
            RejectedError,
            "duration: 10001 ms, allowed 10 to 10000 ms",
        ),
        (
            lambda link: link.arm(watchdog=2.001),
            RejectedError,
            "arm: period: watchdog 2001 ms, allowed 100 to 2000 ms",
        ),
        (
            lambda link: link.status(0.009),
            RejectedError,
            "status: period: 9 ms, allowed 0 or at least 10 ms",
        ),
        (
            lambda link: link.status(0.0004),
            RejectedError,
            "status: period: 1 ms, allowed 0 or at least 10 ms",
        ),
        (
            lambda link: link.arm(watchdog=np.nan),
            FrameError,
            "watchdog = nan s, allowed 0 to 65.535 s",
        ),
        (lambda link: link.status(-0.001), FrameError, "period = -0.001 s, allowed 0 to 65.535 s"),
        (
            lambda link: link.move(ServoCommand(POSE, 65.536)),
            FrameError,
            "duration = 65.536 s, allowed 0 to 65.535 s",
        ),
        (
            lambda link: link.move(ServoCommand([0] * 5 + [-3.2768], 1.0)),
            FrameError,
            "angle of -3.2768 rad, allowed ±3.2767",
        ),
        (lambda link: link.arm(3), ValueError, "3 is not a valid Action"),
    ],
)
def test_bad_input_is_one_line_with_value_bound_and_unit_and_moves_nothing(
    virtual_hand, armed, call, error, says
):
    before = virtual_hand.pulses()
    with pytest.raises(error) as caught:
        call(armed)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)
    armed.sleep(0.1)
    assert armed.status().state == "armed"
    np.testing.assert_array_equal(virtual_hand.pulses(), before)


# --- silence, faults
# ------------------------------------------------------------------------------------------------


def test_silence_ends_in_a_latched_fault_that_clear_leaves(virtual_hand, armed):
    virtual_hand.run(0.6)
    with pytest.raises(FaultError, match="watchdog"):
        armed.move(ServoCommand(POSE, 1.0))
    with pytest.raises(FaultError):
        armed.arm()
    armed.clear()
    armed.arm()
    armed.move(ServoCommand(POSE, 1.0))
    assert armed.wait().counters["watchdog_trips"] == 1


def test_a_fault_that_latched_before_the_wait_for_a_move_is_told_by_it(virtual_hand, link):
    link.arm(Action.hold)
    link.move(ServoCommand(POSE, 0.5))
    for _ in range(2):  # the program is busy for longer than the watchdog and the move
        virtual_hand.run(1.0)
    with pytest.raises(FaultError, match="watchdog"):
        link.wait()
    assert link.wait().state == "fault", "it is told once"


@pytest.mark.parametrize("reset", [Reset.brownout, Reset.crash], ids=lambda reset: reset.name)
def test_a_suspicious_reset_needs_a_clear_by_any_program(reset):
    hand = VirtualHand(reset=reset)
    for _ in range(2):
        with pytest.raises(FaultError, match=reset.name), HandLink(hand.connect) as link:
            link.arm()
    with HandLink(hand.connect) as link:
        link.clear()
        link.arm()
        assert link.state == "armed"


def test_a_slow_hand_whose_servos_hold_without_power_is_armed_from_the_fist():
    hand = dataclasses.replace(HPAC, rate_limit=0.5)
    config = config_of(hand)
    for servo in config:
        servo.holds_unpowered = 1
    with HandLink(VirtualHand(config=config).connect, hand=hand) as link:
        link.arm()
        link.move(ServoCommand(hand.servo_max, 3.2))
        link.wait()
        link.clear()
        link.arm()
        assert not link.last_status.servo.any()


def test_a_hand_that_has_held_for_an_hour_moves_again(link):
    """Numbers of other messages stay within what a MOVE may be ahead of the last one."""
    link.arm()
    for command in streamed(np.random.default_rng(6), 2):
        link.move(command)
        link.wait()
        for _ in range(0x8001):
            link.exchange._frame("heartbeat", None)


def test_a_hand_that_has_restarted_in_a_fault_says_that_the_link_is_over(virtual_hand, link):
    virtual_hand.restart(Reset.brownout)
    for _ in range(2):
        with pytest.raises(RejectedError, match="the board has restarted; this link is over"):
            link.clear()


# --- bad lines
# ------------------------------------------------------------------------------------------------------


def test_every_command_arrives_once_over_a_line_that_loses_a_tenth(virtual_hand):
    lossy = Overheard(virtual_hand)
    with HandLink(lambda: lossy, attempts=10, timeout=0.03) as link:
        link.arm()
        lossy.spoil(loss=0.1)
        for command in streamed(np.random.default_rng(6), 200):
            link.move(command)
            np.testing.assert_allclose(link.wait().servo, command.servo, atol=1e-4)
        assert link.statistics.retried > 10
        assert link.statistics.rejected == 0


@pytest.mark.parametrize(
    ("reply", "says"),
    [
        (of_another_version, "a hand that speaks protocol 9, .*; flash the firmware"),
        (refusing, r"answers HELLO with an ACK \(length\)"),
        (lambda data: data, "an echo: what is sent comes back .*; take off a jumper"),
        (lambda data: b"abc\0", "12 bytes that are neither frames nor text; another baud"),
    ],
    ids=["version", "ack", "echo", "text"],
)
def test_what_answers_unlike_a_hand_is_a_handshake_error(virtual_hand, reply, says):
    with pytest.raises(HandshakeError, match=says):
        HandLink(lambda: Device(virtual_hand, reply), handshake_timeout=0.3).connect()


def test_an_unplugged_hand_neither_connects_nor_reads_nor_writes(virtual_hand):
    transport = virtual_hand.connect()
    virtual_hand.plugged = False
    for call in (virtual_hand.connect, lambda: transport.read(0.0), lambda: transport.write(b"")):
        with pytest.raises(PortError, match="unplugged"):
            call()


def test_a_virtual_clock_whose_ticks_never_come_is_refused():
    with pytest.raises(ParameterError, match="period_us = 0 µs must be at least 1 µs"):
        VirtualHand(period_us=0)


def test_the_virtual_clock_has_64_bits():
    hand = VirtualHand(start_us=1 << 40)
    hand.run(0.1)
    assert hand.now_us == (1 << 40) + 100_000


def test_a_reset_of_the_board_is_noticed(virtual_hand, armed):
    virtual_hand.restart(Reset.power_on, boot_count=2)
    with pytest.raises(RejectedError, match="state boot"):
        armed.move(ServoCommand(POSE, 1.0))
    assert armed.connect().boot_count == 2


def test_all_errors_are_one_tree():
    for error in (PortError, HandshakeError, LinkTimeout, RejectedError, FaultError, FrameError):
        assert issubclass(error, HpacError)
    assert issubclass(PortError, OSError)
    assert issubclass(LinkTimeout, TimeoutError)


# --- log, pulses
# ----------------------------------------------------------------------------------------------------


def test_the_wire_log_has_every_frame(virtual_hand, tmp_path):
    with WireLog(tmp_path / "wire.jsonl") as log, HandLink(virtual_hand.connect, log=log) as link:
        link.arm()
        link.move(ServoCommand(POSE, 1.0))
    lines = [json.loads(line) for line in (tmp_path / "wire.jsonl").read_text().splitlines()]
    sent = [line for line in lines if line["direction"] == "sent"]
    answers = [line for line in lines if "round_trip" in line]
    assert [line["seq"] for line in sent] == [line["seq"] for line in answers]
    assert len(lines) == link.statistics.sent + link.statistics.received
    move = next(line for line in sent if line["message"] == "move")
    session = {"session": link.info.session}
    assert move["fields"] == {
        **session,
        "duration_ms": 1000,
        "servo": [5000, 4000, 3000, 2000, 1000, 6000],
    }
    assert encode(Frame("move", move["seq"], 0, move["fields"]))[1:-1].hex() == move["hex"]
    ack = next(line for line in answers if line.get("acked") == "move")
    assert (ack["reason"], ack["state"]) == ("ok", "armed")


@given(st.lists(st.floats(0, 1), min_size=6, max_size=6))
def test_servo_from_pulses_is_the_inverse_of_pulses_from_servo(share):
    servo = HPAC.servo_min + np.array(share) * (HPAC.servo_max - HPAC.servo_min)
    np.testing.assert_allclose(servo_from_pulses(pulses_from_servo(servo)), servo, atol=1e-6)


def test_an_angle_that_is_no_number_has_no_pulses():
    with pytest.raises(ShapeError, match=r"servo\[1\] = nan must be a finite number"):
        pulses_from_servo([0.0, np.nan, 0.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("pulses", "error", "says"),
    [
        ([1_500_000] * 5, ShapeError, r"shape \(..., 6\), not \(5,\)"),
        (0, ShapeError, r"shape \(..., 6\), not \(\)"),
        (["a"] * 6, ShapeError, "array of numbers"),
        ([1_500_000] * 5 + [np.nan], ShapeError, r"pulses\[5\] = nan must be a finite number"),
        ([0] * 6, FrameError, f"no pulses on {', '.join(SERVOS)}: the hand is not armed"),
        (
            [1_500_000, 0, 1_500_000, 1_500_000, 1_500_000, 1_500_000],
            FrameError,
            "no pulses on index_mcp: the hand is not armed",
        ),
        (
            [[1_500_000] * 6, [1_500_000] * 4 + [0, 1_500_000]],
            FrameError,
            "no pulses on pinky_mcp: the hand is not armed",
        ),
        (
            [[0] * 6, [1_500_000] * 6],
            FrameError,
            "no pulses on some servo: the hand is not armed",
        ),
    ],
)
def test_what_are_no_pulses_of_six_servos_have_no_angles(pulses, error, says):
    with pytest.raises(error, match=says):
        servo_from_pulses(pulses)


@pytest.fixture
def calibrated_hand():
    """A hand whose file has zeros, and a servo range other than the nominal one."""
    zeros = Calibration(servo_zero=(0.01,) * len(SERVOS))
    thumb = dataclasses.replace(
        HPAC.digits["thumb"], servo_radius=HPAC.digits["thumb"].servo_radius * 0.98
    )
    return dataclasses.replace(
        HPAC, name="mine", digits=HPAC.digits | {"thumb": thumb}, calibration=zeros
    )


@pytest.mark.parametrize("own", [False, True], ids=["the nominal board", "its own board"])
def test_a_calibrated_hand_is_commanded_within_its_boards_table_and_says_what_is_clipped(
    calibrated_hand, own
):
    assert limits_hash(calibrated_hand) != limits_hash(HPAC)
    flashed = calibrated_hand if own else HPAC
    wanted = calibrated_hand.servo_max + 0.01 * own
    board = VirtualHand(config=config_of(flashed))
    with HandLink(board.connect, hand=calibrated_hand) as link:
        link.arm()
        says = (
            rf"{wanted[0]:.4f} rad is clipped to {flashed.servo_max[0]:.4f} rad, .*'{flashed.name}'"
        )
        with pytest.warns(ClippedWarning, match=f"thumb_mp: {says}"):
            link.move(ServoCommand(wanted, 2.0))
        link.wait()
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # told once
            link.move(ServoCommand(wanted, 2.0))
        link.wait()
        servo = servo_from_pulses(board.pulses(), flashed)
    np.testing.assert_allclose(servo, np.minimum(wanted, flashed.servo_max), atol=2e-4)


@pytest.mark.parametrize("calibrated", [False, True])
def test_a_hand_that_is_slower_than_the_board_is_refused(virtual_hand, calibrated_hand, calibrated):
    hand = calibrated_hand if calibrated else HPAC
    slower = dataclasses.replace(hand, rate_limit=HPAC.rate_limit / 2)
    with HandLink(virtual_hand.connect, hand=slower) as link:
        with pytest.raises(HandshakeError, match="limits"):
            link.arm()
        assert link.state == "idle"


@pytest.mark.parametrize("rate_limit", [0.1, 0.3, HPAC.rate_limit])
@pytest.mark.parametrize("bent", [0.0, 0.2])
def test_a_closed_hand_of_any_limits_opens_slowly_after_an_error(rate_limit, bent):
    """Also where that takes longer than a move may, and where 0 rad is out of its range."""
    workspace = HPAC.workspace | {"index_mcp": (bent, HPAC.workspace["index_mcp"][1])}
    hand = dataclasses.replace(HPAC, rate_limit=rate_limit, workspace=workspace)
    course = []
    board = VirtualHand(
        period_us=10_000,
        config=config_of(hand),
        on_pulses=lambda now_us, pulses: pulses.all() and course.append((now_us, *pulses)),
    )
    rest = np.clip(0.0, hand.servo_min, hand.servo_max)
    with HandLink(board.connect, hand=hand) as link:
        link.arm()
        for share in (0.2, 0.4):
            target = rest + share * (hand.servo_max - rest)
            link.move(ServoCommand(target, 1.1 * move_duration(rest, target, hand)))
        link.wait()
        course.clear()
        release(link, ZeroDivisionError())
        assert link.state == "idle"
    assert not board.pulses().any()
    now_us, *pulses = np.array(course).T
    servo = servo_from_pulses(np.transpose(pulses), hand)
    np.testing.assert_allclose(servo[0], target, atol=2e-4)
    np.testing.assert_allclose(servo[-1], rest, atol=2e-4)
    window = 10
    way = np.abs(servo[window:] - servo[:-window]).max(axis=1)
    speed = 1e6 * way / (now_us[window:] - now_us[:-window])
    assert speed.max() < 1.05 * GENTLE * rate_limit


def test_a_trim_that_its_field_cannot_tell_is_a_config_fault_before_it_is_another_table():
    config = default_config()
    config[2].trim_ns = 40_000
    with VirtualHand(config=config) as hand, HandLink(hand.connect) as link:
        with pytest.raises(FaultError, match=r"in fault \(config\): arm refused; `hpac doctor`"):
            link.arm()
