"""The printed sheet: exact to a tenth of a millimetre, every tag where the code says, its scale to be
checked.
"""

import re
from pathlib import Path
from unittest.mock import Mock

import cv2
import numpy as np
import pytest

import hpac
from experiments.pictures import Piece, Pinhole
from hpac_gym.calibration.driven import SIDES
from hpac_gym.camera import CameraError, commands
from hpac_gym.camera.detection import HD, READS, Device, Lens, detect, load_lens
from hpac_gym.camera.sheet import CHAINS, HAND, OBJECT, PAGE, STRIPS, TAGS, draw, points
from hpac_gym.model import JOINTS, SERVOS
from hpac_gym.output import OutputError
from tests.options import refused


@pytest.fixture(scope="module")
def printed(tmp_path_factory):
    """The sheet as a picture, and its dots per mm."""
    path = tmp_path_factory.mktemp("sheet") / "tags.png"
    draw(path)
    picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    return picture, picture.shape[1] / PAGE[0]


def test_every_tag_is_printed_where_the_layout_says_and_as_large(printed):
    picture, dots = printed
    seen = detect(cv2.resize(picture, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))
    assert set(seen) == set(TAGS) == set(range(29))
    for id, corners in seen.items():
        assert (TAGS[id].corners > 10).all()  # mm, which every printer leaves
        assert (TAGS[id].corners < np.array(PAGE) - 10).all()
        x, y = (2 * corners.T + 1.0) / dots  # from the middle of a pixel to the paper's edge
        np.testing.assert_allclose(np.stack([x, PAGE[1] - y], axis=1), TAGS[id].corners, atol=0.1)


def test_its_ruler_is_as_long_as_it_says(printed):
    picture, dots = printed
    row = picture[round((PAGE[1] - 14) * dots)]
    dark = np.flatnonzero(row < 128)
    assert np.ptp(dark) / dots == pytest.approx(100, abs=0.1)


def test_a_pdf_is_a_page_of_a4(tmp_path):
    draw(tmp_path / "tags.pdf")
    box = re.search(rb"/MediaBox \[ 0 0 ([\d.]+) ([\d.]+) \]", (tmp_path / "tags.pdf").read_bytes())
    assert np.array(box.groups(), dtype=float) / 72 * 25.4 == pytest.approx(PAGE, abs=0.01)


def test_a_strip_names_the_joints_of_its_servo():
    assert set(CHAINS) == set(STRIPS) == set(SIDES) == set(SERVOS)
    joints = [name for chain in CHAINS.values() for name in chain[1:]]
    assert sorted(joints) == sorted(JOINTS)
    assert CHAINS["index_mcp"] == ("palm", "index_mcp", "index_pip", "index_dip")


def test_a_board_has_its_middle_at_zero_and_is_in_metres():
    corners = np.concatenate(list(points(OBJECT).values()))
    np.testing.assert_allclose(corners.mean(axis=0), 0, atol=1e-12)
    np.testing.assert_allclose(np.ptp(corners, axis=0), [0.027, 0.027, 0])
    assert points(HAND)[4][0] == pytest.approx([-0.0225, 0.0225, 0])


def test_another_kind_of_file_is_one_line(tmp_path, capsys):
    with pytest.raises(OutputError, match=r"must end in \.pdf, \.svg, \.png"):
        draw(tmp_path / "tags.doc")
    assert hpac.main(["tags", "--out", str(tmp_path / "tags.svg")]) == 0
    assert "measure the line of 100 mm" in capsys.readouterr().out


# --- a camera's numbers from the sheet


def turned(count):
    """Rendered pictures of the whole sheet from different sides."""
    rng = np.random.default_rng(0)
    sheet = Piece((PAGE[0] / 2, PAGE[1] / 2), *PAGE)
    for _ in range(count):
        place = np.array([*rng.uniform(-0.25, 0.25, 2), rng.uniform(0.35, 0.45)])
        target = np.array([*rng.uniform(-0.03, 0.03, 2), 0.0])
        camera = Pinhole(place, target, np.array([1.0, 0.2, 0]), focal=930.0)
        yield camera.picture([(sheet, np.zeros(3), np.eye(3)[0], np.eye(3)[1])], rng)


def frames(pictures):
    """A camera that gives some pictures, and then none."""
    pictures = iter(pictures)
    return Mock(spec=Device, read=lambda: next(pictures, None))


BOARDS = {"hand_board": (0, 0.04, -0.03, 0, 0, 0, 1), "object_board": (0, 0, 0.01, 0, 0, 0, 1)}


def test_pictures_of_the_sheet_give_the_camera(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(commands, "Device", lambda *_: frames(turned(40)))
    path = tmp_path / "camera.json"
    assert hpac.main(["tags", "--calibrate", "0", "--out", str(path)]) == 0
    assert "picture 15 of 15: now tilt and move the sheet" in capsys.readouterr().err
    lens = load_lens(path)
    assert lens.focal == pytest.approx((930, 930), rel=0.005)
    assert lens.centre == pytest.approx((639.5, 359.5), abs=5)
    assert lens.size == HD
    assert lens.hand_board is lens.object_board is None


def test_another_calibration_keeps_where_its_owner_put_the_boards(tmp_path, monkeypatch):
    monkeypatch.setattr(commands, "Device", Mock())
    monkeypatch.setattr(commands, "calibrated", lambda _: (Lens(focal=(930.0, 930.0)), 0.1))
    path = tmp_path / "camera.json"
    path.write_text(Lens(focal=(500.0, 500.0), **BOARDS).to_json())
    assert hpac.main(["tags", "--calibrate", "0", "--out", str(path)]) == 0
    assert load_lens(path) == Lens(focal=(930.0, 930.0), **BOARDS)


@pytest.mark.parametrize(
    ("path", "says"),
    [
        ("/proc/none/camera.json", "cannot write to folder"),
        ("/dev/null", "cannot write '/dev/null': it is a device"),
        ("tags.pdf", "camera tags.pdf: "),
    ],
)
def test_a_file_that_is_not_to_be_written_is_told_before_the_camera_is_opened(
    path, says, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delattr(commands, "Device")
    sheet = tmp_path / "tags.pdf"
    sheet.write_text("the sheet")
    words = ["tags", "--calibrate", "0", "--out", path]
    assert says in refused(capsys, lambda: hpac.main(words))
    assert sheet.read_text() == "the sheet"


@pytest.mark.parametrize(
    ("name", "failed", "goes_on"),
    [("0", READS - 1, True), ("0", READS, False), ("film.avi", 1, False), ("²", 1, False)],
)
def test_a_live_camera_may_fail_a_few_times_and_the_end_of_a_video_is_its_end(
    monkeypatch, name, failed, goes_on
):
    came = (True, np.zeros(HD[::-1]))
    video = Mock()
    video.read.side_effect = [came, *[(False, None)] * failed, came]
    monkeypatch.setattr(cv2, "VideoCapture", lambda _: video)
    device = Device(name)
    assert device.read() is not None
    assert (device.read() is not None) == goes_on


def test_the_same_picture_again_calibrates_nothing():
    with pytest.raises(CameraError, match="1 different pictures with 12 tags"):
        commands.calibrated(frames([*turned(1)] * 20))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{", "camera .*: Expecting property name"),
        ("[1]", "camera .*"),
        ("[" * 100_000, "camera .*: maximum recursion depth"),
        ('{"hpac_camera": 2}', "hpac_camera is not 1"),
        ('{"hpac_camera": 1, "focal": [1, 2, 3]}', r"focal = \[1, 2, 3\] pixels must be 2 values"),
        ('{"hpac_camera": 1, "focal": [-1, 1]}', r"must be 2 values within \]0, inf\[ pixels"),
        ('{"hpac_camera": 1, "size": [900, 0]}', r"must be 2 values within \]0, inf\[ pixels"),
        (
            '{"hpac_camera": 1, "focal": [[1], [2, 3]]}',
            r"focal = \[\[1\], \[2, 3\]\] pixels must be",
        ),
        ('{"hpac_camera": 1, "focal": [900, 900]}', "without size, centre, distortion"),
        (
            '{"hpac_camera": 1, "distortion": ["0", "0", "0", "0", "0"]}',
            "distortion = .* must be 5 values",
        ),
        ('{"hpac_camera": 1, "zoom": 1}', "zoom"),
        ('{"hpac_camera": 1, "hand_board": [0, 0, 0]}', r"hand_board = .* must be 7 values"),
        (
            '{"hpac_camera": 1, "hand_board": [0, 0, 0, 0, 0, 0, 0]}',
            "hand_board: the quaternion's length is 0, it must be 1",
        ),
        (
            '{"hpac_camera": 1, "object_board": [0, 0, 0, 3, 0, 0, 0]}',
            "object_board: the quaternion's length is 3, it must be 1",
        ),
    ],
)
def test_a_malformed_camera_file_is_one_line(tmp_path, text, says):
    path = tmp_path / "camera.json"
    path.write_text(text)
    with pytest.raises(CameraError, match=says):
        load_lens(path)


@pytest.mark.skipif(not Path("/dev/null").exists(), reason="no device that is empty")
def test_a_device_is_no_camera_file():
    with pytest.raises(CameraError, match="camera /dev/null: it is a device"):
        load_lens(Path("/dev/null"))


def test_a_camera_file_is_read_as_it_was_written(tmp_path):
    lens = Lens(
        (640, 480), (500.0, 501.0), (320.5, 239.0), (0.1, -0.2, 0, 0, 0), (0, 0, 0, 0, 0, 0, 1)
    )
    (tmp_path / "camera.json").write_text(lens.to_json())
    assert load_lens(tmp_path / "camera.json") == lens
