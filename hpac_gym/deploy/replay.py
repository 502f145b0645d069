"""``hpac replay``: the log of a deployment beside a simulation of the same actions, and where they part."""

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from hpac_gym.command import add_json, say
from hpac_gym.deploy.commands import object_of
from hpac_gym.deploy.episode import LOG_VERSION
from hpac_gym.deploy.errors import DeployError
from hpac_gym.deploy.observer import Observer
from hpac_gym.errors import HpacError
from hpac_gym.evaluation.environment import make_env
from hpac_gym.figures import new_figure, require, save
from hpac_gym.model import HPAC, SERVOS
from hpac_gym.model.checks import Array, as_finite_vector, as_unit_vector
from hpac_gym.model.files import hand_from_toml
from hpac_gym.output import read_text

APART_M = 0.01
"""Distance from which on the object is told to be elsewhere than simulated [m]."""

_HEAD = {"policy", "env_id", "grasp", "object", "port"}
_SIZES = {"position": 3, "sent": len(SERVOS), "hand": len(SERVOS)}
_STEP = {"t", "phase", "action", "quaternion", *_SIZES}
"""What is read of a log's first line and of a step."""


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
    hand = hand_from_toml(head["model"], f"{options.log}") if head.get("model") else HPAC
    thing = object_of(head["object"])
    observer = Observer(head["env_id"], thing, hand, head["grasp"], **needed)
    commanded, simulated, outcome = simulation(observer, needed, steps, options.engine)
    time, sent, seen = (
        np.array([row[name] for row in steps]) for name in ("t", "sent", "position")
    )
    apart = np.abs(sent - commanded)
    step, servo = np.unravel_index(int(np.nanargmax(apart)), apart.shape)
    distance = np.linalg.norm(seen - simulated, axis=1)
    beyond = time[distance > APART_M].tolist()
    played = int(np.isfinite(distance).sum())
    early = f" after {played} steps, before the end of the log" if played < len(steps) else ""
    where = f"parted at {beyond[0]:.2f} s" if beyond else "together"
    text = f"""\
{head["policy"]} on {head["port"]}, {len(steps)} steps, ended: {end}
commands: at most {apart[step, servo]:.3f} rad from the simulation's, {SERVOS[servo]} at {time[step]:.2f} s
object: at most {1e3 * np.nanmax(distance):.0f} mm from the simulated one, {where}
the simulation: {outcome}{early}"""
    say(
        options.json,
        text,
        policy=head["policy"],
        port=head["port"],
        steps=len(steps),
        end=end,
        command_error_rad=float(apart[step, servo]),
        object_error_m=float(np.nanmax(distance)),
        apart_from_s=beyond[0] if beyond else None,
        simulation=outcome,
        simulated_steps=played,
    )
    if options.out:
        save(figure_of(time, sent, commanded, seen, simulated), options.out)
        say(options.json, f"written: {options.out}", written=str(options.out))
    if options.view:
        from hpac_gym.deploy.watching import show_log

        show_log(observer.setup, steps, hand)
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
        if number == 1 and row.get("hpac_deploy") != LOG_VERSION:
            raise DeployError(
                f"log {path}: line 1 must be that of `hpac deploy`, version {LOG_VERSION}"
            )
        needed = _HEAD if number == 1 else _STEP if "step" in row else set()
        if missing := needed - row.keys():
            raise DeployError(f"log {path}, line {number}: without {', '.join(sorted(missing))}")
        try:
            _require_values(row)
        except HpacError as error:
            raise DeployError(f"log {path}, line {number}: {error}") from None
        rows.append(row)
    steps = [row for row in rows[1:] if "step" in row]
    if not steps:
        raise DeployError(f"log {path}: it has no steps")
    end = next((row["end"] for row in rows[1:] if "end" in row), "cut short")
    return rows[0], steps, end


def _require_values(row: dict[str, Any]) -> None:
    """Refuse a first line or a step with values of other kinds."""
    if "hpac_deploy" in row:
        for name, kind in (("env_id", str), ("object", str | dict), ("model", str | None)):
            if not isinstance(value := row.get(name), kind):
                raise DeployError(f"{name} {value!r} is no text")
        if not isinstance(options := row.get("options", {}), dict):
            raise DeployError(f"options {options!r} are not those of an environment")
    elif "step" in row:
        as_finite_vector([row["t"]], 1, "t")
        action = row["action"]
        as_finite_vector(action, len(action) if isinstance(action, list) else 1, "action")
        for name, size in _SIZES.items():
            as_finite_vector(row[name], size, name)
        as_unit_vector(row["quaternion"], 4, "quaternion")


def simulation(
    observer: Observer, options: dict[str, Any], steps: list[dict[str, Any]], engine: str
) -> tuple[Array, Array, str]:
    """The same actions on a simulated hand, whose object stands where it was seen first; `options`
    are of the environment.

    Returns:
        Commands, shape (n, 6) [rad]; where the object is, shape (n, 3) [m], both NaN after the end
        of the episode; and its outcome.
    """
    seen = Rotation.from_quat(steps[0]["quaternion"])
    seen = Rotation.from_quat(observer.setup.hand_quaternion) * seen
    setup = replace(
        observer.setup,
        position=np.array(steps[0]["position"]),
        yaw=0.0,
        object_quaternion=tuple(seen.as_quat().tolist()),
    )
    commanded = np.full((len(steps), len(SERVOS)), np.nan)
    positions = np.full((len(steps), 3), np.nan)
    with make_env(observer.spec.id, engine=engine, model=observer.model, **options) as env:
        bare = env.unwrapped  # whose own `reset` would refuse an object that was seen in the hand
        bare.episodes.reset([0], [np.random.default_rng(0)], [setup])
        for i, row in enumerate(steps):
            positions[i] = bare.state.object_pos[0]
            _, _, over, _, info = bare.step(np.array(row["action"], dtype=np.float32))
            commanded[i] = bare.command.servo
            if over:
                break
    return commanded, positions, info["outcome"]


def figure_of(time: Array, sent: Array, commanded: Array, seen: Array, simulated: Array) -> Any:
    """Commands above, the object below; the simulation is dashed.

    Args:
        time: of every step, shape (n,) [s].
        sent: commands of the hand, shape (n, 6) [rad].
        commanded: commands of the simulation, shape (n, 6) [rad].
        seen: where the object was seen, shape (n, 3) [m].
        simulated: where it is in the simulation, shape (n, 3) [m].
    """
    figure = new_figure(9, 6)
    upper, lower = figure.subplots(2, 1, sharex=True)
    for i, name in enumerate(SERVOS):
        (line,) = upper.plot(time, sent[:, i], label=name)
        upper.plot(time, commanded[:, i], "--", color=line.get_color())
    for i, axis in enumerate("xyz"):
        (line,) = lower.plot(time, 1e3 * seen[:, i], label=f"{axis}, seen")
        lower.plot(time, 1e3 * simulated[:, i], "--", color=line.get_color())
    upper.set_ylabel("command [rad], simulated dashed")
    lower.set_ylabel("object in the hand's frame [mm]")
    lower.set_xlabel("time [s]")
    for axes in (upper, lower):
        axes.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure
