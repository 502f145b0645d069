"""What is known of the hand's state: learnt from whatever it says, and from nothing else."""

from __future__ import annotations

from hpac_gym.bridge.errors import FaultError, RejectedError
from hpac_gym.bridge.frame import Frame
from hpac_gym.bridge.protocol import Fault, Reason, State, name_of
from hpac_gym.bridge.reports import HandStatus
from hpac_gym.model import SERVOS


class KnownState:
    """The latest news of the hand.

    Attributes:
        state: of `protocol.State`; `boot` when not connected.
        fault: of `protocol.Fault`; `none` also when a fault is known but not yet which.
        status: the latest STATUS, or None.
    """

    def __init__(self) -> None:
        self.status: HandStatus | None = None
        self.forget()

    def forget(self) -> None:
        """The connection is gone: nothing is known."""
        self.state = State.boot.name
        self.fault = Fault.none.name

    def take_in(self, frame: Frame) -> None:
        """Learn from any frame of the hand."""
        if "state" in frame.fields:
            self.state = name_of(State, frame.fields["state"])
        if frame.name == "device_status":
            self.status = HandStatus.from_frame(frame)
            self.fault = self.status.fault
        elif frame.name == "fault":
            self.state = State.fault.name
            self.fault = name_of(Fault, frame.fields["fault"])
        elif self.state != State.fault.name:
            self.fault = Fault.none.name

    @property
    def armed(self) -> bool:
        """Whether the hand has said that it is armed."""
        return self.state == State.armed.name

    @property
    def in_fault(self) -> bool:
        """Whether the hand has said that a fault has latched."""
        return self.state == State.fault.name

    def refusal(self, name: str, ack: Frame) -> RejectedError:
        """The error that an ACK with a reason stands for."""
        reason = name_of(Reason, ack.fields["reason"])
        servo = SERVOS[ack.fields["servo"]] if ack.fields["servo"] < len(SERVOS) else None
        if self.in_fault:
            return self.fault_error(f"{name} refused", reason, servo)
        where = f" at servo {servo}" if servo else ""
        return RejectedError(f"the hand refused {name}: {reason}{where} (state {self.state})", reason, servo, self.state)

    def fault_error(self, what: str, reason: str = Reason.state.name, servo: str | None = None) -> FaultError:
        """The error of whoever meets a latched fault."""
        return FaultError(f"the hand is in fault ({self.fault}): {what}; clear() leaves it", reason, servo, self.state)
