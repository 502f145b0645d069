"""Pictures of the named grasps at the end of an episode, and a contact sheet of all of them."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from hpac_gym.evaluation.environment import make_env
from hpac_gym.evaluation.episodes import run_episodes, single
from hpac_gym.model import POSTURES
from hpac_gym.output import replacing
from hpac_gym.physics.engine import Viewpoint
from hpac_gym.policies.loading import load_policy
from hpac_gym.registration import GRASP

VIEW = Viewpoint(width=360, height=330, distance=0.45, yaw_deg=205.0, pitch_deg=-14.0)
VIEW_CENTRE = np.array([0.045, 0.0, 0.09])
"""Point that the camera looks at, in the hand frame [m]."""
SHEET_COLUMNS = 4
TITLE = 36  # px, above each picture
INK = (40, 40, 40)
WARNING = (176, 48, 32)


@dataclass(frozen=True, slots=True)
class Portrait:
    """Picture of the end of an episode.

    Attributes:
        pixels: RGB, shape (height, width, 3).
        held: whether the episode was a success.
    """

    pixels: np.ndarray
    held: bool


def portrait(
    policy: str, grasp: str, seed: int, options: Mapping[str, str], normalize: str | None = None
) -> Portrait:
    """Picture of the end of the episode with that seed; `options` are those of the environment.

    Raises:
        GraspError: The grasp or variant does not exist.
        PolicyError: The policy cannot be loaded, or was made for another environment.
    """
    with make_env(
        GRASP, grasp=grasp, **options, render_mode="rgb_array"
    ) as env:  # else objects have no colours
        *_, last = run_episodes(single(env), [load_policy(policy, env, normalize)], [seed])
        return Portrait(env.unwrapped.picture(VIEW, VIEW_CENTRE), last.success)


def contact_sheet(portraits: Mapping[str, Portrait]) -> Image.Image:
    """The portraits, keyed by grasp, in rows, each with its panel number in the paper and its
    name.
    """
    height, width = next(iter(portraits.values())).pixels.shape[:2]
    height += TITLE
    rows = -(-len(portraits) // SHEET_COLUMNS)
    sheet = Image.new("RGB", (min(len(portraits), SHEET_COLUMNS) * width, rows * height), "white")
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(22)
    for number, (name, seen) in enumerate(portraits.items()):
        left = number % SHEET_COLUMNS * width
        top = number // SHEET_COLUMNS * height
        sheet.paste(Image.fromarray(seen.pixels), (left, top + TITLE))
        title = f"{POSTURES[name].panel} {name.replace('_', ' ')}"
        words = title if seen.held else f"{title}: not held"
        draw.text((left + 12, top + 6), words, fill=INK if seen.held else WARNING, font=font)
    return sheet


def write_pictures(folder: Path, portraits: Mapping[str, Portrait]) -> None:
    """Write ``NAME.png`` for every grasp and ``contact_sheet.png``.

    Raises:
        OutputError: The folder cannot be written, or the disk is full.
    """
    images = {name: Image.fromarray(seen.pixels) for name, seen in portraits.items()}
    for name, image in {**images, "contact_sheet": contact_sheet(portraits)}.items():
        with replacing(folder / f"{name}.png") as temporary:
            image.save(temporary, format="PNG")
