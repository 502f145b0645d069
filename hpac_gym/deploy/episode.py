"""One episode of a policy on a hand: gently in, one command a period, gently out, everything in a log.

Whatever happens, the hand opens slowly and is disarmed before anything else is done."""

import json
import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpac_gym.bridge import HandLink, StreamCounts
from hpac_gym.bridge.link import go, open_hand, release
from hpac_gym.deploy.arm import Arm
from hpac_gym.deploy.errors import PoseError
from hpac_gym.deploy.observer import Observer, Pose
from hpac_gym.deploy.poses import Source, averaged
from hpac_gym.model import SERVOS
from hpac_gym.model.checks import Array, as_finite_vector
from hpac_gym.output import Lines, OutputError, keep, writing
from hpac_gym.policies import Policy
from hpac_gym.policies.policy import ask
from hpac_gym.tasks.task import CONTROL_HZ

WATCHDOG = 0.5
"""Longest silence before the hand relaxes by itself [s]."""
AVERAGED = 0.5
"""Time over which the first pose is averaged [s]."""
OLDEST = 0.5
"""Greatest age of a pose while the hand closes [s]."""
LOG_VERSION = 1


class Log(Lines):
    """One JSON object a line.

    A log of that name, or its wire log, is kept under the next free number; who still writes to it
    goes on there.

    Args:
        path: the file; None keeps nothing.

    Raises:
        OutputError: The file cannot be written.
    """

    def __init__(self, path: Path | None) -> None:
        path = path or Path(os.devnull)
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            keep(path, wire_log)
        super().__init__(path, "a")

    @property
    def path(self) -> Path:
        """Where it is: a later log of its name has moved it."""
        given = Path(self._path)
        here = os.fstat(self._file.fileno())
        try:
            with os.scandir(given.parent) as files:
                mine = (given.with_name(file.name) for file in files if file.inode() == here.st_ino)
                return next(mine, given)
        except OSError:  # its folder has been moved, or may not be listed
            return given

    def write(self, **line: Any) -> None:
        """Write a line.

        Raises:
            OutputError: The disk is full.
        """
        self.append(
            json.dumps(line, default=lambda v: v.tolist() if isinstance(v, np.ndarray) else str(v))
        )


def wire_log(path: Path) -> Path:
    """Where the frames of the wire stand that belong to a log."""
    return path.parent / f"{path.name.removesuffix('.jsonl')}.wire.jsonl"


def run_episode(
    link: HandLink,
    observer: Observer,
    policy: Policy,
    source: Source,
    arm: Arm,
    log: Log,
    *,
    hold: float = 2.0,
    seconds: float = AVERAGED,
    oldest: float = OLDEST,
    live: Callable[[dict[str, Any]], None] = lambda _: None,
    note: Callable[[str], None] = lambda _: None,
) -> StreamCounts:
    """Run one episode on a connected hand; afterwards it is open and without pulses.

    Args:
        link: connected, not armed.
        observer: the task on this hand.
        policy: loaded for `observer`.
        source: poses of the object.
        arm: carries the hand.
        log: gets every step.
        hold: time for which the hand holds after the last step, before it opens [s].
        seconds: time over which the first pose is averaged [s].
        oldest: greatest age of a pose while the hand closes [s].
        live: called with every step's figures.
        note: called with what begins before and after the steps.

    Raises:
        PoseError: No pose, one that cannot be observed, or the object was lost while the hand closed.
        ShapeError, PolicyError: The policy gives no action. DeployError: the arm is not ready.
        OutputError: The log cannot be written.
        BridgeError: The hand refuses, is stopped, or does not answer.
        KeyboardInterrupt: Ctrl-C, after the hand has opened.
    """
    clock = source.clock = link.exchange.transport.now
    counts = StreamCounts()
    try:
        pose = observer.turned(averaged(source, seconds, oldest, pause=link.sleep))
        observer.expects(pose)
        observer.start()
        # It may take longer than the watchdog of an armed hand waits.
        observation, action, target, memory = decided(policy, observer, pose)
        link.arm(watchdog=WATCHDOG)
        note("to the start posture")
        go(link, np.asarray(observer.servo))
        stream = link.stream(1 / CONTROL_HZ)
        counts = stream.counts
        told: dict[str, Any] = {"phase": "ready", "time": 0.0, "offset": [0.0, 0.0, 0.0]}
        if observer.task.wrist_actions:
            told["wrist"] = wrist(action, observer)
        arm.ready(link.sleep, told)
        stream.begin()
        source.begin()
        begun = clock()
        closing = observer.phase()
        for step in range(observer.steps):
            stream.wait()
            phase = observer.phase()
            offset = observer.wrist_offset()
            latest, age = source.latest()
            if age > oldest and phase == closing:
                raise PoseError(
                    f"the object's pose is {age:.3g} s old, allowed {oldest:g} s: given up, the hand opens"
                )
            arm.tell({"phase": phase, "time": step / CONTROL_HZ, "offset": offset.tolist()})
            if step:  # the first is decided
                if age <= oldest:  # once the hand has closed, fingers and arm hide the object
                    pose = observer.turned(latest)
                observation, action, target, memory = decided(
                    policy, observer, pose, memory, begins=False
                )
            servo = stream.send(target)
            observer.sent(servo)
            figures = {"step": step, "t": clock() - begun, "phase": phase}
            log.write(
                **figures,
                position=pose.position,
                quaternion=pose.quaternion,
                observation=observation,
                action=action,
                target=target,
                sent=servo,
                hand=link.last_status.servo,
            )
            heat = float(link.last_status.heat.max())
            live(figures | {"pose": pose, "offset": offset, "heat": heat, "counts": counts})
        stream.wait()
        stream.close()
        note(f"holds for {hold:g} s")
        link.sleep(hold)
        note("opens")
        open_hand(link)
        log.write(end="done", **asdict(counts))
    except BaseException as error:
        release(link, error)
        with suppress(OutputError):
            log.write(end=f"{type(error).__name__}: {error}", **asdict(counts))
        raise
    link.clear()
    return counts


def decided(
    policy: Policy, observer: Observer, pose: Pose, memory: Any = None, begins: bool = True
) -> tuple[NDArray[np.float32], Array, Array, Any]:
    """What a policy observes and decides in a step.

    Args:
        policy: loaded for `observer`.
        observer: the task on this hand.
        pose: the object.
        memory: of the policy, from the step before.
        begins: whether it is the first step.

    Returns:
        The observation; the action, clipped to −1…1; servo angles for it, shape (6,) [rad]; and the
        policy's memory.

    Raises:
        ShapeError: The action has another shape, or something that is not a finite number.
    """
    observation = observer.see(pose)
    given, memory = ask(policy, observation, memory, np.array([begins]))
    (size,) = observer.action_space.shape
    action = np.clip(as_finite_vector(given, size, "the policy's action"), -1.0, 1.0)
    return observation, action, observer.command(action), memory


def wrist(action: Array, observer: Observer) -> dict[str, float]:
    """Where the first action of a policy that does so places the wrist, −1…1 by name."""
    return dict(zip(observer.task.wrist_actions, action[len(SERVOS) :].tolist(), strict=True))
