"""The same policy in the environment and through the whole wire: ``python -m experiments.deployed``.

In lock-step, with a virtual clock: observer → policy → link → frames → firmware core → pulses,
latched at 50 Hz → servos → a MuJoCo hand with its object, and the pose of the object back to the
observer. Each seed is one episode of the environment, whose own run is the comparison."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hpac_gym.bridge import BridgeError, HandLink, StreamCounts
from hpac_gym.command import run_module, whole_number
from hpac_gym.deploy.episode import Log, run_episode
from hpac_gym.deploy.errors import DeployError
from hpac_gym.deploy.observer import Observer
from hpac_gym.envs import HandEnv
from hpac_gym.evaluation.environment import make_env
from hpac_gym.evaluation.episodes import run_episodes, single
from hpac_gym.evaluation.evaluate import env_id_of
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.evaluation.statistics import paired_difference, success_counts
from hpac_gym.evaluation.workers import shared
from hpac_gym.output import markdown, write_text
from hpac_gym.policies.loading import load_policy
from hpac_gym.progress import progress
from hpac_gym.tasks.task import SUCCESS
from hpac_gym.virtual.body import LockStep
from hpac_gym.virtual.wire import BadTransport, Faults

LINKS = {
    "good": Faults(),
    "2 ms jitter": Faults(jitter=0.002),
    "16 ms latency": Faults(latency=0.016),
    "5 % lost": Faults(loss=0.05),
    "all three": Faults(jitter=0.002, latency=0.016, loss=0.05),
}
"""What is wrong with the link."""
OUT = Path("docs/results/experiments/deployed.json")


def through_the_wire(
    env: HandEnv, policy_name: str, env_id: str, seed: int, faults: Faults
) -> tuple[bool, StreamCounts]:
    """One episode on the firmware and a simulated body; the link is good until the hand closes and
    after the last command.
    """
    world = LockStep(env, seed)
    observer = Observer(env_id, world.seen_object)
    observer.setup = replace(world.body.setup, object=world.seen_object)
    policy = load_policy(policy_name, observer)
    wire = BadTransport(world.hand, np.random.default_rng([seed, 8]), Faults())
    counts = StreamCounts()

    def begin(figures: dict[str, Any]) -> None:
        nonlocal counts
        wire.there.faults = wire.back.faults = (
            faults if figures["step"] < observer.steps - 1 else Faults()
        )
        counts = figures["counts"]

    with HandLink(lambda: wire) as link:
        try:
            run_episode(
                link, observer, policy, world, world, Log(None), hold=0.1, seconds=0.2, live=begin
            )
        except (DeployError, BridgeError):
            wire.there.faults = wire.back.faults = Faults()
    return world.body.outcome == SUCCESS, counts


def in_the_environment(env: HandEnv, policy_name: str, seed: int) -> bool:
    """One episode of the environment."""
    *_, last = run_episodes(single(env), [load_policy(policy_name, env)], [seed])
    return last.success


def pairs(policy: str, faults: Faults, seeds: Sequence[int]) -> list[tuple]:
    """Success in the environment and through the wire, and the counts of the stream, by seed."""
    env_id = env_id_of(policy)
    with make_env(env_id, engine="mujoco") as made:
        env = made.unwrapped
        env.spec = made.spec
        rows = []
        for seed in seeds:
            alone = in_the_environment(made, policy, seed)
            held, counts = through_the_wire(env, policy, env_id, seed, faults)
            rows.append((alone, held, counts.sent, counts.refused, counts.lost))
    return rows


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    parser.add_argument("--policy", default="grasp")
    parser.add_argument("--episodes", type=whole_number(1), default=1000, help="for each link")
    parser.add_argument("--links", nargs="+", choices=LINKS, default=list(LINKS))
    parser.add_argument("--workers", type=whole_number(1), default=os.cpu_count() or 1)
    parser.add_argument("--out", type=Path, default=OUT, metavar="JSON")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Run the episodes, print a row a link, write them."""
    jobs = [
        (arguments.policy, LINKS[name], list(range(first, min(first + 10, last))))
        for name in arguments.links
        for last in [HELD_OUT_SEED + arguments.episodes]
        for first in range(HELD_OUT_SEED, last, 10)
    ]
    names = [name for name in arguments.links for _ in range(len(jobs) // len(arguments.links))]
    found: dict[str, list[tuple]] = {name: [] for name in arguments.links}
    bar = progress(names, "episodes")
    for name, rows in zip(bar, shared(pairs, jobs, arguments.workers), strict=True):
        found[name] += rows
    cells = []
    for name, rows in found.items():
        count = len(rows)
        alone, held, sent, refused, lost = (sum(row[i] for row in rows) for i in range(5))
        more = [row[1] - row[0] for row in rows]
        gain, *interval = paired_difference(more.count(1), more.count(-1), count)
        cells.append(
            {
                "link": name,
                "environment": success_counts(alone, count),
                "wire": success_counts(held, count),
                "difference": gain,
                "difference_95": interval,
                "same_outcome": more.count(0) / count,
                "moves": sent,
                "refused": refused,
                "lost": lost,
            }
        )
    command = f"python -m experiments.deployed --policy {arguments.policy} --episodes {arguments.episodes}"
    write_text(arguments.out, json.dumps({"command": command, "cells": cells}, indent=1) + "\n")
    head = ("link", "environment", "wire", "difference", "same outcome", "moves", "refused", "lost")
    print(markdown(head, [_row(cell) for cell in cells]))
    return 0


def _row(cell: dict[str, Any]) -> tuple[str, ...]:
    low, high = cell["difference_95"]
    return (
        cell["link"],
        f"{cell['environment']['success_rate']:.1%}",
        f"{cell['wire']['success_rate']:.1%}",
        f"{100 * cell['difference']:+.1f} [{100 * low:+.1f}, {100 * high:+.1f}]",
        f"{cell['same_outcome']:.1%}",
        f"{cell['moves']:,}",
        f"{cell['refused']:,}",
        f"{cell['lost']:,}",
    )


if __name__ == "__main__":
    sys.exit(run_module("experiments.deployed", __doc__, add_arguments))
