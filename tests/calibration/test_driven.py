"""A hand that is swept and watched, in lock-step: driver → link → the firmware in virtual time → a
simulated hand → rendered pictures of its tags → record. The hand ends open and without pulses whatever
happens, and what was recorded is kept.
"""

import io
import json
import sys
from dataclasses import replace
from functools import cache, partial
from itertools import chain
from threading import Lock
from unittest.mock import Mock

import numpy as np
import pytest

import hpac
from experiments.hidden import LAWS, hidden_hands
from experiments.rig import Rig
from experiments.strips import STRIP_LENS, Body
from hpac_gym.bridge import FaultError, HandLink, VirtualHand, servo_from_pulses
from hpac_gym.bridge.hands import config_of
from hpac_gym.calibration import driven
from hpac_gym.calibration.driven import LEAST_SLACK, AnglesFile, Eye, added, angles_in
from hpac_gym.calibration.driver import Segment, sweep_servo
from hpac_gym.calibration.judging import judged
from hpac_gym.calibration.record import (
    EXTENDING,
    FLEXING,
    REST,
    Protocol,
    RecordError,
    concatenate,
    read_sweep,
    write_sweep,
)
from hpac_gym.camera import CameraError, angles
from hpac_gym.camera.sheet import CHAINS, STRIPS
from hpac_gym.model import HPAC, JOINT_INDEX, SERVO_INDEX
from hpac_gym.model.calibration import Calibration
from hpac_gym.model.settled import settled_joints_from_servo

SHORT = Protocol(points=9, seconds_per_point=1.0, hold=0.5, rest=1.0, both_directions=True)
SHORTER = Protocol(points=5, seconds_per_point=0.8, hold=0.5, rest=1.0, both_directions=True)
PROTOCOLS = {"index_mcp": SHORT}
RATE_HZ = 8.0


class Rigged:
    """A hand on a virtual wire, with its physics in its stand before the camera."""

    def __init__(self, servo, seed=1, hand=HPAC, physics=False):
        self.body = Body(Rig(), seed)
        if physics:
            self.body.mount(servo)
        self.pulses = []
        self.swept = hand
        self.hand = VirtualHand(config=config_of(hand), on_pulses=self.on_pulses)
        self.segment = Segment(servo)

    def on_pulses(self, now_us, pulses):
        self.body.on_pulses(now_us, pulses)
        self.pulses.append(pulses)

    def sweep(self, look, protocol=SHORTER):
        with HandLink(self.hand.connect, hand=self.swept) as link:
            sweep_servo(link, look, self.segment, self.swept, protocol, RATE_HZ)
        return self

    def errors(self):
        columns = [JOINT_INDEX[name] for name in CHAINS[self.segment.servo][1:]]
        seen = self.segment.joint_pos[:, columns]
        return np.degrees(np.abs(seen - np.array(self.body.true)[:, columns]))


@cache
def watched(servo):
    """A hand that was swept before the camera."""
    rigged = Rigged(servo, seed=2, physics=True)
    rigged.sweep(rigged.body.look, PROTOCOLS.get(servo, SHORTER))
    rigged.segment.angles_from_tags(STRIP_LENS)
    return rigged


@pytest.fixture
def index(monkeypatch):
    """The index as it was watched; further fits of its tags take fewer pictures."""
    rigged = watched("index_mcp")
    monkeypatch.setattr(angles, "FITTED", 15)
    return rigged


def test_the_angles_of_a_picture_are_good_to_half_a_degree(index):
    assert len(index.segment.time) == 160
    errors = index.errors()
    assert not np.isnan(errors).any()
    assert np.median(errors) < 0.1
    assert np.quantile(errors, 0.95) < 0.25
    assert errors.max() < 0.5


@pytest.mark.parametrize(
    "servo",
    [
        "ring_mcp",
        "thumb_mp",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in ("middle_mcp", "pinky_mcp", "thumb_cmc")
        ),
    ],
)
def test_so_are_those_of_every_other_servo(servo):
    """From the other side, where flexion turns the tags the other way; and of the thumb."""
    errors = watched(servo).errors()
    assert np.isnan(errors).mean() < 0.02
    assert np.nanquantile(errors, 0.95) < 0.5
    assert watched(servo).segment.joint_pos[:, JOINT_INDEX[servo]].max() > 0.8  # flexion: positive


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("zero_deg", "points", "told"),
    [(-0.6, 31, False), (-4.0, 31, False)]
    + [(zero, points, True) for zero in (0.0, 0.6, 1.2) for points in (13, 31)],
)
def test_a_thumb_that_flexes_from_command_0_on_is_told(zero_deg, points, told):
    """Five hands whose geometry is up to 5 % off the design's; their angles count from rest."""
    for built in hidden_hands(5, 5, LAWS["laws of the fit"]):
        zero = (np.radians(zero_deg), *(0.0,) * 5)
        hand = replace(built.hand, calibration=Calibration(zero))
        segment = Segment("thumb_mp")
        for point, angle in enumerate(np.linspace(0.0, HPAC.servo_max[0], points)):
            segment.labels.append((FLEXING, point))
            segment.time.append(float(point))
            segment.commanded.append(np.array([angle, *(0.0,) * 5]))
        angles = settled_joints_from_servo(np.array(segment.commanded), hand)
        segment.joint_pos = angles - angles[0]
        segment.joint_pos[0] = np.nan  # a point whose tags no picture shows
        assert (segment.slack(HPAC) < LEAST_SLACK) == told


def test_a_record_has_what_calibration_wants(index):
    record = index.segment.sweep()
    assert judged(record, HPAC) == []
    assert np.allclose(np.diff(record.time), 1 / RATE_HZ)
    rest = np.flatnonzero(record.phase == REST)
    assert rest[0] == 0
    assert rest[-1] == len(record) - 1
    assert (record.phase == REST).sum() == 16
    for phase in (FLEXING, EXTENDING):
        held = (record.phase == phase) & (record.point >= 0)
        assert set(record.point[held]) == set(range(SHORT.points))
        for point in range(SHORT.points):
            servo = record.servo[held & (record.point == point), 1]
            assert servo == pytest.approx(HPAC.servo_max[1] * point / 8, abs=2e-4)
            assert len(servo) == 2
    others = [i for i in range(6) if i != 1]
    assert (record.servo[:, others] == 0).all()
    assert np.isnan(record.joint_pos[:, 5:]).all()


def test_neighbours_that_would_hide_the_tags_are_flexed_meanwhile():
    record = Rigged("middle_mcp").sweep(dict).segment.sweep()
    servo = record.servo[record.phase != REST]
    assert servo[:, 1] == pytest.approx(HPAC.servo_max[1], abs=1e-3)
    assert (servo[:, [0, 3, 4, 5]] == 0).all()


BENT = replace(HPAC, rate_limit=0.4, workspace=HPAC.workspace | {"ring_mcp": (0.1, 1.2)})
"""A slow hand whose ring finger does not open to 0 rad."""


@pytest.mark.parametrize("hand", [HPAC, BENT], ids=["nominal", "bent"])
def test_at_rest_there_are_no_pulses_but_for_the_thumb(hand):
    for servo, pulsed in (("index_mcp", False), ("thumb_mp", True)):
        rigged = Rigged(servo, hand=hand)
        resting = []

        def look(rigged=rigged, resting=resting):
            resting.append(bool(rigged.pulses[-1].any()))
            return {}

        rigged.sweep(look)
        at_rest = [phase == REST for phase, _ in rigged.segment.labels]
        assert {on for on, rest in zip(resting, at_rest, strict=True) if rest} == {pulsed}
        assert not rigged.pulses[-1].any()
        others = np.delete(rigged.segment.sweep().servo, [SERVO_INDEX[servo], 5], axis=1)
        rest = np.delete(hand.servo_min, [SERVO_INDEX[servo], 5])
        np.testing.assert_allclose(others, np.tile(rest, (len(others), 1)), atol=1e-3)


# --- safety


@pytest.mark.parametrize("at", [3, 25, 50, 73], ids=["rest", "flexion", "extension", "last rest"])
@pytest.mark.parametrize("error", [KeyboardInterrupt(), CameraError("gone"), ZeroDivisionError()])
def test_every_error_opens_the_hand_disarms_it_and_keeps_what_there_is(at, error):
    rigged = Rigged("index_mcp")

    def look():
        if len(rigged.segment.seen) == at:
            raise error
        return {}

    with pytest.raises(type(error)):
        rigged.sweep(look)
    assert not rigged.pulses[-1].any()
    told = [pulses for pulses in rigged.pulses if pulses.all()]
    if told:
        assert servo_from_pulses(told[-1]) == pytest.approx(np.zeros(6), abs=1e-3)
        steps = np.diff([servo_from_pulses(pulses) for pulses in told], axis=0)
        assert np.abs(steps).max() < 2e-3 + 2e-3  # no jump: 2 rad/s and a step of the wire
    assert len(rigged.segment.sweep()) == at


@pytest.mark.parametrize("before", [True, False])
def test_an_estop_ends_the_sweep_without_pulses(before):
    """One that is latched before it lets nothing move."""
    rigged = Rigged("index_mcp")
    with HandLink(rigged.hand.connect) as link:

        def look():
            if len(rigged.segment.seen) == 20:
                link.estop()
            return {}

        if before:
            link.estop()
        with pytest.raises(FaultError):
            sweep_servo(link, look, rigged.segment, HPAC, SHORTER, RATE_HZ)
        assert not rigged.hand.pulses().any()
    assert np.any(rigged.pulses) != before
    assert not before or len(rigged.segment.time) == 8  # the first rest


# --- exchanged tags, and none


def exchanged(seen, first, second):
    """Pictures of the index with two tags glued where the other belongs."""
    tags = STRIPS["index_mcp"]
    belongs = {tags[first].id: tags[second].id, tags[second].id: tags[first].id}
    return [{belongs.get(id, id): corners for id, corners in picture.items()} for picture in seen]


@pytest.mark.parametrize("glued", [(1, 2), (2, 3), (1, 3)])
def test_exchanged_tags_are_refused(index, glued):
    wrong = replace(index.segment, seen=exchanged(index.segment.seen, *glued))
    wrong.angles_from_tags(STRIP_LENS)
    with pytest.raises(RecordError, match=r"the record is refused: .* are labels exchanged"):
        judged(wrong.sweep(), HPAC)


def test_a_strip_of_another_digit_is_not_found(index):
    wrong = replace(index.segment, servo="middle_mcp")
    with pytest.raises(CameraError, match=r"0 pictures show all tags .*: palm 0, middle_mcp 0"):
        wrong.angles_from_tags(STRIP_LENS)


def test_a_camera_that_is_moved_is_told(index):
    seen = [dict(tags) for tags in index.segment.seen]
    for number, tags in enumerate(seen):
        for id, corners in tags.items():
            tilt = np.array([[1.0, 0.0], [0.0, 1.0 - 0.3 * number / len(seen)]])
            tags[id] = corners @ tilt
    rest = np.array([phase == REST for phase, _ in index.segment.labels])
    with pytest.raises(CameraError, match="pixels from a turn about one axis"):
        angles.turns(seen, STRIPS["index_mcp"], STRIP_LENS, rest)


def test_pictures_without_a_tag_lose_that_angle_alone(index):
    tag = STRIPS["index_mcp"][3].id
    rest = np.array([phase == REST for phase, _ in index.segment.labels])
    holed = [
        {id: corners for id, corners in seen.items() if id != tag or number % 3}
        for number, seen in enumerate(index.segment.seen)
    ]
    joint_pos, _ = angles.turns(holed, STRIPS["index_mcp"], STRIP_LENS, rest)
    assert np.isnan(joint_pos[::3, 2]).all()
    assert not np.isnan(joint_pos[:, :2]).any()
    never_at_rest = [
        seen if not r else {} for seen, r in zip(index.segment.seen, rest, strict=True)
    ]
    with pytest.raises(CameraError, match=r"tag 11 \(palm\) is not seen at rest"):
        angles.turns(never_at_rest, STRIPS["index_mcp"], STRIP_LENS, rest)


def test_a_stalled_camera_and_a_missing_strip_are_told(monkeypatch, camera):
    picture = {11: np.zeros((4, 2))}
    latest = Mock(return_value=(picture, 0.0))
    monkeypatch.setattr(driven, "Device", Mock())
    monkeypatch.setattr(driven, "Watch", lambda *_: Mock(latest=latest, fault=""))
    monkeypatch.setattr(driven, "PATIENCE", 0.1)
    eye = Eye(camera)
    with pytest.raises(CameraError, match=r"not seen: tag 12 \(index_mcp\), 13 \(index_pip\), 14"):
        eye.begin("index_mcp")
    assert eye.look() is picture
    assert eye.look() == {}  # the same picture
    for latest.return_value in (None, (picture, 1.1)):
        with pytest.raises(CameraError, match="no picture for 1 s: it hangs"):
            eye.look()


# --- angles of another program


def test_angles_of_another_program_are_joined_by_the_time_of_the_day(tmp_path):
    path = tmp_path / "angles.csv"
    lines = [f"{100 + 0.01 * k},{0.01 * k},{'' if k > 50 else 0.02 * k}" for k in range(101)]
    text = "\n".join(["time_s,joint_index_mcp_rad,joint_index_pip_rad", *lines])
    path.write_text(f"{text}\n101.5,0.")  # the last line is still being written
    segment = Segment("index_mcp", labels=[(REST, -1)] * 4, unix=[99.0, 100.105, 100.8, 101.05])
    segment.time = [0.0, 0.1, 0.2, 0.3]
    AnglesFile(path).measure(segment, HPAC)
    mcp, pip = segment.joint_pos[:, [JOINT_INDEX["index_mcp"], JOINT_INDEX["index_pip"]]].T
    np.testing.assert_allclose(mcp, [np.nan, 0.105, 0.8, 1.0], atol=1e-9)
    np.testing.assert_allclose(pip, [np.nan, 0.21, np.nan, np.nan], atol=1e-9)
    assert np.isnan(segment.joint_pos[:, JOINT_INDEX["thumb_ip"]]).all()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (None, "No such file"),
        ("", "no rows with time_s and any of joint_thumb_ip_rad"),
        ("time_s,angle\n0,1\n", "no rows with time_s and any of"),
        ("time_s,joint_index_mcp_rad\n0,one\n", "could not convert"),
        (f"time_s,joint_index_mcp_rad\n{'9' * 200_000},0\n", "field larger than field limit"),
        ("time_s,joint_index_mcp_rad\n1,0\n0,0\n", "times must increase"),
        ("time_s,joint_index_mcp_rad\nnan,0\n", "times must increase"),
        ("time_s,joint_index_mcp_rad\n1,90\n", "within ±π rad"),
        ("time_s,joint_index_mcp_rad\n1,0", "no rows with time_s"),
        ("time_s,joint_ring_mcp_rad\n1,0\n", "none of the joints of index_mcp within 0.1 s of a"),
        ("time_s,joint_index_mcp_rad\n2,0\n", "none of the joints of index_mcp within 0.1 s of a"),
    ],
)
def test_angles_that_are_none_are_one_line(tmp_path, text, says):
    path = tmp_path / "angles.csv"
    if text is not None:
        path.write_text(text)
    with pytest.raises(RecordError, match=says):
        AnglesFile(path).measure(Segment("index_mcp", unix=[1.0]), HPAC)


def test_the_last_rows_of_angles_are_read_without_the_others(tmp_path):
    path = tmp_path / "angles.csv"
    rows = [f"{at},0.25\n" for at in range(10_000, 11_000)]
    path.write_text("time_s,joint_index_mcp_rad\n" + "".join(rows))
    for last, count in ((11, 1), (12, 1), (22, 2), (10_999, 999), (11_000, 1000), (12_000, 1000)):
        assert angles_in(path, last)[1].tolist() == [*range(11_000 - count, 11_000)]
    with pytest.raises(RecordError, match="no rows"):
        angles_in(path, 10)


# --- the file, and the command


def test_a_segment_stands_where_the_old_one_stood_and_others_stay(index):
    """Between two others of one servo and trial, they would become one without it."""
    between = index.segment
    around = replace(index.segment, trial=1)
    count = len(between.time)
    assert sorted(added(added(None, between), around).trial) == [0] * count + [1] * count
    record = added(concatenate([around.sweep(), between.sweep(), around.sweep()]), between)
    assert [int(record.trial[rows[0]]) for rows in record.segments()] == [1, 0, 1]
    assert len(record) == 3 * count


@pytest.fixture
def wired(monkeypatch, request):
    """The command on a hand in lock-step; its camera sees what it saw when the hand was `watched`."""
    servo = getattr(request, "param", "index_mcp")
    rigged = Rigged(servo)
    seen = watched(servo).segment.seen
    rigged.pictures = chain(seen[:1], seen)  # the first for who waits for all tags
    watch = Mock(latest=lambda: (next(rigged.pictures), 0.0), fault="")
    monkeypatch.setattr(angles, "FITTED", 15)
    monkeypatch.setattr(driven, "connector", lambda *_: rigged.hand.connect)
    monkeypatch.setattr(driven, "Device", Mock())
    monkeypatch.setattr(driven, "Watch", lambda *_: watch)
    monkeypatch.setattr(driven, "PROTOCOL", PROTOCOLS.get(servo, SHORTER))
    monkeypatch.setattr(driven, "sweep_servo", partial(sweep_servo, rate_hz=RATE_HZ))
    monkeypatch.setattr("hpac_gym.calibration.sweep.save", Mock())
    monkeypatch.setattr("hpac_gym.calibration.calibrate.save", Mock())
    monkeypatch.setattr("hpac_gym.calibration.calibrate.DRAWS", 2)
    return rigged


@pytest.fixture
def camera(tmp_path):
    """A camera with its file, as on the command line."""
    lens = tmp_path / "camera.json"
    lens.write_text(STRIP_LENS.to_json())
    return f"0,{lens}"


WORDS = ("sweep", "--port", "any", "--servo", "index_mcp")


class Terminal(io.StringIO):
    """What a person types."""

    def isatty(self):
        return True


def test_the_command_asks_sweeps_and_its_record_calibrates(
    wired, camera, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(sys, "stdin", Terminal("\n"))
    words = [*WORDS, "--camera", camera, "--out", str(tmp_path / "out"), "--json"]
    assert hpac.main(words) == 0, capsys.readouterr().err
    told = capsys.readouterr()
    asked = "index_mcp: tags 11 palm, 12 index_mcp, 13 index_pip, 14 index_dip; the camera looks"
    assert told.err.startswith(asked)
    assert "its tags fit to 0.0" in told.err
    assert "taut" not in told.err
    path = tmp_path / "out" / "sweep.csv"
    assert json.loads(told.out)["record"] == str(path)
    assert not wired.hand.pulses().any()
    assert hpac.main(["calibrate", str(path), "--out", str(tmp_path / "hand.toml")]) == 0
    assert "g_CMC" not in capsys.readouterr().out


@pytest.mark.parametrize("typed", [Terminal(), None], ids=["^D", "none"])
def test_where_nobody_answers_nothing_moves(wired, camera, tmp_path, capsys, monkeypatch, typed):
    monkeypatch.setattr(sys, "stdin", typed)
    assert hpac.main([*WORDS, "--camera", camera, "--out", str(tmp_path)]) == 2
    said = capsys.readouterr()
    assert (said.out, said.err.count("\n")) == ("", 2)
    assert said.err.endswith("error: standard input has ended: nobody answers\n")
    assert not np.any(wired.pulses)


@pytest.mark.parametrize("wired", ["thumb_mp"], indirect=True)
def test_the_command_warns_of_a_thumb_that_may_be_taut_at_rest(wired, camera, tmp_path, capsys):
    driven.record("any", tmp_path / "sweep.csv", camera=camera, servos=["thumb_mp"])
    told = capsys.readouterr().err
    assert "thumb_mp: it flexes from command 0 on. If its tendon is taut there" in told


class Writer:
    """Another program: each look at the clock is 0.05 s later, and has written a row up to then."""

    def __init__(self, path, hand):
        self.path = path
        self.hand = hand
        self.now = 1000.0
        self.until = np.inf
        self.lock = Lock()  # threads of libraries look, too
        path.write_text("time_s,joint_index_mcp_rad,joint_index_pip_rad\n")

    def time(self):
        with self.lock:
            self.now += 0.05
            if self.now <= self.until:
                pulses = self.hand.pulses()
                servo = servo_from_pulses(pulses)[1] if pulses.all() else 0.0
                with self.path.open("a") as file:
                    print(f"{self.now:.3f},{0.9 * servo:.6f},{1.08 * servo:.6f}", file=file)
            return self.now


@pytest.fixture
def tracker(wired, tmp_path, monkeypatch):
    tracker = Writer(tmp_path / "angles.csv", wired.hand)
    monkeypatch.setattr(driven.time, "time", tracker.time)
    return tracker


def test_another_tracker_s_angles_are_taken_and_an_old_record_is_kept(tracker, tmp_path, capsys):
    path = tmp_path / "sweep.csv"
    words = [*WORDS, "--servo", "index_mcp", "--angles", str(tracker.path), "--points", "3"]
    words += ["--out", str(tmp_path)]
    for trial in ("0", "1"):
        assert hpac.main([*words, "--trial", trial]) == 0
        assert capsys.readouterr().err.count("recorded: ") == 1
    assert not (tmp_path / "sweep-1.csv").exists()
    before = path.read_text()
    assert hpac.main([*words, "--points", "4"]) == 0
    assert (tmp_path / "sweep-1.csv").read_text() == before != path.read_text()
    record = read_sweep(path)
    assert set(record.trial) == {0, 1}
    np.testing.assert_allclose(record.joint_pos[:, 4], 0.9 * record.servo[:, 1], atol=2e-3)
    assert np.isnan(record.joint_pos[:, :3]).all()


@pytest.mark.parametrize("seconds", [0.05, 10.0], ids=["at once", "while it flexes"])
def test_a_tracker_that_stops_ends_the_sweep(wired, tracker, tmp_path, capsys, seconds):
    """Before the hand has a pulse; and when its last row is a second old."""
    tracker.until = tracker.now + seconds
    tracker.time()
    tracker.now = max(tracker.now, tracker.until + 1.1 - seconds)
    assert hpac.main([*WORDS, "--angles", str(tracker.path), "--out", str(tmp_path)]) == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert f"error: angles {tracker.path}: its last row is 1." in said
    assert "s old, the limit is 1 s" in said
    assert bool(np.any(wired.pulses)) == (seconds > 1)
    assert not wired.hand.pulses().any()
    assert tracker.now < tracker.until + 1.3
    assert not (tmp_path / "sweep.csv").exists()


def test_an_interrupted_sweep_leaves_the_record_as_it_was(wired, camera, tmp_path, capsys):
    def stopped():
        yield from watched("index_mcp").segment.seen[:50]
        raise KeyboardInterrupt

    path = tmp_path / "sweep.csv"
    write_sweep(path, watched("index_mcp").segment.sweep())
    before = path.read_bytes()
    wired.pictures = stopped()
    assert hpac.main([*WORDS, "--camera", camera, "--out", str(tmp_path)]) == 130
    assert "recorded: " not in capsys.readouterr().err
    assert path.read_bytes() == before
    assert np.any(wired.pulses)
    assert not wired.hand.pulses().any()


def test_a_complete_sweep_is_recorded_whoever_hears_of_it(wired, camera, tmp_path, monkeypatch):
    def closed(text, **_):
        if "its tags fit" in text:
            raise BrokenPipeError

    monkeypatch.setattr(driven, "print", closed, raising=False)
    with pytest.raises(BrokenPipeError):
        driven.record("any", tmp_path / "sweep.csv", camera=camera, servos=["index_mcp"])
    assert set(read_sweep(tmp_path / "sweep.csv").swept) == {SERVO_INDEX["index_mcp"]}


def test_a_wrong_strip_is_not_recorded_and_told(wired, camera, tmp_path, capsys):
    wired.pictures = iter(exchanged(wired.pictures, 0, 3))
    words = [*WORDS, "--camera", camera, "--out", str(tmp_path)]
    assert hpac.main(words) == 2
    assert "error: sweep of index_mcp: tag 11 (palm) must stand still" in capsys.readouterr().err
    assert not (tmp_path / "sweep.csv").exists()
    assert not wired.hand.pulses().any()
