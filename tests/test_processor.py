"""The tests that another processor's rounding could break pass under that rounding too.

On x86-64, glibc has several variants of sine, cosine and their kin, and OpenBLAS and PyTorch
several kernels; which one runs depends on the processor. Environment variables choose the ones of
an old processor, so that no machine hides what fails on another one. The tests are those that the
marker `processor` names; what the gate leaves out of this pass is said there."""

import pytest

from tests.processes import ROOT, python

OLD_PROCESSOR = {
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX512F",
    "OPENBLAS_CORETYPE": "Nehalem",
    "ATEN_CPU_CAPABILITY": "default",
}
MARK = "pytest.mark." + "processor"
FILES = sorted(
    path for path in (ROOT / "tests").rglob("test_*.py") if MARK in path.read_text(encoding="utf-8")
)
LONGEST = "end_as_they_did and (GraspAny or GraspType)"
"""Tests that take as long as all others together, and add other objects to what these show; the
slow pass runs them.
"""
SINES = (
    "import math; print(hash(tuple(math.sin(0.1 * k) + math.cos(0.1 * k) for k in range(10_000))))"
)


@pytest.fixture(scope="module")
def old_processor() -> dict[str, str]:
    """Variables that choose another rounding."""
    if python("-c", SINES).stdout == python("-c", SINES, **OLD_PROCESSOR).stdout:
        pytest.skip(
            "no second pass: this machine has one sine only, or its C library is not glibc 2.33 or later for x86-64"
        )
    return OLD_PROCESSOR


def test_there_are_such_tests():
    assert {path.name for path in FILES} >= {"test_gate.py", "test_trained.py"}


@pytest.mark.parametrize(
    ("which", "left_out"),
    [
        ("processor and not slow", LONGEST),
        pytest.param("processor", "nothing", marks=pytest.mark.slow),
    ],
)
def test_the_same_tests_pass_with_the_rounding_of_an_old_processor(which, left_out, old_processor):
    """All in one process, since loading the packages takes as long as some of the tests."""
    names = [str(path.relative_to(ROOT)) for path in FILES]
    chosen = ["-m", which, "-k", f"not ({left_out})"]
    done = python("-m", "pytest", *names, "-rA", *chosen, "-p", "no:cacheprovider", **old_processor)
    assert done.returncode == 0, done.stdout[-3000:]
    passed = [line for line in done.stdout.splitlines() if line.startswith("PASSED")]
    assert [name for name in names if not any(name in line for line in passed)] == []
