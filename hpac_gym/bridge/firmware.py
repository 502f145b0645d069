"""The firmware's programs for this computer: those that a checkout has built, or compiled once into the
user's cache from the sources that come with the package."""

import hashlib
import os
import platform
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

from hpac_gym.bridge.errors import FirmwareMissing

BUILD_VARIABLE = "HPAC_FIRMWARE_BUILD"
"""Environment variable for a build folder, which is then the only one."""
PACKAGE = Path(__file__).resolve().parents[1]
FOLDERS = (PACKAGE / "firmware", PACKAGE.parent / "firmware")
"""Places of the sources: in an installed package, in a checkout."""
FLAGS = ("-std=c99", "-O2", "-Icore", "-Iboard", "-Iboard/host")
PROGRAMS = {
    "hpac_host": ("board/loop.c", "board/host/main.c"),
    "libhpac.so": ("board/host/library.c", "-fPIC", "-shared"),
}
"""What is compiled at first use, and from what beside the core."""


def firmware_file(name: str) -> Path:
    """Path of a program of the firmware: `hpac_host`, `hpac_driver` or `libhpac.so`.

    Raises:
        FirmwareMissing: It is not in the build folder, and cannot be compiled.
    """
    folder = next((folder for folder in FOLDERS if (folder / "core").is_dir()), FOLDERS[-1])
    given = os.environ.get(BUILD_VARIABLE)
    built = (Path(given).absolute() if given else folder / "build") / name
    if built.exists():
        return built
    if given or name not in PROGRAMS or not (folder / "core").is_dir():
        unset = f", or unset {BUILD_VARIABLE}" if given else ""
        raise FirmwareMissing(f"{built} is missing: run `make firmware` in a checkout{unset}")
    return _compiled(folder, name)


def _compiled(folder: Path, name: str) -> Path:
    """A program in the user's cache, under a key of its sources, its compiler and this machine."""
    compiler = shlex.split(os.environ.get("CC") or "cc")
    try:
        version = subprocess.run(
            [*compiler, "--version"], capture_output=True, check=True, stdin=subprocess.DEVNULL
        ).stdout
    except (OSError, subprocess.CalledProcessError):
        raise FirmwareMissing(
            f"a virtual hand is the firmware, compiled at its first use, and there is no C compiler '{shlex.join(compiler)}': "
            "install one (Debian: apt-get install gcc libc6-dev) or set CC; a real hand needs none"
        ) from None
    core = sorted(path.relative_to(folder) for path in folder.glob("core/*.c"))
    command = [*compiler, *FLAGS, *map(str, core), *PROGRAMS[name]]
    key = hashlib.sha256(repr((command, version, platform.machine())).encode())
    sources = [*folder.glob("core/*.[ch]"), *folder.glob("board/*.[ch]")]
    for path in sorted([*sources, *folder.glob("board/host/*.[ch]")]):
        key.update(path.name.encode() + b"\0" + path.read_bytes())
    usual = os.path.expanduser("~/Library/Caches" if sys.platform == "darwin" else "~/.cache")
    cache = Path(os.environ.get("XDG_CACHE_HOME") or usual).absolute() / "hpac_gym" / "firmware"
    path = cache / key.hexdigest()[:16] / name
    if path.exists():
        return path
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent) as scratch:
            made = Path(scratch) / name
            done = subprocess.run(
                [*command, "-o", made], cwd=folder, capture_output=True, text=True, check=False
            )
            if done.returncode == 0:
                made.replace(path)
                return path
    except OSError as error:
        reason = error.strerror or str(error)
        raise FirmwareMissing(
            f"cannot write '{path}': {reason}; XDG_CACHE_HOME names another folder"
        ) from None
    said = done.stderr.strip().splitlines() or ["it gives no reason"]
    reason = next((line for line in said if "error" in line), said[-1])
    raise FirmwareMissing(f"'{shlex.join(compiler)}' cannot compile {name}: {reason}")
