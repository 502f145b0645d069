"""Random programs of users, as text: what they do with a hand, how they end, and which of them the
measures against a forgotten hand cannot see."""

from dataclasses import dataclass
from textwrap import indent

import numpy as np

SIGNALS = ("SIGINT", "SIGINT", "SIGTERM", "SIGHUP")
_HEAD = """
import asyncio, atexit, code, gc, multiprocessing, os, signal, sys, threading, time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, closing
signal.signal(signal.SIGINT, signal.default_int_handler)
from hpac_gym.bridge import Action, HandLink
from hpac_gym.model import HPAC, ServoCommand
{broken}
PORT = sys.argv[1]

def drive(link):
    link.arm(action=Action.{action}, watchdog={watchdog})
    print("armed", flush=True)
    link.move(ServoCommand(0.6 * HPAC.servo_max, 0.8))
    {work}

def session():
{session}

def main():
{main}

if __name__ == "__main__":
    main()
"""
WORKS = (
    "link.sleep({seconds})",
    "link.wait()",
    "time.sleep({seconds})",
    "[link.status() for _ in range(40)]",
    "stream = link.stream(); [stream.send(0.6 * HPAC.servo_max) for _ in range(20)]",
    "sum(i * i for i in range(2_000_000)); link.sleep({seconds})",
    "raise ValueError('a mistake of the user')",
    "sys.exit(3)",
    "raise KeyboardInterrupt",
    "link.estop()",
    "link.connect(); link.arm(); link.sleep({seconds})",
)
"""What a program does with its armed hand."""
UNSEEN = (
    "os._exit(0)",
    "os.kill(os.getpid(), signal.SIGKILL)",
    "os.execv(sys.executable, [sys.executable, '-c', 'pass'])",
)
"""Ends that no program can see coming."""
CLOSED = {
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
    "closing": """
with closing(HandLink(PORT)) as link:
    link.connect()
    drive(link)
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
}
"""Ways to open a link that release the hand on their way out, by name."""
KEPT = {
    "fork, child ends": """
with HandLink(PORT) as link:
    drive(link)
    if os.fork() == 0:
        sys.exit(0)
    os.wait()
    link.heartbeat()
""",
    "forgotten": """
global link
link = HandLink(PORT)
link.connect()
drive(link)
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
    "cells": """
cells = ("link = HandLink(PORT); link.connect()", "drive(link)", "link.heartbeat()", "{stop}")
for cell in cells:
    try:
        exec(cell, globals())
    except (KeyboardInterrupt, Exception) as error:
        print(repr(error))
""",
    "own signal handler": """
signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
with HandLink(PORT) as link:
    drive(link)
""",
}
"""Ways that release it at the end of the program or of another thread, or whose child must end."""
STOPS = ("pass", "link.estop()", "link.close()", "sys.exit(1)")
AROUND = {
    "alone": "session()",
    "thread": """
thread = threading.Thread(target=session)
thread.start()
thread.join()
""",
    "executor": """
with ThreadPoolExecutor(1) as pool:
    pool.submit(session).result()
""",
    "fork": """
child = os.fork()
if child == 0:
    session()
    sys.exit(0)
os.waitpid(child, 0)
""",
    "multiprocessing": """
child = multiprocessing.get_context("fork").Process(target=session)
child.start()
child.join()
""",
    "at exit": "atexit.register(session)",
}
"""What the link is opened in, by name."""
SURVIVES = """
try:
    session()
except BaseException as error:
    print(type(error).__name__)
gc.collect()
with HandLink(PORT) as again:
    print("again", again.state)
"""
"""A program that goes on, and needs its port again."""
CONTROLS = {
    "handlers": """
from hpac_gym.bridge import interrupts
for number in (signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, signal.SIG_DFL)
interrupts.interrupts.install = lambda: None
""",
    "release": """
from hpac_gym.bridge import connection
connection.last_words = lambda *_: ("", None)
""",
    "finalizer": """
import weakref
weakref.finalize = lambda *_: type("Never", (), {"detach": lambda self: None})()
""",
    "close": """
from hpac_gym.bridge.transport import SerialTransport
kept_open = []
SerialTransport.close = kept_open.append
""",
}
"""Parts of the ending, by name, and what takes each out."""


@dataclass(frozen=True, slots=True)
class Program:
    """One program and the signals that it gets from outside."""

    kind: str
    text: str
    unseen: bool
    """Whether it ends without a chance to release its hand."""
    signals: tuple[str, ...]
    """Signals in their order; none for a program that is left alone."""
    from_start: bool
    """Whether the first one comes after the program's start, else after the first pulse."""
    delays: tuple[float, ...]
    """Time before each signal [s]."""
    stopped: bool
    """Whether the program is stopped (Ctrl-Z) meanwhile, and then goes on."""
    to_group: bool
    """Whether children get them too, as from a terminal."""
    blas_threads: int


def drawn(rng: np.random.Generator, broken: str = "") -> Program:
    """Draw one program; `broken` takes out a part of the ending."""
    unseen = bool(rng.random() < 0.05)
    around = "survives" if rng.random() < 0.15 else str(rng.choice(list(AROUND)))
    ways = CLOSED if around == "survives" else CLOSED | KEPT
    way = str(rng.choice(list(ways)))
    if (
        around == "executor" and "os.fork" in ways[way]
    ):  # it keeps the child's exit as a result, and waits for ever
        around = "thread"
    seconds = f"{rng.uniform(0.1, 1.5):.2f}"
    stop = str(rng.choice(STOPS))
    main = SURVIVES if around == "survives" else AROUND[around]
    # A hold would keep the hand of an unseen end on for half a minute.
    text = _HEAD.format(
        broken=broken,
        action=rng.choice(["relax", "detach"] if unseen else ["hold", "relax", "detach"]),
        watchdog=rng.choice([0.4, 2.0]),
        work=rng.choice(UNSEEN if unseen else WORKS).format(seconds=seconds),
        session=indent(ways[way].strip("\n").replace("{stop}", stop), "    "),
        main=indent(main.strip("\n"), "    "),
    )
    signals = tuple(rng.choice(SIGNALS, rng.choice([0, 1, 1, 2, 3])).tolist())
    gaps = 10 ** rng.uniform(-3, 0.2, len(signals))
    return Program(
        f"{way}, {around}",
        text,
        unseen,
        signals,
        bool(rng.random() < 0.3),
        tuple(float(gap) for gap in np.round(gaps, 4)),
        bool(rng.random() < 0.2),
        bool(rng.random() < 0.5),
        int(rng.choice([1, 2])),
    )
