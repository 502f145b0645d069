"""From a camera's picture to the corners of tags, and the camera's own numbers: focal lengths,
centre, distortion.
"""

import json
import threading
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from time import monotonic
from typing import Any, Generic, TypeVar

import numpy as np

from hpac_gym.camera import CameraError, opencv
from hpac_gym.camera.sheet import TAGS
from hpac_gym.errors import HpacError
from hpac_gym.model.checks import Array
from hpac_gym.output import read_text
from hpac_gym.settings import check_bounds, setting

HD = (1280, 720)
FIELD_OF_VIEW_DEG = 65.0
"""Horizontal field of view of a camera without a file (chosen: a usual webcam)."""
Seen = dict[int, Array]
"""Corners of the tags in one picture, by id, in the order of `sheet.Tag.corners`, shape (4, 2)
[pixels].
"""
READS = 5
"""Reads of a camera that fail in a row before it counts as gone (chosen)."""
_MEASURED = ("size", "focal", "centre", "distortion")
"""What a calibration measures."""
_ANY = (-np.inf, np.inf)
_Result = TypeVar("_Result")
_EDGE_PART = (0.08, 0.92)
"""Part of an edge on which it is looked for."""
_EDGE_POINTS = 24
_EDGE_REACH = 2.0
"""On either side of the first guess: less than a tag's module [pixels]."""
_EDGE_STEP = 0.25
_EDGE_LEAST = 0.2
"""Share of the steepest rise below which a rise is noise."""


@dataclass(frozen=True, slots=True)
class Lens:
    """A camera's numbers, in OpenCV's model: focal lengths, principal point [pixels], distortion;
    as they stand those of a camera of `HD` with `FIELD_OF_VIEW_DEG`.

    Raises:
        ParameterError: A number is missing, not finite, or not positive where it must be.
        CameraError: A quaternion is not of length 1.
    """

    size: tuple[int, int] = setting(HD, size=2, bounds=(0, np.inf), above=True, unit="pixels")
    """Width and height of its pictures [pixels]."""
    focal: tuple[float, float] = setting(
        (HD[0] / 2 / np.tan(np.radians(FIELD_OF_VIEW_DEG) / 2),) * 2,
        size=2,
        bounds=(0, np.inf),
        above=True,
        unit="pixels",
    )
    centre: tuple[float, float] = setting(
        ((HD[0] - 1) / 2, (HD[1] - 1) / 2), size=2, bounds=_ANY, unit="pixels"
    )
    distortion: tuple[float, ...] = setting((0.0,) * 5, size=5, bounds=_ANY)
    hand_board: tuple[float, ...] | None = setting(None, size=7, bounds=_ANY)
    """Where the hand's board is in the hand's frame: x, y, z [m] and a quaternion xyzw; None is
    `poses.HAND_BOARD`.
    """
    object_board: tuple[float, ...] | None = setting(None, size=7, bounds=_ANY)
    """The same of the object's board in the object's axes; None: flat on its top."""

    def __post_init__(self) -> None:
        check_bounds(self)
        for name in ("hand_board", "object_board"):
            board = getattr(self, name)
            if board and not 0.9 <= (length := np.linalg.norm(board[3:])) <= 1.1:
                raise CameraError(f"{name}: the quaternion's length is {length:.3g}, it must be 1")

    def tags(self, picture: np.ndarray) -> Seen:
        """The sheet's tags in a picture of this camera, see `detect`.

        Raises:
            CameraError: Its size is another one.
        """
        if picture.shape[1::-1] != self.size:
            width, height = picture.shape[1::-1]
            raise CameraError(
                f"the camera's pictures have {width}×{height} pixels, its numbers are for "
                f"{self.size[0]}×{self.size[1]}: calibrate it with `hpac tags --calibrate`"
            )
        return detect(picture)

    @property
    def matrix(self) -> Array:
        """The camera's matrix, shape (3, 3)."""
        matrix = np.diag([*self.focal, 1.0])
        matrix[:2, 2] = self.centre
        return matrix

    def to_json(self) -> str:
        """The text of its file."""
        return json.dumps({"hpac_camera": 1, **asdict(self)}, indent=2) + "\n"


def load_lens(path: Path) -> Lens:
    """Read a camera's file, as ``hpac tags --calibrate`` writes it.

    Raises:
        CameraError: It cannot be read, or is no such file, or a number is missing.
    """
    text = read_text(path, "camera", CameraError)
    try:
        table = json.loads(text)
        if table.pop("hpac_camera") != 1:
            raise CameraError("hpac_camera is not 1")
        lens = Lens(**table)
        if missing := [name for name in _MEASURED if name not in table]:
            raise CameraError(
                f"without {', '.join(missing)}; `hpac tags --calibrate` measures them"
            )
        return lens
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, CameraError) as error:
        raise CameraError(f"camera {path}: {error}") from None


def lens_of(text: str) -> tuple[str, Lens]:
    """The name of a camera and its numbers: ``N``, or ``N,FILE``; without a file they are guessed,
    which a warning tells.

    Raises:
        CameraError: The file is none of a camera.
    """
    name, _, file = text.partition(",")
    if not file:
        warnings.warn(
            f"no file of the camera is given: a horizontal field of view of {FIELD_OF_VIEW_DEG:g}° is assumed, "
            "and no distortion; `hpac tags --calibrate` measures them",
            stacklevel=2,
        )
    return name, load_lens(Path(file)) if file else Lens()


@cache
def _detector() -> Any:
    cv2 = opencv()
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    settings.relativeCornerRefinmentWinSize = 1.0
    settings.cornerRefinementWinSize = 3
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    return cv2.aruco.ArucoDetector(family, settings)


def detect(picture: np.ndarray) -> Seen:
    """The sheet's tags in a picture, shape (height, width) or (height, width, 3); a tag that is
    there twice is left out.
    """
    if picture.ndim == 3:
        picture = opencv().cvtColor(picture, opencv().COLOR_BGR2GRAY)
    corners, ids, _ = _detector().detectMarkers(picture)
    tag_ids = [] if ids is None else ids.ravel().tolist()
    seen = {
        id: square.reshape(4, 2).astype(float)
        for id, square in zip(tag_ids, corners, strict=True)
        if id in TAGS and tag_ids.count(id) == 1
    }
    if not seen:
        return {}
    return dict(zip(seen, _on_edges(picture, np.stack(list(seen.values()))), strict=True))


def _on_edges(picture: np.ndarray, corners: Array) -> Array:
    """Corners where lines through the edges of their squares meet.

    OpenCV's corners lie 0.2 pixels too far inside in a slightly blurred picture, and scatter by
    0.08; those of the lines lie within 0.06.

    Args:
        picture: grey values.
        corners: of the squares, clockwise in the picture, shape (k, 4, 2) [pixels].
    """
    along = np.linspace(*_EDGE_PART, _EDGE_POINTS)
    away = np.arange(-_EDGE_REACH, _EDGE_REACH + 1e-6, _EDGE_STEP)
    way = np.roll(corners, -1, axis=1) - corners
    outward = np.stack([way[..., 1], -way[..., 0]], axis=-1)
    outward /= np.linalg.norm(way, axis=-1, keepdims=True)
    starts = corners[:, :, None] + along[:, None] * way[:, :, None]
    places = starts[:, :, :, None] + away[:, None] * outward[:, :, None, None]
    flat = places.reshape(-1, len(away), 2).astype(np.float32)
    grey = opencv().remap(
        picture.astype(np.float32), flat[..., 0], flat[..., 1], opencv().INTER_LINEAR
    )
    # Where it becomes brighter outwards, and by how much: the mean place is the edge.
    rise = np.diff(grey.reshape(places.shape[:-1]), axis=-1)
    rise = (rise - _EDGE_LEAST * rise.max(axis=-1, keepdims=True)).clip(min=0.0)
    total = rise.sum(axis=-1)
    middle = (away[1:] + away[:-1]) / 2
    off = np.where(total > 0, (rise * middle).sum(axis=-1) / np.where(total > 0, total, 1.0), 0.0)
    centred = along - 0.5  # the line of least squares through evenly spaced points
    slope = (off * centred).sum(axis=-1) / (centred**2).sum()
    offset = off.mean(axis=-1)
    starts = corners + (offset - 0.5 * slope)[..., None] * outward
    ends = corners + way + (offset + 0.5 * slope)[..., None] * outward
    # In homogeneous coordinates a line is the cross product of two points, and a point of two lines.
    one = ((0, 0), (0, 0), (0, 1))
    lines = np.cross(*(np.pad(points, one, constant_values=1.0) for points in (starts, ends)))
    meet = np.cross(np.roll(lines, 1, axis=1), lines)
    return meet[..., :2] / meet[..., 2:]


def rays(pixels: Array, lens: Lens) -> Array:
    """Directions of pixels from the camera, as x and y at depth 1, without distortion.

    Args:
        pixels: shape (..., 2).
        lens: the camera.

    Returns:
        Shape (..., 2).
    """
    flat = opencv().undistortPoints(
        pixels.reshape(-1, 1, 2), lens.matrix, np.array(lens.distortion)
    )
    return flat.reshape(pixels.shape)


# The camera itself ---------------------------------------------------------------


class Device:
    """A camera by its number, or a video by its file or address, as OpenCV opens it.

    Raises:
        CameraError: It cannot be opened.
    """

    def __init__(self, name: str, size: tuple[int, int] = HD) -> None:
        cv2 = opencv()
        number = name.isdecimal() and len(name) < 10  # OpenCV takes no larger ones
        self._video = cv2.VideoCapture(int(name) if number else name)
        if not self._video.isOpened():
            raise CameraError(f"camera {name} cannot be opened")
        self._reads = READS if number else 1
        if number:
            self._video.set(cv2.CAP_PROP_FRAME_WIDTH, size[0])
            self._video.set(cv2.CAP_PROP_FRAME_HEIGHT, size[1])

    def read(self) -> np.ndarray | None:
        """The next picture, shape (height, width) or (height, width, 3); None: there is no more, or a
        camera has failed `READS` times.
        """
        for _ in range(self._reads):
            came, picture = self._video.read()
            if came:
                return picture
        return None

    def close(self) -> None:
        """Let the camera go."""
        self._video.release()


class Watch(Generic[_Result]):
    """A thread that looks at each picture of a camera, or packet of a port, since reading blocks; it keeps
    the latest result.

    Args:
        frames: its `read` gives the next one, or None when there are no more, and its `close` lets it go.
        look: what is made of one; an `HpacError` that it raises is kept as `fault`.

    Attributes:
        fault: why the last one had no result; empty if it had one.
    """

    def __init__(self, frames: Any, look: Callable[[Any], _Result]) -> None:
        self.fault = ""
        self._latest: tuple[_Result, float] | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(
            target=self._run, args=(frames, look), name="hpac camera", daemon=True
        )
        self._thread.start()

    def _run(self, frames: Any, look: Callable[[Any], _Result]) -> None:
        try:
            while not self._stop.is_set():
                picture = frames.read()
                at = monotonic()
                if picture is None:
                    self.fault = f"{self.fault}; the camera gives no more pictures".lstrip("; ")
                    break
                try:
                    self._latest = look(picture), at
                    self.fault = ""
                except HpacError as error:
                    self.fault = f"{error}"
        except Exception as error:  # of a thread, which nobody else would see
            self.fault = f"{type(error).__name__}: {error}"
        finally:
            frames.close()

    def latest(self) -> tuple[_Result, float] | None:
        """The latest result and its age [s]; None before the first. Never waits."""
        latest = self._latest
        return None if latest is None else (latest[0], monotonic() - latest[1])

    def close(self) -> None:
        """Let the camera go; at most a second if it hangs."""
        self._stop.set()
        self._thread.join(1.0)
