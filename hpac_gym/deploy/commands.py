"""``hpac deploy``: a trained policy on a hand.

The object's pose comes from a source, the arm is told when each phase begins, and every step goes
into a log. Ctrl-C opens the hand slowly and disarms it."""

import argparse
import sys
import time
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import Any

from hpac_gym.body.objects import ObjectSpec
from hpac_gym.body.own_objects import as_object
from hpac_gym.bridge import HandLink, WireLog
from hpac_gym.bridge.commands import PORT_HELP, connector
from hpac_gym.bridge.transport import open_transport
from hpac_gym.command import add_json, say, seconds
from hpac_gym.deploy.arm import arm_of
from hpac_gym.deploy.episode import (
    AVERAGED,
    LOG_VERSION,
    OLDEST,
    Log,
    decided,
    run_episode,
    wire_log,
    wrist,
)
from hpac_gym.deploy.errors import DeployError
from hpac_gym.deploy.observer import Observer
from hpac_gym.deploy.poses import averaged, source_of
from hpac_gym.evaluation import options as environment
from hpac_gym.model import SERVOS, load_hand
from hpac_gym.model.files import hand_to_toml
from hpac_gym.output import file_hash
from hpac_gym.policies.loading import NAMES, NORMALIZE, load_policy, needed_options
from hpac_gym.policies.policy_file import policy_path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hpac deploy`."""
    parser.add_argument("policy", help=NAMES)
    parser.add_argument("--normalize", metavar="FILE", help=NORMALIZE)
    parser.add_argument("--port", help=f"{PORT_HELP}; without one only --dry-run is possible")
    parser.add_argument(
        "--object",
        required=True,
        metavar="SHAPE:M,M",
        help="what the camera knows of the object: cylinder:RADIUS,HALF_HEIGHT, sphere:RADIUS, box:HALF,HALF,HALF [m] or a file",
    )
    parser.add_argument(
        "--pose",
        required=True,
        metavar="SOURCE",
        help="where it is, in the hand's frame: X,Y,Z[,QX,QY,QZ,QW] [m], a .csv, udp:PORT, or camera:N[,FILE]",
    )
    parser.add_argument("--arm", default="none", help="none, enter (a person) or udp:HOST:PORT")
    parser.add_argument(
        "--env", metavar="ID", help="environment of a policy whose file names none (HPAC-Grasp-v0)"
    )
    parser.add_argument(
        "--grasp", metavar="NAME", help="named grasp or type, for the tasks that have them"
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="any other option of the environment that the policy was trained in, such as wrist=free; may be repeated",
    )
    parser.add_argument(
        "--model",
        metavar="FILE",
        help="what commands are computed with: a hand file, as `hpac calibrate` writes it",
    )
    parser.add_argument(
        "--average", type=seconds, default=AVERAGED, metavar="S", help="the first pose's mean [s]"
    )
    parser.add_argument(
        "--oldest", type=seconds, default=OLDEST, metavar="S", help="age limit of a pose [s]"
    )
    parser.add_argument(
        "--hold", type=seconds, default=2.0, metavar="S", help="before it opens [s] (%(default)s)"
    )
    parser.add_argument(
        "--log",
        type=Path,
        default=Path("runs/deploy.jsonl"),
        help="JSON lines; a file of that name is kept as NAME-1, or the next free number",
    )
    parser.add_argument(
        "--dry-run", action="store_true", help="print observation and first command; move nothing"
    )
    parser.add_argument("--view", action="store_true", help="show the hand in the browser")
    add_json(parser)
    parser.set_defaults(run=run)


def object_of(given: str | dict[str, Any]) -> ObjectSpec:
    """The object of an ``--object``, or of the arguments of `own_object`.

    Raises:
        ParameterError: It is none.
    """
    return as_object(environment.object_of(given) if isinstance(given, str) else given)


def run(options: argparse.Namespace) -> int:
    """Run one episode, or only tell what would be done."""
    env_id = options.env or environment.env_id_of(options.policy)
    hand = load_hand(options.model)
    needed = needed_options(options.policy, env_id)
    needed |= {"object": environment.object_of(options.object)}
    given = environment.with_set(needed, options.set)
    thing = given.pop("object")
    observer = Observer(env_id, as_object(thing), hand, options.grasp, **given)
    policy = load_policy(options.policy, observer, options.normalize)
    with ExitStack() as stack:
        source = source_of(options.pose, observer.setup.object)
        stack.enter_context(closing(source))
        if options.dry_run:
            _dry_run(options, observer, policy, source)
            return 0
        if options.port is None:
            raise DeployError("--port is missing: name one, or --dry-run")
        if observer.task.wrist_actions and options.arm == "none":
            raise DeployError(
                f"{options.policy} places the wrist ({', '.join(observer.task.wrist_actions)}), "
                "and --arm none moves none: take --arm enter or --arm udp:HOST:PORT"
            )
        arm = stack.enter_context(closing(arm_of(options.arm)))
        port = connector(options.port, stack)
        transport = stack.enter_context(closing(open_transport(port)))  # or no log is begun
        log = stack.enter_context(Log(options.log))
        log.write(hpac_deploy=LOG_VERSION, **_head(options, observer, given, thing))
        regular = options.log.is_file()  # beside /dev/null there is no wire log
        wire = stack.enter_context(WireLog(wire_log(options.log))) if regular else None
        link = stack.enter_context(HandLink(lambda: transport, hand=hand, log=wire))
        task = observer.spec.id
        said = f"{options.policy} on {options.port}: {task}, {observer.steps / 20:g} s; Ctrl-C opens the hand"
        say(options.json, said, policy=options.policy, port=options.port, env=task)
        live = [_live] if sys.stderr.isatty() else []
        if options.view:
            from hpac_gym.deploy.watching import watched

            live.append(stack.enter_context(watched(link, observer.setup, hand)))
        counts = run_episode(
            link,
            observer,
            policy,
            source,
            arm,
            log,
            hold=options.hold,
            seconds=options.average,
            oldest=options.oldest,
            live=lambda figures: [show(figures) for show in live],
            note=_note,
        )
        where = log.path
    names = ("acknowledged", "late", "lost", "refused")
    told = {name: getattr(counts, name) for name in names}
    said = ", ".join(f"{number} {name}" for name, number in told.items())
    said = f"done: {counts.sent} commands, {said}; log in {where}"
    say(options.json, said, commands=counts.sent, **told, log=str(where))
    return 0


def _head(
    options: argparse.Namespace, observer: Observer, given: dict[str, Any], thing: Any
) -> dict[str, Any]:
    """The first line of a log: what it takes to play it again."""
    path = policy_path(options.policy)
    return {
        "began": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "policy": options.policy,
        "policy_sha256": file_hash(path, DeployError) if path.is_file() else None,
        "env_id": observer.spec.id,
        "grasp": options.grasp,
        "options": given,
        "object": thing if isinstance(thing, dict) else options.object,
        "hand": observer.model.name,
        "model": hand_to_toml(observer.model) if options.model else None,
        "port": options.port,
        "servos": SERVOS,
        "terms": [[term.name, *term.labels] for term in observer.task.terms],
        "start": observer.servo,
    }


def _dry_run(options: argparse.Namespace, observer: Observer, policy: Any, source: Any) -> None:
    """Print every entry of the first observation with name and unit, and the first command."""
    pose = averaged(source, options.average, options.oldest)
    observer.expects(pose)
    observation, action, target, _ = decided(policy, observer, pose)
    labels = [(term, label) for term in observer.task.terms for label in term.labels]
    entries = [
        {"name": term.name, "label": label, "value": float(value), "unit": term.unit}
        for (term, label), value in zip(labels, observation, strict=True)
    ]
    placed = wrist(action, observer)
    if options.json:
        say(
            True,
            "",
            observation=entries,
            servos=SERVOS,
            start_rad=observer.servo.tolist(),
            first_command_rad=target.tolist(),
            wrist=placed,
        )
        return
    for entry in entries:
        print("{name:<14} {label:<18} {value:9.4f}  {unit}".format(**entry))
    print(f"\n{'servo':<14} {'start [rad]':>12} {'first command [rad]':>20}")
    for row in zip(SERVOS, observer.servo, target, strict=True):
        print("{:<14} {:12.4f} {:20.4f}".format(*row))
    if placed:
        told = ", ".join(f"{name} {value:+.2f}" for name, value in placed.items())
        print(f"the policy places the wrist: {told}")
    print("dry run: nothing was sent")


def _note(text: str, end: str = "\n") -> None:
    """A line of its own, over the one of the steps."""
    text = f"\r{text:<90}" if sys.stderr.isatty() else text
    with suppress(OSError):
        print(text, end=end, file=sys.stderr, flush=True)


def _live(now: dict[str, Any]) -> None:
    """One line that is written over and over."""
    counts = now["counts"]
    _note(
        f"{now['t']:5.2f} s  {now['phase']:<8} heat {now['heat']:4.0%}  late {counts.late}  "
        f"lost {counts.lost}  refused {counts.refused}  worst delay {1e3 * counts.worst_delay:.1f} ms",
        end="",
    )
