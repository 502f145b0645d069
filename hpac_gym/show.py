"""``hpac show``: watch a trained policy grasp, in the browser, on the MuJoCo hand of the environments.

The page is that of ``render_mode="human"``: it needs neither a display nor another package."""

from __future__ import annotations

import argparse
import webbrowser
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from hpac_gym.command import whole_number
from hpac_gym.envs.page import Page
from hpac_gym.evaluation.environment import make_env
from hpac_gym.evaluation.episodes import run_episodes, single
from hpac_gym.evaluation.evaluate import env_id_of
from hpac_gym.evaluation.options import add_env_options, env_options
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.output import OutputError, replacing
from hpac_gym.policies.loading import NAMES, NORMALIZE, load_policy
from hpac_gym.registration import GRASP
from hpac_gym.tasks.task import CONTROL_HZ

FILMS: dict[str, dict[str, Any]] = {
    ".gif": {"duration": 1000 / CONTROL_HZ, "loop": 0},
    ".mp4": {"fps": CONTROL_HZ, "macro_block_size": None, "quality": 7},
}
"""Kinds of films, and how imageio writes them."""
PAUSE = CONTROL_HZ
"""Pictures for which the end of an episode stays."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hpac show`."""
    parser.add_argument("--policy", help=NAMES)
    parser.add_argument("--normalize", help=NORMALIZE)
    add_env_options(parser, "id, also module:My-v0 (default: a policy file's own)")
    parser.set_defaults(engine="mujoco")
    parser.add_argument("--seed", type=whole_number(0), default=HELD_OUT_SEED, help="of the first")
    parser.add_argument("--episodes", type=whole_number(1), help="how many (default: until Ctrl-C)")
    parser.add_argument(
        "--record", type=Path, metavar="FILE", help="write a film (.mp4, .gif) instead of a page"
    )
    parser.add_argument("--no-browser", action="store_true", help="print the page's address only")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Show episodes, one after another."""
    policy = options.policy or ("scripted" if options.grasp or options.env else "grasp")
    env_id = options.env or env_id_of(policy) or GRASP
    count = options.episodes or (3 if options.record else None)
    with ExitStack() as stack:
        env = stack.enter_context(
            make_env(env_id, render_mode="rgb_array", **env_options(options, env_id))
        )
        actor = load_policy(policy, env, options.normalize)
        screen = stack.enter_context(_Film(options.record) if options.record else _Screen())
        if not options.record and not options.no_browser:
            webbrowser.open(screen.address)
        done = held = 0
        while done != count:
            held += _episode(env, actor, options.seed + done, screen)
            done += 1
            print(f"{policy} on {env_id}: {held} of {done} succeeded", flush=True)
    if options.record:
        print(f"written: {options.record}")
    return 0


def _episode(env: Any, actor: Any, seed: int, screen: Any) -> bool:
    held = False
    for step in run_episodes(single(env), [actor], [seed]):
        screen.show(env.render())
        held = step.success
    for _ in range(PAUSE):
        screen.show(env.render())
    return held


class _Screen:
    """The page in the browser, in real time."""

    def __enter__(self) -> _Screen:
        self._page = Page()
        self.address = self._page.address
        return self

    def __exit__(self, *_: object) -> None:
        self._page.close()

    def show(self, picture: np.ndarray) -> None:
        """Show a picture."""
        self._page.show(picture)


class _Film:
    """A film in a file."""

    def __init__(self, path: Path) -> None:
        if path.suffix not in FILMS:
            raise OutputError(f"--record '{path}' must end in {' or '.join(FILMS)}")
        self._path = path
        self._stack = ExitStack()

    def __enter__(self) -> _Film:
        import imageio.v2 as imageio  # an extra

        temporary = self._stack.enter_context(replacing(self._path))
        suffix = self._path.suffix
        self._writer = self._stack.enter_context(
            imageio.get_writer(temporary, format=suffix, **FILMS[suffix])
        )
        return self

    def __exit__(self, *error: Any) -> None:
        self._stack.__exit__(*error)

    def show(self, picture: np.ndarray) -> None:
        """Add a picture."""
        self._writer.append_data(picture)
