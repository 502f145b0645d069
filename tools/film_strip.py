"""Film strips of an environment with one row per episode: ``python -m tools.film_strip``.

Each page of ``docs/environments`` gives the command for its picture. The camera of a task with an
object stands still, so that a lift is seen. A row begins with what it shows and how it ended, and
why; a row of postures begins with its goal.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from hpac_gym.command import command_parser, run, seconds, whole_number
from hpac_gym.envs.episodes import open_episodes
from hpac_gym.errors import ParameterError
from hpac_gym.evaluation.environment import make_env
from hpac_gym.evaluation.episodes import run_episodes, single
from hpac_gym.output import replacing
from hpac_gym.physics.engine import HAND_POSITION
from hpac_gym.physics.simulation import ENGINES
from hpac_gym.policies import Policy
from hpac_gym.policies.baselines import constant_posture
from hpac_gym.policies.loading import load_policy, needed_options
from hpac_gym.tasks.posture import TOLERANCE
from hpac_gym.tasks.senses import VIEW_TARGET

FRAME = (300, 225)
"""Size of a picture on the strip, without its caption above [px]."""
FINER = 2
"""Pixels rendered for each pixel of the strip, along both sides."""
CAPTION = 24
TITLE = 32
BORDER = 2  # px
INK = (40, 40, 40)
FAILED = (176, 48, 32)
RULE = (225, 225, 225)
BACK_OFF = 1.35
"""Factor of the distance of a task's camera, so that the lifted hand stays in the picture."""
ORDINARY = 0.12
"""Longest side of an object for which that is far enough [m]; for longer ones the camera stands
further back and looks lower.
"""
RAISED = np.array([0.0, 0.0, 0.05])
"""Where that camera looks, above the hand's place at the start [m]."""
WHY = {
    "reach": "the hand hit it on its way",
    "close": "pushed away while the hand closed",
    "lift": "slipped out in the lift",
    "shake": "slipped out in the shake",
    "place": "lost on the way down, or not where it belongs",
}
"""Why an episode failed, by its phase."""


@dataclass(frozen=True, slots=True)
class Row:
    """One episode: what it shows, how it ended, and its pictures with their captions."""

    title: str
    success: bool
    pictures: list[Image.Image]


def film_strip(env: gymnasium.Env, policy: Policy, seed: int, times: Sequence[float]) -> Row:
    """Pictures of one episode after the control steps closest to these times [s], or at its end,
    if that is earlier.
    """
    bare = env.unwrapped
    wanted = {max(1, round(time / bare.dt)) for time in times}
    pictures: list[Image.Image] = []
    carried = 0.0
    for step in run_episodes(single(env), [policy], [seed]):
        info = step.info
        if step.number == 0:
            target = camera_target(bare)
            if target is None:
                pictures.append(captioned(picture_of_goal(env, seed), "goal"))
            continue
        carried = max(carried, info.get("hold_time", 0.0))
        ended = info.get("outcome", "running") != "running"
        if step.number in wanted or (pictures and ended and step.number < max(wanted)):
            pictures.append(captioned(taken(bare, target), caption(step.number * bare.dt, info)))
    if not pictures[int(target is None) :]:
        return Row("", False, [])
    return Row(title_of(bare, info, carried), bool(info["is_success"]), pictures)


def camera_target(bare: Any) -> np.ndarray | None:
    """Where a camera that stands still looks [m]; None for a task without an object, whose hand
    does not move either.
    """
    setup = open_episodes(bare).setups[0]
    if setup.object is None:
        return None
    half_way = 0.0 if setup.target is None else (setup.target - setup.position) / 2
    looked_at = setup.hand_rotation @ (VIEW_TARGET + half_way)
    return HAND_POSITION + bare.state.palm_offset[0] + looked_at + RAISED


def taken(bare: Any, target: np.ndarray | None) -> np.ndarray:
    """A picture, several times as large as on the strip."""
    view = bare.task.viewpoint
    size = {"width": FINER * FRAME[0], "height": FINER * FRAME[1]}
    if target is None:
        return bare.picture(replace(view, **size))
    setup = open_episodes(bare).setups[0]
    back_off = BACK_OFF if setup.target is None else 1.15  # that camera is far already
    longest = 2 * max(setup.object.half_extents)
    longer = max(0.0, longest - ORDINARY)
    distance = back_off * view.distance + 3.0 * longer
    target = target - np.array([0.0, 0.0, 0.7 * longer])
    view = replace(view, distance=distance, **size)
    return open_episodes(bare).simulation.engine.picture(0, view, target)


def picture_of_goal(env: gymnasium.Env, seed: int) -> np.ndarray:
    """The nominal hand in the posture that an episode asks for."""
    goal = open_episodes(env.unwrapped).setups[0].goal
    with gymnasium.make(
        env.spec.id, engine=env.spec.kwargs["engine"], randomize="nominal", render_mode="rgb_array"
    ) as nominal:
        policy = constant_posture(nominal)
        observation, _ = nominal.reset(seed=seed, options={"goal": goal})
        memory = None
        over = False
        while not over:
            action, memory = policy.predict(observation, memory)
            observation, _, _, over, _ = nominal.step(action)
        return taken(nominal.unwrapped, None)


def captioned(pixels: np.ndarray, text: str) -> Image.Image:
    """A picture of the strip with its caption above."""
    picture = Image.new("RGB", (FRAME[0], CAPTION + FRAME[1]), "white")
    picture.paste(Image.fromarray(pixels).resize(FRAME, Image.Resampling.LANCZOS), (0, CAPTION))
    ImageDraw.Draw(picture).text((8, 4), text, fill=INK, font=ImageFont.load_default(15))
    return picture


def caption(time: float, info: dict[str, Any]) -> str:
    """Caption with the time, and phase, outcome or error from `info`."""
    words = [f"{time:.3g} s"]
    if "phase" in info:
        words.append(info["phase"] if info["outcome"] == "running" else info["outcome"])
    if "largest_error" in info:
        words.append(f"largest error {info['largest_error']:.2f} rad")
    return ", ".join(words)


def title_of(bare: Any, info: dict[str, Any], carried: float) -> str:
    """What an episode shows, how it ended, and why it failed; `carried` is for how long the hand had
    the object [s].
    """
    if "largest_error" in info:
        error = f"largest error {info['largest_error']:.2f} rad, {TOLERANCE:g} allowed"
        return f"bring fifteen joints to the goal: {'success' if info['is_success'] else 'failure'}, {error}"
    thing = open_episodes(bare).setups[0].object
    size = " x ".join(f"{2e3 * half:.0f}" for half in thing.half_extents)
    named = info.get("type") or info.get("object") or thing.shape
    what = f"{named.replace('_', ' ')}, {size} mm, {1e3 * thing.mass:.0f} g"
    if info["is_success"]:
        return f"{what}: success"
    missed = info.get("missed") if info.get("held") else None
    if not missed and carried == 0 and info["phase"] not in ("reach", "close"):
        missed = "the hand closed beside it"
    if info.get("is_crushed"):
        missed = "crushed"
    return f"{what}: failure, {missed or WHY.get(info['phase'], 'lost')}"


def sheet(rows: Sequence[Row]) -> Image.Image:
    """The strips below each other, each under its title; short ones are padded with white."""
    width = FRAME[0] + BORDER
    height = TITLE + CAPTION + FRAME[1] + BORDER
    columns = max(len(row.pictures) for row in rows)
    image = Image.new("RGB", (columns * width - BORDER, len(rows) * height - BORDER), "white")
    draw = ImageDraw.Draw(image)
    font = ImageFont.load_default(19)
    for number, row in enumerate(rows):
        top = number * height
        draw.rectangle((0, top, image.width, top + TITLE), fill=RULE)
        draw.text((8, top + 4), row.title, fill=INK if row.success else FAILED, font=font)
        for column, picture in enumerate(row.pictures):
            image.paste(picture, (column * width, top + TITLE))
    return image


def main(argv: Sequence[str] | None = None) -> None:
    parser = command_parser("tools.film_strip", __doc__)
    parser.add_argument("id", help="id of the environment, such as HPAC-Grasp-v0")
    parser.add_argument("--policy", default="scripted", help="scripted, random, or a policy file")
    parser.add_argument("--engine", default="mujoco", choices=ENGINES, help="physics")
    parser.add_argument(
        "--seeds",
        nargs="+",
        type=whole_number(0),
        default=[0],
        metavar="SEED",
        help="one row each",
    )
    parser.add_argument(
        "--at",
        nargs="+",
        type=seconds,
        required=True,
        metavar="SECONDS",
        help="times of the pictures",
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("runs/film_strip.png"),
        metavar="PNG",
        help="the picture",
    )
    options = parser.parse_args(argv)
    given = {"engine": options.engine} | needed_options(options.policy)
    with make_env(options.id, render_mode="rgb_array", **given) as env:
        policy = load_policy(options.policy, env)
        rows = [film_strip(env, policy, seed, options.at) for seed in options.seeds]
    if not any(row.pictures for row in rows):
        raise ParameterError(f"no episode has a control step at any of {options.at} s")
    with replacing(options.out) as temporary:
        sheet(rows).quantize(256, dither=Image.Dither.NONE).save(
            temporary, format="PNG", optimize=True
        )
    print(f"drawn to {options.out}")


if __name__ == "__main__":
    sys.exit(run(main))
