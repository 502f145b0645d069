"""A policy on a hand: what it observes, where poses come from, and that the hand ends open and
without pulses whatever happens.
"""

import io
import json
import os
import re
import shutil
import signal
import sys
import time
from contextlib import closing, nullcontext, redirect_stderr, redirect_stdout
from dataclasses import asdict, replace
from itertools import chain, count, repeat
from pathlib import Path
from unittest.mock import Mock, create_autospec

import gymnasium
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

import hpac
from experiments import deployed
from hpac_gym.bridge import FaultError, HandLink, HostBoard, VirtualHand, servo_from_pulses
from hpac_gym.bridge.errors import LinkTimeout, LogWarning
from hpac_gym.bridge.protocol import Frame, encode
from hpac_gym.deploy import replay
from hpac_gym.deploy.arm import Arm, arm_of
from hpac_gym.deploy.commands import object_of
from hpac_gym.deploy.episode import Log, run_episode, wire_log
from hpac_gym.deploy.errors import DeployError, PoseError
from hpac_gym.deploy.observer import TASKS, UPRIGHT, Observer, Pose
from hpac_gym.deploy.poses import Fixed, Packets, averaged, pose_of, source_of
from hpac_gym.deploy.replay import simulation
from hpac_gym.deploy.watching import watched
from hpac_gym.errors import ShapeError
from hpac_gym.model import HPAC, servo_from_synergy
from hpac_gym.model.calibration import Calibration
from hpac_gym.model.files import hand_to_toml
from hpac_gym.model.settled import FLEXION, settled_joints_from_servo
from hpac_gym.output import OutputError
from hpac_gym.policies.loading import load_policy
from hpac_gym.registration import GRASP, GRASP_ANY, GRASP_TYPE
from hpac_gym.tasks.cameras import CameraNoise
from hpac_gym.tasks.grasp_rules import GRASP_TYPES
from hpac_gym.view.page import HandPage
from tests.options import refused
from tests.processes import started, wait_for

CAN = object_of("cylinder:0.02,0.05")
PLACE = Pose(np.array([0.05, 0.005, 0.11]))
WORDS = ("grasp", "--object", "cylinder:0.02,0.05", "--pose", "0.05,0.005,0.11")
VIRTUAL = ("--port", "virtual")


@pytest.fixture
def hand():
    return VirtualHand()


@pytest.fixture
def link(hand):
    """A connected link to `hand`, not armed."""
    with HandLink(hand.connect) as connected:
        yield connected


@pytest.fixture
def path(tmp_path):
    """Where a deployment's log shall be."""
    return tmp_path / "log.jsonl"


def episode(link, policy, source=None, arm=None, log=None, observer=None, **how):
    """Run an episode: of the can that stands at its place, without an arm or a log unless given."""
    observer = observer or Observer(GRASP, CAN)
    given = (source or Fixed(PLACE), arm or Arm(), log or Log(None))
    return run_episode(link, observer, policy, *given, **({"seconds": 0.1} | how))


class Deciding:
    """A policy that decides by the number of its step, which it remembers."""

    def __init__(self, decide):
        self.decide = decide

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        step = (state or 0) + 1
        return self.decide(step), step


def failing(fault):
    """A policy that closes, and after some steps does something else."""
    return Deciding(lambda step: fault() if step == 12 else np.array([0.0, 1, 1, 1, 1, 0]))


def told(capsys, *words, command="deploy"):
    status = hpac.main([command, *map(str, words)])
    return status, capsys.readouterr()


@pytest.fixture(scope="module")
def deployed_once(tmp_path_factory):
    """A deployment: its log, and what it told on standard output and standard error."""
    made = tmp_path_factory.mktemp("deployed") / "log.jsonl"
    with redirect_stdout(io.StringIO()) as out, redirect_stderr(io.StringIO()) as err:
        assert hpac.main(["deploy", *WORDS, *VIRTUAL, "--log", f"{made}"]) == 0
    return made, out.getvalue(), err.getvalue()


@pytest.fixture
def log(deployed_once, path):
    """A copy of the log of a deployment."""
    return Path(shutil.copy(deployed_once[0], path))


# --- the observer


@pytest.mark.parametrize(
    ("name", "options"), [*((name, {}) for name in TASKS), (GRASP_ANY, {"wrist": "free"})]
)
def test_an_observer_sees_what_the_environment_observes(name, options):
    quiet = {"position": 0.0, "angle": 0.0, "size": 0.0}
    env = gymnasium.make(name, engine="mujoco", noise=quiet, **options).unwrapped
    rng = np.random.default_rng(0)
    for seed in range(2):
        seen, _ = env.reset(seed=seed)
        setup = env.episodes.setups[0]
        observer = Observer(name, setup.object, **options)
        observer.setup = setup
        observer.start()
        seen_at = env.slices.get("object_seen")  # of the camera of `GRASP_ANY` alone
        over = False
        while observer.step < 20 and not over:
            state = env.state
            turn = Rotation.from_matrix(state.object_rotation[0]).as_quat()
            mine = observer.see(Pose(state.object_pos[0], tuple(turn)))
            if seen_at is None or seen[seen_at][0] == 1.0:
                np.testing.assert_allclose(mine, seen, atol=2e-3 if name != GRASP else 1e-6)
            action = rng.uniform(-1, 1, env.action_space.shape).astype(np.float32)
            observer.command(action)
            seen, _, over, _, _ = env.step(action)
            observer.sent(env.command.servo)
    env.close()


@pytest.mark.parametrize("name", TASKS)
def test_a_pose_without_a_quaternion_is_upright_for_a_hand_that_looks_down_too(name):
    observer = Observer(name, CAN)
    pose, _ = source_of("0.05,0,0.1", CAN).latest()
    seen = observer.see(pose)
    up, down = (seen[observer._layout.slices[part]] for part in ("object_up", "down"))
    np.testing.assert_allclose(up, -down, atol=1e-6)
    if name == GRASP:
        assert observer.turned(pose).quaternion == UPRIGHT


def test_an_episode_of_an_observer_leaves_nothing_to_the_next():
    observer = Observer(GRASP_ANY, CAN, wrist="free")
    course = []
    for _ in range(2):
        observer.start()
        observer.command(np.array([0.0] * 6 + [0.5, 0.5, 0.5, 1.0]))
        course.append((observer.setup.yaw, observer._setup.yaw, *observer._setup.position))
    assert course[0] == course[1]


# --- poses


def test_sources_are_told_by_their_text(tmp_path):
    assert source_of("0.05,0,0.1").latest()[0].quaternion is None
    path = tmp_path / "poses.csv"
    path.write_text("time_s,x_m,y_m,z_m\n0,0.05,0,0.1\n0.5,0.06,0,0.1\n")
    now = [10.0]
    recorded = source_of(f"{path}")
    recorded.clock = lambda: now[0]
    for begun in (12.0, 20.0):
        now[0] = begun
        assert recorded.latest()[0].position[0] == 0.05
        now[0] += 0.7
        pose, age = recorded.latest()
        assert (pose.position[0], age) == (0.06, pytest.approx(0.2))
        recorded.begin()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("50,5,110", "the object is 121 m from the hand, allowed 1.0 m; is it in mm"),
        ("0.05,nan,0.1", "is not x, y, z"),
        ("0.05,0", "is not x, y, z"),
        ("0.05,0,0.1,0,0,0,2", "the quaternion's length is 2, it must be 1"),
        ("somewhere", "is not x,y,z in m, with or without a quaternion, nor udp:PORT, nor a .csv"),
        ("/none.csv", "poses /none.csv: No such file"),
        ("udp:²", "'udp:²' is not x,y,z in m"),
        ("udp:99999", r"udp:99999: .*port must be 0-65535.?$"),
    ],
)
def test_a_source_that_is_none_is_one_line(text, says):
    with pytest.raises(DeployError, match=says):
        source_of(text)


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        ("", "no rows"),
        ("0,0.05,x,0.1\n", "row 2: could not convert string to float: 'x'"),
        ("0,0.05,0\n", "row 2: the columns are time_s, x_m"),
        ("0,0.05,0,0.1\n" * 2, "row 3: time_s = 0 s must be finite, after 0 s"),
        ("0,0.05,0,,0.1\n", "row 2: the columns are time_s, x_m"),
        ("nan,0.05,0,0.1\n", "row 2: time_s = nan s must be finite"),
        ("0,0.05,0,0.1\ninf,0.05,0,0.1\n", "row 3: time_s = inf s must be finite"),
        ('0,"0.05,0,0.1\n' + "1,0.05,0,0.1\n" * 20_000, "field larger than field limit"),
    ],
    ids=["none", "text", "column", "time", "gap", "nan", "infinite", "quote"],
)
def test_a_file_that_has_no_poses_is_one_line(rows, says, tmp_path):
    path = tmp_path / "poses.csv"
    path.write_text("time_s,x_m,y_m,z_m,qx\n" + rows)
    with pytest.raises(PoseError, match=f"^poses {path}.* {says}"):
        source_of(f"{path}")


def test_packets_come_by_udp_and_what_is_none_is_ignored(monkeypatch, udp):
    now = [0.0]
    monkeypatch.setattr("hpac_gym.camera.detection.monotonic", lambda: now[0])
    packets = Packets(0)
    udp.connect(("127.0.0.1", packets.port))
    wrong = (
        *(b"\xff", b"{}", b'{"hpac_pose": 2}', b"[" * 4000),
        b'{"hpac_pose": 1, "position": [1e9, 0, 0]}',
        b'{"hpac_pose": 1, "position": [1%b, 0, 0]}' % (b"0" * 400),
    )
    for data in wrong:
        udp.send(data)
    wait_for(lambda: packets.latest() or "too large" in packets.fault, 10)
    assert packets.latest() is None
    # Nobody asks meanwhile: a pose ages from when it came.
    udp.send(b'{"hpac_pose": 1, "position": [0.05, 0, 0.1]}')
    udp.send(b'{"pose": 1}')
    wait_for(lambda: '"pose": 1' in packets.fault, 10)
    assert packets.fault.startswith("no packet with hpac_pose, position and quaternion: ")
    now[0] = 10.0
    pose, age = packets.latest()
    assert pose.position.tolist() == [0.05, 0, 0.1]
    assert age == 10.0
    packets.close()


def test_a_port_that_is_taken_names_the_pose():
    packets = Packets(0)
    says = f"--pose udp:{packets.port}: .*Address already in use"
    with pytest.raises(DeployError, match=says):
        source_of(f"udp:{packets.port}")
    packets.close()


def test_a_hand_is_armed_once_there_are_pose_and_action_and_what_is_waited_for_is_told(
    link, monkeypatch, capsys
):
    monkeypatch.setattr("hpac_gym.progress.monotonic", count().__next__)
    packets = Packets(0)
    monkeypatch.setattr(link, "arm", lambda **_: pytest.fail("armed"))
    with pytest.raises(PoseError, match=f"no pose of the object within 5 s at udp:{packets.port}"):
        episode(link, failing(None), packets)
    with pytest.raises(ShapeError, match=r"the policy's action must have shape .*6\), not \(5,\)"):
        episode(link, Deciding(lambda _: np.zeros(5)))
    said = f"waiting for poses at udp:{packets.port}\n"
    assert capsys.readouterr().err == said
    with pytest.raises(DeployError, match=r"arm at 127\.0\.0\.1:9 did not say that it is ready"):
        arm_of("udp:127.0.0.1:9").ready(lambda _: None, {"phase": "ready"})
    assert capsys.readouterr().err == "waiting for the arm at 127.0.0.1:9\n"
    packets.close()


def test_the_first_pose_is_a_mean():
    now = [0.0]

    def pause(seconds):
        now[0] += seconds

    rng = np.random.default_rng(0)
    turns = chain([[0.0, 0.0, 0.0, 1.0]] * 2, repeat([0.0, 0.0, 1.0, 0.0]))
    numbers = ([0.05, *rng.normal(0, 0.01, 2), *turn] for turn in turns)
    latest = Mock(side_effect=((pose_of(each, "here"), 0.0) for each in numbers))
    mean = averaged(Mock(latest=latest, clock=lambda: now[0]), 2.0, 0.5, pause=pause)
    assert np.abs(mean.position[1:]).max() < 0.003
    assert np.abs(mean.quaternion) == pytest.approx([0.0, 0.0, 1.0, 0.0])


# --- the command


def test_a_dry_run_prints_every_entry_and_moves_nothing(capsys):
    status, said = told(capsys, *WORDS, "--dry-run")
    assert (status, said.err) == (0, "")
    rows = [line for line in said.out.splitlines() if line.endswith(("rad", "m", "1"))]
    assert len([row for row in rows if not row.startswith("servo  ")]) >= 30
    assert "object_pos     x                     0.1000  0.05 m" in said.out
    assert "thumb_cmc            1.2000" in said.out
    assert said.out.endswith("dry run: nothing was sent\n")


def test_a_policy_that_places_the_wrist_tells_a_person_where_and_its_log_is_played(
    path, capsys, monkeypatch
):
    """With the options that it needs of its environment."""
    keys, enter = os.pipe()
    os.write(enter, b"\n")
    monkeypatch.setattr("sys.stdin", os.fdopen(keys))
    words = ("grasp-any-wrist", *WORDS[1:], *VIRTUAL, "--log", path, "--arm", "enter")
    status, said = told(capsys, *words)
    os.close(enter)
    assert status == 0, said.err
    first = json.loads(path.read_text().splitlines()[1])
    lines = said.err.splitlines()[1:6]
    for line, name, value in zip(lines, ("x", "y", "z", "yaw"), first["action"][6:], strict=False):
        assert line == f"arm: the policy places wrist_{name} {value:+.2f}"
    assert lines[4] == "the object is seen; Enter: the hand stands there, close"
    status, said = told(capsys, path, command="replay")
    assert (status, said.err) == (0, "")
    assert said.out.startswith("grasp-any-wrist on virtual, 144 steps, ended: done")


def test_an_enter_that_was_typed_before_the_question_is_none(monkeypatch):
    keys, terminal = os.openpty()
    monkeypatch.setattr("sys.stdin", os.fdopen(terminal))
    os.write(keys, b"\n")
    waited = []

    def wait(seconds):
        waited.append(seconds)
        if len(waited) == 3:
            os.write(keys, b"\n")

    arm_of("enter").ready(wait, {"phase": "ready"})
    assert len(waited) >= 3
    sys.stdin.close()
    os.close(keys)


def test_a_line_without_its_end_is_no_enter(monkeypatch):
    keys, enter = os.pipe()
    monkeypatch.setattr("sys.stdin", os.fdopen(keys))
    os.write(enter, b"x")
    os.close(enter)
    with pytest.raises(DeployError, match="standard input is closed"):
        arm_of("enter").ready(time.sleep, {"phase": "ready"})


def test_without_a_standard_input_nobody_is_waited_for(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.stdin", None)
    words = ("deploy", *WORDS, "--port", "virtual", "--arm", "enter")
    assert "standard input is closed" in refused(capsys, lambda: hpac.main(words))


GONE = Mock(isatty=lambda: True, write=Mock(side_effect=BrokenPipeError))
"""A terminal that is no more."""


@pytest.mark.parametrize("stderr", [None, GONE], ids=["closed", "gone"])
def test_an_episode_that_nobody_follows_goes_on(stderr, path, capsys, monkeypatch):
    monkeypatch.setattr("sys.stderr", stderr)
    status, said = told(capsys, *WORDS, *VIRTUAL, "--log", path)
    arm_of("enter").tell({"phase": "lift"})
    monkeypatch.undo()
    assert (status, len(said.out.splitlines())) == (0, 2)
    assert "done: 64 commands" in said.out


def test_an_episode_leaves_a_log_and_tells_what_it_does(deployed_once):
    path, out, err = deployed_once
    assert "64 commands, 64 acknowledged, 0 late, 0 lost, 0 refused" in out
    assert err.splitlines() == ["to the start posture", "holds for 2 s", "opens"]
    head, *steps, end = map(json.loads, path.read_text().splitlines())
    assert (head["hpac_deploy"], head["env_id"], end["end"]) == (1, GRASP, "done")
    assert len(steps) == 64
    # The STATUS that came with the command before, at the beginning of its ramp.
    np.testing.assert_allclose(steps[10]["hand"], steps[8]["sent"], atol=1e-4)
    assert np.abs(np.diff([step["sent"] for step in steps], axis=0)).max() <= 0.1
    assert path.with_name("log.wire.jsonl").exists()


def test_the_page_of_a_deployment_shows_the_hand_by_its_file_and_a_stop_that_nobody_confirmed(
    link, monkeypatch
):
    page = create_autospec(HandPage)
    monkeypatch.setattr("hpac_gym.deploy.watching.HandPage", page)
    monkeypatch.setattr(link, "estop", Mock(side_effect=LinkTimeout("no answer to estop")))
    link.status()
    hand = replace(HPAC, calibration=Calibration(servo_zero=(0.3,) * 6))
    pictures = page.return_value.show.mock_calls
    with watched(link, Observer(GRASP, CAN).setup, hand):
        wait_for(lambda: pictures)
        first = pictures[0].args[0]
        _, _, stop = page.call_args.args
        stop()
        told = "Stop NOT CONFIRMED: switch the supply off. no answer to estop. before"
        wait_for(lambda: pictures[-1].args[0].text.startswith(told))
    assert first.text == "before or after the episode; idle"
    expected = settled_joints_from_servo(first.servo, hand, FLEXION)
    assert np.abs(expected).max() > 0.1
    np.testing.assert_allclose(first.joint_pos, expected, atol=5e-3)


def test_a_log_is_kept_from_the_next_deployment_that_names_it(log, capsys):
    words = [*WORDS, "--log", log, "--port"]
    steps = log.read_text()
    assert told(capsys, *words, "/dev/none")[0] == 2
    assert log.read_text() == steps
    assert told(capsys, *words, "virtual")[0] == 0
    assert log.with_stem("log-1").read_text() == steps
    assert log.read_text().count("\n") == 66


def test_every_log_has_a_wire_log_of_its_own_and_says_where_a_later_one_has_moved_it(tmp_path):
    names = [wire_log(Path(name)).name for name in ("n.jsonl", "try.1", "try.2")]
    assert names == ["n.wire.jsonl", "try.1.wire.jsonl", "try.2.wire.jsonl"]
    given = tmp_path / "n.jsonl"
    wire_log(given).write_text("frames")
    with Log(given) as first:
        wire_log(given).write_text("its own frames")
        with Log(given) as second, Log(given) as third:
            places = [log.path.name for log in (first, second, third)]
            first.write(end="done")
    assert places == ["n-2.jsonl", "n-3.jsonl", "n.jsonl"]
    assert given.with_stem("n-2").read_text() == '{"end": "done"}\n'
    wires = [(tmp_path / f"n-{number}.wire.jsonl").read_text() for number in (1, 2)]
    assert wires == ["frames", "its own frames"]


@pytest.mark.skipif(not Path("/dev/null").exists(), reason="no device that keeps nothing")
def test_beside_a_device_there_is_no_wire_log(capsys):
    status, out = told(capsys, *WORDS, *VIRTUAL, "--log", "/dev/null")
    assert (status, out.out.split("; log in ")[1]) == (0, "/dev/null\n")
    assert not Path("/dev/null.wire.jsonl").exists()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_full_disk_of_the_wire_log_alone_is_a_warning(path, capsys):
    path.with_name("log.wire.jsonl").symlink_to("/dev/full")
    with pytest.warns(LogWarning, match="link continues without it: .* No space") as said:
        status, out = told(capsys, *WORDS, *VIRTUAL, "--log", path)
    assert (status, len(said)) == (0, 1)
    assert "error" not in out.err
    assert "done: 64 commands" in out.out


def test_a_wire_log_that_is_a_folder_is_one_line(path, capsys):
    path.with_name("log.wire.jsonl").mkdir()
    words = ["deploy", *WORDS, *VIRTUAL, "--log", str(path)]
    line = refused(capsys, lambda: hpac.main(words))
    assert line.endswith("log.wire.jsonl': Is a directory")


# --- what goes wrong on the way: the hand is opened and disarmed first


class Lost(Fixed):
    """Loses the object after a while."""

    looks = 0

    def latest(self):
        self.looks += 1
        return self._pose, 0.0 if self.looks < 15 else 0.504


class Full(Log):
    """A disk that is full after twenty lines."""

    def write(self, **line):
        if line.get("step", 0) >= 20 or "end" in line:
            raise OutputError("cannot write 'log': No space left on device")


@pytest.mark.parametrize(
    ("fault", "source", "log", "error", "says"),
    [
        (
            lambda: np.full(6, np.nan),
            Fixed,
            Log,
            ShapeError,
            r"the policy's action\[0\] = nan must",
        ),
        (lambda: np.zeros((1, 6)), Fixed, Log, ShapeError, r"must have shape \(6,\), not \(1, 6\)"),
        (lambda: np.full(6, 1j), Fixed, Log, ShapeError, "complex128 is not a type of real"),
        (lambda: ["open"] * 6, Fixed, Log, ShapeError, "the policy's action must be an array of"),
        (Mock(side_effect=KeyboardInterrupt("by hand")), Fixed, Log, KeyboardInterrupt, "by hand"),
        (Mock(side_effect=ZeroDivisionError("x")), Fixed, Log, ZeroDivisionError, "x"),
        (
            lambda: np.zeros(6),
            Lost,
            Log,
            PoseError,
            "0.504 s old, allowed 0.5 s: given up, the hand opens",
        ),
        (lambda: np.zeros(6), Fixed, Full, OutputError, "No space left"),
    ],
    ids=["NaN", "shape", "complex", "text", "Ctrl-C", "bug", "lost object", "full disk"],
)
def test_the_hand_opens_and_is_disarmed_before_an_error_is_told(fault, source, log, error, says):
    course = []
    hand = VirtualHand(on_pulses=lambda _, pulses: pulses.all() and course.append(pulses))
    with HandLink(hand.connect) as link:
        with pytest.raises(error, match=says):
            episode(link, failing(fault), source(PLACE), log=log(None))
        assert link.state == "idle"
    assert not hand.pulses().any()
    angles = servo_from_pulses(course)
    assert angles.max(axis=0)[1:5].min() > 0.3, "it had closed"
    np.testing.assert_allclose(angles[-1], 0.0, atol=1e-4)


@pytest.mark.parametrize(("env_id", "options"), [(GRASP, {}), (GRASP_ANY, {"wrist": "free"})])
def test_a_first_decision_may_be_slow_and_none_is_asked_for_twice(hand, link, env_id, options):
    observer = Observer(env_id, CAN, **options)
    steps = []

    def decide(step):
        if not steps:
            hand.run(0.6)  # longer than the watchdog waits
        steps.append(step)
        return np.zeros(observer.action_space.shape)

    episode(link, Deciding(decide), observer=observer)
    assert steps == list(range(1, observer.steps + 1))


def test_a_hand_does_not_close_on_an_object_that_is_lost_while_the_arm_gets_ready(link):
    class Arriving(Arm):
        def ready(self, wait, told):
            source.looks = 15

    source = Lost(PLACE)
    source.looks = 15
    with pytest.raises(PoseError, match=r"0\.504 s old, allowed 0\.5 s$"):
        averaged(source, 0.0, 0.5)
    source.looks = 0
    with pytest.raises(PoseError, match=r"0\.504 s old, allowed"):
        episode(link, failing(None), source, Arriving(), live=lambda _: pytest.fail("closes"))


def test_a_recording_is_played_by_the_clock_of_the_hand(tmp_path, capsys):
    poses = tmp_path / "poses.csv"
    poses.write_text("time_s,x_m,y_m,z_m\n0,0.05,0.005,0.11\n0.1,0.05,0.005,0.11\n")
    words = ["deploy", *WORDS[:4], f"{poses}", *VIRTUAL, "--log", f"{tmp_path}/log.jsonl"]
    assert hpac.main(words) == 2
    assert "s old, allowed 0.5 s: given up, the hand opens" in capsys.readouterr().err


def test_an_estop_from_elsewhere_ends_the_episode_and_stays(hand):
    with HandLink(hand.connect) as link:

        def estop():
            hand.receive(encode(Frame("estop", 7, 0, {})))
            return np.zeros(6)

        with pytest.raises(FaultError, match="estop"):
            episode(link, failing(estop))
    assert not hand.pulses().any()
    with HandLink(hand.connect) as another:  # the end of the program that was stopped leaves it
        assert another.status().fault == "estop"


def test_ctrl_c_opens_a_hand_in_real_time(path):
    with HostBoard() as board:
        words = [*WORDS, "--port", board.port, "--log", str(path)]
        with started("-m", "hpac", "deploy", *words) as running:
            wait_for(
                lambda: (pulses := board.pulses()).all() and servo_from_pulses(pulses)[1] > 0.3, 30
            )
            running.send_signal(signal.SIGINT)
            _, said = running.communicate(timeout=30)
        assert (running.returncode, said) == (130, "to the start posture\ninterrupted\n")
        assert not board.pulses().any()
    *_, end = path.read_text().splitlines()
    assert json.loads(end)["end"].startswith("KeyboardInterrupt")


@pytest.fixture
def remote(udp):
    """The arm of a program, which is `udp`."""
    with closing(arm_of(f"udp:127.0.0.1:{udp.getsockname()[1]}")) as made:
        yield made


def test_an_arm_is_told_every_phase(link, remote, udp):
    observer = Observer(GRASP, CAN)
    remote.ready = lambda *_: None
    policy = load_policy("grasp", observer)
    episode(link, policy, arm=remote, observer=observer, hold=0.0)
    told = [json.loads(udp.recv(4096)) for _ in range(observer.steps)]
    assert list(dict.fromkeys(packet["phase"] for packet in told)) == list(observer.task.phases)
    assert [packet["time"] for packet in told] == pytest.approx(np.arange(observer.steps) / 20)
    assert max(packet["offset"][2] for packet in told) == pytest.approx(0.14, abs=0.002)


def test_an_arm_says_when_it_is_ready_and_an_answer_to_an_earlier_question_is_none(remote, udp):
    ready = b'{"hpac_arm": 1, "ready": true}'
    # The third answer comes twice, since it is slow.
    answers = [[b"what?"], [b"[" * 4000], [ready, ready], [], [b'{"hpac_arm": 2}'], [ready]]

    def wait(_):
        data, address = udp.recvfrom(4096)
        assert json.loads(data)["phase"] == "ready"
        for answer in answers.pop(0):
            udp.sendto(answer, address)
        time.sleep(0.01)

    for left in (3, 0):
        remote.ready(wait, {"phase": "ready"})
        assert len(answers) == left


def test_the_hand_is_preshaped_before_the_arm_is_asked_and_a_recording_begins_then(hand, link):
    class Arriving(Arm):
        def ready(self, wait, told):
            shapes.append(servo_from_pulses(hand.pulses()))
            source.begin = Mock()

    shapes = []
    source = Fixed(PLACE)
    observer = Observer(GRASP_TYPE, CAN, HPAC, "rod")
    episode(link, load_policy("scripted", observer), source, Arriving(), observer=observer)
    source.begin.assert_called_once_with()
    preshape = servo_from_synergy(GRASP_TYPES["rod"].start.preshape)
    np.testing.assert_allclose(shapes, [preshape], atol=1e-3)


# --- through the whole wire


def test_a_policy_holds_through_the_whole_wire_what_it_holds_in_the_environment():
    rows = deployed.pairs("grasp", ["all three"], range(3_000_000, 3_000_008))
    alone, held, sent, refused, lost = (sum(row[i] for row in rows) for i in range(1, 6))
    assert alone >= 5
    assert held >= alone - 2
    assert (sent, refused) == (8 * 64, 0)
    assert lost > 0


def test_through_the_wire_the_first_look_is_that_of_the_environment():
    with gymnasium.make(GRASP, engine="mujoco", noise=asdict(deployed.NOISE)) as made:
        env = made.unwrapped
        for seed in range(3):
            seen, _ = env.reset(seed=seed)
            world = deployed.LockStep(env, seed, noise=CameraNoise(0.0, 0.0, 0.0))
            observer = Observer(GRASP, world.seen_object)
            observer.start(world.body.setup)
            eye = deployed.Eye(env, world)
            np.testing.assert_allclose(observer.see(eye.latest()[0]), seen, atol=2e-3)
            exact = observer.see(world.latest()[0])
            assert np.abs(exact - seen).max() > 0.01  # the control


def test_jitter_and_deadlines_are_measured_in_real_time():
    found = deployed.in_real_time(1.0)
    assert 15 < found["sent"] + found["skipped"] < 25
    assert 0 <= found["p50_ms"] <= found["p99_ms"] <= found["worst_ms"] <= 25


# --- a log beside a simulation


def test_a_log_is_played_beside_a_simulation_and_no_legend_lies_on_a_curve(
    log, capsys, monkeypatch
):
    monkeypatch.setattr(replay, "save", Mock(side_effect=replay.save))
    picture = log.with_suffix(".png")
    status, said = told(capsys, log, "--out", picture, command="replay")
    assert (status, said.err) == (0, "")
    lines = said.out.splitlines()
    assert lines[0] == "grasp on virtual, 64 steps, ended: done"
    assert float(lines[1].split()[3]) < 0.05  # a little speed is left for early frames
    assert "the simulation: success" in lines[3]
    assert picture.stat().st_size > 10_000
    for axes in replay.save.call_args.args[0].axes:
        assert axes.get_legend().get_window_extent().x0 > axes.get_window_extent().x1


def test_the_simulation_has_the_object_turned_as_it_was_seen(monkeypatch):
    observer = Observer(GRASP, object_of("box:0.02,0.03,0.05"))
    turn = Rotation.from_quat(UPRIGHT) * Rotation.from_euler("z", -0.3)
    step = {"position": PLACE.position, "quaternion": turn.as_quat(), "action": np.zeros(6)}
    with gymnasium.make(GRASP, engine="mujoco") as env:
        monkeypatch.setattr(replay, "make_env", lambda *_, **__: nullcontext(env))
        monkeypatch.setattr(env, "reset", None)  # the scene is set up once
        simulation(observer, {}, [step], "mujoco")
        found = env.unwrapped.state.object_rotation[0]
    np.testing.assert_allclose(found, turn.as_matrix(), atol=0.02)


def test_an_object_of_a_file_and_a_calibrated_hand_are_played_as_they_were_deployed(
    path, tmp_path, capsys
):
    mesh = f"{tmp_path}/block.stl"
    trimesh.creation.box((40.0, 40.0, 100.0)).export(mesh)
    file = tmp_path / "hand.toml"
    file.write_text(hand_to_toml(replace(HPAC, calibration=Calibration(servo_zero=(0.3,) * 6))))
    words = ("grasp", "--object", mesh, "--set", "object.mass=0.3", "--set", "object.scale=0.001")
    assert told(capsys, *words, *WORDS[3:], *VIRTUAL, "--log", path, "--model", file)[0] == 0
    head, *_ = path.read_text().splitlines()
    assert json.loads(head)["object"] == {"path": mesh, "mass": 0.3, "scale": 0.001}
    file.unlink()
    status, said = told(capsys, path, command="replay")
    assert (status, said.err) == (0, "")
    assert float(said.out.splitlines()[1].split()[3]) < 0.05


def test_nothing_is_compared_after_the_end_of_the_simulation(path, capsys):
    with pytest.warns(UserWarning, match=r"= 0\.\d* m in .*PickPlace-v0 draws it at 0\.\d* to 0"):
        assert told(capsys, "pick-place", *WORDS[1:], *VIRTUAL, "--log", path)[0] == 0
    status, said = told(capsys, path, command="replay")
    assert (status, said.err) == (0, "")
    lines = said.out.splitlines()
    assert float(lines[1].split()[3]) < 0.15
    assert re.fullmatch(
        "the simulation: failure after . steps, before the end of the log", lines[3]
    )


def test_an_object_that_moved_is_told(log, capsys):
    rows = [json.loads(line) for line in log.read_text().splitlines()]
    for row in rows[10:-1]:
        row["position"][1] += 0.05
    del rows[0]["options"]  # as in older logs
    log.write_text("\n".join(map(json.dumps, rows)))
    assert "parted at 0.4" in told(capsys, log, command="replay")[1].out


HEAD = '{"hpac_deploy": 1, "env_id": "", "grasp": null, "object": "", "policy": "", "port": ""}'


def step(**change):
    """A step of a log."""
    zeros = {name: [0.0] * size for name, size in replay._SIZES.items()}
    row = {"step": 0, "t": 0, "phase": "close", "action": [0.0] * 6, **zeros}
    return json.dumps(row | {"quaternion": [0, 0, 0, 1], **change})


def test_a_log_that_was_cut_short_is_read(log, capsys):
    text = log.read_text()
    log.write_text(text[: len(text) // 2])
    status, said = told(capsys, log, command="replay")
    assert status == 0
    assert "ended: cut short" in said.out


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "it has no steps"),
        ("{}\n", "line 1 must be that of `hpac deploy`, version 1"),
        ('{"hpac_deploy": 1, "env_id": ""}\n', "line 1: without grasp, object, policy, port"),
        (f"{HEAD}\n", "it has no steps"),
        (f"{HEAD}\nx\n{{}}\n", "line 2: no JSON object"),
        (f"{HEAD}\n5\n", "line 2: no JSON object"),
        (
            f'{HEAD}\n{{}}\n{{"step": 0, "t": 0, "phase": "close", "quaternion": [0, 0, 0, 1]}}\n',
            "line 3: without action, hand, position, sent",
        ),
        (HEAD.replace('""', "null", 1), "line 1: env_id None is no text"),
        (HEAD.replace('"object": ""', '"object": 5'), "line 1: object 5 is no text"),
        (f'{HEAD[:-1]}, "model": 5}}', "line 1: model 5 is no text"),
        (f'{HEAD[:-1]}, "options": [1]}}', "line 1: options [1] are not those of an environment"),
        (f"{HEAD}\n{step(position=None)}", "line 2: position must have shape (..., 3), not ()"),
        (f"{HEAD}\n{step(action='abc')}", "line 2: action must be an array of numbers"),
        (f"{HEAD}\n{step(action=[0.1, [1, 2]])}", "line 2: action must be an array of numbers"),
        (
            f"{HEAD}\n{step(quaternion=[0] * 4)}",
            "line 2: quaternion = [0.0, 0.0, 0.0, 0.0] of norm 0",
        ),
    ],
    ids=range(15),
)
def test_what_is_no_log_is_one_line(path, capsys, text, says):
    path.write_text(text)
    assert says in refused(capsys, lambda: hpac.main(["replay", str(path)]))
