"""The driving part of ``hpac sweep --port``: a hand is swept at its own pace, one servo at a time in
both directions, and watched: by a camera that sees the tags of ``hpac tags``, or by another program.

Whatever happens, the hand is opened and disarmed, and what was recorded is kept."""

import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from hpac_gym.bridge import HandLink
from hpac_gym.bridge.commands import connector
from hpac_gym.calibration.driver import PROTOCOL, Driver, Look
from hpac_gym.calibration.record import CLEARED, RecordError, Sweep, read_sweep, write_sweep
from hpac_gym.calibration.segment import Segment, added, angles_in
from hpac_gym.camera import CameraError
from hpac_gym.camera.detection import Device, Lens, Seen, Watch, lens_of
from hpac_gym.camera.sheet import STRIPS
from hpac_gym.model import HPAC, SERVO_INDEX, SERVOS, Hand
from hpac_gym.output import keep, writable_file, writing

OLDEST = 1.0
"""Age of the last picture, or row of angles, at which a sweep is given up [s]."""
TAIL = 1 << 14
"""Bytes at the end of a file of angles in which its last row is looked for."""
PATIENCE = 5.0
"""Time for which a strip is looked for before the hand moves [s]."""
SIDES = {
    "thumb_mp": "along the axis of the thumb's MP joint, the thumb being in front of the palm",
    "index_mcp": "from the thumb's side",
    "middle_mcp": "from the thumb's side",
    "ring_mcp": "from the little finger's side",
    "pinky_mcp": "from the little finger's side",
    "thumb_cmc": "along the axis of the thumb's CMC joint",
}
"""From where the camera looks."""
TAUT = (
    "{}: it flexes from command 0 on. If its tendon is taut there, all its angles are off by a constant, "
    "which no camera sees: set the horn back by a tooth, and sweep again"
)
LEAST_SLACK = np.radians(0.3)
"""Slack, as an angle of the servo, below which a tendon may have been taut at rest (chosen): it is
known to 0.1° with 31 points, to 0.3° with 13 [rad].
"""


class Eye:
    """The tags in the newest picture of a watch, each picture once.

    Raises:
        CameraError: On a call: the last picture is older than `OLDEST`.
    """

    def __init__(self, watch: Watch[Seen]) -> None:
        self._watch = watch
        self._last: Seen | None = None

    def __call__(self) -> Seen | None:
        latest = self._watch.latest()
        if latest is None or latest[1] > OLDEST:
            raise CameraError(f"no picture for {OLDEST:g} s: {self._watch.fault or 'it hangs'}")
        if latest[0] is self._last:
            return None
        self._last = latest[0]
        return self._last

    def wait_for(self, servo: str, patience: float = PATIENCE) -> None:
        """Wait until all tags of a strip are seen.

        Raises:
            CameraError: Some are not, after `patience` [s].
        """
        deadline = time.monotonic() + patience
        while True:
            latest = self._watch.latest()
            seen = latest[0] if latest is not None and latest[1] < OLDEST else {}
            missing = [f"{tag.id} ({tag.label})" for tag in STRIPS[servo] if tag.id not in seen]
            if not missing:
                return
            if time.monotonic() > deadline:
                raise CameraError(
                    f"sweep of {servo}: not seen: tag {', '.join(missing)} {self._watch.fault}".strip()
                )
            time.sleep(0.02)


def fresh(path: Path) -> Seen:
    """See that another program writes angles now: no tags.

    Raises:
        RecordError: The last row of its file is older than `OLDEST`; or as of `angles_in`.
    """
    age = time.time() - angles_in(path, TAIL)[1][-1]
    if abs(age) > OLDEST:
        raise RecordError(
            f"angles {path}: its last row is {age:.4g} s old, the limit is {OLDEST:g} s: "
            "does a program write it, and time_s as seconds since 1970?"
        )
    return {}


def record(
    port: str,
    path: Path,
    *,
    camera: str | None = None,
    angles: Path | None = None,
    servos: Sequence[str] = SERVOS,
    trial: int = 0,
    points: int | None = None,
    hand: Hand = HPAC,
    ask: Callable[[str], object] | None = None,
) -> Sweep:
    """Sweep a hand, and write the record: each servo as soon as it is complete.

    Args:
        port: as of every command.
        path: the record; what it has stays, but for servos of this trial that are swept to the end:
            then the file is kept as `NAME-1`, or the next free number.
        camera: number of a camera, or a video, and with a comma its file.
        angles: file that another program writes meanwhile, see `angles_in`.
        servos: servos to sweep.
        trial: number of the repetition.
        points: sampling points of a servo; None: as many as `PROTOCOL` has.
        hand: the hand.
        ask: tells a person what to do, and waits; None: nobody is asked.

    Raises:
        CameraError, BridgeError, RecordError, OutputError: See there.
    """
    writable_file(path)
    swept: set[int] = set()
    if path.exists():
        before = read_sweep(path)
        swept.update(before.swept[before.trial == trial].tolist())
    with ExitStack() as stack:
        look: Look = dict if angles is None else partial(fresh, angles)
        lens = Lens()
        if camera is not None:
            name, lens = lens_of(camera)
            watch = Watch(Device(name, lens.size), lens.tags)
            stack.callback(watch.close)
            look = Eye(watch)
        link = stack.enter_context(HandLink(connector(port, stack, hand), hand=hand))
        protocol = replace(PROTOCOL, points=points or PROTOCOL.points)
        driver = Driver(link, look, hand, protocol)
        for servo in dict.fromkeys(servos):
            ids = ", ".join(f"{tag.id} {tag.label}" for tag in STRIPS[servo])
            if ask is not None and camera is not None:
                ask(f"{servo}: tags {ids}; the camera looks {SIDES[servo]}. Enter sweeps it")
            if isinstance(look, Eye):
                look.wait_for(servo)
            else:
                look()
            words = f"sweep of {servo}, recorded when complete; Ctrl-C opens the hand"
            print(words, file=sys.stderr, flush=True)
            segment = Segment(servo, trial)
            driver.sweep(segment)
            if angles is not None:
                segment.angles_from_file(angles)
            if isinstance(look, Eye):
                try:
                    misfit = segment.angles_from_tags(lens)
                except CameraError as error:
                    raise CameraError(f"sweep of {servo}: {error}") from None
            grown = added(path, segment)
            if SERVO_INDEX[servo] in swept:
                swept.clear()  # the others of this run are added to the same file
                with writing(path):
                    keep(path)
            write_sweep(path, grown)
            print(f"recorded: {servo} in {path}", file=sys.stderr, flush=True)
            if isinstance(look, Eye):
                print(f"its tags fit to {misfit:.2f} pixels", file=sys.stderr, flush=True)
                if servo == CLEARED and segment.slack(hand) < LEAST_SLACK:
                    print(TAUT.format(servo), file=sys.stderr, flush=True)
    return read_sweep(path)
