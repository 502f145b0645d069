"""``hpac replay``: the log of a deployment beside a simulation of the same actions, and where they part."""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hpac_gym.command import add_json, say
from hpac_gym.deploy.commands import object_of
from hpac_gym.deploy.episode import LOG_VERSION
from hpac_gym.deploy.errors import DeployError
from hpac_gym.deploy.observer import Observer
from hpac_gym.evaluation.environment import make_env
from hpac_gym.figures import new_figure, require, save
from hpac_gym.model import SERVOS
from hpac_gym.model.checks import Array
from hpac_gym.output import read_text

APART_M = 0.01
"""Distance from which on the object is told to be elsewhere than simulated [m]."""

_HEAD = {"policy", "env_id", "grasp", "object", "port"}
_STEP = {"t", "phase", "position", "quaternion", "action", "sent", "hand"}
"""What is read of a log's first line and of a step."""


@dataclass(frozen=True, slots=True)
class Course:
    """A deployment and its simulation, one row a step."""

    time: Array
    """Shape (n,) [s]."""
    sent: Array
    """Commands that the hand was sent, shape (n, 6) [rad]."""
    hand: Array
    """Angles that the hand last reported, shape (n, 6) [rad]."""
    seen: Array
    """Where the object was seen, in the hand's frame, shape (n, 3) [m]."""
    commanded: Array
    """Commands of the simulation, shape (n, 6) [rad]; NaN after its episode."""
    simulated: Array
    """Where the object is in the simulation, shape (n, 3) [m]; NaN after its episode."""
    outcome: str
    """How the simulation's episode ended."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hpac replay`."""
    parser.add_argument("log", type=Path, help="log of `hpac deploy`")
    parser.add_argument("--out", type=Path, metavar="PNG", help="a picture of both courses")
    parser.add_argument("--engine", default="mujoco", help="mujoco or pybullet (%(default)s)")
    parser.add_argument("--view", action="store_true", help="play it in the browser until Ctrl-C")
    add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Simulate the actions of a log, and tell where the two part."""
    if options.out:
        require(options.out)
    head, steps, end = read_log(options.log)
    needed = head.get("options", {})
    observer = Observer(head["env_id"], object_of(head["object"]), grasp=head["grasp"], **needed)
    course = simulated(observer, needed, steps, options.engine)
    apart = np.abs(course.sent - course.commanded)
    step, servo = np.unravel_index(int(np.nanargmax(apart)), apart.shape)
    distance = np.linalg.norm(course.seen - course.simulated, axis=1)
    beyond = np.flatnonzero(distance > APART_M)
    played = int(np.isfinite(distance).sum())
    early = f" after {played} steps, before the end of the log" if played < len(steps) else ""
    where = f"apart from {course.time[beyond[0]]:.2f} s on" if beyond.size else "together"
    text = f"""\
{head["policy"]} on {head["port"]}, {len(steps)} steps, ended: {end}
commands: at most {apart[step, servo]:.3f} rad from the simulation's, {SERVOS[servo]} at {course.time[step]:.2f} s
object: at most {1e3 * np.nanmax(distance):.0f} mm from the simulated one, {where}
the simulation: {course.outcome}{early}"""
    say(
        options.json,
        text,
        policy=head["policy"],
        port=head["port"],
        steps=len(steps),
        end=end,
        command_error_rad=float(apart[step, servo]),
        object_error_m=float(np.nanmax(distance)),
        apart_from_s=float(course.time[beyond[0]]) if beyond.size else None,
        simulation=course.outcome,
        simulated_steps=played,
    )
    if options.out:
        save(figure_of(course), options.out)
        say(options.json, f"written: {options.out}", written=str(options.out))
    if options.view:
        from hpac_gym.deploy.watching import show_log

        show_log(observer.setup, steps)
    return 0


def read_log(path: Path) -> tuple[dict[str, Any], list[dict[str, Any]], str]:
    """First line, steps and end of a log; a last line that was cut short is left out.

    Raises:
        DeployError: It cannot be read, or is no log of a deployment.
    """
    lines = read_text(path, "log", DeployError).splitlines()
    rows: list[dict[str, Any]] = []
    for number, line in enumerate(lines, 1):
        try:
            row = json.loads(line)
        except ValueError:
            if number == len(lines):
                break
            row = None
        if not isinstance(row, dict):
            raise DeployError(f"log {path}, line {number}: no JSON object")
        rows.append(row)
    if not rows or rows[0].get("hpac_deploy") != LOG_VERSION:
        raise DeployError(
            f"log {path}: line 1 must be that of `hpac deploy`, version {LOG_VERSION}"
        )
    for number, row in enumerate(rows, 1):
        needed = _HEAD if number == 1 else _STEP if "step" in row else set()
        if missing := needed - row.keys():
            raise DeployError(f"log {path}, line {number}: without {', '.join(sorted(missing))}")
    steps = [row for row in rows[1:] if "step" in row]
    if not steps:
        raise DeployError(f"log {path}: it has no steps")
    end = next((row["end"] for row in rows[1:] if "end" in row), "cut short")
    return rows[0], steps, end


def simulated(
    observer: Observer, options: dict[str, Any], steps: list[dict[str, Any]], engine: str
) -> Course:
    """The same actions on a simulated hand, whose object stands where it was seen first; `options`
    are of the environment.
    """
    place = np.array(steps[0]["position"])
    setup = replace(observer.setup, position=place)
    time, sent, hand, seen = (
        np.array([row[name] for row in steps]) for name in ("t", "sent", "hand", "position")
    )
    commanded = np.full(sent.shape, np.nan)
    positions = np.full(seen.shape, np.nan)
    with make_env(observer.spec.id, engine=engine, **options) as env:
        env.reset(seed=0, options={"setup": setup})
        bare = env.unwrapped
        for i, row in enumerate(steps):
            positions[i] = bare.state.object_pos[0]
            _, _, over, _, info = env.step(np.array(row["action"], dtype=np.float32))
            commanded[i] = bare.command.servo
            if over:
                break
    return Course(time, sent, hand, seen, commanded, positions, info["outcome"])


def figure_of(course: Course) -> Any:
    """Commands above, the object below; the simulation is dashed."""
    figure = new_figure(9, 6)
    upper, lower = figure.subplots(2, 1, sharex=True)
    for i, name in enumerate(SERVOS):
        (line,) = upper.plot(course.time, course.sent[:, i], label=name)
        upper.plot(course.time, course.commanded[:, i], "--", color=line.get_color())
    for i, axis in enumerate("xyz"):
        (line,) = lower.plot(course.time, 1e3 * course.seen[:, i], label=f"{axis}, seen")
        lower.plot(course.time, 1e3 * course.simulated[:, i], "--", color=line.get_color())
    upper.set_ylabel("command [rad], simulated dashed")
    lower.set_ylabel("object in the hand's frame [mm]")
    lower.set_xlabel("time [s]")
    for axes in (upper, lower):
        axes.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure
