"""Devices that are no hand, or not the one that is expected."""

from hpac_gym.bridge.frame import Frame, FrameSplitter, encode
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
