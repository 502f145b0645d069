"""Sources of the object's pose: fixed, a file, packets from another program, a camera.

All of them give poses in the frame of the hand, as `hpac_gym.deploy.observer.Pose` has it."""

import csv
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from time import monotonic, sleep
from types import SimpleNamespace

import numpy as np
from scipy.spatial.transform import Rotation

from hpac_gym.body.objects import ObjectSpec
from hpac_gym.camera.detection import Device, Lens, Watch, lens_of
from hpac_gym.camera.poses import object_place
from hpac_gym.deploy.errors import MALFORMED, PoseError, packet, udp
from hpac_gym.deploy.observer import Pose
from hpac_gym.output import read_text
from hpac_gym.progress import Late

PACKET = "hpac_pose"
"""Name of the version field of a packet: ``{"hpac_pose": 1, "position": [x, y, z], "quaternion":
[x, y, z, w]}``, in m, in UTF-8, one a datagram; without a quaternion the object stands upright.
"""
FURTHEST = 1.0
"""No object that a hand can hold is seen further from it [m]."""
COLUMNS = ("time_s", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")


class Source:
    """Where poses come from.

    Attributes:
        where: its name in messages.
        clock: the time [s], by which a recording is played.
        fault: why the last one was none; empty if nobody knows.
    """

    where = "its source"
    clock: Callable[[], float] = monotonic
    fault = ""

    def latest(self) -> tuple[Pose, float] | None:
        """The latest pose and its age [s]; None before the first. Never waits."""
        raise NotImplementedError

    def begin(self) -> None:
        """Take note that the hand begins to close."""

    def close(self) -> None:
        """Let go what the source holds."""


def pose_of(numbers: Sequence[float], where: str) -> Pose:
    """The pose of three numbers, x, y, z [m], or of seven, with a quaternion xyzw.

    Raises:
        PoseError: Another count, NaN, a place beyond `FURTHEST`, or no unit quaternion.
    """
    values = np.asarray(numbers, dtype=float)
    if values.shape not in ((3,), (7,)) or not np.isfinite(values).all():
        raise PoseError(f"{where}: {list(numbers)} is not x, y, z [m], or these and qx, qy, qz, qw")
    if (far := float(np.linalg.norm(values[:3]))) > FURTHEST:
        raise PoseError(
            f"{where}: the object is {far:.3g} m from the hand, allowed {FURTHEST} m; is it in mm?"
        )
    if len(values) == 3:
        return Pose(values)
    if abs(length := float(np.linalg.norm(values[3:]))) < 0.9 or length > 1.1:
        raise PoseError(f"{where}: the quaternion's length is {length:.3g}, it must be 1")
    return Pose(values[:3], tuple((values[3:] / length).tolist()))


class Fixed(Source):
    """One pose for ever."""

    def __init__(self, pose: Pose) -> None:
        self._pose = pose

    def latest(self) -> tuple[Pose, float]:
        return self._pose, 0.0


class Recorded(Source):
    """Poses from a file with the columns `COLUMNS`, the last four optional, played when it is first
    asked, and again when the hand begins to close; the last one ages.

    Raises:
        PoseError: The file cannot be read, or a row is no pose or goes back in time.
    """

    def __init__(self, path: Path) -> None:
        text = read_text(path, "poses", PoseError, "utf-8-sig")
        self._rows: list[tuple[float, Pose]] = []
        self._began: float | None = None
        where = f"poses {path}"
        before = -np.inf
        try:
            rows = list(csv.DictReader(text.splitlines()))
            for number, row in enumerate(rows, 2):
                where = f"poses {path}, row {number}"
                given = tuple(name for name in COLUMNS if row.get(name))
                if given not in (COLUMNS[:4], COLUMNS):
                    raise PoseError(f"{where}: the columns are {', '.join(COLUMNS)}")
                at, *numbers = (float(row[name]) for name in given)
                if not before < at < np.inf:
                    raise PoseError(
                        f"{where}: time_s = {at:g} s must be finite, after {before:g} s"
                    )
                self._rows.append((at, pose_of(numbers, where)))
                before = at
        except (csv.Error, ValueError) as error:
            raise PoseError(f"{where}: {error}") from None
        if not rows:
            raise PoseError(f"{where}: no rows")

    def begin(self) -> None:
        self._began = None

    def latest(self) -> tuple[Pose, float]:
        if self._began is None:
            self._began = self.clock() - self._rows[0][0]
        now = self.clock() - self._began
        at, pose = next((row for row in reversed(self._rows) if row[0] <= now), self._rows[0])
        return pose, max(now - at, 0.0)


class Packets(Watch[Pose], Source):
    """Poses that another program sends by UDP to a port of this computer; see `PACKET`.

    A thread takes each as it comes: in the port's queue a pose would not age, and keep out newer
    ones.

    Raises:
        DeployError: The port cannot be opened.

    Attributes:
        fault: why the last packet was no pose.
    """

    def __init__(self, port: int) -> None:
        self._socket = udp(f"--pose udp:{port}", "127.0.0.1", port, bind=True)
        self._socket.settimeout(0.1)  # before the thread looks whether the port is closed
        self.port = self._socket.getsockname()[1]
        self.where = f"udp:{self.port}"
        super().__init__(SimpleNamespace(read=self._read, close=self._socket.close), _told)

    def _read(self) -> bytes | None:
        while not self._stop.is_set():
            with suppress(TimeoutError):
                return self._socket.recv(4096)
        return None


def _told(data: bytes) -> Pose:
    """The pose of a packet."""
    try:
        told = packet(data, PACKET)
        return pose_of([*told["position"], *told.get("quaternion", ())], "packet")
    except MALFORMED as error:
        raise PoseError(
            f"no packet with {PACKET}, position and quaternion: {data[:80]!r} ({error})"
        ) from None


class Tags(Watch[Pose], Source):
    """Poses from the tags of ``hpac tags`` on the object and on the hand, before one camera.

    Args:
        frames: the camera.
        lens: its numbers, which also say where the boards are.
        top: height of the object's board above its centre, where the lens says no other [m].

    Attributes:
        fault: why the last picture shows no pose.
    """

    where = "the camera"

    def __init__(self, frames: Device, lens: Lens, top: float) -> None:
        def look(picture: np.ndarray) -> Pose:
            place = object_place(lens.tags(picture), lens, top)
            turn = Rotation.from_matrix(place.rotation)
            return Pose(place.position, tuple(turn.as_quat().tolist()))

        super().__init__(frames, look)


def source_of(text: str, seen: ObjectSpec | None = None) -> Source:
    """The source of a ``--pose``: ``X,Y,Z[,QX,QY,QZ,QW]``, ``udp:PORT``, a CSV file, or
    ``camera:N[,FILE]``.

    Args:
        text: names the source.
        seen: the object before a camera.

    Raises:
        PoseError: It is none of them. DeployError: The port is taken. CameraError: The camera
            cannot be opened, or its file is none.
    """
    kind, _, rest = text.partition(":")
    if kind == "camera" and rest:
        camera, lens = lens_of(rest)
        return Tags(Device(camera, lens.size), lens, seen.half_extents[2] if seen else 0.0)
    if kind == "udp" and rest.isdecimal():
        return Packets(int(rest))
    if text.endswith(".csv"):
        return Recorded(Path(text))
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        raise PoseError(
            f"--pose '{text}' is not x,y,z in m, with or without a quaternion, nor udp:PORT, nor a .csv, nor camera:N"
        ) from None
    return Fixed(pose_of(numbers, "--pose"))


def averaged(
    source: Source,
    seconds: float,
    oldest: float,
    patience: float = 5.0,
    pause: Callable[[float], None] = sleep,
) -> Pose:
    """The mean of the poses of some time: policies that look once look here.

    Args:
        source: where poses come from.
        seconds: time over which is averaged, after the first pose [s].
        oldest: greatest age of a pose [s].
        patience: longest wait for the first one [s].
        pause: waits for some seconds, and keeps the hand alive meanwhile.

    Raises:
        PoseError: No pose came, or the object was lost.
    """
    late = Late(f"waiting for poses at {source.where}")
    begun = source.clock()
    while source.latest() is None:
        if source.clock() - begun > patience:
            raise PoseError(
                f"no pose of the object within {patience:g} s at {source.where}"
                + (f": {source.fault}" if source.fault else "")
            )
        late()
        pause(0.02)
    poses: list[Pose] = []
    until = source.clock() + seconds
    while True:
        latest, age = source.latest()
        if age <= oldest and not any(latest is pose for pose in poses):
            poses.append(latest)
        if source.clock() >= until:
            break
        pause(0.02)
    if not poses:
        raise PoseError(f"the object's pose is {age:.3g} s old, allowed {oldest:g} s")
    place = np.mean([pose.position for pose in poses], axis=0)
    quaternions = [pose.quaternion for pose in poses if pose.quaternion]
    if not quaternions:
        return Pose(place)
    return Pose(place, tuple(Rotation.from_quat(quaternions).mean().as_quat().tolist()))
