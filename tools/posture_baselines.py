"""Judge what nobody trained on HPAC-Posture-v1, on held-out episodes: ``python -m tools.posture_baselines``.

The constant action asks for the goal's own synergy; the integral controller corrects it by what the camera measures. Its gain was
chosen on seeds from 5,000 on.
"""

from __future__ import annotations

import sys
from typing import Any

import gymnasium

from agents.command import command_parser
from hpac import run, whole_number
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.evaluation.statistics import wilson_interval
from hpac_gym.tasks.scripted import ScriptedPosture

ENV_ID, STEPS = "hpac_gym:HPAC-Posture-v1", 40


def main(argv: list[str] | None = None) -> int:
    parser = command_parser("tools.posture_baselines", __doc__)
    parser.add_argument("--episodes", type=whole_number(1), default=400, help=f"of each, from seed {HELD_OUT_SEED} on")
    parser.add_argument("--engine", default="mujoco", help="mujoco, whose batch takes seconds, or pybullet, which takes minutes")
    args = parser.parse_args(argv)
    mode = "sync" if args.engine == "pybullet" else None
    scripts = {"integral controller": ScriptedPosture(), "constant action": ScriptedPosture(gain=0.0)}
    print("| policy | nominal hand | *hand* |\n| --- | --- | --- |")
    for name, script in scripts.items():
        cells = []
        for preset in ("nominal", "hand"):
            options = {"randomize": preset, "engine": args.engine, "vectorization_mode": mode}
            cells.append(_rate(script, args.episodes, options))
        print(f"| {name} | {' | '.join(cells)} |", flush=True)
    return 0


def _rate(script: ScriptedPosture, episodes: int, options: dict[str, Any]) -> str:
    """Share of the episodes that end within the tolerance, with its interval."""
    envs = gymnasium.make_vec(ENV_ID, num_envs=min(episodes, 20), **options)
    won, seeds = 0, range(HELD_OUT_SEED, HELD_OUT_SEED + episodes)
    for first in range(0, episodes, envs.num_envs):
        batch = seeds[first : first + envs.num_envs]
        observation, _ = envs.reset(seed=[*batch, *[0] * (envs.num_envs - len(batch))])
        script.reset()
        for _ in range(STEPS):
            observation, *_, infos = envs.step(script.act(observation))
        won += int(infos["is_success"][: len(batch)].sum())
    envs.close()
    low, high = wilson_interval(won, episodes)
    return f"{won / episodes:.1%} ({low:.1%} … {high:.1%})"


if __name__ == "__main__":
    sys.exit(run(main))
