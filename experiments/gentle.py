"""Does feeling pay? Baselines and learned policies on the gentle task:
``python -m experiments.gentle rows|closures|judge|join``.

Every policy moves the hand by increments of its synergy, 20 a second, from the same open posture.
*teacher* reads the true contact forces, which no hand has; *loop* is the same rule on what the
servos tell. ``judge`` runs policy files, such as those of ``agents.gentle``. The teacher's numbers
were chosen on training seeds; every result is of held-out ones."""

import json
import shlex
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from agents.gentle import Hands
from agents.gentle_rule import CLOSING, MOVES, PER_RADIAN, RULE, STEPS, UNTOLD
from experiments.results import read_results, write_results
from hpac_gym.command import add_counts, command_parser, run
from hpac_gym.evaluation.episodes import run_episodes, worlds
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.evaluation.statistics import success_counts
from hpac_gym.model import Array, synergy_from_action
from hpac_gym.output import OutputError, writable_folder
from hpac_gym.physics.settings import BODIES
from hpac_gym.physics.simulation import SET_UPS
from hpac_gym.policies.closure import Closures
from hpac_gym.policies.loading import load_policy, needed_options
from hpac_gym.policies.policy_file import policy_path
from hpac_gym.registration import GENTLE
from hpac_gym.tasks.gentle import LIMIT_UNIT
from hpac_gym.tasks.task import SUCCESS
from hpac_gym.tasks.terms import GRASP_CENTRE, LENGTH_UNIT

RESULTS = Path(__file__).parents[1] / "docs" / "results" / "experiments" / "gentle.json"
SET_UP = "mujoco/light"
WORLDS = 128
FREE = 10
"""Control steps in which no digit touches yet."""
TOUCH = 0.02
"""Force below which a digit is free [N]."""


def episodes_of(env: Hands, act: Callable[[], Array], seed: int) -> dict[str, Array]:
    """Outcome of one episode of each world, from consecutive seeds; `act` returns decisions for all
    hands now, shape (n, 6).
    """
    env.seed(seed)
    env.reset()
    limit = env.episodes.task.crush_limit.copy()
    success = np.zeros(env.num_envs, bool)
    crushed = success.copy()
    over = success.copy()
    for _ in range(STEPS):
        *_, done, infos = env.step(np.arctanh(np.clip(act(), -0.999, 0.999)))
        for world in np.flatnonzero(done & ~over):
            success[world] = infos[world]["is_success"]
            crushed[world] = infos[world]["is_crushed"]
        over |= done
        if over.all():
            break
    return {"limit": limit, "success": success, "crushed": crushed}


class Feeling:
    """The rule on what the servos tell: an estimate of the squeeze from the thumb's load.

    Args:
        env: hands with ``obs="load"``.
        fit: coefficients of the estimate, shape (5,), of `fitted`.
        memory: whether it removes the servo's bias, as seen while nothing is touched, and averages
            the readings.
    """

    def __init__(self, env: Hands, fit: Array, memory: bool) -> None:
        self._env = env
        self._fit = fit
        self._memory = memory
        self._bias = np.zeros(env.num_envs)
        self._felt = self._bias.copy()
        self._far = self._bias.copy()
        self._place = np.zeros((env.num_envs, 3))

    def __call__(self) -> Array:
        env = self._env
        age = env.recent.step[:, 0]
        fields = fields_of(env)
        felt = features(fields) @ self._fit
        place = LENGTH_UNIT * fields["object_pos"] + GRASP_CENTRE
        begins = age == 0
        width = LENGTH_UNIT * fields["object_size"][:, 0]
        self._far = np.where(begins, place[:, 0] + width, self._far)
        self._place = np.where((age <= CLOSING)[:, None], place, self._place)
        slip = np.linalg.norm(place - self._place, axis=1)
        if self._memory:
            bias = self._bias + (felt - self._bias) / (age + 1)
            self._bias = np.where(age < FREE, bias, self._bias)
            felt = felt - self._bias
            self._felt = np.where(begins, felt, self._felt + 0.5 * (felt - self._felt))
            felt = self._felt
        force = np.maximum(felt, 0.0)[:, None] * [0.0, 1.0, *RULE.shares]
        limit = LIMIT_UNIT * fields["crush_limit"][:, 0] if env.told else np.full(len(age), UNTOLD)
        synergy = synergy_from_action(env.recent.action)
        moved = RULE.increments(synergy, age, force, limit, self._far, slip)
        return MOVES.decisions(moved * PER_RADIAN)


def fields_of(env: Hands) -> dict[str, Array]:
    """The newest observations by field, each of shape (n, k)."""
    last = env.recent.last[:, -1]
    return {name: last[:, where] for name, where in env.episodes.observations.slices.items()}


def features(fields: dict[str, Array]) -> Array:
    """What the squeeze is estimated from, shape (n, 5): the thumb's load, and powers of its servo's
    angle.
    """
    servo = fields["servo"][:, 0]
    return np.stack([fields["load"][:, 0], np.ones_like(servo), servo, servo**2, servo**3], axis=1)


def fitted(env: Hands) -> Array:
    """Coefficients of `features` for the thumb's force, from the teacher's episodes, shape (5,): the
    load beyond that of a free thumb, times the newtons that one unit of it means.
    """
    inputs = []
    forces = []
    env.seed(0)
    env.reset()
    for _ in range(CLOSING):
        env.step(np.arctanh(np.clip(env.taught(), -0.999, 0.999)))
        slow = env.recent.step[:, 0] > FREE
        inputs.append(features(fields_of(env))[slow])
        forces.append(env.episodes.now.state.contact_force[slow, 1])
    load, *powers = np.concatenate(inputs).T
    curves = np.stack(powers, axis=1)
    force = np.concatenate(forces)
    free = force < TOUCH
    curve = np.linalg.lstsq(curves[free], load[free])[0]
    unit = force @ force / (force @ (load - curves @ curve))
    return unit * np.append(1.0, -curve)


def closure_outcomes(closures: Array, episodes: int, seed: int) -> tuple[Array, Array]:
    """Every closure on every one of some episodes.

    Args:
        closures: decisions, shape (m, 8), −1…1.
        episodes: number of episodes.
        seed: of the first one.

    Returns:
        Success, shape (episodes, m), and crush limits, shape (episodes,) [N].
    """
    count = len(closures)
    envs = gymnasium.make_vec(GENTLE, count, engine="mujoco", body="light")
    kind = Closures()
    success = np.zeros((episodes, count), bool)
    limit = np.zeros(episodes)
    for episode in range(episodes):
        setup = envs.task.setup(np.random.default_rng(seed + episode))
        setup = replace(setup, hand_settings=BODIES["light"])
        envs.reset(seed=seed, options={"setup": setup})
        limit[episode] = setup.crush_limit
        over = np.zeros(count, bool)
        for step in range(STEPS):
            actions = kind.actions(closures, np.full(count, step)).astype(np.float32)
            *_, ended, _, _ = envs.step(actions)
            success[episode] |= (envs.episodes.outcome == SUCCESS) & ~over
            over |= ended
            if over.all():
                break
    envs.close()
    return success, limit


def summary(found: dict[str, Array]) -> dict[str, Any]:
    """Successes of episodes by their crush limit, with Wilson intervals, and the share crushed where it
    is known.
    """
    limit = found["limit"]
    groups = {
        "all": limit > 0,
        "2.5 to 3 N": limit < 3,
        "3 to 4 N": (limit >= 3) & (limit < 4),
        "4 to 5 N": limit >= 4,
    }
    rows = {
        name: success_counts(int(found["success"][chosen].sum()), int(chosen.sum()))
        for name, chosen in groups.items()
        if chosen.any()
    }
    crushed = found.get("crushed")
    return rows if crushed is None else rows | {"crushed": float(crushed.mean())}


def rows(episodes: int, body: str, told: bool) -> dict[str, Any]:
    """The teacher, and the loop on the servos' load without and with memory, on held-out episodes."""
    env = Hands(WORLDS, "load", told, body)
    fit = fitted(env)
    policies = {
        "teacher": env.taught,
        "loop": Feeling(env, fit, False),
        "loop with memory": Feeling(env, fit, True),
    }
    judged = {}
    for name, act in policies.items():
        parts = [
            episodes_of(env, act, HELD_OUT_SEED + first) for first in range(0, episodes, WORLDS)
        ]
        judged[name] = summary(
            {key: np.concatenate([one[key] for one in parts])[:episodes] for key in parts[0]}
        )
    env.close()
    return judged


def closures(count: int, episodes: int) -> dict[str, Any]:
    """The best fixed closure, chosen on half of the episodes and judged on the other, and the best
    of all for each episode.
    """
    decisions = np.random.default_rng(0).uniform(-1, 1, (count, 8))
    success, limit = closure_outcomes(decisions, episodes, HELD_OUT_SEED)
    half = episodes // 2
    best = success[:half].mean(axis=0).argmax()
    return {
        "fixed closure": summary({"limit": limit[half:], "success": success[half:, best]}),
        f"best of {count} closures": summary({"limit": limit, "success": success.any(axis=1)}),
    }


def judge(name: str, first_seed: int, episodes: int, **options: Any) -> dict[str, Any]:
    """`summary` of episodes of a policy file."""
    ends = []
    given = needed_options(name) | options
    seeds = range(first_seed, first_seed + episodes)
    with worlds(GENTLE, given, episodes) as (env, envs):
        for step in run_episodes(envs, [load_policy(name, env)] * envs.num_envs, seeds):
            if step.over:
                ends.append((step.info["crush_limit"], step.success, step.info["is_crushed"]))
    limit, success, crushed = (np.array(column) for column in zip(*ends, strict=True))
    cells = summary({"limit": limit, "success": success, "crushed": crushed})
    return {"policy": name, "options": given} | cells


def _write(file: Path, words: str, found: dict[str, Any]) -> None:
    write_results(file, words, **found)
    print(json.dumps(found), flush=True)


def main(argv: list[str] | None = None) -> None:
    parser = command_parser("experiments.gentle", __doc__)
    parser.add_argument("what", choices=("rows", "closures", "judge", "join"), help="what to do")
    parser.add_argument("policies", nargs="*", help="of `judge`: gentle, or policy files")
    parser.add_argument("--set-up", choices=SET_UPS, default=SET_UP, help="engine and body")
    parser.add_argument("--untold", action="store_true", help="the crush limit is not told")
    add_counts(
        parser,
        episodes=(1, 384, "how many"),
        seed_start=(0, HELD_OUT_SEED, "of `judge`"),
        closures=(1, 64, "number of random closures"),
    )
    parser.add_argument("--out", type=Path, default=Path("runs/gentle"), help="folder of results")
    arguments = parser.parse_args(argv)
    if (arguments.what == "judge") != bool(arguments.policies):
        parser.error("judge, and it alone, takes policies")
    engine, body = arguments.set_up.split("/")
    told = not arguments.untold
    if arguments.what in ("closures", "join") and (arguments.set_up != SET_UP or not told):
        parser.error("rows and judge alone take --set-up and --untold")
    if arguments.what == "rows" and engine != "mujoco":
        parser.error(f"--set-up is '{arguments.set_up}': rows run in MuJoCo alone")
    out = writable_folder(arguments.out)
    words = f"gentle {shlex.join(sys.argv[1:] if argv is None else argv)}"
    where = f"{engine}_{body}{'' if told else '_untold'}"
    if arguments.what == "join":
        parts = {file.stem: read_results(file, "command") for file in sorted(out.glob("*.json"))}
        if not parts:
            raise OutputError(f"nothing to join: no results in '{out}'")
        _write(RESULTS, words, parts)
    elif arguments.what == "rows":
        _write(out / f"rows_{where}.json", words, rows(arguments.episodes, body, told))
    elif arguments.what == "closures":
        found = closures(arguments.closures, arguments.episodes)
        _write(out / "closures.json", words, found)
    else:
        for name in arguments.policies:
            options = {"engine": engine, "body": body, "told": told}
            found = judge(name, arguments.seed_start, arguments.episodes, **options)
            file = policy_path(name)
            label = file.parent.name if file.stem == "policy" else file.stem
            _write(out / f"{label}_{where}.json", words, found)


if __name__ == "__main__":
    sys.exit(run(main))
