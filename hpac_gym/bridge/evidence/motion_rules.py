"""The rules of docs/wire.md on what moves a hand: ARM and MOVE."""

from collections.abc import Callable

from hpac_gym.bridge.evidence import codec as wire
from hpac_gym.bridge.evidence.device import OURS, SILENCE, SLACK, Device
from hpac_gym.bridge.protocol import CONSTANTS, Reason, State
from hpac_gym.model import SERVOS


def _arm_bounds(d: Device) -> None:
    d.idle()
    d.must(Reason.limits, wire.ARM, d.arm(hash_=d.hash ^ 1), "with another limits hash")
    d.must(Reason.action, wire.ARM, d.arm(action=3), "with action 3")
    for watchdog_ms in (
        0,
        CONSTANTS["watchdog_min_ms"] - 1,
        CONSTANTS["watchdog_max_ms"] + 1,
        0xFFFF,
    ):
        d.must(
            Reason.period,
            wire.ARM,
            d.arm(watchdog_ms=watchdog_ms),
            f"with a watchdog of {watchdog_ms} ms",
        )
    d.must_be(State.idle, "after refused ARMs", powered=False)


def _starting(d: Device) -> None:
    d.idle()
    d.must(Reason.ok, wire.ARM, d.arm())
    d.must(Reason.starting, wire.MOVE, d.move(0), "right after ARM")
    seen = []
    last = 0
    for _ in range(600):
        status = d.status()
        d.expect(
            status.attached & last == last,
            f"servos {status.attached:06b} after {last:06b}: one has lost its pulses",
        )
        d.expect(
            (status.attached ^ last).bit_count() <= 1,
            f"servos {status.attached:06b} after {last:06b}: two at once",
        )
        seen += [status.attached] if status.attached != last else []
        last = status.attached
        if last == 0x3F and not status.moving:
            break
        d.live(0.01)
    d.expect(
        len(seen) == len(SERVOS), f"servos started in {len(seen)} steps, must be {len(SERVOS)}"
    )
    d.must(Reason.ok, wire.MOVE, d.move(0), "once the hand is at rest")


def _moves(d: Device) -> None:
    d.armed()
    d.moved(2000)
    d.moved(500)
    quarter = max(0.5, d.pace_ms / 2000)  # of a move long enough for delays not to matter [s]
    d.must(
        Reason.ok,
        wire.MOVE,
        d.move(2500, round(4000 * quarter)),
        "with minimum jerk",
        flags=wire.MINIMUM_JERK,
    )
    d.live(quarter)
    gone = [at - rest - 500 for at, rest in zip(d.status().servo, d.rest, strict=True)]
    d.expect(
        max(gone) < 440,  # a linear move is 500 ahead, this one 207
        f"after a quarter of minimum jerk {max(gone)} of 2000 [1e-4 rad], must be 207",
    )
    d.live(quarter)
    status = d.status()
    d.expect(status.moving == 1, "in the middle of a move it says that it does not move")
    half = [abs(at - rest - 1500) for at, rest in zip(status.servo, d.rest, strict=True)]
    d.expect(
        max(half) < 600,
        f"half-way through minimum jerk {status.servo}, {max(half)} from the middle [1e-4 rad]",
    )
    d.live(2 * quarter + SLACK)
    d.moved(0)


def _move_bounds(d: Device) -> None:
    d.armed()
    for i, servo in enumerate(d.limits):
        for wrong in (servo.min_urad // 100 - 1, servo.max_urad // 100 + 1, -32768, 32767):
            got = d.refusal(
                wire.MOVE,
                d.move([wrong if j == i else rest for j, rest in enumerate(d.rest)], 10_000),
            )
            d.expect(
                got == (Reason.angle, i),
                f"{SERVOS[i]} to {wrong} [1e-4 rad]: {got}, must be angle at servo {i}",
            )
        d.live(0.01)
    for duration_ms in (0, CONSTANTS["move_min_ms"] - 1, CONSTANTS["move_max_ms"] + 1, 0xFFFF):
        d.must(Reason.duration, wire.MOVE, d.move(0, duration_ms), f"of {duration_ms} ms")
    for i, servo in enumerate(d.limits):
        room = max(servo.max_urad - servo.rest_urad, servo.min_urad - servo.rest_urad, key=abs)
        rate = servo.rate_urad_s * 1e-6
        way = min(0.15 * rate, abs(room) * 1e-6)  # [rad]
        target = [
            rest + round(way * 1e4) * (1 if room > 0 else -1) if j == i else rest
            for j, rest in enumerate(d.rest)
        ]
        for flags, peak, times in ((0, 1.0, 1.5), (wire.MINIMUM_JERK, 1.875, 1.2)):
            duration_ms = max(int(1e3 * peak * way / (times * rate)), CONSTANTS["move_min_ms"])
            got = d.refusal(wire.MOVE, d.move(target, duration_ms), flags=flags)
            speed = 1e3 * peak * way / duration_ms
            d.expect(
                got == (Reason.rate, i) or speed < 1.15 * rate,
                f"{SERVOS[i]} at {speed:g} rad/s, flags {flags}: {got}, must be rate at servo {i}",
            )
            d.live(0.01)
    status = d.status()
    d.expect(
        not status.moving and list(status.servo) == d.rest,
        f"after refused moves {status.servo}, must be {d.rest}",
    )


def _repeats(d: Device) -> None:
    d.armed()
    seq = d.send(wire.HEARTBEAT, OURS) + 100
    first = d.move(1000)
    d.must(Reason.ok, wire.MOVE, first, "newer", seq=seq)
    d.arrive()
    d.must(Reason.ok, wire.MOVE, first, "the same frame again", seq=seq)
    d.must(Reason.stale, wire.MOVE, d.move(1500), "another MOVE of the same number", seq=seq)
    d.must(Reason.stale, wire.MOVE, first, "an older number", seq=seq - 1)
    d.must(
        Reason.stale,
        wire.MOVE,
        first,
        "a number half the circle ahead",
        seq=(seq + 0x8000) % 0x10000,
    )
    status = d.status()
    d.expect(not status.moving, "a repeated or old MOVE moves the hand")
    d.expect(status.last_seq == seq, f"last_seq {status.last_seq}, must be {seq}")
    d.must(
        Reason.ok, wire.MOVE, d.move(500), "the largest step ahead", seq=(seq + 0x7FFF) % 0x10000
    )


def _repeat_after_clear(d: Device) -> None:
    d.armed()
    seq = d.send(wire.HEARTBEAT, OURS) + 100
    d.must(Reason.ok, wire.MOVE, d.move(1000), seq=seq)
    d.must(Reason.ok, wire.CLEAR, OURS)
    d.must(Reason.ok, wire.ARM, d.arm())
    d.started()
    d.must(Reason.stale, wire.MOVE, d.move(1000), "that was carried out before CLEAR", seq=seq)


def _no_ack(d: Device) -> None:
    d.armed(watchdog_ms=CONSTANTS["watchdog_max_ms"])
    d.expect(
        d.ask(wire.HEARTBEAT, OURS, flags=wire.NO_ACK) is SILENCE,
        "HEARTBEAT without ACK was answered",
    )
    d.live(0.01)
    d.expect(
        d.ask(wire.MOVE, d.move(300), flags=wire.NO_ACK) is SILENCE, "MOVE without ACK was answered"
    )
    d.live(0.01)
    d.must(Reason.duration, wire.MOVE, d.move(0, 1), "without ACK, but refused", flags=wire.NO_ACK)


MOTION_RULES: dict[str, Callable[[Device], None]] = {
    "ARM checks hash, action and watchdog": _arm_bounds,
    "servos start one after the other; MOVE waits for them": _starting,
    "MOVE arrives; minimum jerk": _moves,
    "MOVE out of limits, too fast, too short, too long is refused": _move_bounds,
    "a MOVE comes once; old numbers are refused": _repeats,
    "a MOVE from before CLEAR is refused": _repeat_after_clear,
    "no ACK where none is wanted, refusals always": _no_ack,
}
