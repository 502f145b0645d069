"""Hands that a sweep allows as well as the calibrated one: draws from the posterior of its numbers,
which `hpac calibrate` writes into the report beside the hand file, and `hpac forecast` reads.

They hold as far as the hand obeys the laws of the fit."""

import json
from pathlib import Path

import numpy as np

from hpac_gym.calibration.combinations import digit_with, hand_with
from hpac_gym.calibration.identification import Identification
from hpac_gym.errors import HpacError
from hpac_gym.model import Hand

DRAWS = 50
"""Number of drawn hands (chosen)."""
_CMC = "thumb_cmc"


class PosteriorError(HpacError, ValueError):
    """There are no drawn hands beside a hand file, or they are of another file."""


def report_folder(hand_file: Path) -> Path:
    """The folder of the report that `hpac calibrate` writes beside a hand file."""
    return hand_file.with_name(f"{hand_file.stem}-report")


def drawn_hands(hand: Hand, draws: dict[str, list[list[float]]]) -> list[Hand]:
    """The hands of an identification's draws.

    Args:
        hand: the calibrated hand, whose numbers remain where there are no draws.
        draws: draws of each digit's `combinations` and of the CMC, as `draws_of`.
    """
    return [
        hand_with(
            hand,
            {
                name: digit_with(hand.digits[name], np.array(draws[name][number]))
                for name in hand.digits
                if name in draws
            },
            draws[_CMC][number] if _CMC in draws else None,
            name=f"{hand.name}, draw {number}",
        )
        for number in range(len(next(iter(draws.values()))))
    ]


def draws_of(identified: Identification) -> dict[str, list[list[float]]]:
    """An identification's draws by digit, and of the CMC, shape (draws, numbers) each."""
    draws = {name: fit.draws.tolist() for name, fit in identified.fits.items()}
    return draws | ({} if identified.cmc_draws is None else {_CMC: identified.cmc_draws.tolist()})


def draws_text(hand: Hand, identified: Identification) -> str:
    """The contents of `draws.json`."""
    text = {"zero": hand.calibration.servo_zero, "draws": draws_of(identified)}
    return json.dumps(text) + "\n"


def read_draws(hand_file: Path, hand: Hand) -> list[Hand]:
    """The drawn hands that lie beside a hand file.

    Raises:
        PosteriorError: There are none, or none of a digit or the CMC; or they are of another file.
    """
    path = report_folder(hand_file) / "draws.json"
    try:
        text = json.loads(path.read_text(encoding="utf-8"))
        hands = drawn_hands(hand, text["draws"])
        same = np.allclose(text["zero"], hand.calibration.servo_zero, rtol=0, atol=1e-9)
    except (
        OSError,
        ValueError,
        LookupError,
        TypeError,
        AttributeError,
        StopIteration,
        OverflowError,
        RecursionError,
    ) as error:
        raise PosteriorError(
            f"{path}, which 'hpac calibrate' writes beside {hand_file}, cannot be read: {error}"
        ) from None
    if not same:
        raise PosteriorError(
            f"{path} is of another hand than {hand_file}: the servos' zeros differ"
        )
    missing = [name for name in (*hand.digits, _CMC) if name not in text["draws"]]
    if missing:
        raise PosteriorError(
            f"{path} has no draws of {', '.join(missing)}, whose numbers are the design's and not this hand's: sweep all "
            "servos"
        )
    return hands
