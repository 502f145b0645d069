"""The `hpac` command as a person types it: one line for a mistake, and an exit status that says
what happened.
"""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path
from unittest.mock import Mock

import pytest

import hpac_gym
from hpac import COMMANDS, GROUPS, completion, main
from hpac_gym.command import USAGE_ERROR, run
from hpac_gym.errors import EXTRA_OF, WorkspaceError
from tests.options import help_of, refused
from tests.processes import ROOT, python

POSED = ["--object", "cylinder:0.02,0.05", "--pose", "0.05,0.005,0.11"]
NAMES = [command.name for command in COMMANDS]
HEAVY = {"numpy", "scipy", "matplotlib", "gymnasium", "pybullet", "mujoco", "torch"}


REFUSING = """
import importlib.abc, sys

class Refuse(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in refused:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

refused = set(sys.argv[1].split(","))
sys.meta_path.insert(0, Refuse())
"""
LISTS_MODULES = (
    REFUSING
    + """
import hpac
for words in sys.argv[2:]:
    try:
        status = hpac.main(words.split())
    except SystemExit as left:
        status = left.code
    print(f"status {status}: {words}: ", *sys.modules, flush=True)
"""
)


def loaded(done: subprocess.CompletedProcess[str]) -> dict[str, set[str]]:
    """The modules that `LISTS_MODULES` has loaded, by status and words of each command."""
    found = re.findall(r"^(status \w+: .*):  (.*)", done.stdout, re.M)
    return {words: set(modules.split()) for words, modules in found}


def test_the_list_of_commands_loads_no_heavy_package():
    done = python("-c", LISTS_MODULES, "", "--help", "nonsense")
    found = loaded(done)
    assert list(found) == ["status 0: --help", "status 2: nonsense"]
    assert not HEAVY & set.union(*found.values())


def test_the_help_of_a_command_needs_no_extra_and_loads_no_engine():
    """One after the other in one interpreter: the first one named is to blame."""
    refused = ",".join({*EXTRA_OF, "viser"})
    done = python(
        "-c", LISTS_MODULES, refused, *(f"{name} --help" for name in NAMES), "posture all"
    )
    *helps, (needing, modules) = loaded(done).items()
    assert [words for words, _ in helps] == [f"status 0: {name} --help" for name in NAMES]
    assert re.findall(r"^usage: hpac (\w+)", done.stdout, re.M) == NAMES
    assert "(default: runs/deploy.jsonl)" in done.stdout
    assert modules >= {"numpy", "gymnasium"}
    assert [
        words for words, found in helps if {"pybullet", "mujoco", "scipy.optimize"} & found
    ] == []
    assert needing == "status 2: posture all", "something of what is refused is needed elsewhere"
    assert done.stderr.startswith("error: this command needs more: pip install '.[study]'")


def test_help_lists_every_command_with_its_line_by_group():
    said = help_of()
    assert {row.group for row in COMMANDS} == set(GROUPS)
    for group, about in GROUPS.items():
        listed = said.partition(f"\n{group}: {about}\n")[2].partition("\n\n")[0]
        rows = [[row.name, row.help] for row in COMMANDS if row.group == group]
        assert [line.split(maxsplit=1) for line in listed.splitlines()] == rows


def test_completion_knows_commands_options_and_files():
    script = completion()

    def completed(*words: str) -> list[str]:
        ask = f"COMP_WORDS=({' '.join(words)!s}); COMP_CWORD={len(words) - 1}; _hpac; echo ${{COMPREPLY[@]}}"
        done = subprocess.run(
            ["bash", "-c", f"{script}\n{ask}"], capture_output=True, text=True, check=True
        )
        return done.stdout.split()

    assert completed("hpac", "do") == ["doctor"]
    assert completed("hpac", "benchmark", "--tr") == ["--training-seeds"]
    assert completed("hpac", "nonsense", "--a") == []
    assert "complete -o default" in script


@pytest.mark.skipif(shutil.which("zsh") is None, reason="no zsh")
def test_completion_is_registered_in_a_bare_zsh():
    words = ["zsh", "-f", "-c", f"{completion()}\nprint -r -- $_comps[hpac]"]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("_bash_complete -o default -F _hpac\n", "")


def test_one_place_says_how_to_install_an_extra():
    """The package is on no index: every message names the checkout."""
    sources = [path for path in (ROOT / "hpac_gym").rglob("*.py") if path.name != "errors.py"]
    sources += [*(ROOT / "agents").glob("*.py"), *(ROOT / "experiments").glob("*.py")]
    texts = {path: path.read_text(encoding="utf-8") for path in sources}
    assert not [path for path, text in texts.items() if re.search(r"hpac_gym\[|'\.\[", text)]


def test_a_command_runs_in_a_folder_that_was_deleted(tmp_path):
    script = "import os, sys, hpac\nos.rmdir(os.getcwd())\nsys.exit(hpac.main(['estop', '--help']))"
    (tmp_path / "gone").mkdir()
    done = python("-c", script, folder=tmp_path / "gone")
    assert done.returncode == 0
    assert "usage: hpac estop" in done.stdout


def test_without_a_command_the_list_is_told(capsys):
    with pytest.raises(SystemExit, match=str(USAGE_ERROR)):
        main([])
    told = capsys.readouterr()
    assert told.out == ""
    assert all(f"  {row.name} " in told.err for row in COMMANDS)


def test_the_version_and_the_completion_are_told(capsys):
    for option in ("--version", "--completion"):
        with pytest.raises(SystemExit, match="0"):
            main([option])
    assert capsys.readouterr().out == f"hpac_gym {hpac_gym.__version__}\n{completion()}\n"
    assert metadata.version("hpac_gym") == hpac_gym.__version__


@pytest.mark.parametrize("name", NAMES)
def test_a_help_tells_of_json_no_empty_default_and_none_in_the_form_of_python(name):
    told = help_of(name)
    assert re.search(r"^  --json  +print", told, re.M)
    assert not re.search(r"\(default: *[)\[]", told)


def test_a_command_that_takes_a_policy_takes_its_statistics():
    found = {name: set(re.findall(r"^  (--[\w-]+|policy) ", help_of(name), re.M)) for name in NAMES}
    taking = [name for name, options in found.items() if options & {"--policy", "policy"}]
    assert {"deploy", "grasps", "show"} <= set(taking)
    assert [name for name in taking if "--normalize" not in found[name]] == ["export"]


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["clear", "--port", "virtual"], ["left", "state", "attached"]),
        (["estop", "--port", "virtual"], ["stopped", "fault"]),
        (["wiggle", "--port", "virtual", "--servo", "ring_mcp"], ["servo", "number"]),
        (
            ["deploy", "grasp", *POSED, "--dry-run"],
            ["observation", "servos", "start_rad", "first_command_rad", "wrist"],
        ),
    ],
    ids=lambda words: words[0],
)
def test_json_is_all_that_a_command_prints(words, names, capsys):
    assert main([*words, "--json"]) == 0
    (line,) = capsys.readouterr().out.splitlines()
    assert list(json.loads(line)) == names


def test_json_of_a_deployment_and_its_replay(tmp_path, capsys):
    log = str(tmp_path / "log.jsonl")
    for words in (["deploy", "grasp", *POSED, "--port", "virtual", "--log", log], ["replay", log]):
        assert main([*words, "--json"]) == 0
    _, counts, replayed = map(json.loads, capsys.readouterr().out.splitlines())
    assert counts["commands"] == replayed["steps"] > 0
    assert (counts["refused"], counts["log"], replayed["end"]) == (0, log, "done")


def test_the_status_is_the_command_s_an_error_on_purpose_one_line_and_any_other_is_not_hidden(
    capsys,
):
    assert [run(lambda status=status: status) for status in (0, 7)] == [0, 7]
    assert run(Mock(side_effect=WorkspaceError("2 rad\n  above 1 rad"))) == USAGE_ERROR
    assert capsys.readouterr().err == "error: 2 rad above 1 rad\n"
    with pytest.raises(ValueError, match="a bug"):
        run(Mock(side_effect=ValueError("a bug")))


SWALLOWS = """
import os, signal
try:
    os.kill(os.getpid(), signal.SIGINT)
    sum(range(1_000_000))
except BaseException:
    pass
"""
"""What trimesh does with a Ctrl-C during its import."""


@pytest.mark.parametrize(
    "program",
    [
        "import hpac_gym.view",
        "import hpac_gym.physics.mujoco",
        "from hpac_gym.body.own_meshes import _decomposed; _decomposed('a.stl', {})",
    ],
)
def test_ctrl_c_during_an_import_that_catches_everything_is_not_lost(program, tmp_path):
    for package in ("viser", "coacd", "trimesh", "mujoco"):
        (tmp_path / f"{package}.py").write_text(SWALLOWS)
    path = os.pathsep.join((str(tmp_path), str(ROOT)))
    done = python("-c", f"{program}; print('it goes on')", PYTHONPATH=path)
    assert done.stdout == ""
    assert done.stderr.endswith("KeyboardInterrupt\n")


SCRIPT = """
import sys
from hpac_gym.command import run
def command():
    print({words!r} * {times}, flush={flush})
    open({path!r}).close()
    return 0
sys.exit(run(command))
"""


def printing(times: int, flush: bool) -> str:
    """A program that prints a word so many times, which may be more than any buffer holds."""
    return SCRIPT.format(words="word ", times=times, flush=flush, path=os.devnull)


NO_SPACE = "No space left on device"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
@pytest.mark.parametrize(
    ("words", "output", "reason"),
    [
        (["-u", "-m", "hpac", "--help"], "> /dev/full", NO_SPACE),
        (["-m", "hpac", "--version"], "> /dev/full", NO_SPACE),
        (["-c", printing(1, False)], "> /dev/full", NO_SPACE),
        (["-c", printing(1, True)], "> /dev/full", NO_SPACE),
        (["-c", printing(100_000, False)], "> /dev/full", NO_SPACE),
        (["-m", "hpac", "--help"], ">&-", "it is closed"),
    ],
    ids=["help", "version", "short", "short, flushed", "long", "closed"],
)
def test_a_full_or_closed_standard_output_is_one_line_and_status_2(words, output, reason):
    command = f"{shlex.join([sys.executable, *words])} {output}"
    done = subprocess.run(command, shell=True, stderr=subprocess.PIPE, text=True, timeout=600)
    complaint = f"error: cannot write to standard output: {reason}\n"
    assert (done.returncode, done.stderr) == (USAGE_ERROR, complaint)


def test_a_fault_of_another_file_is_not_taken_for_one_of_standard_output():
    done = python("-c", SCRIPT.format(words="word", times=1, flush=False, path="/no/such/file"))
    assert done.returncode == 1
    assert "FileNotFoundError" in done.stderr
    assert done.stdout == "word\n"


def test_an_output_without_some_signs_is_no_traceback():
    done = python("-m", "hpac", "sweep", "--help", PYTHONIOENCODING="ascii")
    assert done.stderr == ""
    assert "\\u2026" in done.stdout


@pytest.mark.parametrize("stream", ["out", "err"])
def test_only_a_reader_of_the_output_that_leaves_ends_a_command_without_an_error(stream):
    script = (
        "import sys; from hpac_gym.command import run; "
        f"run(lambda: print('word', file=sys.std{stream}, flush=True))"
    )
    reader, writer = os.pipe()
    os.close(reader)
    ends = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, f"std{stream}": writer}
    done = subprocess.run([sys.executable, "-c", script], **ends, check=False)
    os.close(writer)
    assert (done.returncode == 0) == (stream == "out")
    assert not done.stderr


@pytest.mark.parametrize(
    ("words", "extra", "package"),
    [
        ("sweep --record x.csv", "study", "matplotlib"),
        ("calibrate x.csv", "study", "matplotlib"),
        ("posture all", "study", "matplotlib"),
        ("grasps -n 1", "grasps", "PIL"),
    ],
)
def test_without_its_packages_a_command_says_what_it_needs(
    words, extra, package, monkeypatch, capsys
):
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.delitem(sys.modules, "hpac_gym.evaluation.pictures", raising=False)
    needs = f"pip install '.[{extra}]' in a checkout of hpac_gym (no module {package})"
    said = refused(capsys, lambda: main(words.split()))
    assert said == f"error: this command needs more: {needs}"


def test_a_missing_module_of_this_package_is_a_bug_and_no_missing_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "hpac_gym.calibration.sweep", None)
    with pytest.raises(ModuleNotFoundError):
        main(["sweep", "--record", "x.csv"])


DISTRIBUTION = {
    "PIL": "pillow",
    "cv2": "opencv-python-headless",
    "imageio_ffmpeg": "imageio-ffmpeg",
    "sb3_contrib": "sb3-contrib",
    "sbx": "sbx-rl",
    "stable_baselines3": "stable-baselines3",
}
"""Distributions that are not called like their package."""


def test_the_extra_of_a_package_installs_it():
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    extras = {
        extra: {re.match(r"[\w-]+", line)[0].lower() for line in lines}
        for extra, lines in tomllib.loads(text)["project"]["optional-dependencies"].items()
    }
    carried = {"jax": "sbx"}  # sbx-rl requires it
    for package, extra in EXTRA_OF.items():
        named = DISTRIBUTION.get(package, package)
        assert named in extras[extra] or carried.get(package) == extra, package


@pytest.mark.parametrize("module", ["agents.race", "tools.film_strip"])
def test_a_module_outside_of_the_wheel_names_its_extra_in_one_line(module):
    script = f"{REFUSING}\nimport runpy; runpy.run_module({module!r}, run_name='__main__')"
    done = python("-c", script, "torch,PIL,imageio")
    assert done.returncode == 1
    assert re.fullmatch(
        r"error: this command needs more: pip install '\.\[\w+\]' in a checkout of hpac_gym "
        r"\(no module \w+\)\n",
        done.stderr,
    )
