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
from scipy.spatial.transform import Rotation

from hpac_gym.body.objects import ObjectSpec
from hpac_gym.bridge import BridgeError, HandLink, StreamCounts, VirtualHand, servo_from_pulses
from hpac_gym.bridge.hands import VirtualTransport
from hpac_gym.command import run_module, whole_number
from hpac_gym.deploy.arm import Nobody
from hpac_gym.deploy.episode import Log, run_episode
from hpac_gym.deploy.errors import DeployError
from hpac_gym.deploy.observer import Observer, Pose
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
from hpac_gym.tasks.cameras import CameraNoise
from hpac_gym.tasks.task import RUNNING, SUCCESS

LATCH_US = 20_000
"""Period of a servo's pulses [µs]."""
LINKS = {
    "good": {},
    "2 ms jitter": {"jitter": 0.002},
    "16 ms latency": {"latency": 0.016},
    "5 % lost": {"loss": 0.05},
    "all three": {"jitter": 0.002, "latency": 0.016, "loss": 0.05},
}
"""What is wrong with the link [s, share of the frames in each direction]."""
OUT = Path("docs/results/experiments/deployed.json")


class Body(Nobody):
    """A simulated hand that follows the pulses of the firmware, and an arm that moves it; also the
    source of the object's pose.
    """

    def __init__(self, env: HandEnv, seed: int, noise: CameraNoise = CameraNoise()) -> None:
        env.reset(seed=seed)
        self._episodes = env.episodes
        self._task = env.task
        self._noise = noise
        self._rng = np.random.default_rng([seed, 9])
        self._began_us: int | None = None
        self._step = 0
        self._latched: np.ndarray | None = None
        self._now_us = 0
        self.outcome = RUNNING
        setup = self._episodes.setups[0]
        error = 1 + noise.size * self._rng.standard_normal()
        half = tuple(side * error for side in setup.object.half_extents)
        self.seen_object = ObjectSpec(setup.object.shape, half, 0.1, 0.8)
        self.setup = setup
        self._wrist = env.task.wrist_path(setup, env.episodes.times)[None]

    def ready(self, wait: Any, told: dict[str, Any]) -> None:
        """The arm's table and the physics begin."""
        self._began_us = self._now_us

    def on_pulses(self, now_us: int, pulses: np.ndarray) -> None:
        """Advance the physics to the firmware's time."""
        self._now_us = now_us
        if self._began_us is None or not pulses.all():
            return
        simulation = self._episodes.simulation
        dt = simulation.engine.dt
        substeps = round(self._episodes.dt / dt)
        since = now_us - self._began_us
        if self._latched is None or since % LATCH_US == 0:
            self._latched = servo_from_pulses(pulses)
        while self.outcome == RUNNING and (self._step + 1) * dt * 1e6 <= since:
            row = min(self._step, self._wrist.shape[1] - 1)
            simulation.command(self._latched[None], dt)
            simulation.advance(self._wrist[:, row : row + 1])
            self._step += 1
            if self._step % substeps == 0:
                state = simulation.state()
                self._task.watch(state, self._episodes.dt, simulation.engine.contacts)
                self.outcome = int(self._task.judge(state, self._episodes.dt)[0])

    def latest(self) -> tuple[Pose, float]:
        """The object as a camera sees it."""
        state = self._episodes.simulation.state()
        place = state.object_pos[0] + self._noise.position * self._rng.standard_normal(3)
        turn = Rotation.from_rotvec(self._noise.angle * self._rng.standard_normal(3))
        seen = turn * Rotation.from_matrix(state.object_rotation[0])
        return Pose(place, tuple(seen.as_quat().tolist())), 0.0


class Link(VirtualTransport):
    """A link on which frames are lost in both directions, the host's are late by up to `jitter`, and
    the hand's by `latency`, once the hand is armed.
    """

    def __init__(
        self,
        hand: VirtualHand,
        rng: np.random.Generator,
        loss: float = 0.0,
        jitter: float = 0.0,
        latency: float = 0.0,
    ) -> None:
        super().__init__(hand)
        self.bad = False
        self._rng = rng
        self._loss = loss
        self._jitter = jitter
        self._latency = latency
        self._out: list[tuple[float, bytes]] = []
        self._back: list[tuple[float, bytes]] = []

    def _arrives(self) -> bool:
        return not self.bad or self._rng.random() >= self._loss

    def write(self, data: bytes) -> None:
        if self._arrives():
            late = self._rng.uniform(0, self._jitter) if self.bad else 0.0
            self._out.append((self.now() + late, data))

    def read(self, timeout: float) -> bytes:
        until = self.now() + timeout
        while True:
            while self._out and self._out[0][0] <= self.now():
                super().write(self._out.pop(0)[1])
            if self._back and self._back[0][0] <= self.now():
                return self._back.pop(0)[1]
            if self.now() >= until:
                return b""
            due = min([until, *(at for at, _ in (*self._out[:1], *self._back[:1]))])
            data = super().read(max(due - self.now(), 1e-6))
            for frame in filter(None, data.split(b"\0")):
                if self._arrives():
                    at = self.now() + self.bad * self._latency
                    self._back.append((at, b"\0" + frame + b"\0"))


def through_the_wire(
    env: HandEnv, policy_name: str, env_id: str, seed: int, wrong: dict[str, float]
) -> tuple[bool, StreamCounts]:
    """One episode on the firmware and a simulated body."""
    body = Body(env, seed)
    hand = VirtualHand(on_pulses=body.on_pulses)
    observer = Observer(env_id, body.seen_object)
    observer.setup = replace(body.setup, object=body.seen_object)
    policy = load_policy(policy_name, observer)
    made = Link(hand, np.random.default_rng([seed, 8]), **wrong)
    counts = StreamCounts()

    def begin(figures: dict[str, Any]) -> None:
        nonlocal counts
        made.bad = figures["step"] < observer.steps - 1
        counts = figures["counts"]

    with HandLink(lambda: made) as link:
        try:
            run_episode(
                link, observer, policy, body, body, Log(None), hold=0.1, seconds=0.2, live=begin
            )
        except (DeployError, BridgeError):
            made.bad = False
    return body.outcome == SUCCESS, counts


def in_the_environment(env: HandEnv, policy_name: str, seed: int) -> bool:
    """One episode of the environment."""
    *_, last = run_episodes(single(env), [load_policy(policy_name, env)], [seed])
    return last.success


def pairs(policy: str, wrong: dict[str, float], seeds: Sequence[int]) -> list[tuple]:
    """Success in the environment and through the wire, and the counts of the stream, by seed."""
    env_id = env_id_of(policy)
    with make_env(env_id, engine="mujoco") as made:
        env = made.unwrapped
        env.spec = made.spec
        rows = []
        for seed in seeds:
            alone = in_the_environment(made, policy, seed)
            held, counts = through_the_wire(env, policy, env_id, seed, wrong)
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
