"""Random programs of users against the firmware in real time: however one ends, its hand has no
pulses, or the program said so, and its port is free.

A program is drawn from ways to open a link, to drive the hand and to end; signals come from outside
at a random moment. Each runs with a board of its own. `os._exit` and SIGKILL are left out: no
program can release a hand then, and the watchdog is there for it. They are the negative control."""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from textwrap import indent

import numpy as np
from tqdm import tqdm

from hpac_gym.bridge.errors import PortError
from hpac_gym.bridge.hands import HostBoard
from hpac_gym.bridge.transport import SerialTransport
from hpac_gym.command import run_module, whole_number

SETTLED = 0.5
"""Time after a program's end at which its hand is looked at [s]."""
PATIENCE = 30.0
"""Time in which a program must have ended after its signal [s]."""
SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")

_HEAD = """
import asyncio, code, gc, multiprocessing, os, signal, sys, threading, time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from hpac_gym.bridge import Action, HandLink
from hpac_gym.model import HPAC, ServoCommand

PORT = sys.argv[1]

def drive(link):
    link.arm(action=Action.{action}, watchdog={watchdog})
    print("armed", flush=True)
    link.move(ServoCommand(0.6 * HPAC.servo_max, 0.8))
    {work}

def main():
{main}

if __name__ == "__main__":
    {end}
"""

WORKS = (
    "link.sleep({seconds})",
    "link.wait()",
    "time.sleep({seconds})",
    "[link.status() for _ in range(40)]",
    "sum(i * i for i in range(2_000_000)); link.sleep({seconds})",
    "raise ValueError('a mistake of the user')",
    "sys.exit(3)",
    "raise KeyboardInterrupt",
)
"""What a program does with its armed hand."""

MAINS = {
    "with": """
with HandLink(PORT) as link:
    drive(link)
""",
    "finally": """
link = HandLink(PORT)
link.connect()
try:
    drive(link)
finally:
    link.close()
""",
    "forgotten": """
global link
link = HandLink(PORT)
link.connect()
drive(link)
""",
    "collected": """
link = HandLink(PORT)
link.connect()
drive(link)
del link
gc.collect()
""",
    "exit stack": """
with ExitStack() as stack:
    link = stack.enter_context(HandLink(PORT))
    drive(link)
""",
    "worker thread": """
def work():
    with HandLink(PORT) as link:
        drive(link)
thread = threading.Thread(target=work)
thread.start()
thread.join()
""",
    "daemon thread": """
def work():
    with HandLink(PORT) as link:
        drive(link)
thread = threading.Thread(target=work, daemon=True)
thread.start()
thread.join(2.0)
""",
    "thread uses main's link": """
with HandLink(PORT) as link:
    thread = threading.Thread(target=drive, args=(link,))
    thread.start()
    time.sleep(0.9)
    {stop}
thread.join()
""",
    "executor": """
def work():
    with HandLink(PORT) as link:
        drive(link)
with ThreadPoolExecutor(1) as pool:
    pool.submit(work).result()
""",
    "asyncio, blocking": """
async def work():
    with HandLink(PORT) as link:
        drive(link)
asyncio.run(work())
""",
    "asyncio, in a thread": """
async def work():
    with HandLink(PORT) as link:
        await asyncio.to_thread(drive, link)
asyncio.run(work())
""",
    "asyncio, cancelled": """
async def work():
    with HandLink(PORT) as link:
        drive(link)
        while True:
            link.heartbeat()
            await asyncio.sleep(0.05)
async def both():
    task = asyncio.create_task(work())
    await asyncio.sleep(1.5)
    task.cancel()
    await task
asyncio.run(both())
""",
    "generator, closed": """
def hand():
    with HandLink(PORT) as link:
        drive(link)
        while True:
            yield link.status()
steps = hand()
for _ in range(5):
    next(steps)
steps.close()
""",
    "generator, forgotten": """
def hand():
    with HandLink(PORT) as link:
        drive(link)
        while True:
            yield link.status()
global steps
steps = hand()
for _ in range(5):
    next(steps)
""",
    "context manager of the user": """
@contextmanager
def hand():
    link = HandLink(PORT)
    link.connect()
    try:
        yield link
    finally:
        link.close()
with hand() as link:
    drive(link)
""",
    "fork, child ends": """
with HandLink(PORT) as link:
    drive(link)
    if os.fork() == 0:
        sys.exit(0)
    os.wait()
    link.heartbeat()
""",
    "fork, child opens": """
child = os.fork()
if child == 0:
    with HandLink(PORT) as link:
        drive(link)
    sys.exit(0)
os.waitpid(child, 0)
""",
    "multiprocessing, child opens": """
def work():
    with HandLink(PORT) as link:
        drive(link)
child = multiprocessing.get_context("fork").Process(target=work)
child.start()
child.join()
""",
    "multiprocessing, global link": """
def work():
    global link
    link = HandLink(PORT)
    link.connect()
    drive(link)
child = multiprocessing.get_context("fork").Process(target=work)
child.start()
child.join()
""",
    "notebook": """
console = code.InteractiveInterpreter(globals())
for cell in (
    "link = HandLink(PORT)",
    "link.connect()",
    "drive(link)",
    "link.status()",
    "{stop}",
):
    console.runsource(cell)
""",
    "own signal handler": """
signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
with HandLink(PORT) as link:
    drive(link)
""",
    "swallows errors": """
try:
    with HandLink(PORT) as link:
        drive(link)
except BaseException as error:
    print(type(error).__name__)
""",
}
"""How a program opens a link, by name."""

STOPS = ("pass", "link.estop()", "link.close()", "sys.exit(1)")
CONTROL = """
link = HandLink(PORT)
link.connect()
drive(link)
os._exit(0)
"""
"""A program that must be found out."""


@dataclass(frozen=True, slots=True)
class Program:
    """One program and the signal that it gets from outside."""

    kind: str
    text: str
    signals: tuple[str, ...]
    """Signals in their order; none for a program that is left alone."""
    delay: float
    """Time of the first one after the program says that it is armed, the others 0.1 s apart [s]."""
    to_group: bool
    """Whether children get them too, as from a terminal."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """What was left of a program."""

    program: Program
    left: str
    """`""` for nothing; else `on` (pulses, and not told), `locked` (port) or `running`."""
    told: bool
    """Whether the program said that the hand may still have pulses."""
    output: str


def drawn(rng: np.random.Generator, control: bool = False) -> Program:
    """Draw one program."""
    kind = "control" if control else str(rng.choice(list(MAINS)))
    main = CONTROL if control else MAINS[kind]
    seconds = f"{rng.uniform(0.1, 1.5):.2f}"
    work = "link.wait()" if control else str(rng.choice(WORKS)).format(seconds=seconds)
    text = _HEAD.format(
        action="hold" if control else rng.choice(["hold", "relax", "detach"]),
        watchdog=rng.choice([0.4, 2.0]),
        work=work,
        main=indent(main.strip("\n").replace("{stop}", str(rng.choice(STOPS))), "    "),
        end="main()",
    )
    count = 0 if control else int(rng.choice([0, 1, 1, 2]))
    return Program(
        kind,
        text,
        tuple(rng.choice(SIGNALS, count).tolist()),
        float(rng.uniform(-0.5, 1.5)),
        bool(rng.random() < 0.5),
    )


def judged(program: Program) -> Verdict:
    """Run one program to its end and look at its hand and port."""
    with HostBoard() as board:
        process = subprocess.Popen(
            [sys.executable, "-c", program.text, board.port],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        )
        said = _signalled(process, program, board)
        try:
            said += process.communicate(timeout=PATIENCE)[0]
            _wait_for_group(process.pid)
        except (subprocess.TimeoutExpired, TimeoutError):
            os.killpg(process.pid, signal.SIGKILL)
            return Verdict(program, "running", False, said + process.communicate()[0])
        time.sleep(SETTLED)
        told = "UnconfirmedWarning" in said
        left = "on" if board.pulses().any() and not told else ""
        try:
            SerialTransport(board.port).close()
        except PortError:
            left = "locked"
        return Verdict(program, left, told, said)


def _signalled(process: subprocess.Popen, program: Program, board: HostBoard) -> str:
    """Send the program its signals; returns what it said so far."""
    if not program.signals:
        return ""
    deadline = time.monotonic() + PATIENCE
    while process.poll() is None and time.monotonic() < deadline and not board.pulses().any():
        time.sleep(0.01)
    time.sleep(max(program.delay, 0.0))
    for name in program.signals:
        try:
            send = os.killpg if program.to_group else os.kill
            send(process.pid, getattr(signal, name))
        except ProcessLookupError:
            break
        time.sleep(0.1)
    return ""


def _wait_for_group(group: int) -> None:
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return
        time.sleep(0.02)
    raise TimeoutError


def run_programs(
    count: int, seed: int, workers: int = 2, control: bool = False
) -> Sequence[Verdict]:
    """Judge `count` programs drawn from a seed."""
    programs = [drawn(np.random.default_rng([seed, place]), control) for place in range(count)]
    with ThreadPoolExecutor(workers) as pool:
        bar = tqdm(total=count, desc="programs", unit="program", disable=not sys.stderr.isatty())
        verdicts = []
        for verdict in pool.map(judged, programs):
            verdicts.append(verdict)
            bar.update()
        bar.close()
    return verdicts


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    parser.add_argument("--count", type=whole_number(1), default=300, help="number of programs")
    parser.add_argument("--seed", type=whole_number(0), default=0)
    parser.add_argument("--workers", type=whole_number(1), default=2, help="programs at a time")
    parser.add_argument("--control", action="store_true", help="programs that leave a hand on")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Run programs, print what was left; the status is 1 if anything was."""
    verdicts = run_programs(arguments.count, arguments.seed, arguments.workers, arguments.control)
    bad = [verdict for verdict in verdicts if verdict.left]
    for verdict in bad:
        program = verdict.program
        print(
            f"--- {verdict.left}: {program.kind}, {program.signals}, {program.delay:.3f} s, "
            f"group {program.to_group}\n{program.text}\n--- it said\n{verdict.output}"
        )
    kinds = Counter(verdict.program.kind for verdict in verdicts)
    left = Counter(verdict.left for verdict in bad)
    print(
        f"{len(verdicts)} programs of {len(kinds)} kinds, "
        f"{sum(bool(verdict.program.signals) for verdict in verdicts)} with signals: "
        f"left on {left['on']}, port locked {left['locked']}, still running {left['running']}, "
        f"told {sum(verdict.told for verdict in verdicts)}"
    )
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(run_module("tools.evidence.user_programs", __doc__, add_arguments))
