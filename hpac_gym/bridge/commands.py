"""The bridge's commands of `hpac`: clear, conform, doctor, wiggle; and the sender of
`hpac posture`.
"""

import argparse
import json
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager

import numpy as np

from hpac_gym.bridge.doctor import Finding, diagnose, find_ports
from hpac_gym.bridge.errors import PortError
from hpac_gym.bridge.evidence.conform import Row, conform
from hpac_gym.bridge.hands import HostBoard, VirtualHand, config_of
from hpac_gym.bridge.link import HandLink
from hpac_gym.bridge.transport import Transport, open_transport
from hpac_gym.command import add_json, say
from hpac_gym.errors import WorkspaceError
from hpac_gym.model import HPAC, SERVOS, Hand, ServoCommand, load_hand, move_duration

_WIGGLE_TIME = 0.8
PORT_HELP = "serial port, socket://HOST:PORT, `virtual` (the firmware in this process) or `host` (the firmware as a process)"


def add_conform(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hpac conform`."""
    _add_hand(parser, _conform)
    parser.add_argument(
        "--json", action="store_true", help="print a JSON list of rule, tried, holds, failure"
    )


def add_wiggle(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hpac wiggle`."""
    _add_hand(parser, _wiggle)
    add_json(parser)
    parser.add_argument(
        "--servo", choices=SERVOS, action="append", help="only this servo; may be repeated"
    )
    parser.add_argument(
        "--angle", type=float, default=0.3, help="angle from rest [rad] (default: %(default)s)"
    )


def add_clear(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hpac clear`."""
    _add_hand(parser, _clear)
    add_json(parser)


def add_doctor(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hpac doctor`."""
    _add_hand(parser, _doctor, required=False)
    parser.add_argument(
        "--json", action="store_true", help="print a JSON list of port, healthy, what, advice"
    )


def _add_hand(
    parser: argparse.ArgumentParser,
    run: Callable[[argparse.Namespace], int],
    required: bool = True,
) -> None:
    """The arguments of every command that talks to a hand."""
    parser.add_argument(
        "--port",
        required=required,
        help=PORT_HELP if required else f"check only this port: {PORT_HELP}",
    )
    parser.add_argument(
        "--hand", metavar="FILE", help="hand parameters (TOML) of the firmware (default: nominal)"
    )
    parser.set_defaults(run=run)


def connector(port: str, stack: ExitStack, hand: Hand = HPAC) -> str | Callable[[], Transport]:
    """The `port` argument of a `HandLink` for a `--port`; starts the firmware for `virtual` and
    `host`.

    Raises:
        PortError: The name is empty.
    """
    if not port:
        raise PortError("--port '' names no port")
    if port == "virtual":
        return VirtualHand(config=config_of(hand)).connect
    if port == "host":
        return stack.enter_context(HostBoard()).connect
    return port


@contextmanager
def _linked(port: str, hand: Hand) -> Iterator[HandLink]:
    with ExitStack() as stack:
        yield stack.enter_context(HandLink(connector(port, stack, hand), hand=hand))


def _print_json(rows: Sequence[object], *names: str) -> None:
    """Print rows as a JSON list of objects with the named attributes."""
    print(
        json.dumps(
            [{name: getattr(row, name) for name in names} for row in rows],
            indent=2,
            ensure_ascii=False,
        )
    )


def _conform(options: argparse.Namespace) -> int:
    with ExitStack() as stack:
        hand = load_hand(options.hand)
        rows = conform(open_transport(connector(options.port, stack, hand)), hand)
        return verdict(rows, options.json, "rule", "tried", "holds", "failure")


def verdict(rows: Iterable[Row], as_json: bool, *names: str) -> int:
    """Print each row as soon as it is known, or all of them as JSON with the named attributes;
    returns 1 unless all hold.
    """
    known = []
    for row in rows:
        known.append(row)
        if not as_json:
            print(
                "holds " if row.holds else "BROKEN" if row.tried else "NOT TRIED",
                row,
                sep="  ",
                flush=True,
            )
    if as_json:
        _print_json(known, *names)
    return 0 if all(row.holds for row in known) else 1


def _wiggle(options: argparse.Namespace) -> int:
    hand = load_hand(options.hand)
    rest = np.clip(0.0, hand.servo_min, hand.servo_max)
    names = options.servo or SERVOS
    room = min((hand.servo_max - rest)[np.isin(SERVOS, names)])
    if not 0 < options.angle <= room:
        raise WorkspaceError(
            f"--angle {options.angle} rad must be above 0 and at most {room:.3f} rad"
        )
    with _linked(options.port, hand) as link:
        link.arm()
        for name in names:
            index = SERVOS.index(name)
            number = f"servo {index + 1} of {len(SERVOS)}"
            say(options.json, f"{number}: {name} flexes and returns", servo=name, number=index + 1)
            target = rest.copy()
            target[index] += options.angle
            # Minimum jerk peaks at 1.875 times the mean.
            duration = max(_WIGGLE_TIME, 2 * move_duration(rest, target, hand))
            for pose in (target, rest):
                link.move(ServoCommand(pose, duration), minimum_jerk=True)
                link.wait()
                link.sleep(0.2)
    return 0


def _clear(options: argparse.Namespace) -> int:
    with _linked(options.port, load_hand(options.hand)) as link:
        fault = link.last_status.fault if link.last_status else "none"
        link.clear()
        status = link.status()
    left = f"left fault {fault}; " if fault != "none" else ""
    say(
        options.json,
        f"{left}state {status.state}, pulses on {len(status.attached)} servos",
        left=fault,
        state=status.state,
        attached=list(status.attached),
    )
    return 0


def _doctor(options: argparse.Namespace) -> int:
    hand = load_hand(options.hand)
    ports = find_ports() if options.port is None else [options.port]
    with ExitStack() as stack:
        findings = [diagnose(port, connector(port, stack, hand), hand) for port in ports]
    if not ports:
        what = "no USB serial port on this machine"
        advice = "plug the hand in; with a cable that carries data; in a container or virtual machine pass the device through"
        findings = [Finding("ports", False, what, advice)]
    if options.json:
        _print_json(findings, "port", "healthy", "what", "advice")
    else:
        print("\n".join(map(str, findings)))
    return 0 if any(finding.healthy for finding in findings) else 1


def send_and_hold(port: str, commands: Iterable[ServoCommand], hand: Hand = HPAC) -> None:
    """Arm the hand at a port, move it from rest, wait until it has arrived, and hold it until
    Ctrl-C, unless it is virtual.

    Args:
        port: as in the commands.
        commands: target angles and duration of each move.
        hand: the hand with whose limits the firmware must have been built.

    Raises:
        BridgeError: The port, the hand or the firmware failed; the hand is then without pulses, or
            an `UnconfirmedWarning` was issued.
    """
    with _linked(port, hand) as link:
        link.arm()
        pose = np.clip(0.0, hand.servo_min, hand.servo_max)
        for command in commands:
            fastest = 1.1 * move_duration(pose, command.servo, hand)
            link.move(ServoCommand(command.servo, max(command.duration, fastest)))
            link.wait()
            pose = command.servo
        if port == "virtual":  # held, its clock would run on to the overload at once
            print("arrived", file=sys.stderr)
            return
        print("holding; Ctrl-C lets go", file=sys.stderr)
        try:
            while True:
                link.sleep(1.0)
        except KeyboardInterrupt:
            return
