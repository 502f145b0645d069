"""``hpac forecast``: how often a policy will succeed on one's own hand, from one sweep of it.

Virtual hands are drawn from what the sweep leaves open (`hpac_gym.calibration.posterior`), and the
policy runs its episodes on each, commanded with the calibrated file. What no sweep tells is the
simulation's: friction, masses and contacts, and the scale of lengths and forces."""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hpac_gym.calibration.posterior import DRAWS, read_draws
from hpac_gym.command import add_json, say, whole_number
from hpac_gym.evaluation.environment import make_env
from hpac_gym.evaluation.evaluate import add_seeds_and_workers, run_block
from hpac_gym.evaluation.options import add_policy_and_env, env_of
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.evaluation.statistics import predicted_rate
from hpac_gym.evaluation.workers import shared
from hpac_gym.model import HPAC, Hand, load_hand
from hpac_gym.policies.loading import NAMES, load_policy

NOMINAL = "nominal"
EPISODES = 50
OF = 1000
"""Episodes of each virtual hand, and those that are predicted (chosen)."""


def forecast(
    hands: Sequence[Hand],
    policy: str,
    env_id: str,
    options: Mapping[str, Any],
    episodes: int,
    *,
    of: int = OF,
    seed_start: int = HELD_OUT_SEED,
    workers: int = 1,
    normalize: str | None = None,
) -> dict[str, Any]:
    """Run a policy on virtual hands, each in episodes of its own.

    Args:
        hands: the virtual hands, at least two.
        policy: as `load_policy` takes it.
        env_id: the environment.
        options: of the environment, `model` among them.
        episodes: of each hand.
        of: number of predicted episodes.
        seed_start: seed of the first episode.
        workers: number of processes.
        normalize: as in `load_policy`.

    Returns:
        `successes` of each virtual hand, in this number of `episodes`; the `success_rate` that is
        expected; and `interval_95`, of the share of successes among `of` episodes to come.

    Raises:
        EnvError: The environment is unknown.
        PolicyError: The policy cannot be loaded, or was made for another environment.
    """
    with make_env(env_id, **options) as env:
        load_policy(policy, env, normalize)  # errors are raised here, not in a worker
    jobs = [
        ([policy], env_id, {**options, "hand": hand}, range(first, first + episodes), normalize)
        for hand, first in zip(
            hands, range(seed_start, seed_start + len(hands) * episodes, episodes), strict=True
        )
    ]
    successes = tuple(
        sum(episode.success for (episode,) in rows)
        for rows in shared(run_block, jobs, workers, "virtual hands")
    )
    rate, *interval = predicted_rate(successes, episodes, of)
    return {
        "successes": successes,
        "episodes": episodes,
        "of": of,
        "success_rate": rate,
        "interval_95": tuple(interval),
    }


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hpac forecast`."""
    parser.add_argument(
        "file",
        type=Path,
        metavar="hand.toml",
        help="what 'hpac calibrate' wrote, its report beside it",
    )
    add_policy_and_env(
        parser,
        "id (default: a policy file's own, otherwise HPAC-Grasp-v0)",
        but=("hand", "hands", "model"),
        default="scripted",
        help=NAMES,
    )
    parser.add_argument(
        "--model",
        dest="commands",
        metavar="FILE",
        help=f"hand file that commands are computed with (default: hand.toml); {NOMINAL}: the paper's hand",
    )
    parser.add_argument(
        "--hands",
        dest="count",
        type=whole_number(2),
        default=DRAWS,
        help="number of virtual hands, at most as many as the file was calibrated with",
    )
    parser.add_argument(
        "--episodes", type=whole_number(1), default=EPISODES, help="episodes of each virtual hand"
    )
    parser.add_argument(
        "--of", type=whole_number(1), default=OF, help="episodes that are predicted"
    )
    add_seeds_and_workers(parser)
    add_json(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the command: draw the virtual hands, run the policy, print the forecast."""
    hand = load_hand(args.file)
    hands = read_draws(args.file, hand)
    env_id, given = env_of(args, args.policy)
    model = HPAC if args.commands == NOMINAL else load_hand(args.commands or args.file)
    expected = forecast(
        hands[: args.count],
        args.policy,
        env_id,
        {**given, "model": model},
        args.episodes,
        of=args.of,
        seed_start=args.seed_start,
        workers=args.workers,
        normalize=args.normalize,
    )
    told = " ".join(map(str, (args.policy, *given.values())))
    facts = {
        "hand": str(args.file),
        "policy": args.policy,
        "env_id": env_id,
        "model": args.commands or str(args.file),
        "options": given,
        **expected,
    }
    low, high = expected["interval_95"]
    line = (
        f"{args.file}, {told}, commanded with {args.commands or 'it'}: {expected['success_rate']:.1%} expected; "
        f"in {args.of} episodes {low:.1%} to {high:.1%} (95 %), from {len(expected['successes'])} virtual hands with "
        f"{args.episodes} episodes each; friction, masses and contacts as simulated"
    )
    say(args.json, line, **facts)
    return 0
