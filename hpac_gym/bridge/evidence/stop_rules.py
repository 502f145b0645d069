"""The rules of docs/wire.md on what stops a hand, and on its reports: the watchdog, ESTOP, CLEAR,
STATUS.
"""

import struct
from collections.abc import Callable

from hpac_gym.bridge.evidence import codec as wire
from hpac_gym.bridge.evidence.device import OURS, SESSION, SLACK, Device, Status
from hpac_gym.bridge.protocol import CONSTANTS, Action, Fault, Reason, State, name_of

EARLY = 0.02  # what a device's clock may be ahead in a fifth of a second [s]
SILENT_AT = 2000  # pose above rest in which the host falls silent [1e-4 rad]


def _silence(d: Device, action: Action, watchdog_ms: int) -> tuple[Status, float]:
    """Let the watchdog trip; returns the STATUS afterwards, and the earliest time at which it can
    have tripped [s].
    """
    d.armed(action, watchdog_ms)
    d.moved(SILENT_AT)
    expires = d.transport.now() + watchdog_ms * 1e-3
    d.must(Reason.ok, wire.HEARTBEAT, OURS)
    d.unasked.clear()
    d.listen(watchdog_ms * 1e-3 - 0.04)
    d.must_be(State.armed, f"40 ms before the watchdog's {watchdog_ms} ms:")
    d.listen(0.04 + SLACK)
    status = d.must_be(State.fault, f"after {watchdog_ms} ms of silence", Fault.watchdog)
    d.must_have_told(Fault.watchdog)
    return status, expires


def _watchdog_detach(d: Device) -> None:
    for watchdog_ms in (CONSTANTS["watchdog_min_ms"], CONSTANTS["watchdog_max_ms"]):
        status, _ = _silence(d, Action.detach, watchdog_ms)
        d.expect(not status.attached, f"detach leaves servos {status.attached:06b} with pulses")


def _watchdog_relax(d: Device) -> None:
    before, expires = _silence(d, Action.relax, 100)
    if _relax_seconds(d) > SLACK + 0.2:  # long enough to be watched
        _watch_relax(d, before, expires)
    d.listen(max(1.5, _relax_seconds(d)))
    status = d.status()
    d.expect(
        not status.attached and list(status.servo) == d.rest,
        f"after relax {status.servo}, servos {status.attached:06b}",
    )


def _relax_seconds(d: Device) -> float:
    """How long a relax from where the host falls silent takes [s]."""
    return SILENT_AT * 1e-4 / d.relax_rate


def _watch_relax(d: Device, before: Status, expires: float) -> None:
    d.expect(
        before.attached == 0x3F,
        f"relax has taken the pulses of servos {before.attached ^ 0x3F:06b} at once",
    )
    d.listen(0.1)
    status = d.status()
    gone = [
        abs(was - rest) - abs(at - rest)
        for was, at, rest in zip(before.servo, status.servo, d.rest, strict=True)
    ]
    d.expect(
        min(gone) > 0,
        f"relax takes servo {gone.index(min(gone))} by {min(gone)} towards rest in 0.1 s [1e-4 rad]",
    )
    way = max(abs(rest + SILENT_AT - at) for at, rest in zip(status.servo, d.rest, strict=True))
    most = 1e4 * d.relax_rate * (d.transport.now() - expires + EARLY)
    d.expect(way <= most, f"relax has gone {way} [1e-4 rad], at most {most:.0f} at its rate")


def _watchdog_hold(d: Device) -> None:
    before, _ = _silence(d, Action.hold, 100)
    d.listen(CONSTANTS["hold_max_ms"] * 1e-3 - 1.0)
    status = d.status()
    d.expect(
        status.attached == 0x3F and status.servo == before.servo,
        f"hold: {status.servo}, servos {status.attached:06b}",
    )
    relax_s = max(1.5, _relax_seconds(d) + SLACK)
    d.listen(1.0 + relax_s)
    d.must_be(State.fault, f"{relax_s:g} s after hold must have become relax", powered=False)


def _hello_in_a_hold(d: Device) -> None:
    before, _ = _silence(d, Action.hold, 100)
    d.hello(SESSION + 1)
    status = d.must_be(State.fault, "after HELLO in a hold", Fault.watchdog, powered=True)
    d.expect(
        status.attached == before.attached,
        f"HELLO leaves servos {status.attached:06b} of {before.attached:06b} with pulses",
    )
    d.must(Reason.session, wire.CLEAR, OURS, "of the session before, in a hold")


def _arm_again(d: Device) -> None:
    d.armed(Action.hold, CONSTANTS["watchdog_max_ms"])
    d.must(Reason.ok, wire.ARM, d.arm(Action.detach, 100), "while armed")
    d.listen(0.1 + SLACK)
    d.must_be(State.fault, "after 100 ms of silence", Fault.watchdog, powered=False)


def _watchdog_food(d: Device) -> None:
    d.armed(Action.detach, 200)
    d.live(1.0)
    d.must_be(State.armed, "with a HEARTBEAT every 30 ms")
    d.armed(Action.detach, 200)
    before = d.status()
    other = struct.pack("<I", 5)
    unfit = [
        (wire.STATUS, bytes(2)),
        (wire.HEARTBEAT, other),
        (wire.HELLO, bytes(4)),
        (wire.MOVE, d.move(0, 1)),
    ]
    for kind, payload in unfit * 5:
        d.send(kind, payload)
        d.listen(0.02)
    status = d.must_be(State.fault, "after 0.4 s of STATUS, strangers and refused MOVEs")
    d.expect(
        status.trips - before.trips == 1,
        f"watchdog_trips counts {status.trips - before.trips} of 1",
    )


def _estop(d: Device) -> None:
    kinds = (
        (0, b"", wire.VERSION),
        (0xFF, b"", wire.VERSION),
        (0, bytes(7), wire.VERSION),
        (0, b"", 1),
        (9, b"\1", 200),
    )
    for flags, payload, version in kinds:
        d.armed(Action.hold)
        d.unasked.clear()
        text = f"with flags {flags}, {len(payload)} bytes, version {version}"
        d.must(Reason.ok, wire.ESTOP, payload, text, flags=flags, version=version)
        d.must_have_told(Fault.estop)
        d.must_be(State.fault, "after ESTOP", Fault.estop, powered=False)
    d.idle()
    d.must(Reason.ok, wire.ESTOP, b"", "in IDLE")
    d.must_be(State.fault, "after ESTOP in IDLE", Fault.estop)


def _latched(d: Device) -> None:
    d.armed()
    d.must(Reason.ok, wire.ESTOP)
    d.must(Reason.state, wire.ARM, d.arm(), "in a fault")
    d.must(Reason.state, wire.MOVE, d.move(0), "in a fault")
    d.must(Reason.ok, wire.HEARTBEAT, OURS, "in a fault")
    d.must(Reason.session, wire.CLEAR, struct.pack("<I", 5), "of another session, in a fault")
    hello = d.hello(SESSION)
    d.expect(hello.state == State.fault, f"HELLO leaves the fault: {name_of(State, hello.state)}")
    d.must_be(State.fault, "after all but CLEAR", Fault.estop, powered=False)
    d.must(Reason.ok, wire.CLEAR, OURS, "in a fault")
    d.must_be(State.idle, "after CLEAR", Fault.none)


def _clear(d: Device) -> None:
    d.armed()
    d.must(Reason.ok, wire.MOVE, d.move(2000))
    d.live(0.1)
    d.must(Reason.ok, wire.CLEAR, OURS, "in a move")
    status = d.must_be(State.idle, "after CLEAR", powered=False)
    d.expect(not status.moving, "after CLEAR in a move it says that it moves")
    d.listen(0.5)
    later = d.status()
    d.expect(
        later.servo == status.servo,
        f"after CLEAR the commanded pose goes on from {status.servo} to {later.servo}",
    )


def _periodic(d: Device) -> None:
    d.idle()
    d.must(
        Reason.period, wire.STATUS, struct.pack("<H", CONSTANTS["status_min_ms"] - 1), "every 9 ms"
    )
    for ended_by in ("STATUS 0", "HELLO"):
        d.status(50)
        d.unasked.clear()
        d.listen(1.0)
        count = sum(
            message.kind == wire.DEVICE_STATUS and message.seq == 0 for message in d.unasked
        )
        d.expect(17 <= count <= 21, f"{count} STATUS of number 0 in 1 s, must be 20")
        d.hello(SESSION) if ended_by == "HELLO" else d.status(0)
        d.unasked.clear()
        d.listen(0.3)
        d.expect(
            not d.unasked, f"after {ended_by} it still sends {len(d.unasked)} messages by itself"
        )


def _counters(d: Device) -> None:
    d.idle()
    before = d.status()
    for _ in range(5):
        d.must(Reason.ok, wire.HEARTBEAT, OURS)
        d.must(Reason.state, wire.MOVE, d.move(0))
    status = d.status()
    accepted = (status.accepted - before.accepted) % 2**32
    d.expect(accepted == 6, f"accepted counts {accepted}, must be 6")
    d.expect(
        status.refused - before.refused == 5,
        f"refused counts {status.refused - before.refused}, must be 5",
    )
    d.listen(0.2)
    later = d.status()
    passed_ms = (later.uptime_ms - status.uptime_ms) % 2**32
    d.expect(
        180 <= passed_ms <= 200 + 1e3 * SLACK, f"uptime_ms counts {passed_ms} ms, must be some 200"
    )
    derated = 1000 - 37.5 * (min(max(later.heat_percent), 100) - 80)
    d.expect(
        abs(later.rate_permille - min(derated, 1000)) <= 40,
        f"rate_permille {later.rate_permille} at a heat of {max(later.heat_percent)} %",
    )


STOP_RULES: dict[str, Callable[[Device], None]] = {
    "silence: detach": _watchdog_detach,
    "silence: relax": _watchdog_relax,
    "silence: hold, then relax": _watchdog_hold,
    "HELLO ends neither a fault nor its hold": _hello_in_a_hold,
    "ARM while armed replaces watchdog and safe action": _arm_again,
    "messages that feed the watchdog, and others": _watchdog_food,
    "ESTOP is accepted from any sender, with any contents": _estop,
    "a fault is latched until CLEAR": _latched,
    "CLEAR stops motion and pulses": _clear,
    "periodic STATUS": _periodic,
    "counters": _counters,
}
