"""The rules of docs/wire.md on frames: HELLO, versions, damage, lengths, flags, sessions."""

import struct
from collections.abc import Callable

from hpac_gym.bridge.evidence import codec as wire
from hpac_gym.bridge.evidence.device import OURS, SESSION, Device
from hpac_gym.bridge.limits import limits_hash
from hpac_gym.bridge.protocol import CONSTANTS, Reason, Reset, State, name_of


def _hello(d: Device) -> None:
    hello = d.hello(SESSION)
    d.expect(
        hello.session == SESSION, f"session {hello.session:08x} in force after HELLO {SESSION:08x}"
    )
    wanted = limits_hash(d.hand, hello.trim_ns, hello.reversed_mask)
    d.expect(
        hello.limits_hash == wanted,
        f"limits hash {hello.limits_hash:08x}, this hand's is {wanted:08x} (--hand FILE?)",
    )
    d.expect(
        hello.watchdog_ms == CONSTANTS["watchdog_ms"] and hello.reset in list(Reset),
        f"HELLO tells a watchdog of {hello.watchdog_ms} ms, must be {CONSTANTS['watchdog_ms']},"
        f" and the reset {name_of(Reset, hello.reset)}",
    )


def _hello_looks(d: Device) -> None:
    d.armed()
    hello = d.hello(0)
    d.expect(hello.session == SESSION, f"HELLO 0 changed the session to {hello.session:08x}")
    d.expect(
        hello.watchdog_ms == 250, f"HELLO 0 tells a watchdog of {hello.watchdog_ms} ms, not 250"
    )
    d.expect(hello.state == State.armed, f"HELLO 0 left the hand {name_of(State, hello.state)}")
    d.must(Reason.ok, wire.HEARTBEAT, OURS, "after HELLO 0")


def _hello_takes_over(d: Device) -> None:
    d.armed()
    d.hello(SESSION + 1)
    d.must_be(State.idle, "after HELLO of another controller", powered=False)
    d.must(Reason.session, wire.HEARTBEAT, OURS, "of the session before")


def _other_version(d: Device) -> None:
    d.idle()
    before = d.status()
    for version in (1, 3, 255):
        answer = d.ask(wire.HELLO, struct.pack("<I", 7), version=version)
        d.expect(
            answer.kind == wire.DEVICE_HELLO,
            f"HELLO of version {version} is not answered by HELLO",
        )
        d.must(Reason.version, wire.STATUS, bytes(2), f"of version {version}", version=version)
    status = d.status()
    d.expect(
        status.bad_version - before.bad_version == 6,
        f"bad_version counts {status.bad_version - before.bad_version} of 6",
    )
    d.must(
        Reason.ok, wire.HEARTBEAT, OURS, "of the session that another version's HELLO must not end"
    )


def _damage(d: Device) -> None:
    d.idle()
    before = d.status()
    good = wire.frame(wire.CLEAR, 900, OURS)
    sent = 0
    for bit in range(8, 8 * (len(good) - 1), 3):
        bad = bytearray(good)
        bad[bit // 8] ^= 1 << bit % 8
        if 0 not in bad[1:-1]:
            d.transport.write(bytes(bad))
            d.unasked.clear()
            d.listen(0.01)
            d.expect(
                not d.unasked, f"a frame with bit {bit} turned was answered: {bytes(bad).hex()}"
            )
            sent += 1
    status = d.status()
    counted = (
        status.bad_crc
        + status.bad_frame
        + status.overrun
        - before.bad_crc
        - before.bad_frame
        - before.overrun
    )
    d.expect(
        counted == sent,
        f"{counted} of {sent} damaged frames counted in bad_crc, bad_frame, overrun",
    )


def _junk(d: Device) -> None:
    d.idle()
    for junk in (
        b"\x05abc\0",
        b"x" * 300 + b"\0",
        b"\0" * 50,
        b"\x01",
        b"\xff" * 254 + b"\0",
        b"ets Jul 29 2019 12:21:46\r\n",
    ):
        d.transport.write(junk)
        d.must(Reason.ok, wire.HEARTBEAT, OURS, f"right after {junk[:12]!r}")


def _lost_byte(d: Device) -> None:
    d.idle()
    one = wire.frame(wire.HEARTBEAT, 901, OURS)
    for at in range(len(one)):
        d.transport.write(one[:at] + one[at + 1 :])
        d.must(Reason.ok, wire.HEARTBEAT, OURS, f"after one that lost its byte {at}")


def _lengths(d: Device) -> None:
    d.idle()
    for kind, length in wire.LENGTHS.items():
        for wrong in (
            {0, max(length - 1, 0), length + 1, 30} - {length} if kind != wire.ESTOP else ()
        ):
            d.must(Reason.length, kind, bytes(wrong), f"with {wrong} bytes of payload")
    for kind in (8, 0x33, 0x7F):
        d.must(Reason.type, kind, b"", f"message 0x{kind:02x}")


def _device_types(d: Device) -> None:
    d.idle()
    for kind in (0x80, wire.DEVICE_HELLO, wire.ACK, 0xFF):
        d.unasked.clear()
        d.send(kind, bytes(4))
        d.listen(0.05)
        d.expect(
            not d.unasked,
            f"a frame of the hand's own type 0x{kind:02x} was answered",
        )


def _flags(d: Device) -> None:
    d.idle()
    payloads = {wire.HELLO: OURS, wire.ARM: d.arm(), wire.MOVE: d.move(0), wire.HEARTBEAT: OURS}
    payloads |= {wire.CLEAR: OURS, wire.STATUS: bytes(2)}
    for kind, payload in payloads.items():
        allowed = {wire.MOVE: 3, wire.HEARTBEAT: 2}.get(kind, 0)
        for bit in range(8):
            if not allowed >> bit & 1:
                d.must(Reason.flags, kind, payload, f"with flag 0x{1 << bit:02x}", flags=1 << bit)


def _sessions(d: Device) -> None:
    d.armed()
    for other in (0, SESSION ^ 1, SESSION + 1):
        session = struct.pack("<I", other)
        frames = [(wire.ARM, d.arm(session=other)), (wire.MOVE, d.move(500, session=other))]
        for kind, payload in (*frames, (wire.HEARTBEAT, session), (wire.CLEAR, session)):
            d.must(Reason.session, kind, payload, f"of session {other:08x}")
            d.live(0.01)
    status = d.must_be(State.armed, "after them")
    d.expect(not status.moving, "after them it moves")


def _priorities(d: Device) -> None:
    d.idle()
    d.must(Reason.length, wire.ARM, bytes(3), "too short, with flags and of no session", flags=0x80)
    d.must(
        Reason.flags, wire.ARM, d.arm(session=5), "with a flag and of another session", flags=0x80
    )
    d.must(Reason.session, wire.ARM, d.arm(action=9, session=5), "of another session and action 9")
    d.must(Reason.state, wire.MOVE, d.move(0, duration_ms=1), "in IDLE, too short")
    d.must(
        Reason.limits, wire.ARM, d.arm(action=9, hash_=d.hash ^ 1), "with another hash and action 9"
    )
    d.must(
        Reason.action,
        wire.ARM,
        d.arm(action=9, watchdog_ms=1),
        "with action 9 and a watchdog of 1 ms",
    )


FRAME_RULES: dict[str, Callable[[Device], None]] = {
    "HELLO is answered with session and the limits' hash": _hello,
    "HELLO 0 is answered and changes nothing": _hello_looks,
    "HELLO of another controller disarms and takes over": _hello_takes_over,
    "another version: HELLO is answered, all else but ESTOP refused": _other_version,
    "a damaged frame is counted and not answered": _damage,
    "junk does not affect later frames": _junk,
    "a lost byte costs at most one frame": _lost_byte,
    "length and type are checked": _lengths,
    "messages of the hand's own types are ignored": _device_types,
    "flags are checked": _flags,
    "ARM, MOVE, HEARTBEAT and CLEAR belong to the session": _sessions,
    "order of the checks of a frame": _priorities,
}
