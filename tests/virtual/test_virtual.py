"""A virtual hand: in real time behind its port, and in lock-step with what can go wrong with a wire."""

import json
import os
import re
import signal
from contextlib import closing, contextmanager
from dataclasses import replace
from threading import Event
from unittest.mock import Mock, call

import numpy as np
import pytest

import hpac
from hpac_gym.bridge import (
    HandLink,
    HostBoard,
    PortError,
    VirtualHand,
    pulses_from_servo,
    stop as bridge_stop,
)
from hpac_gym.deploy.commands import object_of
from hpac_gym.deploy.episode import Log, run_episode
from hpac_gym.deploy.observer import Observer, Pose
from hpac_gym.deploy.poses import Fixed
from hpac_gym.evaluation.environment import make_env
from hpac_gym.model import ServoCommand
from hpac_gym.policies.loading import load_policy
from hpac_gym.registration import GRASP, GRASP_ANY
from hpac_gym.tasks.task import RUNNING, SUCCESS
from hpac_gym.view.page import HandPage
from hpac_gym.virtual.body import (
    KEPT,
    LATCH_US,
    LATE,
    OPENED_AFTER_US,
    Body,
    LockStep,
    Path as WristPath,
)
from hpac_gym.virtual.commands import CAN, scene
from hpac_gym.virtual.hand import Virtual
from hpac_gym.virtual.wire import BadTransport, Faults, Way
from tests.options import refused
from tests.processes import children_of, python, started, wait_for_the_end

SEEDS = range(3_000_000, 3_000_004)
FAULTLESS = Faults()


@pytest.fixture(scope="module")
def env():
    made = make_env(GRASP, engine="mujoco", body="light")
    yield made.unwrapped
    made.close()


@pytest.fixture(scope="module")
def can_env():
    """The environment of the default scene."""
    with make_env(GRASP, engine="mujoco", body="light", object=object_of(CAN)) as made:
        yield made.unwrapped


@pytest.fixture
def named():
    """A body in the scene of a named grasp."""
    with make_env(GRASP, engine="mujoco", body="light", grasp="small_cylinder") as made:
        yield Body(made.unwrapped, 0, scene(made.unwrapped, GRASP, None))


@contextmanager
def running(*words, **variables):
    """`hpac virtual`, its port and the words of the command that it prints."""
    with started("-m", "hpac", "virtual", *words, **variables) as process:
        greeting, _, typed = (process.stdout.readline() for _ in range(3))
        yield process, greeting.split()[3].rstrip(";"), typed.split()[1:]


# --- in real time


@pytest.fixture
def board():
    with HostBoard() as started:
        yield started


@pytest.fixture
def hand(env, board):
    with closing(Virtual(Body(env, 3), board, blind=60.0)) as made:
        yield made


READY = b'{"hpac_arm": 1, "phase": "ready"}'


@pytest.fixture
def program(udp, hand):
    """The socket of a program that drives the arm of `hand`."""
    udp.connect(("127.0.0.1", hand.arm_port))
    return udp


@pytest.fixture
def is_back(hand):
    """Whether the object is back; it begins 3 cm above its place."""
    start = hand.body.state().object_pos[0].copy()
    setup = hand.body.setup
    hand.body.place(replace(setup, position=setup.position + np.array([0.0, 0.0, 0.03])))
    hand.body.setup = setup
    return lambda: np.linalg.norm(hand.body.state().object_pos[0] - start) < 0.01


@pytest.mark.parametrize(
    ("outcome", "phase", "back"),
    [(SUCCESS, "lift", True), (RUNNING, "lift", False), (RUNNING, "", True)],
)
def test_the_object_is_back_when_the_arm_is_asked_to_be_ready_before_or_after_an_episode(
    hand, is_back, program, monkeypatch, outcome, phase, back
):
    """Also where the hand has kept its power since; during an episode it is not moved."""
    monkeypatch.setattr(hand.body, "tidy_up", lambda state: None)
    hand.body.outcome = outcome
    hand._phase = phase
    program.send(READY)
    hand.turn()
    assert is_back() == back


def test_an_episode_begins_after_one_that_was_given_up_before_the_hand_closed(hand, board, program):
    with HandLink(board.connect) as link:
        for episode in (1, 2):
            link.arm(watchdog=2.0)
            for _ in range(3):
                program.send(READY)
                hand.turn()
            assert (hand._episodes, hand.body._powered) == (episode, True)
            assert hand._seen_until < np.inf
            link.clear()
            hand._due = 0.0
            hand.turn()
            assert hand._seen_until == np.inf


def test_a_virtual_hand_whose_board_was_killed_says_so(hand, board):
    hand.turn()
    board.process.kill()
    board.process.wait()
    with pytest.raises(PortError, match=f"{board.port}: the board behind it has ended"):
        hand.turn()


@pytest.fixture
def page(hand):
    """The page of `hand`, whose sliders rest."""
    hand.page = Mock(spec=HandPage, object_back=Event())
    hand.page.wanted.return_value = np.zeros(6)
    return hand.page


def test_the_page_tells_what_came_of_its_red_button_until_a_program_drives_again(
    hand, page, board, monkeypatch
):
    monkeypatch.setattr(bridge_stop, "PATIENCE", 0.3)

    def said():
        for _ in range(3):
            hand.turn()
        return page.show.call_args.args[0].text

    def drive():
        with HandLink(board.connect) as link:
            link.clear()
            link.arm(watchdog=2.0)
            assert said() == "A program drives the hand. "
            hand.estop()
            return said()

    assert said() == "The sliders drive the hand. "
    assert drive() == drive() == f"Stopped: fault estop until `hpac clear --port {board.port}`. "
    board.process.send_signal(signal.SIGSTOP)
    hand.estop()
    assert said().startswith("Stop NOT CONFIRMED: switch the supply off. no answer to estop")
    assert page.free.call_args == call(True)
    board.process.send_signal(signal.SIGCONT)


def test_a_page_stops_a_board_that_has_restarted_at_another_port(hand, board):
    before = board.port
    board.__exit__()
    occupied = os.openpty()
    board.__enter__()
    assert board.port != before
    hand.estop()
    assert hand.stopped.startswith("Stopped: fault estop")
    for end in occupied:
        os.close(end)


def test_the_page_s_button_puts_the_object_back_once(hand, page, is_back):
    page.object_back.set()
    for _ in range(3):
        hand.turn()
    assert not page.object_back.is_set()
    assert is_back()


def test_what_is_typed_against_a_virtual_hand_holds_the_object(tmp_path):
    with running("--object", "cylinder:0.02,0.05") as (process, _, words):
        log = tmp_path / "log.jsonl"
        done = python("-m", "hpac", *words, "--log", str(log), "--hold", "0.2")
        assert done.returncode == 0, done.stderr
        refused = int(re.search(r"(\d+) refused", done.stdout)[1])
        assert refused <= 8, "of 64, on a busy machine"
        board = children_of(process, 1)
        process.stdout.readline()
        outcome = process.stdout.readline()
        assert outcome == "episode 1: success\n" or (refused and outcome.startswith("episode 1: "))
        process.send_signal(signal.SIGTERM)
        said, _ = process.communicate(timeout=10)
        assert process.returncode == 0
        assert "object: cylinder" in said
    steps = [json.loads(line) for line in log.read_text().splitlines()][1:-1]
    closing = [step["position"] for step in steps if step["phase"] == "close"]
    assert np.ptp(closing, axis=0).max() > 0  # poses came, with their noise
    wait_for_the_end(board, 10)


def test_a_hidden_hand_that_restarts_when_its_port_is_opened_is_reached_over_a_bad_wire_and_told_at_the_end():
    words = ("--seed", "4", "--reset-on-open", "--latency", "0.005", "--damage", "0.02")
    with running(*words) as (process, port, _):
        for _ in range(2):
            with HandLink(port) as link:
                link.arm(watchdog=2.0)
                link.move(ServoCommand(np.full(6, 0.2), 0.4))
                np.testing.assert_allclose(link.wait().servo, 0.2, atol=1e-3)
                link.clear()
        process.send_signal(signal.SIGHUP)
        said, _ = process.communicate(timeout=10)
    assert "hand H-PAC train_27, 91% of the nominal size" in said
    assert "servo zero [deg]: thumb_mp" in said


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--loss", "2"], "loss = 2.0 must be a number within [0, 1]"),
        (["--latency", "-1"], "latency = -1.0 s must be a number within [0, 10] s"),
        (["--grasp", "none"], "no grasp 'none'"),
        (["--object", "ball"], "--object 'ball' is not one of"),
        (["--grasp", "rod", "--object", "sphere:0.03"], "grasp 'rod' has its own object"),
        (["--env", GRASP_ANY, "--grasp", "rod"], f"--grasp and --object are of {GRASP}"),
        (["--arm-port", "99999"], "UDP port 99999"),
        (["--arm-port", "47999", "--pose-port", "70000"], "UDP port 70000"),
        (["--heat", "101"], "--heat 101 % must be at most 100 %"),
        (["--angles", "/dev/full"], "cannot write '/dev/full': No space left on device"),
    ],
)
def test_wrong_words_are_one_line(words, says, capsys):
    assert says in refused(capsys, lambda: hpac.main(["virtual", *words]))


# --- in lock-step


def worlds(env, seeds=SEEDS, **how):
    """Worlds, one after the other."""
    return (LockStep(env, seed, **how) for seed in seeds)


def through(worlds, faults=FAULTLESS, policy=None, source=None, item=None, **how):
    """Episodes that succeeded in some worlds, and the counts of their streams."""
    held = 0
    counts = []
    for seed, world in enumerate(worlds, SEEDS[0]):
        observer = Observer(GRASP, item or world.seen_object)
        wire = BadTransport(world.hand, np.random.default_rng(seed), FAULTLESS)

        def spoil(figures, wire=wire, last=observer.steps - 1):
            wire.there.faults = wire.back.faults = faults if figures["step"] < last else FAULTLESS

        with HandLink(lambda wire=wire: wire) as link:
            given = (policy or load_policy("grasp", observer), source or world, world, Log(None))
            words = {"hold": 0.3, "seconds": 0.1, "live": spoil} | how
            counts.append(run_episode(link, observer, *given, **words))
        held += world.body.outcome == SUCCESS
    return held, counts


@pytest.mark.parametrize(("damage", "by_table"), [(0.1, True), (0.0, False)])
def test_a_grasp_survives_damaged_frames_and_an_arm_that_is_told_carries_as_one_with_a_table(
    env, damage, by_table
):
    """What loss, jitter and latency do is measured by `experiments.deployed`."""
    held, counts = through(worlds(env, by_table=by_table), Faults(damage=damage))
    assert held >= 3
    assert sum(count.refused for count in counts) == 0
    assert (sum(count.lost for count in counts) > 0) == (damage > 0)


OPEN = Mock(predict=Mock(return_value=(np.array([-1.0, -1, -1, -1, -1, 0.5]), None)))
"""A policy that does not close."""
ELSEWHERE = Fixed(Pose(np.array([0.08, -0.06, 0.18])))


@pytest.mark.parametrize(
    ("wrong", "seeds"), [({"policy": OPEN}, SEEDS[:1]), ({"source": ELSEWHERE}, SEEDS)]
)
def test_a_hand_that_does_not_close_or_sees_the_object_elsewhere_holds_it_less(env, wrong, seeds):
    """The controls of the test above."""
    held, _ = through(worlds(env, seeds), **wrong)
    assert held <= len(seeds) // 2


def test_five_digits_that_close_together_hold_and_lift_the_can_of_the_default_scene(can_env):
    held = []
    body = Body(can_env, 0, scene(can_env, GRASP, None))
    servo = np.array([0.0, 0, 0, 0, 0, 1.2])
    for step in range(290):
        servo[:-1] = 1.1 * np.clip(step / 60 - 0.8, 0, 1.5) / 1.5
        height = 0.08 * np.clip(step / 60 - 3, 0, 1)
        if step % 3 == 0:
            body.tell({"time": step / 60, "offset": [0.0, 0.0, height]})
        body.follow(round(step * 1e6 / 60), pulses_from_servo(servo))
        held.append(not body.state().supported[0])
    assert np.linalg.norm(body.state().object_pos[0]) < 0.15
    assert all(held[-20:])
    assert not any(held[5:40])


class Whole(LockStep):
    """As in real time: the physics runs before the arm is ready, too."""

    def __init__(self, env, seed, setup):
        super().__init__(env, seed, setup, by_table=False)
        self.hand.quiet_until_us = 0

    def ready(self, wait, told):
        self.body.begin(self.hand.now_us)

    def _on_pulses(self, now_us, pulses):
        self.body.follow(now_us, pulses)
        self.hand.quiet_until_us = now_us + LATCH_US


def test_the_policy_holds_the_can_of_the_default_scene(can_env):
    whole = Whole(can_env, 0, scene(can_env, GRASP, None))
    held, _ = through([whole], item=object_of(CAN), seconds=0.3, hold=0.5)
    assert held == 1


def test_the_arm_follows_smoothly_what_it_is_told():
    path = WristPath()
    times = np.arange(0, 1.0, 0.05)
    for time_told in times:
        path.tell(time_told, np.array([0.02 * np.sin(7 * time_told) ** 2, 0, 0]))
    fine = np.arange(0.1, 0.9, 0.005)
    followed = np.array([path.at(t)[0] for t in fine])
    np.testing.assert_allclose(followed, 0.02 * np.sin(7 * fine) ** 2, atol=5e-4)
    assert np.abs(np.diff(followed, 2)).max() < 2 * 0.02 * 2 * 49 * 0.005**2
    assert path.at(5.0)[0] == path.at(0.95)[0]
    assert not path.at(-0.1).any()


def test_an_arm_forgets_what_it_was_told_long_ago():
    path = WristPath()
    for step in range(3 * KEPT):
        path.tell(step / 20, np.array([0.0, 0.0, step % 100]))
    assert len(path._told) <= KEPT
    assert path.at(29.9)[2] == pytest.approx(98.0)
    assert path.at(99.9)[2] == 99.0


def away(body):
    """How far the object of a body is from its place [m]."""
    return np.linalg.norm(body.state().object_pos[0] - body.setup.position)


def test_the_thumb_of_a_resting_hand_does_not_lie_in_the_object_of_a_named_grasp(named):
    for began in (0, 1_000_000):
        named.follow(began + 300_000, np.zeros(6))
        assert away(named) < 0.005
        named.begin(began + 300_000)  # an episode, which ends with the thumb turned away
        named.tell({"time": 0.0, "offset": [0.0, 0.0, 0.0]})
        named.follow(began + 700_000, pulses_from_servo(np.zeros(6)))
        named.follow(began + 900_000, np.zeros(6))
        named.tidy_up(named.state())


def test_an_object_that_a_program_has_pushed_aside_is_back_once_the_hand_has_no_pulses(named):
    """As by arming a hand whose thumb lies on the other side of it."""
    open_hand = pulses_from_servo(np.zeros(6))
    for now in range(20_000, 2_200_000, 20_000):
        if now == 2_000_000:
            assert away(named) > 0.015, "it is left where it lies while a program drives the hand"
        named.follow(now, open_hand if now < 2_000_000 else 0 * open_hand)
        named.tidy_up(named.state())
    assert away(named) < 0.005


@pytest.fixture
def body(env):
    return Body(env, 0, scene(env, GRASP, None))


def test_a_body_lifts_its_wrist_when_it_is_told_and_stands_again_after_the_episode(body):
    rest = pulses_from_servo(np.zeros(6))
    body.follow(100_000, rest)
    body.begin(100_000)
    for step in range(20):
        body.tell({"time": step / 20, "offset": [0.0, 0.0, 0.01 * step]})
        body.follow(100_000 + 50_000 * (step + 1), rest)
    late = 0.95 - LATE
    assert body.state().palm_offset[0, 2] == pytest.approx(0.2 * (late + 0.05), abs=0.005)
    body.follow(1_200_000, 0 * rest)
    body.tidy_up(body.state())
    assert not body.state().palm_offset[0].any()
    assert body.outcome == RUNNING


def test_a_hand_that_is_left_closed_by_a_stop_is_opened_and_its_object_put_back(body):
    closed = pulses_from_servo(np.full(6, 0.8))
    body.begin(0)
    body.tell({"time": 0.0, "offset": [0.0, 0.0, 0.0]})
    body.follow(400_000, closed)
    for now in range(800_000, OPENED_AFTER_US + 1_000_000, 400_000):
        was_closed = body.state().horn[0].max() > 0.5
        body.follow(now, 0 * closed)
        body.tidy_up(body.state())
    assert was_closed
    assert body.state().horn[0, :5].max() < 0.05
    assert away(body) < 0.002


def test_an_object_that_is_lost_is_back_also_while_something_drives_the_hand(body):
    setup = body.setup
    body.place(replace(setup, position=np.array([0.9, 0.0, 0.1])))
    body.setup = setup
    body.follow(20_000, pulses_from_servo(np.zeros(6)))
    body.tidy_up(body.state())
    assert away(body) < 0.002


def test_a_hand_whose_object_is_put_back_stays_as_its_servos_have_it(env):
    """A hidden hand's servos have zeros of their own."""
    body = Body(env, 7, scene(env, GRASP, 7))
    body.follow(400_000, pulses_from_servo(np.full(6, 0.5)))
    horn = body.state().horn[0].copy()
    assert np.abs(horn - 0.5).max() > 0.02
    body.put_back()
    np.testing.assert_allclose(body.state().horn[0], horn, atol=1e-6)


def test_servos_look_at_their_pulses_every_20_ms_and_stay_without_any_while_the_time_goes_on(body):
    wide = pulses_from_servo(np.full(6, 0.5))
    body.follow(0, pulses_from_servo(np.zeros(6)))
    body.follow(LATCH_US - 1_000, wide)
    assert body.state().horn[0, :5].max() < 0.01
    body.follow(2 * LATCH_US - 1, wide)
    assert 0.05 < body.state().horn[0, :5].max() <= 0.5  # 8 rad/s for 20 ms
    body.follow(300_000, 0 * wide)
    np.testing.assert_allclose(body.state().horn[0], 0.5, atol=0.01)
    assert body.state().time[0] == pytest.approx(0.3, abs=0.01)


def test_a_quiet_virtual_hand_calls_only_when_it_is_asked_to():
    calls = []

    def note(now_us, _):
        calls.append(now_us)
        hand.quiet_until_us = now_us + LATCH_US

    hand = VirtualHand(quiet_until_us=LATCH_US)
    hand._on_pulses = note
    with HandLink(hand.connect) as link:
        link.sleep(0.1)
    assert calls[:4] == [LATCH_US, 2 * LATCH_US, 3 * LATCH_US, 4 * LATCH_US]


def test_what_a_hand_says_unasked_is_as_late_as_its_answers():
    wire = BadTransport(VirtualHand(), np.random.default_rng(0), Faults(latency=0.016))
    came = []
    with HandLink(lambda: wire) as link:
        asked = wire.now()
        link.status(period=0.05)
        take_in = link.exchange.known.take_in
        link.exchange.known.take_in = lambda *told: came.append(wire.now()) or take_in(*told)
        link.exchange.listen(0.2)
    assert came[:3] == pytest.approx(asked + 0.016 + 0.05 * np.arange(1, 4), abs=0.002)


# --- the wire


def test_a_wire_loses_damages_and_delays_whole_frames():
    rng = np.random.default_rng(0)
    sent = b"".join(b"\0" + bytes([number]) * 9 + b"\0" for number in range(1, 201))
    way = Way(rng, Faults(loss=0.2, damage=0.3), to_hand=True)
    way.send(0.0, sent[:7])
    way.send(0.0, sent[7:])
    came = [frame for frame in way.arrived(0.0).split(b"\0") if frame]
    whole = [frame for frame in came if len(set(frame)) == 1 and len(frame) == 9]
    assert 130 < len(came) < 190
    assert 0.55 < len(whole) / len(came) < 0.85
    late = Way(rng, Faults(latency=0.016), to_hand=False)
    late.send(1.0, b"abc\0")
    assert late.due == pytest.approx(1.016)
    assert late.arrived(1.015) == b""
    assert late.arrived(1.016) == b"\0abc\0"
    jittery = Way(rng, Faults(jitter=0.01), to_hand=True)
    for number in range(1, 50):
        jittery.send(0.001 * number, bytes([number]) + b"\0")
    order = [frame[0] for frame in jittery.arrived(1.0).split(b"\0") if frame]
    assert order == sorted(order)
    assert len(order) == 49


def test_what_is_no_packet_moves_no_arm(hand, program):
    program.settimeout(5)
    for wrong in (
        b"\xff",
        b"{}",
        b"[]",
        b"[" * 4000,
        b'{"hpac_arm": 2}',
        b'{"hpac_arm": 1, "phase": "lift"}',
        *(
            f'{{"hpac_arm": 1, "phase": "lift", "time": {at}, "offset": {offset}}}'.encode()
            for at, offset in (
                ("Infinity", "[0, 0, 0]"),
                ("NaN", "[0, 0, 0]"),
                ("1e308", "[0, 0, 0]"),
                ("1" * 400, "[0, 0, 0]"),
                ('"soon"', "[0, 0, 0]"),
                ("1", "[0, 0]"),
                ("1", '["a", "b", "c"]'),
                ("1", "[[0], [0], [0]]"),
                ("1", "[NaN, 0, 0]"),
                ("1", "7"),
            )
        ),
    ):
        program.send(READY)
        program.send(wrong)
        hand._hear(0)
        assert json.loads(program.recv(4096)) == {"hpac_arm": 1, "ready": True}
        assert hand.body._began_us is None, wrong
        assert not hand.body._path._told, wrong
    hand.turn()
