"""Does feeling pay? Baselines and learned policies on the gentle task:
``python -m experiments.gentle rows|closures|train|at|join``.

Every policy moves the hand by increments of its synergy, 20 a second, from the same open posture.
*teacher* reads the true contact forces, which no hand has; the learned ones imitate it on what they
do themselves (DAgger), once with ``obs="deploy"`` and once with ``obs="load"``, with as many
episodes. PPO can go on from there (``--steps``). The teacher's numbers were chosen on training seeds;
every result is of held-out ones."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.spaces import Box
from stable_baselines3.common.vec_env import VecEnvWrapper

import hpac_gym  # noqa: F401  registers the environments
from hpac_gym.command import run_module
from hpac_gym.envs.sb3 import HandVecEnv
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.evaluation.statistics import success_counts
from hpac_gym.model import HPAC, action_from_synergy
from hpac_gym.model.checks import Array
from hpac_gym.output import writable_folder, write_text
from hpac_gym.physics.settings import BODIES
from hpac_gym.policies.closure import Closures
from hpac_gym.registration import GENTLE
from hpac_gym.tasks.gentle import LIMIT_UNIT
from hpac_gym.tasks.task import SUCCESS, open_hand
from hpac_gym.tasks.terms import GRASP_CENTRE, LENGTH_UNIT

ID = GENTLE
STEPS = 88
OPEN = open_hand(1.2)
LARGEST = np.array([0.06, 0.10, 0.10, 0.10, 0.10, 0.10])
"""Largest increment of each driven joint [rad]; a learned policy's actions are its square roots, so
that small steps are as easy to find as large ones."""
CLOSING = 48
"""Control steps of an episode, and those until the lift."""
PAST = 5
STACK = 4
"""Control steps that are remembered, and frames of an observation."""
FREE = 10
"""Control steps in which no digit touches yet."""


@dataclass(frozen=True, slots=True)
class Rule:
    """Numbers of the loop: close fast to just before contact, then by what each digit feels."""

    fast: float = 0.272
    """Synergy until which the fingers close fast, for an object 50 mm from the palm [rad]."""
    fastx: float = 5.61
    """By how much less for each metre more [rad/m]."""
    fstep: float = 0.0635
    step: float = 0.0185
    back: float = 0.00912
    """Increments: fast, largest closing and largest opening one [rad]."""
    gain: float = 0.00973
    """Increment for a newton that is missing [rad/N]."""
    cmc: float = 0.937
    tpre: float = 0.138
    tstep: float = 0.0325
    """CMC; MP up to which the thumb closes fast, and how fast [rad]."""
    delay: float = 8.29
    """Control steps that the thumb waits."""
    phi: float = 0.82
    """Share of the crush limit that is aimed at."""
    thumb: float = 0.871
    """Share of the aim that the thumb presses with."""
    over: float = 1.37
    """Share of the aim beyond which all digits give way."""
    index: float = 0.673
    ring: float = 0.595
    pinky: float = 0.505
    """Weights of the fingers' shares; the middle's is 1."""
    slip: float = 107.0
    """Growth of the aim for each metre that the object slips beyond 2 mm [1/m]."""

    @property
    def shares(self) -> Array:
        """Share of the aim that each finger presses with, shape (4,)."""
        weights = np.array([self.index, 1.0, self.ring, self.pinky])
        return weights / weights.sum()

    def increments(
        self, synergy: Array, step: Array, force: Array, limit: Array, far: Array, slip: Array
    ) -> Array:
        """Increments of n hands, shape (n, 6) [rad].

        Args:
            synergy: shape (n, 6) [rad].
            step: control steps since the episode began, shape (n,).
            force: of the palm, if it is known, and of every digit, shape (n, 6) [N].
            limit: crush limit, shape (n,) [N].
            far: distance from the palm to the object's far side, shape (n,) [m].
            slip: of the object in the hand, shape (n,) [m].
        """
        grown = np.minimum(self.phi * (1 + self.slip * np.maximum(slip - 2e-3, 0.0)), 0.95)
        aim = (grown * limit)[:, None]
        shares = np.append(self.thumb, self.shares)
        squeeze = force.sum(axis=1, keepdims=True) / 2
        move = np.clip(self.gain * (shares * aim - force[:, 1:]), -self.back, self.step)
        move[(squeeze > aim)[:, 0]] = np.minimum(move, 0.0)[(squeeze > aim)[:, 0]]
        move = np.where(squeeze > self.over * aim, -self.back, move)
        fast = np.clip(self.fast - self.fastx * (far - 0.05), 0.0, 1.2)[:, None]
        move[:, 1:] = np.where(synergy[:, 1:5] < fast, self.fstep, move[:, 1:])
        move[:, 0] = np.where(synergy[:, 0] < self.tpre, self.tstep, move[:, 0])
        move[step < self.delay, 0] = 0.0
        return np.column_stack([move, np.clip(self.cmc - synergy[:, 5], -0.1, 0.1)])


RESULTS = Path(__file__).parents[1] / "docs" / "results" / "experiments" / "gentle.json"
COMMAND = "; ".join(
    f"python -m experiments.gentle {words}"
    for words in (
        "train --obs load --seeds 0 1 2 3 4 --rounds 8 --episodes 384",
        "train --obs deploy --seeds 0 1 2 3 4 --rounds 8 --episodes 384",
        "at --obs load --seeds 0 1 2 3 4 --limits 4 --episodes 128",
        "rows --episodes 384",
        "closures --closures 64 --episodes 24",
        "join",
    )
)
RULE = Rule()
WORLDS = 128


class Increments(VecEnvWrapper):
    """n hands that are moved by increments of their synergy, and see their last observations.

    Attributes:
        synergy: of every hand, shape (n, 6) [rad].
        age: control steps since its episode began, shape (n,).
    """

    def __init__(self, num_envs: int, obs: str, **options: Any) -> None:
        env = HandVecEnv(ID, num_envs, engine="mujoco", body="light", obs=obs, **options)
        size = env.observation_space.shape[0]
        super().__init__(
            env,
            Box(-10.0, 10.0, (STACK * size,), np.float32),
            Box(-1.0, 1.0, (6,), np.float32),
        )
        self.episodes = env.envs.episodes
        self.task = self.episodes.task
        self.slices = self.episodes.observations.slices
        self.synergy = np.tile(OPEN, (num_envs, 1))
        self.age = np.zeros(num_envs, int)
        self._past = np.zeros((num_envs, PAST, size), np.float32)
        self._early = np.zeros((num_envs, size), np.float32)

    def reset(self) -> Array:
        self._begin(np.ones(self.num_envs, bool), self.venv.reset())
        return self._stacked()

    def _stacked(self) -> Array:
        """Mean of the first `FREE` steps, and every second of the last `PAST`, at the rate of the readings."""
        frames = [self._early, *self._past[:, ::2].swapaxes(0, 1)]
        return np.concatenate(frames, axis=1)

    def _begin(self, worlds: Array, seen: Array) -> None:
        self.synergy[worlds] = OPEN
        self.age[worlds] = 0
        self._past[worlds] = seen[worlds, None]
        self._early[worlds] = seen[worlds]

    def step_async(self, actions: Array) -> None:
        moved = np.sign(actions) * np.square(actions) * LARGEST
        self.synergy = np.clip(self.synergy + moved, HPAC.synergy_min, HPAC.synergy_max)
        self.venv.step_async(action_from_synergy(self.synergy).astype(np.float32))

    def step_wait(self) -> Any:
        seen, reward, done, infos = self.venv.step_wait()
        self.age += 1
        self._past = np.roll(self._past, -1, axis=1)
        self._past[:, -1] = seen
        ends = np.flatnonzero(done)
        for world in ends:
            self._past[world, -1] = infos[world]["terminal_observation"]
        free = (self.age <= FREE)[:, None]
        mean = self._early + (self._past[:, -1] - self._early) / (self.age[:, None] + 1)
        self._early = np.where(free, mean, self._early).astype(np.float32)
        last = self._stacked()
        for world in ends:
            infos[world]["terminal_observation"] = last[world]
        self._begin(done, seen)
        return self._stacked(), 0.1 * reward, done, infos

    def taught(self, rule: Rule) -> Array:
        """Actions of a rule that knows everything, shape (n, 6)."""
        state = self.episodes.now.state
        setups = self.episodes.setups
        far = np.array([one.position[0] + one.object.half_extents[0] for one in setups])
        slip = self.task.grip.slip * (self.age > CLOSING)
        move = rule.increments(
            self.synergy, self.age, state.contact_force, self.task.crush_limit, far, slip
        )
        return action_of(move)


def action_of(move: Array) -> Array:
    """Actions of increments, shape (n, 6)."""
    share = np.clip(move / LARGEST, -1.0, 1.0)
    return np.sign(share) * np.sqrt(np.abs(share))


def episodes_of(env: Increments, act: Callable[[Array], Array], seed: int) -> dict[str, Array]:
    """Outcome of one episode of each world, from consecutive seeds."""
    env.seed(seed)
    seen = env.reset()
    limit = env.task.crush_limit.copy()
    success = np.zeros(env.num_envs, bool)
    crushed = success.copy()
    ended = np.full(env.num_envs, STEPS)
    over = success.copy()
    for step in range(STEPS):
        seen, _, done, infos = env.step(act(seen))
        for world in np.flatnonzero(done & ~over):
            success[world] = infos[world]["is_success"]
            crushed[world] = infos[world]["is_crushed"]
            ended[world] = step
        over |= done
        if over.all():
            break
    return {"limit": limit, "success": success, "crushed": crushed, "ended": ended}


class Feeling:
    """`Rule` on what the servos tell: an estimate of the squeeze from the thumb's load.

    Args:
        env: hands with ``obs="load"``.
        rule: the rule.
        fit: coefficients of the estimate, shape (5,), of `fitted`.
        memory: whether it removes the servo's bias, as seen while nothing is touched, and averages
            the readings.
    """

    def __init__(self, env: Increments, rule: Rule, fit: Array, memory: bool) -> None:
        self._env = env
        self._rule = rule
        self._fit = fit
        self._memory = memory
        self._bias = np.zeros(env.num_envs)
        self._felt = self._bias.copy()
        self._far = np.zeros(env.num_envs)
        self._place = np.zeros((env.num_envs, 3))

    def __call__(self, seen: Array) -> Array:
        env = self._env
        last = seen.reshape(env.num_envs, STACK, -1)[:, -1]
        fields = {name: last[:, where] for name, where in env.slices.items()}
        felt = features(fields) @ self._fit
        place = LENGTH_UNIT * fields["object_pos"] + GRASP_CENTRE
        begins = env.age == 0
        width = LENGTH_UNIT * fields["object_size"][:, 0]
        self._far = np.where(begins, place[:, 0] + width, self._far)
        self._place = np.where((env.age <= CLOSING)[:, None], place, self._place)
        slip = np.linalg.norm(place - self._place, axis=1)
        if self._memory:
            free = env.age < FREE
            share = 1 / (env.age + 1)
            self._bias = np.where(free, self._bias + share * (felt - self._bias), self._bias)
            self._bias[begins] = felt[begins]
            felt = felt - self._bias
            self._felt = np.where(begins, felt, self._felt + 0.5 * (felt - self._felt))
            felt = self._felt
        force = np.maximum(felt, 0.0)[:, None] * [0.0, 1.0, *self._rule.shares]
        limit = LIMIT_UNIT * fields["crush_limit"][:, 0]
        return action_of(self._rule.increments(env.synergy, env.age, force, limit, self._far, slip))


TOUCH = 0.02
"""Force below which a digit is free [N]."""


def features(fields: dict[str, Array]) -> Array:
    """What the squeeze is estimated from, shape (n, 5): the thumb's load, and powers of its servo's
    angle.
    """
    servo = fields["servo"][:, 0]
    return np.stack([fields["load"][:, 0], np.ones_like(servo), servo, servo**2, servo**3], axis=1)


def fitted(env: Increments, rule: Rule, seed: int) -> Array:
    """Coefficients of `features` for the thumb's force, from the teacher's episodes, shape (5,): the
    load beyond that of a free thumb, times the newtons that one unit of it means.
    """
    inputs = []
    forces = []
    env.seed(seed)
    seen = env.reset()
    for _ in range(CLOSING):
        seen, *_ = env.step(env.taught(rule))
        last = seen.reshape(env.num_envs, STACK, -1)[:, -1]
        slow = env.age > FREE
        known = features({name: last[:, where] for name, where in env.slices.items()})
        inputs.append(known[slow])
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
    envs = gymnasium.make_vec(ID, count, engine="mujoco", body="light")
    kind = Closures()
    success = np.zeros((episodes, count), bool)
    limit = np.zeros(episodes)
    for episode in range(episodes):
        setup = envs.task.setup(np.random.default_rng(seed + episode))
        light = BODIES["light"]
        setup = replace(setup, hand_settings=light)
        envs.reset(seed=seed, options={"setup": setup})
        limit[episode] = setup.crush_limit
        over = np.zeros(count, bool)
        for step in range(STEPS):
            actions = kind.actions(closures, np.full(count, step))
            *_, ended, _, _ = envs.step(actions.astype(np.float32))
            success[episode] |= (envs.episodes.outcome == SUCCESS) & ~over
            over |= ended
            if over.all():
                break
    envs.close()
    return success, limit


def learner(env: Increments, seed: int, **settings: Any) -> Any:
    """A PPO of Stable-Baselines3 that has learned nothing yet."""
    from stable_baselines3 import PPO

    chosen = {
        "n_steps": STEPS,
        "batch_size": 1024,
        "n_epochs": 5,
        "learning_rate": 2e-4,
        "gamma": 0.99,
        "gae_lambda": 0.95,
        "target_kl": 0.02,
        "policy_kwargs": {"net_arch": [128, 128], "log_std_init": -3.0},
    } | settings
    return PPO("MlpPolicy", env, seed=seed, device="cpu", **chosen)


def mean_action(model: Any, seen: Array) -> Array:
    """Actions of a learned policy, shape (n, 6)."""
    return model.predict(seen, deterministic=True)[0]


def imitate(
    model: Any,
    env: Increments,
    rule: Rule,
    rounds: int,
    rng: np.random.Generator,
    updates: int = 250,
) -> list[float]:
    """DAgger: the policy learns what the rule would have done where the policy has been.

    Returns:
        Share of the episodes of each round that succeeded.
    """
    optimizer = torch.optim.Adam(model.policy.parameters(), lr=1e-3)
    inputs: list[torch.Tensor] = []
    targets: list[torch.Tensor] = []
    shares = []
    seen = env.reset()
    for number in range(rounds):
        ended = succeeded = 0
        for _ in range(STEPS):
            taught = env.taught(rule)
            inputs.append(torch.as_tensor(seen))
            targets.append(torch.as_tensor(taught, dtype=torch.float32))
            actions = taught if number == 0 else mean_action(model, seen)
            seen, _, done, infos = env.step(actions)
            ended += int(done.sum())
            succeeded += sum(bool(infos[world]["is_success"]) for world in np.flatnonzero(done))
        shares.append(succeeded / max(ended, 1))
        data = torch.cat(inputs)
        told = torch.cat(targets)
        last = number == rounds - 1
        optimizer.param_groups[0]["lr"] = 1e-3 * (1 - number / rounds)
        for part in rng.integers(len(data), size=(3 * updates if last else updates, 1024)):
            loss = (
                (model.policy.get_distribution(data[part]).distribution.mean - told[part])
                .square()
                .mean()
            )
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
        print(
            f"round {number}: {shares[-1]:.3f} of {ended} held, loss {loss.item():.4f}", flush=True
        )
    return shares


def summary(found: dict[str, Array]) -> dict[str, Any]:
    """Successes of episodes by their crush limit, with Wilson intervals."""
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
    return rows | {"crushed": float(found["crushed"].mean())}


def judged(env: Increments, act: Callable[[Array], Array], episodes: int) -> dict[str, Any]:
    """`summary` of held-out episodes."""
    parts = [
        episodes_of(env, act, HELD_OUT_SEED + first) for first in range(0, episodes, env.num_envs)
    ]
    return summary({name: np.concatenate([part[name] for part in parts]) for name in parts[0]})


def train(obs: str, seed: int, rounds: int, steps: int, episodes: int, out: Path) -> dict[str, Any]:
    """Learn with one kind of observation: imitate the teacher, then PPO for some steps; saves the
    model.
    """
    env = Increments(WORLDS, obs)
    model = learner(env, seed)
    env.seed(1_000 * seed)  # the learner has set seeds of its own, which overlap
    shares = imitate(model, env, RULE, rounds, np.random.default_rng(seed))
    if steps:
        model.learn(steps)
    model.save(out / f"{obs}_{seed}.zip")
    result = judged(env, lambda seen: mean_action(model, seen), episodes)
    env.close()
    return {"obs": obs, "seed": seed, "rounds": rounds, "steps": steps, "shares": shares} | result


def rows(episodes: int) -> dict[str, Any]:
    """The teacher, and the loop on the servos' load without and with memory."""
    env = Increments(WORLDS, "load")
    fit = fitted(env, RULE, 0)
    found = {"teacher": judged(env, lambda seen: env.taught(RULE), episodes)}
    for name, memory in (("loop", False), ("loop with memory", True)):
        found[name] = judged(env, Feeling(env, RULE, fit, memory), episodes)
    env.close()
    return found


def closures(count: int, episodes: int) -> dict[str, Any]:
    """The best fixed closure, chosen on half of the episodes and judged on the other, and the best
    of all for each episode.
    """
    decisions = np.random.default_rng(0).uniform(-1, 1, (count, 8))
    success, limit = closure_outcomes(decisions, episodes, HELD_OUT_SEED)
    half = episodes // 2
    best = success[:half].mean(axis=0).argmax()
    no = np.zeros(episodes, bool)
    return {
        "fixed closure": summary(
            {"limit": limit[half:], "success": success[half:, best], "crushed": no[half:]}
        ),
        f"best of {count} closures": summary(
            {"limit": limit, "success": success.any(axis=1), "crushed": no}
        ),
    }


def at_limits(
    obs: str, seed: int, limits: Sequence[float], episodes: int, out: Path
) -> dict[str, Any]:
    """Outcomes of a trained policy where every object has the same crush limit [N]."""
    from stable_baselines3 import PPO

    model = PPO.load(out / f"{obs}_{seed}.zip", device="cpu")
    found = {}
    for limit in limits:
        env = Increments(WORLDS, obs, config={"crush_limit": (limit, limit)})
        found[f"{limit:g} N"] = judged(env, partial(mean_action, model), episodes)["all"]
        env.close()
    return {"obs": obs, "seed": seed} | found


def _write(file: Path, found: dict[str, Any]) -> None:
    write_text(file, json.dumps(found, indent=1) + "\n")
    print(json.dumps(found), flush=True)


def _run(arguments: argparse.Namespace) -> int:
    torch.set_num_threads(1)
    out = writable_folder(arguments.out)
    what = arguments.what
    if what == "train":
        for seed in arguments.seeds:
            found = train(
                arguments.obs, seed, arguments.rounds, arguments.steps, arguments.episodes, out
            )
            _write(out / f"{arguments.obs}_{seed}.json", found)
    elif what == "at":
        for seed in arguments.seeds:
            found = at_limits(arguments.obs, seed, arguments.limits, arguments.episodes, out)
            _write(out / f"at_{arguments.obs}_{seed}.json", found)
    elif what == "join":
        parts = {file.stem: json.loads(file.read_text()) for file in sorted(out.glob("*.json"))}
        _write(RESULTS, {"command": COMMAND} | parts)
    elif what == "rows":
        _write(out / "rows.json", rows(arguments.episodes))
    else:
        _write(out / "closures.json", closures(arguments.closures, arguments.episodes))
    return 0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "what", choices=("rows", "closures", "train", "at", "join"), help="what to compute"
    )
    parser.add_argument("--obs", choices=("deploy", "load"), default="load", help="observation")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0], help="seeds of the trainings")
    parser.add_argument("--rounds", type=int, default=5, help="rounds of imitation")
    parser.add_argument("--steps", type=int, default=0, help="control steps of PPO")
    parser.add_argument("--episodes", type=int, default=512, help="held-out episodes")
    parser.add_argument(
        "--limits", type=float, nargs="+", default=[3.0, 4.0], help="of `at`: crush limits [N]"
    )
    parser.add_argument("--closures", type=int, default=64, help="number of random closures")
    parser.add_argument("--out", type=Path, default=Path("runs/gentle"), help="folder of results")
    parser.set_defaults(run=_run)


if __name__ == "__main__":
    sys.exit(run_module("experiments.gentle", __doc__, add_arguments))
