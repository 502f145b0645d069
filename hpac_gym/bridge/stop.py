"""`hpac estop`: stop a hand from anywhere, also beside the program that drives it.

A hand accepts ESTOP from anybody, so the port is opened without the lock, no session is begun, and
nothing is loaded that the stop does not need."""

import argparse
import sys
from contextlib import ExitStack, suppress

from hpac_gym.bridge.errors import LinkTimeout, PortError
from hpac_gym.bridge.protocol import MESSAGES, Fault, Frame, FrameSplitter, Reason, encode
from hpac_gym.bridge.transport import Transport, open_transport
from hpac_gym.command import add_json, drop_output, say

PATIENCE = 3.0
"""Longest wait for the hand's confirmation [s]."""
_PERIOD = 0.1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hpac estop`."""
    parser.add_argument("--port", required=True, help="port of the hand; may be in use")
    parser.add_argument("--hand", metavar="FILE", help="as in other commands; not read by a stop")
    add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Stop the hand at a port."""
    try:
        with ExitStack() as stack:
            port = options.port
            if port in ("virtual", "host"):
                from hpac_gym.bridge.commands import connector

                port = connector(port, stack)
            transport = open_transport(port, lock=False)
            stack.callback(transport.close)
            stop(transport)
    except (LinkTimeout, PortError) as error:
        raise type(error)(f"ESTOP is not confirmed, switch the servo supply off: {error}") from None
    _tell(options.json, "stopped: no pulses, fault estop; `hpac clear` leaves it")
    return 0


UNCONFIRMED = "Stop NOT CONFIRMED: switch the supply off. {}. "
"""What a page tells of a stop that raised an error."""


def _tell(as_json: bool, said: str) -> None:
    """Tell that the hand is stopped: on standard error where standard output is closed or full, and
    by the exit status alone where both are.
    """
    if sys.stdout is not None:
        try:
            return say(as_json, said, stopped=True, fault="estop")
        except OSError:
            drop_output()
    with suppress(OSError, ValueError):
        print(said, file=sys.stderr, flush=True)


def stop(transport: Transport) -> None:
    """Send ESTOP until the hand confirms that it has no pulses.

    The program that drives the hand may read some of the answers, so STATUS is asked for as well:
    any of them confirms.

    Raises:
        LinkTimeout: No confirmation within `PATIENCE`.
        PortError: The port is gone.
    """
    splitter = FrameSplitter()
    deadline = transport.now() + PATIENCE
    seq = 0
    while transport.now() < deadline:
        for name, fields in (("estop", {}), ("status", {"period_ms": 0})):
            seq += 1
            transport.write(encode(Frame(name, seq, 0, fields)))
        until = min(transport.now() + _PERIOD, deadline)
        while (left := until - transport.now()) > 0:
            if any(_confirms(frame) for _, frame in splitter.push(transport.read(left))):
                return
    raise LinkTimeout(f"no answer to estop for {PATIENCE:g} s")


def _confirms(frame: Frame) -> bool:
    """Whether a frame of the hand says that it has no pulses because of a stop."""
    number = frame.number
    if frame.name == "ack":
        return number("acked") == MESSAGES["estop"].code and number("reason") == Reason.ok
    if frame.name == "device_status":
        return number("fault") == Fault.estop and not number("attached")
    return False
