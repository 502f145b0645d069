"""The bridge's part of the `hpac` command: safety, wiggle, doctor."""

from __future__ import annotations

import argparse
import json
import sys
from contextlib import ExitStack

import numpy as np

from hpac_gym.bridge import safety
from hpac_gym.bridge.doctor import Finding, diagnose, find_ports
from hpac_gym.bridge.host_board import HostBoard
from hpac_gym.bridge.link import HandLink
from hpac_gym.bridge.virtual_hand import VirtualHand
from hpac_gym.command_line import whole_number
from hpac_gym.errors import WorkspaceError
from hpac_gym.model import HPAC, SERVOS, ServoCommand, move_duration

_WIGGLE_TIME = 0.8
_PORT_HELP = "serial port, socket://HOST:PORT, `virtual` (the firmware in this process) or `host` (the firmware as a process)"


def add_commands(subparsers: argparse._SubParsersAction) -> None:
    """Add the bridge's commands; each sets `func`, which takes the namespace and returns an exit status."""
    parser = subparsers.add_parser("safety", help="measure the firmware's safety claims now")
    parser.add_argument("--json", action="store_true", help="a list of claim, figure, limit, unit, holds")
    parser.add_argument("--frames", type=whole_number(1), default=10_000_000, help="hostile frames (default: %(default)s)")
    parser.add_argument("--trials", type=whole_number(1), default=20, help="wall-clock repetitions (default: %(default)s)")
    parser.set_defaults(func=_safety)

    parser = subparsers.add_parser("wiggle", help="move one servo at a time next to its name, to check wiring and order")
    parser.add_argument("--port", required=True, help=_PORT_HELP)
    parser.add_argument("--servo", choices=SERVOS, action="append", help="only this one; can be given again")
    parser.add_argument("--angle", type=float, default=0.3, help="how far from rest [rad] (default: %(default)s)")
    parser.set_defaults(func=_wiggle)

    parser = subparsers.add_parser("doctor", help="find hands, say what is wrong and what to do")
    parser.add_argument("--port", help=f"look only here: {_PORT_HELP}")
    parser.add_argument("--json", action="store_true", help="a list of port, healthy, what, advice")
    parser.set_defaults(func=_doctor)


def _connector(port: str, stack: ExitStack):
    """What a `HandLink` opens for a `--port`; starts a firmware where it names one."""
    if port == "virtual":
        return VirtualHand().connect
    if port == "host":
        return stack.enter_context(HostBoard()).connect
    return port


def _safety(options: argparse.Namespace) -> int:
    claims = []
    for claim in safety.measure(options.frames, options.trials):
        claims.append(claim)
        if not options.json:
            mark = "holds " if claim.holds else "BROKEN"
            print(f"{mark}  {claim.figure:9.4g} ≤ {claim.limit:<5g} {claim.unit:<12} {claim.claim}", flush=True)
    if options.json:
        rows = [{"claim": c.claim, "figure": c.figure, "limit": c.limit, "unit": c.unit, "holds": c.holds} for c in claims]
        json.dump(rows, sys.stdout, indent=2, ensure_ascii=False)
        print()
    return 0 if all(claim.holds for claim in claims) else 1


def _wiggle(options: argparse.Namespace) -> int:
    chosen = options.servo or SERVOS
    if not 0 < options.angle <= min(HPAC.servo_max):
        raise WorkspaceError(f"--angle {options.angle} rad must be above 0 and at most {min(HPAC.servo_max):.3f} rad")
    rest = np.clip(np.zeros(len(SERVOS)), HPAC.servo_min, HPAC.servo_max)
    with ExitStack() as stack:
        link = stack.enter_context(HandLink(_connector(options.port, stack)))
        link.arm()
        for name in chosen:
            index = SERVOS.index(name)
            print(f"servo {index + 1} of {len(SERVOS)}: {name} flexes and returns", flush=True)
            target = rest.copy()
            target[index] += options.angle
            duration = max(_WIGGLE_TIME, 2 * move_duration(rest, target))  # the peak of minimum jerk is 1.875 times the mean
            for pose in (target, rest):
                link.move(ServoCommand(pose, duration), minimum_jerk=True)
                link.wait()
                link.sleep(0.2)
    return 0


def _doctor(options: argparse.Namespace) -> int:
    ports = [options.port] if options.port else find_ports()
    with ExitStack() as stack:
        findings = [diagnose(port, _connector(port, stack)) for port in ports]
    if not ports:
        what = "no USB serial port on this machine"
        advice = "plug the hand in; with a cable that carries data; in a container or virtual machine pass the device through"
        findings = [Finding("ports", False, what, advice)]
    if options.json:
        rows = [{"port": f.port, "healthy": f.healthy, "what": f.what, "advice": f.advice} for f in findings]
        json.dump(rows, sys.stdout, indent=2, ensure_ascii=False)
        print()
    else:
        print("\n".join(map(str, findings)))
    return 0 if any(finding.healthy for finding in findings) else 1
