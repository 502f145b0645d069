"""The tests that another processor's rounding could break pass under that rounding too.

On x86-64, glibc has several variants of sine, cosine and their kin, and OpenBLAS and PyTorch
several kernels; which one runs depends on the processor. Environment variables choose the ones of
an old processor, so that no machine hides what fails on another one. The tests are those that the
marker `processor` names; what the gate leaves out of this pass is said there."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[1]
OLD_PROCESSOR = {
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX512F",
    "OPENBLAS_CORETYPE": "Nehalem",
    "ATEN_CPU_CAPABILITY": "default",
}
MARK = "pytest.mark." + "processor"
FILES = sorted(
    path
    for path in (REPOSITORY / "tests").rglob("test_*.py")
    if MARK in path.read_text(encoding="utf-8")
)
LONGEST = "end_as_they_did and (GraspAny or GraspType)"
"""Tests that take as long as all others together, and add other objects to what these show; the
slow pass runs them.
"""
SINES = (
    "import math; print(hash(tuple(math.sin(0.1 * k) + math.cos(0.1 * k) for k in range(10_000))))"
)


def run(*words: str, **variables: str) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": str(REPOSITORY)} | variables
    return subprocess.run(
        [sys.executable, *words],
        capture_output=True,
        text=True,
        cwd=REPOSITORY,
        env=environment,
        timeout=600,
        check=False,
    )


@pytest.fixture(scope="module")
def old_processor() -> dict[str, str]:
    """Variables that choose another rounding."""
    if run("-c", SINES).stdout == run("-c", SINES, **OLD_PROCESSOR).stdout:
        pytest.skip(
            "no second pass: this machine has one sine only, or its C library is not glibc 2.33 or later for x86-64"
        )
    return OLD_PROCESSOR


def test_there_are_such_tests():
    assert {path.name for path in FILES} >= {"test_gate.py", "test_trained.py"}


@pytest.mark.parametrize("left_out", [LONGEST, pytest.param("nothing", marks=pytest.mark.slow)])
def test_the_same_tests_pass_with_the_rounding_of_an_old_processor(left_out, old_processor):
    """All in one process, since loading the packages takes as long as some of the tests."""
    names = [str(path.relative_to(REPOSITORY)) for path in FILES]
    chosen = ["-m", "processor and not slow", "-k", f"not ({left_out})"]
    done = run("-m", "pytest", *names, "-rA", *chosen, "-p", "no:cacheprovider", **old_processor)
    assert done.returncode == 0, done.stdout[-3000:]
    passed = [line for line in done.stdout.splitlines() if line.startswith("PASSED")]
    assert [name for name in names if not any(name in line for line in passed)] == []
