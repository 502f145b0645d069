"""One line for a mistake, and the exit status that says what happened."""

import argparse
import os
import subprocess
import sys
from pathlib import Path

import pytest

from hpac_gym.command_line import INTERRUPTED, USAGE_ERROR, MissingModule, Parser, needing, run, whole_number
from hpac_gym.errors import WorkspaceError


def raising(error: BaseException):
    def command() -> int:
        raise error

    return command


def test_the_status_is_the_commands_own():
    assert run(lambda: 0) == 0
    assert run(lambda: 7) == 7


def test_an_error_on_purpose_is_one_line_and_any_other_is_not_hidden(capsys):
    assert run(raising(WorkspaceError("2 rad\n  above 1 rad"))) == USAGE_ERROR
    assert capsys.readouterr().err == "error: 2 rad above 1 rad\n"
    with pytest.raises(ValueError, match="a bug"):
        run(raising(ValueError("a bug")))


SCRIPT = """
import sys
from hpac_gym.command_line import run
def command():
    print({words!r} * {times}, flush={flush})
    open({path!r}).close()
    return 0
sys.exit(run(command))
"""


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
@pytest.mark.parametrize("times", [1, 100_000], ids=["short", "longer than any buffer"])
@pytest.mark.parametrize("flush", [True, False])
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_full_standard_output_is_one_line(times, flush, unbuffered):
    script = SCRIPT.format(words="word ", times=times, flush=flush, path=os.devnull)
    told = {"env": os.environ | {"PYTHONUNBUFFERED": unbuffered}, "stderr": subprocess.PIPE, "text": True}
    with Path("/dev/full").open("w") as full:
        done = subprocess.run([sys.executable, "-c", script], stdout=full, timeout=60, **told)
    assert (done.returncode, done.stderr) == (USAGE_ERROR, "error: cannot write to standard output: No space left on device\n")


def test_a_fault_of_another_file_is_not_taken_for_one_of_standard_output():
    script = SCRIPT.format(words="word", times=1, flush=False, path="/no/such/file")
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    assert "FileNotFoundError" in done.stderr
    assert done.stdout == "word\n"


def test_ctrl_c_has_its_own_status(capsys):
    assert run(raising(KeyboardInterrupt())) == INTERRUPTED
    assert capsys.readouterr().err == "interrupted\n"


def test_the_parser_complains_in_one_line(capsys):
    with pytest.raises(SystemExit) as left:
        Parser(prog="hpac some").parse_args(["--nonsense"])
    assert left.value.code == USAGE_ERROR
    assert capsys.readouterr().err == "error: unrecognized arguments: --nonsense (see hpac some --help)\n"


@pytest.mark.parametrize("text", ["0", "-3", "1.5", "many", ""])
def test_what_is_no_whole_number_of_that_size_is_refused(text):
    assert whole_number(1)("12") == 12
    with pytest.raises(argparse.ArgumentTypeError, match=f"'{text}' is not a whole number of at least 1"):
        whole_number(1)(text)


def test_a_missing_package_is_told_with_the_extra_that_brings_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(MissingModule, match=r"pip install 'hpac_gym\[grasps\]' \(no module PIL\)"), needing("grasps"):
        import PIL  # noqa: F401


def test_a_missing_module_of_this_package_is_a_bug_and_no_missing_extra():
    with pytest.raises(ModuleNotFoundError) as caught, needing("grasps"):
        import hpac_gym.nothing  # noqa: F401
    assert not isinstance(caught.value, MissingModule)
