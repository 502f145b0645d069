"""Where the host build of the firmware lies."""

from __future__ import annotations

import os
from pathlib import Path

from hpac_gym.bridge.errors import FirmwareMissing

BUILD_VARIABLE = "HPAC_FIRMWARE_BUILD"
"""Environment variable that names another build folder, for a program that runs outside of a checkout."""


def firmware_file(name: str) -> Path:
    """Path of a file of the host build, `hpac_host` or `libhpac.so`.

    Raises:
        FirmwareMissing: It has not been built.
    """
    checkout = Path(__file__).parents[2] / "firmware" / "build"
    path = Path(os.environ.get(BUILD_VARIABLE, checkout)) / name
    if not path.exists():
        raise FirmwareMissing(f"{path} is missing: run `make firmware` in a checkout, or set {BUILD_VARIABLE}")
    return path
