"""A policy of LeRobot, trained on recorded episodes of the hand: ``python learn.py --out runs/learned``.

A shipped policy grasps drawn objects; the episodes in which it holds them are recorded. ``lerobot-train``
trains a small ACT on them, without pictures, which then grasps other objects, as does the shipped policy.
Everything passes the robot, the wire and the firmware core, in virtual time."""

import argparse
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from lerobot.common.control_utils import predict_action
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.factory import make_pre_post_processors
from lerobot_robot_hpac import Hpac, HpacConfig, features, robot
from lerobot_robot_hpac.features import ACTIONS, POSE, PREDICTED, EnvironmentStateStep, named

from hpac_gym.deploy.episode import decided
from hpac_gym.deploy.observer import Observer
from hpac_gym.envs import HandEnv
from hpac_gym.evaluation.environment import make_env
from hpac_gym.evaluation.statistics import rate_text
from hpac_gym.model import action_from_synergy
from hpac_gym.policies.loading import load_policy
from hpac_gym.tasks.task import RUNNING, SUCCESS
from hpac_gym.virtual.body import LockStep

STATE = (*ACTIONS, *PREDICTED, *POSE)
RECORDED = 7_000_000
JUDGED = range(8_000_000, 8_000_100)
"""First seed of the episodes that are recorded, and the seeds of those that judge."""
robot.SILENCE = 1e6  # the clock is virtual: nothing is late

Act = Callable[[np.ndarray, LockStep, Observer], np.ndarray]


def episode(env: HandEnv, seed: int, act: Act) -> tuple[bool, list[np.ndarray], list[np.ndarray]]:
    """One episode: whether the object was held, and the states and actions of every step."""
    world = LockStep(env, seed)
    observer = Observer("HPAC-Grasp-v0", world.seen_object)
    observer.setup = replace(world.body.setup, object=world.seen_object)
    observer.start()
    features.source_of = lambda *_: world
    start = action_from_synergy(observer.setup.synergy)
    hand = Hpac(HpacConfig(port=world.hand.connect, pose="lockstep", start=list(start)))
    states = []
    actions = []
    with hand:
        world.ready(None, {})
        for _ in range(observer.steps):
            states.append(np.array(list(hand.get_observation().values()), dtype=np.float32))
            actions.append(act(states[-1], world, observer))
            hand.send_action(named(ACTIONS, actions[-1]))
            observer.sent(hand._servo)
        for _ in range(20):
            if world.body.outcome == RUNNING:
                hand.send_action(named(ACTIONS, actions[-1]))
        held = world.body.outcome == SUCCESS
    return held, states, actions


def shipped() -> Act:
    """The policy `grasp`, which looks once."""
    loaded: dict[str, object] = {}

    def act(_: np.ndarray, world: LockStep, observer: Observer) -> np.ndarray:
        begins = observer.step == 0
        if begins:
            loaded["policy"] = load_policy("grasp", observer)
            loaded["memory"] = None
        pose, _ = world.latest()
        _, action, _, loaded["memory"] = decided(
            loaded["policy"], observer, pose, loaded["memory"], begins
        )
        return action.astype(np.float32)

    return act


def learned(folder: Path) -> Act:
    """The trained policy."""
    policy = ACTPolicy.from_pretrained(folder)
    before, after = make_pre_post_processors(policy.config, pretrained_path=str(folder))
    before.steps = [EnvironmentStateStep(), *before.steps]

    def act(state: np.ndarray, _: LockStep, observer: Observer) -> np.ndarray:
        if observer.step == 0:
            policy.reset()
        given = predict_action(
            {"observation.state": state}, policy, torch.device("cpu"), before, after, False
        )
        return np.clip(given.numpy()[0], -1, 1)

    return act


def record(env: HandEnv, count: int, root: Path) -> int:
    """Record the episodes in which the shipped policy holds the object; returns how many it took."""
    state = {"dtype": "float32", "shape": (len(STATE),), "names": list(STATE)}
    action = {"dtype": "float32", "shape": (len(ACTIONS),), "names": list(ACTIONS)}
    stored = {"observation.state": state, "observation.environment_state": state, "action": action}
    data = LeRobotDataset.create("hpac/learn", 20, stored, root=root, robot_type="hpac")
    act = shipped()
    seed = RECORDED
    while data.num_episodes < count:
        held, states, actions = episode(env, seed, act)
        seed += 1
        if held:
            for seen, given in zip(states, actions, strict=True):
                both = {"observation.state": seen, "observation.environment_state": seen}
                data.add_frame({"task": "grasp", "action": given, **both})
            data.save_episode()
    data.finalize()
    return seed - RECORDED


def main() -> int:
    """Record, train, judge."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="a new folder")
    parser.add_argument("--episodes", type=int, default=50)
    parser.add_argument("--steps", type=int, default=2000, help="gradient steps")
    options = parser.parse_args()
    torch.set_num_threads(1)
    made = make_env("HPAC-Grasp-v0", engine="mujoco", body="light")
    env = made.unwrapped
    tried = record(env, options.episodes, options.out / "data")
    print(f"recorded {options.episodes} of {tried} episodes", flush=True)
    words = [
        "--dataset.repo_id=hpac/learn",
        f"--dataset.root={options.out / 'data'}",
        *("--policy.type=act", "--policy.device=cpu", "--policy.push_to_hub=false"),
        *("--policy.dim_model=64", "--policy.n_heads=4", "--policy.dim_feedforward=256"),
        *("--policy.use_vae=false", "--policy.n_encoder_layers=2"),
        *("--policy.chunk_size=64", "--policy.n_action_steps=64", "--policy.optimizer_lr=1e-3"),
        *("--batch_size=32", "--num_workers=0", "--wandb.enable=false", "--seed=1"),
        *(f"--steps={options.steps}", f"--output_dir={options.out / 'train'}"),
    ]
    script = Path(sys.executable).with_name("lerobot-train")
    with (options.out / "train.log").open("w") as log:
        subprocess.run([script, *words], check=True, stdout=log, stderr=log)
    folder = options.out / "train/checkpoints/last/pretrained_model"
    for name, act in {"ACT": learned(folder), "the shipped policy": shipped()}.items():
        held = sum(episode(env, seed, act)[0] for seed in JUDGED)
        print(f"{name}: {held} of {len(JUDGED)}, {rate_text(held, len(JUDGED))}", flush=True)
    made.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
