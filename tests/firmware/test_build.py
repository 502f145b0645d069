"""Building: the firmware, its evidence, and a missing compiler."""

import shutil
import subprocess
from pathlib import Path

import pytest

FIRMWARE = Path(__file__).parents[2] / "firmware"


def test_a_missing_compiler_is_one_clear_line_and_status_2(tmp_path):
    copy = tmp_path / "firmware"
    shutil.copytree(FIRMWARE, copy, ignore=shutil.ignore_patterns("build"))
    answer = subprocess.run(
        ["make", "-C", copy, "CC=no-such-cc"], capture_output=True, text=True, check=False
    )
    assert answer.returncode == 2
    lines = [line for line in answer.stderr.splitlines() if not line.startswith("make")]
    assert len(lines) == 1
    assert "no C compiler 'no-such-cc'" in lines[0]


@pytest.mark.parametrize(
    "path", sorted((FIRMWARE / "core").glob("*.[ch]")), ids=lambda path: path.name
)
def test_the_core_is_freestanding_without_heap_or_floating_point(path):
    text = path.read_text()
    included = {line.split()[1] for line in text.splitlines() if line.startswith("#include <")}
    assert included <= {"<stdint.h>", "<stdbool.h>", "<stddef.h>"}
    code = "\n".join(
        line for line in text.splitlines() if not line.lstrip().startswith(("/*", "*", "//"))
    )
    assert not any(word in code for word in ("malloc", "float ", "double "))


def test_the_core_has_no_writable_globals():
    if not shutil.which("nm"):
        pytest.skip("no nm: apt-get install binutils")
    answer = subprocess.run(
        ["nm", FIRMWARE / "build" / "libhpac.so"], capture_output=True, text=True, check=True
    )
    symbols = [line.split() for line in answer.stdout.splitlines()]
    writable = [s[-1] for s in symbols if len(s) == 3 and s[1] in "dDbBC" and "hpac" in s[-1]]
    exported = [s[-1] for s in symbols if len(s) == 3 and s[1] == "T"]
    assert writable == []
    assert all(name.startswith("hpac_") for name in exported if not name.startswith("_"))
