"""Compile the ESP32 port's syntax against the headers of a real ESP-IDF: ``make -C firmware
idf-headers IDF=PATH``.

Every chip is tried, with the host's compiler: names, fields, arguments and enums are ESP-IDF's own.
FreeRTOS is still our stub, since its headers need a configured project. CMakeLists.txt is held
against the components that own the headers, since a component sees only those that it requires."""

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent
MAIN = HERE.parent / "main"
LOOP = HERE.parents[1] / "loop.c"
CORE = HERE.parents[2] / "core"
OLDEST = (5, 2)
CHIPS = {
    "esp32": (("-DESTOP_PIN=27",), ("-DESTOP_PIN=27", "-DSERVOS_ON_PCA9685=1")),
    "esp32s3": (("-DSUPPLY_ADC_CHANNEL=0",), ("-DPORT_IS_USB=1", "-DSERVOS_ON_PCA9685=1")),
    "esp32c6": (("-DESTOP_PIN=11", "-DSUPPLY_ADC_CHANNEL=0"), ("-DPORT_IS_USB=1",)),
    "esp32c3": (("-DPORT_IS_USB=1", "-DESTOP_PIN=0"), ("-DSERVOS_ON_PCA9685=1",)),
}
"""Chips and wirings."""
COMMON = {"esp_common", "freertos", "soc", "hal", "log", "esp_hw_support", "esp_rom", "heap"}
"""Components that every other one sees."""
OTHERS = ("linux", "bt", "wpa_supplicant", "freertos", "newlib", "esp_libc", "esp_ringbuf")
"""Components whose headers are left out: other boards, and those that stand behind our stubs."""


def version_of(idf: Path) -> tuple[int, int]:
    """Major and minor version of an ESP-IDF.

    Raises:
        SystemExit: There is none in this folder, or not one that the port is for.
    """
    path = idf / "tools" / "cmake" / "version.cmake"
    if not (idf / "components" / "esp_common").is_dir() or not path.is_file():
        sys.exit(f"no ESP-IDF in '{idf}': IDF= names the folder with its components/ and tools/")
    text = path.read_text()
    major, minor = (
        int(re.search(rf"IDF_VERSION_{part} (\d+)", text)[1]) for part in ("MAJOR", "MINOR")
    )
    if not (major, minor) >= OLDEST:
        sys.exit(
            f"ESP-IDF {major}.{minor} in '{idf}': the port needs {OLDEST[0]}.{OLDEST[1]} or later"
        )
    return major, minor


def folders_of(idf: Path, chip: str) -> list[Path]:
    """Folders with headers for one chip."""
    components = [
        path for path in (idf / "components").iterdir() if path.is_dir() and path.name not in OTHERS
    ]
    names = ("include", f"{chip}/include", f"include/{chip}", chip, f"{chip}/register")
    parts = [
        *components,
        *(part for path in components for part in path.iterdir() if part.is_dir()),
    ]
    return [part / name for part in parts for name in names if (part / name).is_dir()]


def sdkconfig(idf: Path, chip: str) -> str:
    """What a project's configuration would define: the chip and what it can do."""
    kconfig = idf / "components" / "soc" / chip / "include" / "soc" / "Kconfig.soc_caps.in"
    pattern = r"config (\w+)\n\s+(?:bool|int|hex)\n\s+default (\S+)"
    can = dict(re.findall(pattern, kconfig.read_text()))
    defined = {
        f"IDF_TARGET_{chip.upper()}": 1,
        "IDF_TARGET": f'"{chip}"',
        "FREERTOS_HZ": 1000,
        "LOG_MAXIMUM_LEVEL": 0,
        "LOG_DEFAULT_LEVEL": 0,
        "LOG_TIMESTAMP_SOURCE_RTOS": 1,
        **{name: 1 if value == "y" else value for name, value in can.items() if value != "n"},
    }
    return "".join(f"#define CONFIG_{name} {value}\n" for name, value in defined.items())


def required(version: tuple[int, int]) -> set[str]:
    """Components that CMakeLists.txt requires of this version."""
    text = (MAIN / "CMakeLists.txt").read_text()
    bound = tuple(map(int, re.search(r'VERSION_LESS "([\d.]+)"', text)[1].split(".")))
    older, newer = re.findall(r"set\(drivers ([^)]*)\)", text)
    rest = re.search(r"PRIV_REQUIRES \$\{drivers\} ([^)]*)\)", text)[1]
    return {*(older if version < bound else newer).split(), *rest.split()}


def owners(idf: Path, header: str) -> set[str]:
    """Components that export a header."""
    found = (idf / "components").glob(f"*/**/include/{header}")
    return {path.relative_to(idf / "components").parts[0] for path in found} - set(OTHERS)


def main() -> int:
    """Check one ESP-IDF; the exit status is 1 if anything does not compile or is not required."""
    idf = Path(sys.argv[1])
    version = version_of(idf)
    wrong = 0
    headers = {
        header
        for path in MAIN.glob("*.[ch]")
        for header in re.findall(
            r'#include "((?:driver|esp_adc|esp_\w+)[\w./]*)"', path.read_text()
        )
    }
    seen = required(version) | COMMON
    for header in sorted(headers):
        if not owners(idf, header) & seen:
            wrong += 1
            print(
                f"{header}: of {sorted(owners(idf, header))}, which CMakeLists.txt does not require"
            )
    compiler = os.environ.get("CC", "cc").split()
    with tempfile.TemporaryDirectory() as folder:
        for chip, wirings in CHIPS.items():
            Path(folder, "sdkconfig.h").write_text(sdkconfig(idf, chip))
            paths = [Path(folder), MAIN, LOOP.parent, CORE, *folders_of(idf, chip)]
            for wiring in wirings:
                for source in [*sorted(MAIN.glob("*.c")), LOOP]:
                    command = [
                        *compiler,
                        "-fsyntax-only",
                        "-std=gnu17",
                        "-Wall",
                        "-include",
                        "sdkconfig.h",
                    ]
                    command += [*wiring, *(f"-I{path}" for path in paths)]
                    command += [f"-idirafter{HERE / 'stubs'}", str(source)]
                    done = subprocess.run(command, capture_output=True, text=True, check=False)
                    ours = [
                        line
                        for line in done.stderr.splitlines()
                        if "error:" in line or str(MAIN) in line or str(LOOP) in line
                    ]
                    if done.returncode or ours:
                        wrong += 1
                        print(f"{chip} {' '.join(wiring)} {source.name}:", *ours[:5], sep="\n  ")
    count = sum(map(len, CHIPS.values())) * (len(list(MAIN.glob("*.c"))) + 1)
    print(
        f"idf-headers: ESP-IDF {version[0]}.{version[1]}, {len(CHIPS)} chips, {count} compilations, {wrong} wrong"
    )
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
