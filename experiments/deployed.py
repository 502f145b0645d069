"""The same policy in the environment and through the whole wire: ``python -m experiments.deployed``.

In lock-step, with a virtual clock: observer → policy → link → frames → firmware core → pulses,
latched at 50 Hz → servos → a MuJoCo hand with its object, and the pose of the object back to the
observer. Each seed is one episode of the environment, whose own run is the comparison. Both see the
object with the same error of the camera, that of the environment's first look, and know its size; in
the last row, a good link, the wire has noise of its own, averaged as `hpac deploy` averages it."""

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from operator import eq
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.results import add_workers_and_out, percent, write_results
from hpac_gym.bridge import BridgeError, HandLink, HostBoard, StreamCounts
from hpac_gym.command import command_parser, run, whole_number
from hpac_gym.deploy.episode import WATCHDOG, Log, run_episode
from hpac_gym.deploy.errors import DeployError
from hpac_gym.deploy.observer import Observer, Pose
from hpac_gym.deploy.poses import Source
from hpac_gym.envs import HandEnv
from hpac_gym.evaluation.environment import make_env
from hpac_gym.evaluation.episodes import run_episodes, single
from hpac_gym.evaluation.options import env_id_of
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.evaluation.statistics import paired_difference, success_counts
from hpac_gym.evaluation.workers import shared
from hpac_gym.model import HPAC
from hpac_gym.output import markdown
from hpac_gym.policies.loading import load_policy
from hpac_gym.tasks.cameras import CameraNoise
from hpac_gym.tasks.task import CONTROL_HZ, SUCCESS
from hpac_gym.virtual.body import LockStep
from hpac_gym.virtual.wire import BadTransport, Faults

OTHER_NOISE = "good, other noise"
LINKS: dict[str, Faults] = {
    "good": Faults(),
    "2 ms jitter": Faults(jitter=0.002),
    "16 ms latency": Faults(latency=0.016),
    "5 % lost": Faults(loss=0.05),
    "all three": Faults(jitter=0.002, latency=0.016, loss=0.05),
    OTHER_NOISE: Faults(),
}
"""What is wrong with the link."""
NOISE = CameraNoise(size=0.0)


class Eye(Source):
    """The camera of a world, with the error of the environment's first look."""

    def __init__(self, env: HandEnv, world: LockStep) -> None:
        now = env.episodes.now
        self._world = world
        self._off = now.seen["position"][0] - now.state.object_pos[0]
        axes = np.stack([now.seen["up"][0], now.seen["side"][0]])
        shown = axes.any(axis=1)  # a ball has neither, a can no side
        self._turn = Rotation.identity()
        if shown.any():
            true = now.state.object_rotation[0].T[[2, 0]]
            self._turn, _ = Rotation.align_vectors(axes[shown], true[shown])

    def latest(self) -> tuple[Pose, float]:
        pose, age = self._world.latest()
        turn = self._turn * Rotation.from_quat(pose.quaternion)
        return Pose(pose.position + self._off, tuple(turn.as_quat().tolist())), age


def through_the_wire(
    env: HandEnv, policy_name: str, env_id: str, seed: int, link_name: str
) -> tuple[bool, StreamCounts]:
    """One episode on the firmware and a simulated body; the link is good until the hand closes and
    after the last command.
    """
    faults = LINKS[link_name]
    other = link_name == OTHER_NOISE
    world = LockStep(env, seed, noise=NOISE if other else CameraNoise(0.0, 0.0, 0.0))
    eye = world if other else Eye(env, world)
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
                link, observer, policy, eye, world, Log(None), hold=0.1, seconds=0.2, live=begin
            )
        except (DeployError, BridgeError):
            wire.there.faults = wire.back.faults = Faults()
    return world.body.outcome == SUCCESS, counts


def pairs(policy: str, links: Sequence[str], seeds: Sequence[int]) -> list[tuple]:
    """Success in the environment and through the wire, and the counts of the stream, by seed and
    link.
    """
    env_id = env_id_of(policy)
    with make_env(env_id, engine="mujoco", noise=asdict(NOISE)) as made:
        env = made.unwrapped
        env.spec = made.spec
        rows = []
        for seed in seeds:
            *_, last = run_episodes(single(made), [load_policy(policy, made)], [seed])
            for link in links:
                held, counts = through_the_wire(env, policy, env_id, seed, link)
                rows.append((link, last.success, held, counts.sent, counts.refused, counts.lost))
    return rows


def summary(rows: Sequence[tuple]) -> list[dict[str, Any]]:
    """Success on both sides, their difference, and the counts of the commands, by link."""
    cells = []
    for name in LINKS:
        mine = [row for row in rows if row[0] == name]
        count = len(mine)
        _, alone, held, sent, refused, lost = zip(*mine, strict=True)
        gain, *interval = paired_difference(held, alone)
        cells.append(
            {
                "link": name,
                "environment": success_counts(sum(alone), count),
                "wire": success_counts(sum(held), count),
                "difference": gain,
                "difference_95": interval,
                "same_outcome": sum(map(eq, alone, held)) / count,
                "moves": sum(sent),
                "refused": sum(refused),
                "lost": sum(lost),
            }
        )
    return cells


def in_real_time(seconds: float) -> dict[str, float]:
    """Stream to the firmware as a process for some time: how far commands are from their times [ms],
    and what became of them.
    """
    rng = np.random.default_rng(0)
    apart = []
    with HostBoard() as board, HandLink(board.connect) as link:
        link.arm(watchdog=WATCHDOG)
        stream = link.stream(1 / CONTROL_HZ)
        clock = link.exchange.transport.now
        begun = clock()
        while clock() < begun + seconds:
            if stream.counts.sent % CONTROL_HZ == 0:  # half open at most: ten minutes heat it
                target = rng.uniform(HPAC.servo_min, HPAC.servo_max / 2)
            stream.wait()
            apart.append((clock() - begun) % stream.period)
            stream.send(target)
        counts = stream.counts
    off = np.array(apart)
    off = 1e3 * np.minimum(off, stream.period - off)
    jitter = np.quantile(off, (0.5, 0.99, 1.0)).round(3).tolist()
    told = ("sent", "late", "skipped", "lost", "refused")
    return dict(zip(("p50_ms", "p99_ms", "worst_ms"), jitter, strict=True)) | {
        name: getattr(counts, name) for name in told
    }


def main(argv: list[str] | None = None) -> None:
    """Run the episodes, print a row a link, write them."""
    parser = command_parser("experiments.deployed", __doc__)
    parser.add_argument(
        "--real-time",
        type=whole_number(1),
        metavar="S",
        help="only stream to the firmware as a process for S seconds: jitter and missed deadlines",
    )
    parser.add_argument("--policy", default="grasp")
    parser.add_argument("--episodes", type=whole_number(1), default=1000, help="for each link")
    add_workers_and_out(parser)
    arguments = parser.parse_args(argv)
    if arguments.real_time:
        print(json.dumps(in_real_time(arguments.real_time)))
        return
    last = HELD_OUT_SEED + arguments.episodes
    jobs = [
        (arguments.policy, list(LINKS), list(range(first, min(first + 10, last))))
        for first in range(HELD_OUT_SEED, last, 10)
    ]
    cells = summary(
        [row for rows in shared(pairs, jobs, arguments.workers, "episodes") for row in rows]
    )
    words = f"deployed --policy {arguments.policy} --episodes {arguments.episodes}"
    write_results(arguments.out, words, cells=cells)
    print(deployed_table(cells))


def deployed_table(cells: Sequence[Mapping[str, Any]]) -> str:
    """The rows as a Markdown table."""
    rows = []
    for cell in cells:
        sides = (cell[where] for where in ("environment", "wire"))
        shares = [f"{one['success_rate']:.1%} {percent(one['interval_95'])}" for one in sides]
        gain = f"{100 * cell['difference']:+.1f} {percent(cell['difference_95'], '+.1f')}"
        refused = f"{cell['refused']:,} of {cell['moves']:,}"
        rows.append((cell["link"], *shares, gain, f"{cell['same_outcome']:.1%}", refused))
    head = ("link", "environment", "wire", "points", "same outcome", "refused commands")
    return markdown(head, rows)


if __name__ == "__main__":
    sys.exit(run(main))
