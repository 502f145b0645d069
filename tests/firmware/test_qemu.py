"""The core on an emulated rv32imc microcontroller: live over a pseudo-terminal, and to the bit
under -icount.
"""

import re
import shutil
import subprocess
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from hpac_gym.bridge import HandLink, servo_from_pulses
from hpac_gym.bridge.protocol import CONSTANTS
from hpac_gym.model import HPAC, stream_command

FIRMWARE = Path(__file__).parents[2] / "firmware"
MACHINE = (
    *("qemu-system-riscv32", "-M", "virt", "-cpu", "rv32,a=false,f=false,d=false"),
    *("-bios", "none", "-display", "none", "-monitor", "none"),
)
TOOLS = {
    "qemu-system-riscv32": "qemu-system-misc",
    "riscv64-unknown-elf-gcc": "gcc-riscv64-unknown-elf",
}
MISSING = [
    f"{tool} (Debian: apt-get install {package})"
    for tool, package in TOOLS.items()
    if not shutil.which(tool)
]

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(bool(MISSING), reason=f"SKIPPED: no {' and no '.join(MISSING)}"),
]


def image(name):
    subprocess.run(["make", "-s", "-C", FIRMWARE, f"build/{name}"], check=True)
    return str(FIRMWARE / "build" / name)


@contextmanager
def running(name):
    """The board as a process; gives the port."""
    command = [*MACHINE, "-serial", "pty", "-kernel", image(name)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        yield re.search(r"/dev/\S+", process.stdout.readline())[0]
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


PATIENT = {"timeout": 0.3, "attempts": 10}
WATCHDOG = CONSTANTS["watchdog_max_ms"] * 1e-3
"""An emulated board on a busy machine is later than any real one."""


def test_a_live_session_over_a_pseudo_terminal():
    with running("hpac_qemu.elf") as port, HandLink(port, **PATIENT) as link:
        link.arm(watchdog=WATCHDOG)
        servo = np.zeros(6)
        for _ in range(40):
            command = stream_command(servo, HPAC.servo_max * 0.9, 0.05)
            servo = command.servo
            link.move(command)
        np.testing.assert_allclose(link.wait().servo, servo, atol=1e-4)
        assert link.statistics.rejected == 0
        start = time.monotonic()
        link.estop()
        assert time.monotonic() - start < 3.0  # on a busy machine
        assert link.status().fault == "estop"
        print(
            f"round trip p50 {1e3 * link.statistics.round_trip(50):.2f} ms, p99 {1e3 * link.statistics.round_trip(99):.2f} ms"
        )


def test_silence_trips_the_watchdog_of_the_emulated_board():
    with running("hpac_qemu.elf") as port, HandLink(port, **PATIENT) as link:
        link.arm(watchdog=WATCHDOG)
        time.sleep(WATCHDOG + 0.5)
        assert link.status().fault == "watchdog"


def golden_run():
    command = [
        *MACHINE,
        "-icount",
        "shift=3,align=off,sleep=off",
        "-serial",
        "stdio",
        "-kernel",
        image("golden_qemu.elf"),
    ]
    return subprocess.run(
        command, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=60, check=True
    ).stdout


def test_the_golden_trajectory_repeats_to_the_bit_and_is_minimum_jerk():
    first = golden_run()
    assert first == golden_run()
    start_us, *lines = first.splitlines()
    rows = np.array([[int(word) for word in line.split()] for line in lines])
    assert len(rows) == 49
    share = (rows[:, 0] - int(start_us)) / 500_000
    assert share[0] < 0.05
    assert share[-1] > 0.95
    shape = 10 * share**3 - 15 * share**4 + 6 * share**5
    expected = shape[:, None] * np.arange(1, 7) * 0.05
    np.testing.assert_allclose(servo_from_pulses(rows[:, 1:]), expected, atol=1e-5)
