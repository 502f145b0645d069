"""PPO of Stable-Baselines3 on a batch of hands; the model and its statistics are a policy.

python sb3_ppo.py --out runs/sb3 --total-steps 2000000
hpac evaluate --policy runs/sb3/model.zip     # finds vecnormalize.pkl beside it
hpac show --policy runs/sb3/model.zip"""

import argparse
from pathlib import Path

from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

from hpac_gym.envs.sb3 import HandVecEnv

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--out", type=Path, default=Path("runs/sb3"))
parser.add_argument("--env", default="hpac_gym:HPAC-Grasp-v0")
parser.add_argument("--total-steps", type=int, default=2_000_000)
parser.add_argument("--num-envs", type=int, default=64)
parser.add_argument("--seed", type=int, default=0)
args = parser.parse_args()

envs = VecNormalize(HandVecEnv(args.env, num_envs=args.num_envs), gamma=0.97)
settings = {"gamma": 0.97, "n_steps": 16, "batch_size": 512, "device": "cpu", "seed": args.seed}
model = PPO("MlpPolicy", envs, verbose=1, **settings)
model.learn(args.total_steps)
args.out.mkdir(parents=True, exist_ok=True)
model.save(args.out / "model.zip")
envs.save(str(args.out / "vecnormalize.pkl"))
envs.close()
print(args.out / "model.zip")
