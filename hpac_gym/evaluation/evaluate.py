"""``hpac evaluate``: policies on held-out episodes.

All policies run the same episodes, one per seed from ``--seed-start`` on; a learned policy is
compared with the baselines. An episode depends only on its seed, so the results do not depend on
the number of workers, nor on whether a world is single or, as on MuJoCo, one of a batch."""

import argparse
import json
import os
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from tqdm import tqdm

from hpac_gym.command import minutes, whole_number
from hpac_gym.envs import HandEnv
from hpac_gym.envs.options import check_number
from hpac_gym.evaluation.blind import CEILING, FLOOR, has_score, score
from hpac_gym.evaluation.environment import make_env
from hpac_gym.evaluation.episodes import BATCH, Step, has_batch, run_episodes, worlds
from hpac_gym.evaluation.options import add_policy_and_env, env_of
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.evaluation.statistics import paired_difference, success_counts
from hpac_gym.evaluation.workers import shared
from hpac_gym.output import markdown, writable_results, write_text
from hpac_gym.policies.baselines import BASELINES
from hpac_gym.policies.loading import NAMES, about, load_policy

BLOCK = 10  # most episodes per job of a worker, with single worlds; in a batch as many as it has
LEARNED = "learned"  # name of a policy file in JSON
NO_PHASE = "unknown"  # name of the phase of failures in a task without phases


@dataclass(frozen=True, slots=True)
class Episode:
    """Result of one episode: ``phase`` is the task's phase at the end, ``holding_force`` [N] its
    score, if it has one.
    """

    seed: int
    success: bool
    total_reward: float
    steps: int
    phase: str | None
    holding_force: float | None = None


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Episodes of several policies, by name; the n-th episode of each has the same seed.

    `options` are those of the environment, with its engine and body also where they were not given.
    """

    env_id: str
    episodes: dict[str, tuple[Episode, ...]]
    options: dict[str, Any]

    def summary(self) -> dict[str, Any]:
        """Success with its interval, return, failures by phase, and differences over paired
        episodes.
        """
        (name, first), *others = self.episodes.items()
        differences = []
        for other, episodes in others:
            held = ([one.success for one in part] for part in (first, episodes))
            difference, *interval = paired_difference(*held)
            differences.append(
                {"of": name, "over": other, "success": difference, "interval_95": interval}
            )
        return {
            "env_id": self.env_id,
            "first_seed": first[0].seed,
            "last_seed": first[-1].seed,
            "policies": {name: _summary(episodes) for name, episodes in self.episodes.items()},
            "differences": differences,
            "options": self.options,
        }


def results(steps: Iterable[Step]) -> Iterator[Episode]:
    """The results of the episodes among the steps of `run_episodes`, in the order in which they
    end.
    """
    rewards: dict[int, float] = {}
    for step in steps:
        rewards[step.world] = rewards[step.world] + step.reward if step.number else 0.0
        if step.over:
            info = step.info
            phase = info.get("phase")
            force = info.get("holding_force")
            yield Episode(
                seed=step.seed,
                success=step.success,
                total_reward=rewards[step.world],
                steps=step.number,
                phase=phase and str(phase),
                holding_force=None if force is None else float(force),
            )


def run_block(
    names: Sequence[str],
    env_id: str,
    options: Mapping[str, Any],
    seeds: Sequence[int],
    normalize: str | None = None,
) -> list[tuple[Episode, ...]]:
    """Run an episode of each policy for each seed, in an environment of their own."""
    columns = []
    with worlds(env_id, options, len(seeds)) as (env, envs):
        for name in names:
            policies = [load_policy(name, env, normalize) for _ in range(envs.num_envs)]
            episode_of = {each.seed: each for each in results(run_episodes(envs, policies, seeds))}
            columns.append([episode_of[seed] for seed in seeds])
    return list(zip(*columns, strict=True))


def parts_of(env: gymnasium.Env[Any, Any], seeds: Sequence[int], workers: int) -> list[Any]:
    """The seeds of each job of a worker: as many as a batch has, but a share for every worker."""
    size = min(BATCH if has_batch(env) else BLOCK, -(-len(seeds) // workers))
    return [seeds[start : start + size] for start in range(0, len(seeds), size)]


def evaluate(
    names: str | Sequence[str],
    env_id: str,
    episodes: int,
    *,
    seed_start: int = HELD_OUT_SEED,
    workers: int = 1,
    time_limit: float = float("inf"),
    options: Mapping[str, Any] | None = None,
    normalize: str | None = None,
) -> Evaluation:
    """Run policies over the same held-out episodes; a policy file gets the name ``learned``, and
    its own if there are several.

    After ``time_limit`` [s] the evaluation stops with fewer episodes, the same ones for every
    policy; ``options`` are those of the environment, such as engine, body and randomize;
    ``normalize`` is as in `load_policy`.

    Raises:
        EnvError: The environment is unknown.
        ParameterError: A number of episodes or workers below 1.
        PolicyError: A policy cannot be loaded, or was made for another environment.
    """
    for name, number in (("episodes", episodes), ("workers", workers)):
        check_number(name, number)
    names = [names] if isinstance(names, str) else names
    options = dict(options or {})
    with make_env(env_id, **options) as env:
        for name in names:
            load_policy(name, env, normalize)  # errors are raised here, not in a worker
        parts = parts_of(env, range(seed_start, seed_start + episodes), workers)
        if isinstance(env.unwrapped, HandEnv):
            options |= {
                name: getattr(env.unwrapped.episodes.options, name) for name in ("engine", "body")
            }
    several = len(set(names) - set(BASELINES)) > 1
    labels = [name if several or name in BASELINES else LEARNED for name in names]
    deadline = time.monotonic() + time_limit
    jobs = [(names, env_id, options, seeds, normalize) for seeds in parts]
    rows: list[tuple[Episode, ...]] = []
    with (
        closing(shared(run_block, jobs, workers)) as blocks,
        tqdm(
            total=episodes,
            desc="evaluating",
            unit="seed",
            disable=not sys.stderr.isatty(),
            dynamic_ncols=True,
        ) as bar,
    ):
        for done in blocks:
            rows += done
            rates = (np.mean([row[number].success for row in rows]) for number in range(len(names)))
            bar.set_postfix_str(
                ", ".join(f"{name} {rate:.0%}" for name, rate in zip(names, rates, strict=True))
            )
            bar.update(len(done))
            if time.monotonic() > deadline:
                break
    return Evaluation(
        env_id,
        {label: tuple(row[number] for row in rows) for number, label in enumerate(labels)},
        options,
    )


def table(summary: dict[str, Any]) -> str:
    """A summary as a table in Markdown."""
    columns = ("policy", "episodes", "success", "95 % interval", "mean return", "failures by phase")
    rows = []
    phased = all(NO_PHASE not in row["failures_by_phase"] for row in summary["policies"].values())
    columns = columns if phased else columns[:-1]
    for name, numbers in summary["policies"].items():
        low, high = numbers["interval_95"]
        phases = (
            ", ".join(f"{phase} {count}" for phase, count in numbers["failures_by_phase"].items())
            or "–"
        )
        rate = (f"{numbers['success_rate']:.1%}", f"{low:.1%} … {high:.1%}")
        row = (name, numbers["episodes"], *rate, f"{numbers['return_mean']:.2f}", phases)
        rows.append(row[: len(columns)])
    lines = [markdown(columns, rows)]
    if given := summary.get("options"):
        lines += ["", f"Options: {', '.join(f'{name} {value}' for name, value in given.items())}."]
    if has_score(summary["env_id"], summary.get("options")):
        scores = ", ".join(
            f"{name} {score(row['success_rate']):.2f}" for name, row in summary["policies"].items()
        )
        ends = f"0 at a random closure ({FLOOR:.1%}) and 1 at the best of many ({CEILING:.1%})"
        lines += ["", f"Score, {ends}: {scores}."]
    for pair in summary["differences"]:
        low, high = pair["interval_95"]
        interval = f"{100 * pair['success']:+.1f} points ({100 * low:+.1f} … {100 * high:+.1f})"
        lines += ["", f"Success of {pair['of']} over {pair['over']}, same episodes: {interval}."]
    return "\n".join(lines)


def add_seeds_and_workers(parser: argparse.ArgumentParser) -> None:
    """The arguments ``--seed-start`` and ``--workers`` of a command that runs episodes."""
    parser.add_argument(
        "--seed-start",
        type=whole_number(0),
        default=HELD_OUT_SEED,
        help="seed of the first episode",
    )
    parser.add_argument(
        "--workers", type=whole_number(1), default=os.cpu_count() or 1, help="number of processes"
    )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hpac evaluate`."""
    add_policy_and_env(
        parser,
        "id, also module:My-v0 (default: a policy file's own, otherwise HPAC-Grasp-v0)",
        required=True,
        action="append",
        help=f"{NAMES}; may be repeated, to compare",
    )
    parser.add_argument("--episodes", type=whole_number(1), default=400, help="episodes per policy")
    add_seeds_and_workers(parser)
    parser.add_argument(
        "--time-limit",
        type=minutes,
        default=float("inf"),
        metavar="MINUTES",
        help="stop after this many minutes, evaluating fewer episodes",
    )
    parser.add_argument(
        "--no-baselines",
        action="store_true",
        help="do not compare a policy file with random and scripted",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--out", type=Path, help="also write the JSON object to this file")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the command: evaluate, print the table, write the file."""
    files = list(dict.fromkeys(name for name in args.policy if name not in BASELINES))
    names = list(
        dict.fromkeys(
            [*args.policy, *(() if args.no_baselines or not files else reversed(BASELINES))]
        )
    )
    if args.out:
        writable_results(args.out, "env_id", "policies")
    made = next((name for name in args.policy if "env_id" in about(name)), args.policy[0])
    env_id, options = env_of(args, made)
    judged = evaluate(
        names,
        env_id,
        args.episodes,
        seed_start=args.seed_start,
        workers=args.workers,
        time_limit=60 * args.time_limit,
        options=options,
        normalize=args.normalize,
    )
    summary = judged.summary()
    told = [{"file": name, **origin} for name in files if (origin := about(name, args.normalize))]
    if len(told) == 1:
        summary["policy"] = told[0]
    elif told:
        summary["files"] = told
    text = json.dumps(summary, indent=2)
    named = replace(judged, episodes=dict(zip(names, judged.episodes.values(), strict=True)))
    scaled = "".join(
        f"\n\n{one['file']}: observations scaled by '{one['normalize']}'."
        for one in told
        if "normalize" in one
    )
    print(text if args.json else table(named.summary()) + scaled, flush=True)
    if args.out:
        write_text(args.out, text + "\n")
    return 0


def failures_by_phase(episodes: Sequence[Episode]) -> Counter[str]:
    """Number of failures in each phase; `NO_PHASE` for a task without phases."""
    return Counter(episode.phase or NO_PHASE for episode in episodes if not episode.success)


def _summary(episodes: Sequence[Episode]) -> dict[str, Any]:
    wins = sum(episode.success for episode in episodes)
    returns = [episode.total_reward for episode in episodes]
    return success_counts(wins, len(episodes)) | {
        "return_mean": float(np.mean(returns)),
        "return_std": float(np.std(returns)),
        "steps_mean": float(np.mean([episode.steps for episode in episodes])),
        "failures_by_phase": dict(failures_by_phase(episodes).most_common()),
    }
