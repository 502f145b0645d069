"""Devices that are no hand, or not the one that is expected, and lines to a hand that are overheard or
bad."""

import numpy as np

from hpac_gym.bridge.hands import VirtualTransport
from hpac_gym.bridge.protocol import MESSAGES, Frame, FrameSplitter, decode, encode
from hpac_gym.virtual.wire import BadTransport, Faults

LOST = Faults(loss=1.0)
"""Of a way on which nothing arrives."""


def of_zeros(name, **fields):
    """A message whose other fields are zero."""
    zeros = {
        part.name: (0,) * part.count if part.count > 1 else 0 for part in MESSAGES[name].fields
    }
    return Frame(name, 1, 0, zeros | fields)


HELLO_OF_A_HAND = of_zeros("device_hello")


def of_another_version(_data):
    return encode(HELLO_OF_A_HAND, version=9)


def refusing(_data):
    """HELLO is answered by an ACK, of reason `length`."""
    return encode(Frame("ack", 1, 0, {"acked": 1, "reason": 12, "servo": 255, "state": 0}))


def hello_alone(data):
    """HELLO is answered as by a hand, nothing else."""
    ((_, frame),) = FrameSplitter().push(data)
    return encode(HELLO_OF_A_HAND) if frame.name == "hello" else b""


def without_status(data):
    """HELLO is answered as by a hand, everything else by an ACK, of reason `type`."""
    ((_, frame),) = FrameSplitter().push(data)
    if frame.name == "hello":
        return encode(HELLO_OF_A_HAND)
    return encode(Frame("ack", frame.seq, 0, {"acked": 7, "reason": 11, "servo": 255, "state": 0}))


class Device(VirtualTransport):
    """Answers every write with what `reply` makes of it."""

    def __init__(self, hand, reply):
        super().__init__(hand)
        self.reply = reply
        self.said = b""

    def write(self, data):
        self.said += self.reply(data)

    def read(self, timeout):
        super().read(0.0 if self.said else timeout)
        said = self.said
        self.said = b""
        return said


class Overheard(BadTransport):
    """A wire that notes when which frame is written; it has no faults until it is `spoiled`."""

    def __init__(self, hand, seed=0):
        super().__init__(hand, np.random.default_rng(seed), Faults())
        self.frames = []

    def write(self, data):
        self.frames.append((self.now(), decode(data[1:-1])))
        super().write(data)

    def spoil(self, **faults):
        """Both ways get these faults and no others."""
        self.there.faults = self.back.faults = Faults(**faults)

    def of(self, name):
        return [(time, frame) for time, frame in self.frames if frame.name == name]
