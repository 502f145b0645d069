"""LeRobot's scripts, killed at random moments: are the hand's pulses off afterwards?

``python -m tests.kills --times 100`` kills each of four scripts 100 times. The hand is the firmware
in a process of its own, which survives the script; its log of pulses is the judge. A moment is drawn
evenly from the duration of an undisturbed run, a signal from `SIGNALS`. Each script runs in a fork of
one process that has imported LeRobot, so that no time goes into imports, in which nothing can happen.
"""

import argparse
import atexit
import json
import os
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Sequence
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.factory import make_pre_post_processors
from lerobot.scripts import lerobot_record, lerobot_replay, lerobot_rollout, lerobot_teleoperate
from lerobot.utils.constants import OBS_ENV_STATE, OBS_STATE
from lerobot_robot_hpac.features import ACTIONS, PREDICTED, EnvironmentStateStep

from hpac_gym.bridge import HostBoard

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT)
PATIENCE = 20.0
"""Time after a signal by which the script must have ended and the pulses be off [s]."""
SCRIPTS = {
    "teleoperate": lerobot_teleoperate,
    "record": lerobot_record,
    "replay": lerobot_replay,
    "rollout": lerobot_rollout,
}
TELEOP = (
    "--teleop.type=hpac_policy --teleop.policy=grasp --teleop.object=cylinder:0.02,0.05"
    " --teleop.pose=0.0485,0,0.12"
)
ARGUMENTS = {
    "teleoperate": f"{TELEOP} --fps=20 --teleop_time_s=4",
    "record": f"{TELEOP} --dataset.repo_id=test/hand --dataset.root={{out}}/episodes"
    " --dataset.push_to_hub=false --dataset.no_stamp=true --play_sounds=false --dataset.fps=20"
    " --dataset.episode_time_s=2 --dataset.reset_time_s=1 --dataset.num_episodes=2"
    " --dataset.single_task=grasp",
    "replay": "--dataset.repo_id=test/hand --dataset.root={data}/episodes --dataset.episode=0"
    " --play_sounds=false",
    "rollout": "--strategy.type=base --policy.path={data}/policy --fps=20 --duration=3"
    " --device=cpu",
}
"""Of each script, with a data set and a policy in the folder `data`."""


def words(script: str, port: str, data: Path, out: Path) -> list[str]:
    """The arguments of a script."""
    told = f"--robot.type=hpac --robot.port={{port}} --robot.id=test {ARGUMENTS[script]}"
    return [word.format(port=port, data=data, out=out) for word in told.split()]


def untrained_policy(folder: Path) -> None:
    """A small ACT with random weights, which sees all numbers of the robot."""
    size = len(ACTIONS) + len(PREDICTED)
    config = ACTConfig(
        device="cpu",
        push_to_hub=False,
        dim_model=32,
        n_heads=2,
        dim_feedforward=32,
        chunk_size=8,
        n_action_steps=8,
        input_features={
            OBS_STATE: PolicyFeature(FeatureType.STATE, (size,)),
            OBS_ENV_STATE: PolicyFeature(FeatureType.ENV, (size,)),
        },
        output_features={"action": PolicyFeature(FeatureType.ACTION, (len(ACTIONS),))},
    )
    config.normalization_mapping = {}
    ACTPolicy(config).save_pretrained(folder)
    before, after = make_pre_post_processors(config)
    before.steps = [EnvironmentStateStep(), *before.steps]
    for processor in (before, after):
        processor.save_pretrained(folder)


def start(script: str, arguments: Sequence[str], log: Path) -> int:
    """Run a script in a fork of this process; returns its process id."""
    if child := os.fork():
        return child
    try:
        os.setsid()
        with log.open("wb") as file:
            for number in (1, 2):
                os.dup2(file.fileno(), number)
        os.close(0)
        sys.argv = [f"lerobot-{script}", *arguments]
        SCRIPTS[script].main()
    except SystemExit as ended:
        os.environ["CODE"] = str(ended.code or 0)
    except BaseException:
        sys.excepthook(*sys.exc_info())
        os.environ["CODE"] = "1"
    finally:  # what an interpreter does at its end, but for the frames of this one
        threading._shutdown()
        atexit._run_exitfuncs()
        sys.stdout.flush()
        os._exit(int(os.environ.get("CODE", 0)))


def has_ended(process: int) -> bool:
    """Whether a child has ended."""
    return os.waitpid(process, os.WNOHANG)[0] != 0


def undisturbed(script: str, data: Path, out: Path) -> float:
    """Duration of a run that nobody ends [s]."""
    with HostBoard() as board:
        began = time.monotonic()
        process = start(script, words(script, board.port, data, out), out / "log.txt")
        _, status = os.waitpid(process, 0)
        lasted = time.monotonic() - began
        if status or board.pulses().any():
            raise RuntimeError(f"{script} failed: {(out / 'log.txt').read_text()[-3000:]}")
    return lasted


def trial(seed: int, script: str, data: Path, out: Path, lasts: float) -> dict[str, object]:
    """Kill a script once.

    Returns:
        What was done; whether there were pulses at the signal; whether in the end there were none
        and the script had ended; and how long after the signal the last pulses were seen [s].
    """
    rng = np.random.default_rng([list(SCRIPTS).index(script), seed])
    number = SIGNALS[seed % len(SIGNALS)]
    moment = float(rng.uniform(0.0, lasts))
    folder = out / f"{script}-{seed}"
    folder.mkdir(parents=True)
    with HostBoard() as board:
        process = start(script, words(script, board.port, data, folder), folder / "log.txt")
        time.sleep(moment)
        powered = bool(board.pulses().any())
        ended = has_ended(process)
        before = ended
        if not ended:
            os.kill(process, number)
        at = time.monotonic()
        last = 0.0
        while (since := time.monotonic() - at) < PATIENCE:
            on = bool(board.pulses().any())
            last = since if on else last
            ended = ended or has_ended(process)
            if ended and not on and since - last > 0.5:
                break
            time.sleep(0.02)
        if not ended:
            os.kill(process, signal.SIGKILL)
            os.waitpid(process, 0)
        return {
            "script": script,
            "seed": seed,
            "signal": signal.Signals(number).name,
            "moment": moment,
            "powered": powered,
            "before": before,
            "off": ended and not on,
            "last": last,
        }


def main(arguments: Sequence[str] | None = None) -> int:
    """Kill the scripts, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--times", type=int, default=100, help="kills of each script")
    parser.add_argument("--lanes", type=int, default=6, help="hands at once")
    parser.add_argument("--script", choices=SCRIPTS, action="append", help="only this one")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("runs/kills"),
        help="a new folder, or that of earlier runs of other scripts",
    )
    options = parser.parse_args(arguments)
    if not options.out.exists():
        options.out.mkdir(parents=True)
        untrained_policy(options.out / "policy")
        undisturbed("record", options.out, options.out)
    print("script       killed  with pulses  off  longest [s]  signals", flush=True)
    good = True
    for script in options.script or SCRIPTS:
        (options.out / script).mkdir()
        lasts = undisturbed(script, options.out, options.out / script)
        given = [(seed, script, options.out, options.out, lasts) for seed in range(options.times)]
        with get_context("fork").Pool(options.lanes) as pool:
            tried = pool.starmap(trial, given, chunksize=1)
        (options.out / f"{script}.jsonl").write_text("\n".join(map(json.dumps, tried)) + "\n")
        rows = [row for row in tried if not row["before"]]
        off = sum(row["off"] for row in rows)
        signals = dict(Counter(row["signal"] for row in rows))
        powered = sum(row["powered"] for row in rows)
        longest = max(row["last"] for row in rows)
        print(
            f"{script:<12} {len(rows):6} {powered:12} {off:4} {longest:12.2f}  {signals}",
            flush=True,
        )
        good &= off == len(rows)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
