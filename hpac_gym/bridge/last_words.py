"""The last words to a hand: CLEAR, then ESTOP, until it confirms that its pulses are off.

One that relaxes in a fault is waited for, and one without pulses in a fault is left in it."""

from collections import Counter

from hpac_gym.bridge.errors import LinkTimeout, PortError, tell
from hpac_gym.bridge.exchange import Exchange
from hpac_gym.bridge.protocol import Fault, Reason
from hpac_gym.progress import Late

TAKEN_OVER = (
    "another program has greeted the hand since, or the board has restarted: it is left as it is"
)
LAST_WORDS_TIME = 3.0
"""How long a silent hand is asked to switch its pulses off [s]."""
RELAX_TIME = 5.0
"""How long a hand that relaxes is waited for [s]: the nominal one needs 3.2 (chosen)."""
_POLL = 0.05
_ATTEMPTS: tuple[tuple[str, ...], ...] = (("clear", "status"),) * 3 + (("estop", "status"),) * 2
"""Messages that end the pulses, each with a question after the state if it was refused."""
_ATTEMPTS_UNGREETED = (("hello", "status"), ("clear", "status")) * 3
"""The same for a device that never answered: not a hand, perhaps, or one that an earlier session
left holding in a fault; sent once, since nothing says that a hand is there.
"""


def release(exchange: Exchange, greeted: bool, timeout: float) -> tuple[str, BaseException | None]:
    """Send the last words: all of them once, and then again for `LAST_WORDS_TIME`.

    Args:
        greeted: whether the hand has answered HELLO.
        timeout: time-out of one answer [s].

    Returns:
        A sentence on the failed attempts, empty if the hand has confirmed; and the interrupt
        received in the meantime (`KeyboardInterrupt`, `SystemExit`), or None.
    """
    known = exchange.known
    told = known.in_fault
    interrupt = _relaxed(exchange, timeout) if greeted and known.may_have_power else None
    fault = known.fault
    until = exchange.transport.now() + LAST_WORDS_TIME
    sent: Counter[str] = Counter()
    failure = "no answer"
    port_gone = False
    late = Late("asking the hand to stop: no answer yet")
    attempts = _ATTEMPTS if greeted else _ATTEMPTS_UNGREETED
    while known.may_have_power and attempts:
        for messages in attempts:
            late()
            try:
                for name in messages:
                    if known.may_have_power:
                        if name == "clear" and known.fault == Fault.estop.name:
                            name = "estop"  # CLEAR would leave the fault
                        sent[name] += 1
                        answer = exchange.request(name, timeout=timeout, attempts=1, late=True)
                        if answer.name == "ack" and answer.number("reason") == Reason.session:
                            return TAKEN_OVER, interrupt
            except LinkTimeout:
                pass
            except Exception as error:
                failure = str(error)
                port_gone = isinstance(error, PortError)
            except BaseException as error:
                interrupt = interrupt or error
        again = greeted and not port_gone and exchange.transport.now() < until
        attempts = _ATTEMPTS if again else ()
    if not known.may_have_power:
        if sent["estop"] and fault != Fault.estop.name:
            tell(
                UserWarning(
                    "CLEAR was not answered in time, ESTOP was sent: `hpac clear` leaves it"
                )
            )
        elif known.in_fault and not told:
            tell(UserWarning(f"the hand is in fault ({known.fault}): `hpac clear` leaves it"))
        return "", interrupt
    tried = ", ".join(f"{name.upper()} × {count}" for name, count in sent.items())
    advice = "if the servos hold, switch their supply off; the hand's watchdog acts by itself if it was armed"
    return (
        f"the hand has not confirmed that it has no pulses (sent {tried or 'nothing'}: {failure}); {advice}",
        interrupt,
    )


def _relaxed(exchange: Exchange, timeout: float) -> BaseException | None:
    """Ask a hand in a fault after its state, which may confirm that it has no pulses, and wait while
    it relaxes; returns the interrupt received in the meantime, which ends the wait. Whether it is
    in one is asked once: the stop of another program may have read what the hand said.
    """
    known = exchange.known
    until = exchange.transport.now() + RELAX_TIME
    late = Late("waiting until the hand has relaxed")
    try:
        if not known.in_fault:  # pulses stay on while this waits
            exchange.request("hello", {"nonce": 0}, timeout=min(timeout, 0.1), attempts=1)
        while known.in_fault and exchange.transport.now() < until:
            exchange.request("status", timeout=timeout, attempts=10)
            if not (known.may_have_power and known.status and known.status.moving):
                break
            late()
            exchange.listen(_POLL)
    except Exception:  # the last words tell
        return None
    except BaseException as error:
        return error
    return None
