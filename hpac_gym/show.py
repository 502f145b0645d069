"""``hpac show``: watch a trained policy grasp, in the browser, on the MuJoCo hand of the environments.

The page is that of ``render_mode="human"``, and needs no OpenGL here; a film is drawn by MuJoCo."""

import argparse
import sys
import time
import webbrowser
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

from hpac_gym.command import add_json, ended_as_by_ctrl_c, say, whole_number
from hpac_gym.envs import HandEnv
from hpac_gym.errors import ParameterError
from hpac_gym.evaluation.environment import make_env
from hpac_gym.evaluation.episodes import run_episodes, single
from hpac_gym.evaluation.options import add_policy_and_env, env_of
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.output import OutputError, replacing
from hpac_gym.policies.loading import NAMES, load_policy, shipped_for
from hpac_gym.progress import progress
from hpac_gym.registration import GRASP
from hpac_gym.tasks.task import CONTROL_HZ

FILMS: dict[str, dict[str, Any]] = {
    ".gif": {"duration": 1000 / CONTROL_HZ, "loop": 0},
    ".mp4": {"fps": CONTROL_HZ, "macro_block_size": None, "quality": 7},
}
"""Kinds of films, and how imageio writes them."""
PAUSE = 1.0
"""Time for which the end of an episode stays [s]."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hpac show`."""
    add_policy_and_env(
        parser,
        "id, also module:My-v0 (default: a policy file's own)",
        help=f"{NAMES} (default: a shipped one of --env; scripted with --grasp)",
    )
    parser.add_argument(
        "--seed", type=whole_number(0), default=HELD_OUT_SEED, help="seed of the first episode"
    )
    parser.add_argument(
        "--episodes",
        type=whole_number(1),
        help="how many (default: until Ctrl-C; 3 with --record)",
    )
    parser.add_argument(
        "--record", type=Path, metavar="FILE", help="write a film (.mp4, .gif) instead of a page"
    )
    parser.add_argument("--no-browser", action="store_true", help="print the page's address only")
    add_json(parser)
    parser.set_defaults(run=ended_as_by_ctrl_c()(run))


def run(options: argparse.Namespace) -> int:
    """Show episodes, one after another."""
    policy = options.policy or ("scripted" if options.grasp else shipped_for(options.env or GRASP))
    env_id, given = env_of(options, policy)
    if "render_mode" in given:
        raise ParameterError("--set render_mode: hpac show has its own")
    count = options.episodes or (3 if options.record else None)
    mode = "rgb_array" if options.record else "human"
    with ExitStack() as stack:
        env = stack.enter_context(make_env(env_id, render_mode=mode, **given))
        actor = load_policy(policy, env, options.normalize)
        film = stack.enter_context(_film(options.record)) if options.record else None
        page = None if film else _page(env, options)
        title = f"{policy} on {env_id.removeprefix('hpac_gym:')}"
        title += f", grasp {options.grasp}" if options.grasp else ""
        done = held = 0
        try:
            while done != count:
                seed = options.seed + done
                if page:
                    so_far = f"{held} of {done} succeeded" if done else "the first episode"
                    page.say(f"{title}, seed {seed}: {so_far}")
                success = _episode(env, actor, seed, film)
                held += success
                done += 1
                said = f"{title}: {held} of {done} succeeded"
                say(options.json, said, policy=policy, env=env_id, seed=seed, success=success)
        except KeyboardInterrupt:  # the end of those who gave no other
            if count:
                raise
            print(file=sys.stderr)
    if options.record:
        say(options.json, f"written: {options.record}", written=str(options.record))
    return 0


def _episode(env: Any, actor: Any, seed: int, film: Any) -> bool:
    """Run an episode, which the page shows by itself; whether it succeeded."""
    steps = run_episodes(single(env), [actor], [seed])
    for step in progress(steps, f"frames of seed {seed}", shown=film is not None):
        if film:
            film.append_data(env.render())
        held = step.success
    if film:
        for _ in range(round(PAUSE * CONTROL_HZ)):
            film.append_data(env.render())
    else:
        time.sleep(PAUSE)
    return bool(held)


def _page(env: Any, options: argparse.Namespace) -> Any:
    """The page of an environment, in the browser."""
    if not isinstance(env.unwrapped, HandEnv):
        raise ParameterError(f"'{env.spec.id}' has no hand for the page: --record FILE films it")
    page = env.unwrapped.episodes.pictures.page
    if options.json:
        say(True, "", page=page.address)
    if not options.no_browser:
        webbrowser.open(page.address)
    return page


@contextmanager
def _film(path: Path) -> Iterator[Any]:
    """The writer of a film."""
    if path.suffix not in FILMS:
        raise OutputError(f"--record '{path}' must end in {' or '.join(FILMS)}")
    import imageio.v2 as imageio

    if path.suffix == ".mp4":
        import imageio_ffmpeg  # an extra, whose absence imageio tells in 29 lines

    how = {"format": path.suffix, **FILMS[path.suffix]}
    with replacing(path) as temporary:
        memory = BytesIO()  # on a full disk Pillow's writer would fail again when it is deleted
        with imageio.get_writer(memory if path.suffix == ".gif" else temporary, **how) as film:
            yield film
        if path.suffix == ".gif":
            temporary.write_bytes(memory.getvalue())
        else:  # a full disk fails in ffmpeg alone
            try:
                imageio_ffmpeg.count_frames_and_secs(temporary)
            except RuntimeError:
                raise OutputError(f"cannot write '{path}': is the disk full?") from None
