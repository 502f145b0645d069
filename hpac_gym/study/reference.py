"""The reference hand: the nominal one with tolerances, friction, drive stretch and a camera, from one file and its seed."""

from __future__ import annotations

import math
import os
import tomllib
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from hpac_gym.errors import ParameterError
from hpac_gym.model import HPAC, Digit
from hpac_gym.study.bench import JointCamera, Protocol
from hpac_gym.study.populations import varied_hand
from hpac_gym.study.rig import Rig, settings_of

REFERENCE_FILE = Path(__file__).parent / "data" / "reference.toml"
SCHEMA = 1
_NUMBERS = tuple(item.name for item in fields(Digit) if item.name not in ("name", "tension_limit"))
_FIELDS = {
    "tolerance": _NUMBERS,
    "physics": ("joint_friction", "dead_band"),
    "camera": ("rate_hz", "noise_deg", "drift_deg_per_min"),
    "protocol": ("points", "seconds_per_point", "hold", "rest", "cutoff_hz"),
    "trials": ("tendon_friction", "friction_spread", "seat"),
    "tracking": ("servo_lag",),
}


@dataclass(frozen=True, slots=True)
class TrialSettings:
    """Differences between two trials of one hand."""

    tendon_friction: float
    """Friction at every joint's guides as a share of the tendons' load."""
    friction_spread: float
    """Relative standard deviation of the frictions."""
    seat: float
    """Standard deviation of the driving tendon's seat on its hub, loose or tight [m]."""


@dataclass(frozen=True, slots=True)
class Reference:
    """A rig whose hand deviates from the nominal one, with the filter of its record."""

    rig: Rig
    cutoff_hz: float
    seed: int
    trials: TrialSettings
    servo_lag: float
    """Delay from the command to the servo's answer, in tracking [s]."""


def load_reference(path: str | os.PathLike[str] = REFERENCE_FILE, seed: int | None = None) -> Reference:
    """Load the reference hand described by a TOML file as deviations from the nominal hand; `seed` replaces the file's seed.

    Raises:
        ParameterError: The file cannot be read or is not TOML, or a number is missing, unknown or negative.
    """
    try:
        table = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ParameterError(f"reference file {path}: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ParameterError(f"reference file {path}: not TOML: {error}") from None
    if table.get("schema") != SCHEMA:
        raise ParameterError(f"reference file {path}: schema {table.get('schema')!r} is not {SCHEMA}")
    _check(table, path)
    seed = table["seed"] if seed is None else seed
    camera, protocol = table["camera"], dict(table["protocol"])
    cutoff_hz = protocol.pop("cutoff_hz")
    rig = Rig(
        hand=varied_hand(HPAC, table["tolerance"], np.random.default_rng(seed)),
        settings=settings_of(**table["physics"]),
        camera=JointCamera(camera["rate_hz"], math.radians(camera["noise_deg"]), math.radians(camera["drift_deg_per_min"]) / 60),
        protocol=Protocol(**protocol),
    )
    return Reference(rig, cutoff_hz, seed, TrialSettings(**table["trials"]), table["tracking"]["servo_lag"])


def _check(table: dict, path: str | os.PathLike[str]) -> None:
    if not isinstance(table.get("seed"), int):
        raise ParameterError(f"reference file {path}: seed must be a whole number, not {table.get('seed')!r}")
    for name, known in _FIELDS.items():
        section = table.get(name)
        if not isinstance(section, dict):
            raise ParameterError(f"reference file {path}: table [{name}] is missing")
        required = () if known is _NUMBERS else known
        wrong = sorted((set(section) - set(known)) | (set(required) - set(section)))
        if wrong:
            raise ParameterError(f"reference file {path}: [{name}] lacks or does not know {', '.join(wrong)}")
        for field, value in section.items():
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 <= value < math.inf:
                raise ParameterError(f"reference file {path}: {field} = {value!r} must be a number of at least 0")
