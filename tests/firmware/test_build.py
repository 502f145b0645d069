"""Building: the firmware, its evidence, and a missing compiler."""

import shutil
import subprocess
from pathlib import Path

import pytest

from tests.processes import python

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


def test_mutants_of_a_source_that_there_is_not_are_refused_with_those_that_there_are():
    answer = python(str(FIRMWARE / "test" / "mutants.py"), "none.c")
    assert answer.returncode == 2
    assert "no source 'none.c': there are hpac_answer.c" in answer.stderr


@pytest.mark.parametrize(
    ("trim", "refused"), [(32_767, False), (32_768, True), (-32_768, False), (-32_769, True)]
)
def test_a_trim_that_the_wire_cannot_tell_is_refused_by_both_boards_with_its_bounds(trim, refused):
    port = FIRMWARE / "board" / "esp32"
    folders = ("test/stubs", "main", "..", "../../core")
    command = ["cc", "-fsyntax-only", "-std=gnu11", "-DSTUB_TARGET=32"]
    command += [
        f"-DSERVO_TRIMS_NS=0, 0, {trim}, 0, 0, 0",
        *(f"-I{port / folder}" for folder in folders),
    ]
    compiled = subprocess.run(
        [*command, port / "main" / "main.c"], capture_output=True, text=True, check=False
    )
    assert (compiled.returncode != 0) == refused
    assert ("outside of -32768 to 32767 ns" in compiled.stderr) == refused
    host = subprocess.run(
        [FIRMWARE / "build" / "hpac_host", "--trim", "2", str(trim), "--parent", "1"],
        capture_output=True,
        text=True,
        check=False,
    )
    said = f"hpac_host: --trim 2 {trim} ns, allowed -32768 to 32767 ns\n" if refused else ""
    assert (host.returncode, host.stderr) == (2 * refused, said)


@pytest.mark.parametrize(
    "path",
    [*sorted((FIRMWARE / "core").glob("*.[ch]")), *sorted((FIRMWARE / "board").glob("*.[ch]"))],
    ids=lambda path: path.name,
)
def test_core_and_loop_are_freestanding_without_heap_or_floating_point(path):
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
