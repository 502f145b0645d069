"""Accuracy of printed tags before a camera, on rendered pictures: ``python -m experiments.watched``.

`objects`: the pose of an object in the hand's frame, from one picture of 1280 × 720 pixels from
0.4 m. The pictures are pieces of the print of the sheet (`experiments.pictures`), blurred by 0.6
pixels, with noise of 3 grey values and an uneven light."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.pictures import Piece, Pinhole
from hpac_gym.camera import CameraError
from hpac_gym.camera.detection import Lens, detect
from hpac_gym.camera.poses import object_place
from hpac_gym.command import run_module, whole_number
from hpac_gym.model.checks import Array
from hpac_gym.output import markdown, write_text
from hpac_gym.progress import progress

OUT = Path("docs/results/experiments/watched.json")
OBJECT_CARD = Piece((50.0, 240.0), 33.0, 33.0)
HAND_CARD = Piece((115.0, 240.0), 51.0, 51.0)
"""The boards, where they are printed."""
TOP = 0.05
"""Half height of the object, on whose top its board lies [m]."""
DISTANCE = 0.4
TILT = np.radians(45.0)
"""Furthest direction of the camera from the normal of the hand's board [rad]."""
TRUE = Lens(focal=(1000.0, 1000.0))
LENSES = {
    "calibrated": TRUE,
    "focal length 2 % off": Lens(focal=(1020.0, 1020.0)),
    "focal length 20 % off": Lens(focal=(1200.0, 1200.0)),
}


def object_scene(
    rng: np.random.Generator, cards: tuple[Piece, Piece] = (OBJECT_CARD, HAND_CARD)
) -> tuple[np.ndarray, Array, Array]:
    """A picture of an upright object before the hand, and the object's true position (3,) [m] and
    rotation (3, 3) in the hand's frame.
    """
    position = np.array([0.05, 0.005, 0.11]) + rng.uniform(-0.02, 0.02, 3)
    # The hand's thumb is up: the object's x, y and z are the hand's z, x and y.
    upright = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    rotation = Rotation.from_rotvec(rng.normal(0.0, 0.15, 3)).as_matrix() @ upright
    on_object = position + TOP * rotation[:, 2]
    on_hand = np.array([0.0, 0.03, -0.03])
    tilt = rng.uniform(0.0, TILT)
    turn = rng.uniform(0.0, 2 * np.pi)
    direction = [np.sin(tilt) * np.cos(turn), np.cos(tilt), np.sin(tilt) * np.sin(turn)]
    middle = (on_object + on_hand) / 2
    across = np.array([rng.choice([-1.0, 1.0]), 0.0, rng.uniform(-0.3, 0.3)])
    camera = Pinhole(middle + DISTANCE * np.array(direction), middle, across)
    pieces = [
        (cards[0], on_object, rotation[:, 0], rotation[:, 1]),
        (cards[1], on_hand, np.array([-1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])),
    ]
    return camera.picture(pieces, rng), position, rotation


def object_errors(count: int, seed: int, lens: Lens = TRUE, shown: bool = False) -> Array:
    """Errors of the object's position [mm] and rotation [°] in some pictures, shape (count, 2); NaN
    where no pose is found.
    """
    errors = np.full((count, 2), np.nan)
    for number in progress(range(count), "pictures", shown):
        picture, position, rotation = object_scene(np.random.default_rng([seed, number]))
        try:
            found = object_place(detect(picture), lens, TOP)
        except CameraError:
            continue
        turned = Rotation.from_matrix(found.rotation.T @ rotation).magnitude()
        errors[number] = 1e3 * np.linalg.norm(found.position - position), np.degrees(turned)
    return errors


def quantiles(errors: Array) -> dict[str, float]:
    """Median, 95th percentile and maximum of what is not NaN."""
    low, high, most = np.nanquantile(errors, (0.5, 0.95, 1.0))
    return {"p50": float(low), "p95": float(high), "max": float(most)}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    parser.add_argument("--pictures", type=whole_number(1), default=500)
    parser.add_argument("--seed", type=whole_number(0), default=0)
    parser.add_argument("--out", type=Path, default=OUT)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Render, measure, write the figures."""
    cells = []
    for name, lens in LENSES.items():
        errors = object_errors(arguments.pictures, arguments.seed, lens, shown=True)
        cells.append(
            {
                "lens": name,
                "pictures": len(errors),
                "missed": int(np.isnan(errors[:, 0]).sum()),
                "position_mm": quantiles(errors[:, 0]),
                "rotation_deg": quantiles(errors[:, 1]),
            }
        )
    command = (
        f"python -m experiments.watched --pictures {arguments.pictures} --seed {arguments.seed}"
    )
    write_text(arguments.out, json.dumps({"command": command, "objects": cells}, indent=1) + "\n")
    head = (
        "lens",
        "missed",
        "position: median [mm]",
        "p95",
        "max",
        "rotation: median [°]",
        "p95",
        "max",
    )
    rows = [
        (
            cell["lens"],
            f"{cell['missed']} of {cell['pictures']}",
            *(f"{v:.2f}" for v in (*cell["position_mm"].values(), *cell["rotation_deg"].values())),
        )
        for cell in cells
    ]
    print(markdown(head, rows))
    return 0


if __name__ == "__main__":
    sys.exit(run_module("experiments.watched", __doc__, add_arguments))
