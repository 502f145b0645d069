"""Devices that are no hand, or not the one that is expected, and lines to a hand that are overheard or
bad."""

import numpy as np

from hpac_gym.bridge.frame import Frame, FrameSplitter, decode, encode
from hpac_gym.bridge.hands import VirtualTransport
from hpac_gym.bridge.protocol import MESSAGES


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


class Overheard(VirtualTransport):
    """Notes when which frame is written; loses what goes "out" or comes "in" if it is told to."""

    def __init__(self, hand, *lost):
        super().__init__(hand)
        self.lost = lost
        self.frames = []

    def write(self, data):
        self.frames.append((self.now(), decode(data[1:-1])))
        if "out" not in self.lost:
            super().write(data)

    def read(self, timeout):
        data = super().read(timeout)
        return b"" if "in" in self.lost else data

    def of(self, name):
        return [(time, frame) for time, frame in self.frames if frame.name == name]


class Bad(Overheard):
    """Once `armed`, loses frames in both directions, delivers the host's late by up to `jitter` and
    the hand's by `latency`.
    """

    def __init__(self, hand, loss=0.0, jitter=0.0, latency=0.0, seed=0):
        super().__init__(hand)
        self.loss = loss
        self.jitter = jitter
        self.latency = latency
        self.rng = np.random.default_rng(seed)
        self.out = []
        self.back = []
        self.armed = False

    def write(self, data):
        if not self.armed or self.rng.random() >= self.loss:
            self.out.append((self.now() + self.armed * self.rng.uniform(0, self.jitter), data))

    def read(self, timeout):
        until = self.now() + timeout
        while True:
            while self.out and self.out[0][0] <= self.now():
                super().write(self.out.pop(0)[1])
            if self.back and self.back[0][0] <= self.now():
                return self.back.pop(0)[1]
            if self.now() >= until:
                return b""
            due = min([until, *(at for at, _ in (*self.out[:1], *self.back[:1]))])
            data = super().read(max(due - self.now(), 1e-6))
            if data and (not self.armed or self.rng.random() >= self.loss):
                self.back.append((self.now() + self.armed * self.latency, data))
