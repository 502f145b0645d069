"""Random programs of users against the firmware in real time: however one ends, its hand has no
pulses, or the program said so, and its port is free.

A program is drawn from ways to open a link, surroundings that it is opened in, ways to drive the
hand and to end; signals come from outside at random moments, some while the program is stopped
(Ctrl-Z). Each runs with a board of its own. A program that ends without a chance to release its
hand (`os._exit`, SIGKILL, `exec`) is what the watchdog is for: it is counted apart, and its hand must
be off once the watchdog and the safe action have run.

`--control` runs the same programs with one part of the bridge's ending taken out, and must find
some that leave something."""

import os
import signal
import subprocess
import sys
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from tqdm import tqdm

from hpac_gym.bridge import HostBoard, PortError, SerialTransport
from hpac_gym.command import add_counts, command_parser, run
from tools.evidence.programs import CONTROLS, Program, drawn

SETTLED = 0.5
"""Time after a program's end at which its hand is looked at [s]."""
WATCHDOG_TIME = 2.0 + 3.2 + SETTLED
"""The same after an end that is left to the watchdog: its longest period, and a relax [s]."""
PATIENCE = 30.0
"""Time in which a program must have ended after its last signal [s]."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """What was left of a program."""

    program: Program
    left: str
    """`""` for nothing; else `on` (pulses, and not told), `locked` (port) or `running`."""
    told: bool
    """Whether the program said that the hand may still have pulses."""
    output: str

    def __str__(self) -> str:
        program = self.program
        return (
            f"--- {self.left or 'nothing left'}: {program.kind}, {program.signals} after {program.delays} s from "
            f"{'the start' if program.from_start else 'the first pulse'}, stopped {program.stopped}, group {program.to_group}, "
            f"{program.blas_threads} BLAS threads\n{program.text}\n--- it said\n{self.output}"
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
            env=os.environ | {"OPENBLAS_NUM_THREADS": str(program.blas_threads)},
        )
        try:
            _signal(process, program, board)
            said = process.communicate(timeout=PATIENCE)[0]
            _wait_for_group(process.pid)
        except (subprocess.TimeoutExpired, TimeoutError):
            os.killpg(process.pid, signal.SIGKILL)
            return Verdict(program, "running", False, process.communicate()[0])
        told = "UnconfirmedWarning" in said
        time.sleep(WATCHDOG_TIME if program.unseen else SETTLED)
        left = "on" if board.pulses().any() and not told else ""
        try:
            SerialTransport(board.port).close()
        except PortError:
            left = "locked"
        if "is used by another program" in said:
            left = "locked"
        return Verdict(program, left, told, said)


def _signal(process: subprocess.Popen[str], program: Program, board: HostBoard) -> None:
    """Send a program its signals."""
    deadline = time.monotonic() + PATIENCE
    while program.signals and not program.from_start and not board.pulses().any():
        if process.poll() is not None or time.monotonic() > deadline:
            return
        time.sleep(0.005)
    send = os.killpg if program.to_group else os.kill
    try:
        if program.stopped:
            send(process.pid, signal.SIGSTOP)
        for name, delay in zip(program.signals, program.delays, strict=True):
            time.sleep(delay)
            send(process.pid, getattr(signal, name))
        if program.stopped:
            send(process.pid, signal.SIGCONT)
    except ProcessLookupError:
        return


def _wait_for_group(group: int) -> None:
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return
        time.sleep(0.02)
    raise TimeoutError


def run_programs(count: int, seed: int, workers: int = 2, control: str = "") -> list[Verdict]:
    """Judge `count` programs drawn from a seed; `control` names a part of `CONTROLS` to take out."""
    broken = CONTROLS.get(control, "")
    programs = [drawn(np.random.default_rng([seed, place]), broken) for place in range(count)]
    with ThreadPoolExecutor(workers) as pool:
        verdicts = pool.map(judged, programs)
        return list(tqdm(verdicts, "programs", count, disable=not sys.stderr.isatty()))


def summary(verdicts: list[Verdict]) -> str:
    """One line: how many programs of what kinds, and what they left."""
    left = Counter(verdict.left for verdict in verdicts)
    unseen = [verdict for verdict in verdicts if verdict.program.unseen]
    return (
        f"{len(verdicts)} programs of {len({verdict.program.kind for verdict in verdicts})} kinds, "
        f"{sum(bool(verdict.program.signals) for verdict in verdicts)} with signals, "
        f"{len(unseen)} that are left to the watchdog: "
        f"left on {left['on']}, port locked {left['locked']}, still running {left['running']}, "
        f"told {sum(verdict.told for verdict in verdicts)}"
    )


def main(argv: list[str] | None = None) -> int:
    """Run programs, print what was left; the status is 1 if anything was."""
    parser = command_parser("tools.evidence.user_programs", __doc__)
    add_counts(
        parser,
        count=(1, 300, "number of programs"),
        seed=(0, 0, "of the programs"),
        workers=(1, 4, "programs at a time"),
    )
    parser.add_argument("--control", choices=CONTROLS, default="", help="part to take out")
    arguments = parser.parse_args(argv)
    verdicts = run_programs(arguments.count, arguments.seed, arguments.workers, arguments.control)
    bad = [verdict for verdict in verdicts if verdict.left]
    print(*bad, summary(verdicts), sep="\n")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(run(main))
