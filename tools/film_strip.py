"""Film strips of an environment with one row per episode: ``python -m tools.film_strip``.

Each page of ``docs/environments`` gives the command for its picture.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from hpac_gym.command import Parser, run, whole_number
from hpac_gym.errors import ParameterError
from hpac_gym.evaluation.episodes import run_episodes, single
from hpac_gym.model import JOINT_INDEX, SERVOS, action_from_synergy
from hpac_gym.output import replacing
from hpac_gym.policies import Policy
from hpac_gym.policies.loading import load_policy
from hpac_gym.policies.policy import EpisodePolicy

FRAME = (300, 225)
"""Size of a picture on the strip, without its caption above [px]."""
CAPTION = 26
BORDER = 2  # px
INK = (40, 40, 40)
RULE = (225, 225, 225)


class StraightToGoal(EpisodePolicy):
    """Scripted policy for a goal environment: commands the goal's six driven joints from the first
    step on.
    """

    def _act(self, observation: dict[str, np.ndarray], memory: None) -> tuple[np.ndarray, None]:
        """The action that corresponds to the goal, shape (6,), −1…1."""
        synergy = observation["desired_goal"][[JOINT_INDEX[name] for name in SERVOS]]
        return np.clip(action_from_synergy(synergy), -1.0, 1.0).astype(np.float32), None


def film_strip(
    env: gymnasium.Env, policy: Policy, seed: int, times: Sequence[float]
) -> list[Image.Image]:
    """Pictures of one episode after the control steps closest to these times [s], up to its end."""
    wanted = {max(1, round(time / env.unwrapped.dt)) for time in times}
    pictures = []
    for step in run_episodes(single(env), [policy], [seed]):
        if step.number in wanted:
            picture = Image.new("RGB", (FRAME[0], CAPTION + FRAME[1]), "white")
            picture.paste(
                Image.fromarray(env.render()).resize(FRAME, Image.Resampling.LANCZOS), (0, CAPTION)
            )
            text = caption(step.number * env.unwrapped.dt, step.info)
            ImageDraw.Draw(picture).text((8, 5), text, fill=INK, font=ImageFont.load_default(15))
            pictures.append(picture)
    return pictures


def caption(time: float, info: dict[str, Any]) -> str:
    """Caption with the time, and phase, outcome or error from `info`."""
    words = [f"{time:.3g} s"]
    if "phase" in info:
        words.append(info["phase"] if info["outcome"] == "running" else info["outcome"])
    if "largest_error" in info:
        words.append(f"largest error {info['largest_error']:.2f} rad")
    return ", ".join(words)


def sheet(rows: Sequence[Sequence[Image.Image]]) -> Image.Image:
    """The strips below each other; short ones are padded with white."""
    width = FRAME[0] + BORDER
    height = CAPTION + FRAME[1] + BORDER
    image = Image.new(
        "RGB", (max(map(len, rows)) * width - BORDER, len(rows) * height - BORDER), "white"
    )
    draw = ImageDraw.Draw(image)
    for row, pictures in enumerate(rows):
        for column, picture in enumerate(pictures):
            draw.rectangle(
                (column * width, row * height, (column + 1) * width, (row + 1) * height), fill=RULE
            )
            image.paste(picture, (column * width, row * height))
    return image


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit status."""
    parser = Parser(
        prog="python -m tools.film_strip", description="Draw episodes as strips of pictures."
    )
    parser.add_argument("id", help="id of the environment, such as HPAC-Grasp-v0")
    parser.add_argument(
        "--policy",
        default="scripted",
        help="scripted, random, or a policy file (default: %(default)s)",
    )
    parser.add_argument(
        "--seeds",
        nargs="+",
        type=whole_number(0),
        default=[0],
        metavar="SEED",
        help="one row each (default: 0)",
    )
    parser.add_argument(
        "--at",
        nargs="+",
        type=float,
        required=True,
        metavar="SECONDS",
        help="times of the pictures",
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("runs/film_strip.png"),
        metavar="PNG",
        help="default: %(default)s",
    )
    options = parser.parse_args(argv)
    return run(lambda: _draw(options))


def _draw(options: argparse.Namespace) -> int:
    with gymnasium.make(options.id, render_mode="rgb_array") as env:
        goals = (
            isinstance(env.observation_space, gymnasium.spaces.Dict)
            and options.policy == "scripted"
        )
        policy = StraightToGoal() if goals else load_policy(options.policy, env)
        rows = [film_strip(env, policy, seed, options.at) for seed in options.seeds]
    if not any(rows):
        raise ParameterError(f"no episode has a control step at any of {options.at} s")
    with replacing(options.out) as temporary:
        sheet(rows).quantize(256, dither=Image.Dither.NONE).save(
            temporary, format="PNG", optimize=True
        )
    print(f"drawn to {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
