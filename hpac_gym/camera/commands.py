"""``hpac tags``: the sheet of tags to print, and a camera's own numbers from pictures of that sheet."""

import argparse
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np

from hpac_gym.camera import CameraError, opencv
from hpac_gym.camera.detection import Device, Lens, Seen, detect, load_lens
from hpac_gym.camera.sheet import RULER, TAGS, draw
from hpac_gym.command import add_json, say
from hpac_gym.output import writable_file, write_text

VIEWS = 15
"""Pictures of the sheet from which a camera is calibrated (chosen)."""
LEAST_TAGS = 12
"""Tags of the sheet that such a picture shows."""
LEAST_MOVED = 60.0
"""Mean way of the tags between two of the pictures [pixels]."""
MOST_PICTURES = 3000
"""Pictures after which the search for different ones ends: 100 s at 30 a second."""
WORST_FIT = 1.0
"""Largest error of the fit, root mean square [pixels]."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hpac tags`."""
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="the sheet: .pdf, .svg or .png (tags.pdf); with --calibrate the camera's file (camera.json)",
    )
    parser.add_argument(
        "--calibrate",
        metavar="CAMERA",
        help="watch the flat printed sheet with this camera (0, 1, … or a video) from different sides, and write its numbers",
    )
    add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Write the sheet, or calibrate a camera."""
    if options.calibrate is None:
        out = options.out or Path("tags.pdf")
        draw(out)
        said = f"written: {out}; print it at 100 %, and measure the line of {RULER:g} mm"
        say(options.json, said, written=str(out), line_mm=RULER)
        return 0
    out = options.out or Path("camera.json")
    writable_file(out)  # a device may be read without end
    before = load_lens(out) if out.exists() else Lens()
    with closing(Device(options.calibrate)) as frames:
        lens, error = calibrated(frames)
    lens = replace(lens, hand_board=before.hand_board, object_board=before.object_board)
    write_text(out, lens.to_json())
    said = f"focal lengths {lens.focal[0]:.1f} and {lens.focal[1]:.1f} pixels, error {error:.2f} pixels; written: {out}"
    say(options.json, said, focal=lens.focal, error=error, written=str(out))
    return 0


def calibrated(frames: Device) -> tuple[Lens, float]:
    """A camera's numbers from `VIEWS` different pictures of the sheet, and the fit's error [pixels].

    Raises:
        CameraError: There are no such pictures, or they do not fit one camera and a flat sheet.
    """
    views: list[Seen] = []
    for _ in range(MOST_PICTURES):
        if (picture := frames.read()) is None:
            break
        seen = detect(picture)
        if len(seen) >= LEAST_TAGS and all(_moved(seen, view) > LEAST_MOVED for view in views):
            views.append(seen)
            said = f"picture {len(views)} of {VIEWS}: now tilt and move the sheet"
            print(said, file=sys.stderr, flush=True)
        if len(views) == VIEWS:
            break
    if len(views) < VIEWS:
        raise CameraError(
            f"{len(views)} different pictures with {LEAST_TAGS} tags of the sheet or more, {VIEWS} are needed"
        )
    sheet = [
        np.concatenate([np.pad(TAGS[id].corners, ((0, 0), (0, 1))) for id in view])
        for view in views
    ]
    cv2 = opencv()
    size = picture.shape[1::-1]
    error, matrix, distortion, _, _ = cv2.calibrateCamera(
        [corners.astype(np.float32) for corners in sheet],
        [np.concatenate(list(view.values())).astype(np.float32) for view in views],
        size,
        None,
        None,
        flags=cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST,
    )
    if not error <= WORST_FIT:
        raise CameraError(
            f"the pictures fit one camera to {error:.2f} pixels, allowed {WORST_FIT:g}: is the sheet flat?"
        )
    (fx, _, cx), (_, fy, cy), _ = matrix.tolist()
    return Lens(size, (fx, fy), (cx, cy), tuple(distortion.ravel()[:5].tolist())), float(error)


def _moved(seen: Seen, before: Seen) -> float:
    both = seen.keys() & before.keys()
    return (
        float(np.mean([np.linalg.norm(seen[id] - before[id]) for id in both])) if both else np.inf
    )
