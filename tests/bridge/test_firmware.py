"""The firmware for this computer: built in a checkout, or compiled once into the user's cache."""

import shutil
import subprocess
import sys

import pytest

import hpac
from hpac_gym.bridge import FirmwareMissing, HandLink, HostBoard, firmware
from hpac_gym.bridge.firmware import BUILD_VARIABLE, FOLDERS, firmware_file
from tests.options import refused


@pytest.fixture
def sources(tmp_path, monkeypatch):
    """A copy of the sources that nobody has built, and an empty cache."""
    folder = tmp_path / "firmware"
    shutil.copytree(FOLDERS[-1], folder, ignore=shutil.ignore_patterns("build", "test"))
    monkeypatch.setattr(firmware, "FOLDERS", (folder,))
    monkeypatch.setattr(firmware, "FLAGS", (*firmware.FLAGS, "-O0"))  # quicker to compile
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv(BUILD_VARIABLE, raising=False)
    return folder


def test_what_is_not_built_is_compiled_once_and_again_when_a_source_changes(
    sources, tmp_path, monkeypatch
):
    """In folders that may be given from where one stands."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", "cache")
    program = firmware_file("hpac_host")
    assert program.is_relative_to(tmp_path / "cache" / "hpac_gym")
    made = program.stat().st_mtime_ns
    with HostBoard() as board, HandLink(board.connect) as link:
        assert link.state == "idle"
    assert firmware_file("hpac_host").stat().st_mtime_ns == made
    with (sources / "core" / "hpac_ramp.h").open("a") as header:
        header.write("/* changed */\n")
    assert firmware_file("hpac_host") != program
    assert list(program.parent.iterdir()) == [program]
    monkeypatch.chdir(program.parent)
    monkeypatch.setenv(BUILD_VARIABLE, ".")
    with HostBoard() as board:
        assert board.port


def test_a_build_in_the_checkout_comes_first(sources):
    (sources / "build").mkdir()
    (sources / "build" / "hpac_host").touch()
    assert firmware_file("hpac_host") == sources / "build" / "hpac_host"


def test_programs_that_start_together_compile_without_harm(sources):
    script = (
        "from pathlib import Path; from hpac_gym.bridge import firmware, HostBoard; import sys\n"
        "firmware.FOLDERS = (Path(sys.argv[1]),)\n"
        "with HostBoard() as board: print(board.port)"
    )
    running = [
        subprocess.Popen([sys.executable, "-c", script, sources], stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    ports = [each.communicate(timeout=60)[0] for each in running]
    assert [each.returncode for each in running] == [0, 0]
    assert all(ports)


@pytest.mark.parametrize(
    ("break_it", "says"),
    [
        (lambda folder, m: m.setenv("CC", "/none/cc"), "there is no C compiler '/none/cc'"),
        (lambda folder, m: m.setenv("XDG_CACHE_HOME", "/proc/none"), "cannot write '/proc/none"),
        (
            lambda folder, m: (folder / "core" / "hpac_ramp.c").write_text("no C"),
            "'cc' cannot compile hpac_host: core/hpac_ramp.c:1",
        ),
        (lambda folder, m: shutil.rmtree(folder / "core"), "run `make firmware` in a checkout"),
        (
            lambda folder, m: m.setenv(BUILD_VARIABLE, str(folder)),
            "run `make firmware` in a checkout, or unset HPAC_FIRMWARE_BUILD",
        ),
    ],
)
def test_what_cannot_be_compiled_is_one_line(sources, monkeypatch, capsys, break_it, says):
    monkeypatch.delenv("CC", raising=False)
    break_it(sources, monkeypatch)
    assert says in refused(capsys, lambda: hpac.main(["clear", "--port", "host"]))


def test_a_real_port_needs_no_compiler(sources, monkeypatch, capsys):
    with HostBoard() as board:
        monkeypatch.setenv("CC", "/none/cc")
        assert hpac.main(["clear", "--port", board.port]) == 0
        assert "state idle" in capsys.readouterr().out
    with pytest.raises(FirmwareMissing):
        firmware_file("hpac_host")
