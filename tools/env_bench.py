"""``python -m tools.env_bench``: the speed of the environments on both engines, compared with
environments of other libraries.

All figures are for a hand that holds a can, at 20 commands per second. A rate is per second of CPU
time, which reduces the effect of other load on the machine, and is the median over rounds in which
all environments take turns. What needs wall-clock time (two threads, two processes of arithmetic)
is the ratio of the best rounds, and a reset the least of five medians: other load only slows. The
other libraries need another MuJoCo version: the command creates a separate virtual environment for
them."""

import json
import os
import statistics
import subprocess
import sys
import venv
from collections import defaultdict
from collections.abc import Sequence
from contextlib import ExitStack
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from hpac_gym.command import command_parser, run, whole_number
from hpac_gym.errors import HpacError
from hpac_gym.output import markdown
from hpac_gym.physics.simulation import ENGINES

WORKER = Path(__file__).with_name("env_bench_worker.py")
NUM_ENVS = (1, 16, 64)
STEPS = 40
"""Steps per round of a single environment, as many as an episode of the grasp task has once the hand
has closed; n environments take STEPS / n each, at least 4.
"""
RESETS = 100
"""Resets of a single environment in each of `env_bench_worker.BLOCKS` blocks; n environments take
RESETS / n each, at least 6.
"""
PEERS = {"HandManipulateBlock-v1": "gymnasium_robotics", "PandaPickAndPlace-v3": "panda_gym"}
"""Ids of a MuJoCo hand and a PyBullet arm, and the modules that register them."""
# Gymnasium-Robotics 1.4.2 fails with an AssertionError from MuJoCo 3.12 on: it does not support the
# new joint types.
PEER_PACKAGES = (
    "gymnasium-robotics==1.4.2",
    "mujoco==3.11.0",
    "panda-gym==3.0.7",
    "gymnasium==1.4.0",
    "numpy==2.4.6",
)
GOALS = {"pybullet": 1.3, "mujoco": 2.0}
"""Wanted ratio of a single environment's rate to that of the faster peer, by engine (chosen)."""

Report = dict[str, Any]


class BenchError(HpacError, RuntimeError):
    """A measurement could not be made."""


class Worker:
    """A process that times one environment."""

    def __init__(self, python: str, **make: Any) -> None:
        threads = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        self._process = subprocess.Popen(
            [python, "-P", str(WORKER)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env=os.environ | threads | {"PYTHONPATH": str(WORKER.parents[1])},
        )
        self.ask("make", **make)

    def send(self, call: str, **arguments: Any) -> None:
        """Start a call."""
        print(json.dumps({"call": call, **arguments}), file=self._process.stdin, flush=True)

    def answer(self) -> dict[str, float]:
        """Wait for the result of the call that was started.

        Raises:
            BenchError: The environment failed.
        """
        line = self._process.stdout.readline()
        answer = (
            json.loads(line)
            if line
            else {"error": f"its process ended with status {self._process.wait()}"}
        )
        if "error" in answer:
            raise BenchError(f"an environment of the benchmark failed: {answer['error']}")
        return answer

    def ask(self, call: str, **arguments: Any) -> dict[str, float]:
        """Send a call and wait for its result."""
        self.send(call, **arguments)
        return self.answer()

    def close(self) -> None:
        """End the process."""
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()


def peers_python() -> str:
    """Python of the peers' virtual environment, which is created if missing.

    Raises:
        BenchError: It cannot be created; the message contains the last line of pip's output.
    """
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    folder = cache / "hpac_gym" / f"bench-peers-{sys.version_info[0]}.{sys.version_info[1]}"
    python = folder / "bin" / "python"
    stamp = folder / "complete"
    wanted = "\n".join(PEER_PACKAGES)
    if not (stamp.exists() and stamp.read_text(encoding="utf-8") == wanted):
        print(f"creating the peers' virtual environment in {folder}", file=sys.stderr)
        venv.create(folder, with_pip=True, clear=True)
        quiet = ("--quiet", "--disable-pip-version-check", "--no-input")
        pip = [python, "-m", "pip", "install", *quiet, *PEER_PACKAGES]
        done = subprocess.run(pip, stderr=subprocess.PIPE, text=True, check=False)
        if done.returncode:
            last = (done.stderr.splitlines() or ["pip failed"])[-1]
            raise BenchError(f"the peers cannot be installed in {folder}: {last}")
        stamp.write_text(wanted, encoding="utf-8")
    return str(python)


def measure(
    engines: Sequence[str], num_envs: Sequence[int], peers: Sequence[str], rounds: int
) -> Report:
    """Time all environments, in rounds in which all take turns.

    Args:
        engines: installed engines to measure.
        num_envs: sizes of the vector environments; two threads are measured at the largest.
        peers: ids from `PEERS`.
        rounds: number of rounds.

    Raises:
        BenchError: An environment failed, or the peers cannot be installed.
    """
    with ExitStack() as stack:

        def worker(python: str = sys.executable, **make: Any) -> Worker:
            made = Worker(python, **make)
            stack.callback(made.close)
            return made

        most = max(num_envs)
        hands = {
            (e, n): worker(kind="hands", engine=e, num_envs=n, threads=1)
            for e in engines
            for n in num_envs
        }
        turns = [(key, each, max(STEPS // key[1], 4)) for key, each in hands.items()]
        if "mujoco" in engines:
            two = worker(kind="hands", engine="mujoco", num_envs=most, threads=2)
            turns.append(("two", two, max(STEPS // most, 4)))
        turns += [
            (name, worker(peers_python(), kind="peer", name=name, module=PEERS[name]), STEPS)
            for name in peers
        ]
        pair = [worker(kind="arithmetic") for _ in range(2)]
        turns.append(("alone", pair[0], STEPS))
        answers: dict[Any, list[dict[str, float]]] = defaultdict(list)
        for _ in range(rounds):
            for key, each, steps in turns:
                answers[key].append(each.ask("measure", steps=steps))
            for each in pair:
                each.send("measure", steps=STEPS)
            answers["pair"].append(
                {"per_second": sum(each.answer()["per_second"] for each in pair)}
            )
        resets = {
            key: each.ask("resets", count=max(RESETS // key[1], 6))["reset_ms"]
            for key, each in hands.items()
        }

    def median(key: Any, figure: str) -> float:
        return statistics.median(row[figure] for row in answers[key])

    def most_per_second(key: Any) -> float:
        return max(row["per_second"] for row in answers[key])

    return {
        "engines": {
            engine: {
                "env_steps_per_cpu_second": {
                    str(n): median((engine, n), "per_cpu_second") for n in num_envs
                },
                "outside_engine": {str(n): median((engine, n), "outside") for n in num_envs},
                "reset_ms": {str(n): resets[engine, n] for n in num_envs},
            }
            for engine in engines
        },
        "two_threads": most_per_second("two") / most_per_second(("mujoco", most))
        if "mujoco" in engines
        else None,
        "two_processes_of_arithmetic": most_per_second("pair") / most_per_second("alone"),
        "peers": {name: median(name, "per_cpu_second") for name in peers},
        "peers_control_hz": {name: median(name, "control_hz") for name in peers},
    }


def text_of(report: Report) -> str:
    """The report as a table, and what a second thread gains."""
    peers = report["peers"]

    def beside_peers(engine: str, n: str, rate: float) -> str:
        goal = f" (goal {GOALS[engine]:g})" if n == "1" else ""
        return f"× {rate / max(peers.values()):.2f}{goal}" if peers else ""

    rows = [
        (
            f"{name}, n = {n}",
            f"{rate:.0f}",
            f"{1 - answer['outside_engine'][n]:.0%}",
            f"{answer['reset_ms'][n]:.2f}",
            beside_peers(name, n, rate),
        )
        for name, answer in report["engines"].items()
        for n, rate in answer["env_steps_per_cpu_second"].items()
    ]
    for name, rate in peers.items():
        rows.append((f"{name}, {report['peers_control_hz'][name]:g} Hz", f"{rate:.0f}", "", "", ""))
    head = ("hand holding a can, one thread", "steps per second of CPU time", "engine's share")
    table = markdown((*head, "reset of a world [ms]", "of the faster peer"), rows)
    arithmetic = f"two processes of plain arithmetic × {report['two_processes_of_arithmetic']:.2f}"
    if report["two_threads"] is None:
        return f"{table}\n\n{arithmetic}"
    return f"{table}\n\ntwo threads over one, mujoco, × {report['two_threads']:.2f}; {arithmetic}"


def main(argv: list[str] | None = None) -> None:
    parser = command_parser("tools.env_bench", __doc__.partition("\n\n")[2])
    parser.add_argument(
        "--engine", choices=ENGINES, action="append", help="only this engine; may be repeated"
    )
    parser.add_argument(
        "--num-envs",
        type=whole_number(1),
        nargs="+",
        default=NUM_ENVS,
        metavar="N",
        help="sizes of the vector environments (default: 1 16 64)",
    )
    parser.add_argument(
        "--rounds", type=whole_number(1), default=9, metavar="N", help="number of rounds"
    )
    parser.add_argument(
        "--no-peers", action="store_true", help="without the other libraries (they need a download)"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    arguments = parser.parse_args(argv)
    installed = [engine for engine in ENGINES if find_spec(engine)]
    missing = [engine for engine in arguments.engine or [] if engine not in installed]
    if missing:
        raise BenchError(
            f"engine {missing[0]!r} is not installed, only {', '.join(installed) or 'none'}"
        )
    engines = [engine for engine in installed if engine in (arguments.engine or installed)]
    # panda-gym needs PyBullet, which has no wheels beyond CPython 3.11.
    peers = (
        []
        if arguments.no_peers
        else [name for name in PEERS if "panda" not in PEERS[name] or sys.version_info < (3, 12)]
    )
    report = measure(engines, arguments.num_envs, peers, arguments.rounds)
    print(json.dumps(report, indent=2) if arguments.json else text_of(report))


if __name__ == "__main__":
    sys.exit(run(main))
