"""The wheel: from it alone a clean environment makes the task, and the agents stay out of it."""

import json
import os
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest
import yaml
from hatchling.builders.sdist import SdistBuilder

from hpac_gym import __version__

ROOT = Path(__file__).resolve().parents[1]
PIP = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet")


def run(*command, **options) -> str:
    """Standard output of a command that has to succeed."""
    done = subprocess.run(
        [str(word) for word in command], capture_output=True, text=True, check=False, **options
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    run(
        *PIP,
        "wheel",
        ROOT,
        "--no-deps",
        "--no-build-isolation",
        "--no-index",
        "--wheel-dir",
        folder,
    )
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def clean_python(wheel, tmp_path_factory) -> Path:
    """A new environment that holds the wheel, and sees this one's dependencies but not its editable
    checkout.

    A path that a .pth file adds has its own .pth files ignored, and an editable install is one of
    those."""
    folder = tmp_path_factory.mktemp("clean")
    venv.create(folder, with_pip=False)
    python = folder / "bin" / "python"
    site = Path(
        run(
            python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=folder
        ).strip()
    )
    run(*PIP, "--python", python, "install", "--no-deps", "--no-index", wheel)
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return python


def test_the_wheel_holds_the_package_its_data_and_nothing_else(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0] for name in names} == {
        "hpac.py",
        "hpac_gym",
        f"hpac_gym-{__version__}.dist-info",
    }
    assert "hpac_gym/py.typed" in names
    packed = {name for name in names if name.startswith("hpac_gym/")}
    source = {
        str(p.relative_to(ROOT))
        for p in (ROOT / "hpac_gym").rglob("*")
        if p.suffix in {".py", ".toml", ".hpac"}
    }
    assets = {
        f"hpac_gym/{p.relative_to(ROOT)}" for p in (ROOT / "assets").rglob("*") if p.is_file()
    }
    firmware = {
        f"hpac_gym/firmware/{p.relative_to(ROOT / 'firmware')}"
        for folder in ("core", "board/host")
        for p in (ROOT / "firmware" / folder).iterdir()
    }
    assert assets
    assert firmware
    assert source | assets | firmware <= packed


def files_of_the_checkout() -> set[str]:
    """What belongs to the project: all files but those that .gitignore names."""
    ignored = {line.strip("/") for line in (ROOT / ".gitignore").read_text().splitlines()}
    ignored |= {".git", ".setup"}
    return {
        str(path.relative_to(ROOT))
        for path in ROOT.rglob("*")
        if path.is_file()
        and not any(
            path.relative_to(ROOT).match(pattern) or parent.match(pattern)
            for pattern in ignored
            for parent in (path.relative_to(ROOT), *path.relative_to(ROOT).parents)
        )
    }


def test_the_sdist_holds_all_that_its_tests_need(tmp_path):
    (built,) = SdistBuilder(str(ROOT)).build(directory=str(tmp_path))
    with tarfile.open(built) as archive:
        packed = {name.partition("/")[2] for name in archive.getnames()}
    files = files_of_the_checkout()
    assert {"tools/generate.py", "examples/quickstart.ipynb", "tests/conftest.py"} <= files
    assert sorted(files - packed) == []


def test_the_citation_has_the_version_and_no_address():
    told = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert told["version"] == __version__
    assert told["cff-version"] == "1.2.0"
    assert not {"url", "doi", "repository-code"} & told.keys(), "there is no public address yet"


def test_public_hosting_calls_the_command_that_decides():
    text = (ROOT / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8")
    (job, docs) = yaml.safe_load(text)["jobs"].values()
    assert job["strategy"]["matrix"]["python"] == ["3.11", "3.12", "3.13", "3.14"]
    assert len(job["strategy"]["matrix"]["os"]) == 3
    assert job["steps"][-1]["run"] == ".ci/run"
    assert docs["steps"][-1]["run"] == "make docs"


def test_pre_commit_runs_what_lint_runs():
    told = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))
    ((hooks,),) = ([repo["hooks"]] for repo in told["repos"])
    assert [hook["entry"].partition("/bin/")[2] for hook in hooks] == [
        "ruff format",
        "ruff check",
        "python -m tools.style",
    ]


@pytest.mark.pybullet
def test_a_clean_environment_makes_the_task_from_the_wheel(clean_python, tmp_path):
    script = """
import importlib.util, json
import gymnasium
env = gymnasium.make("hpac_gym:HPAC-Grasp-v0", engine="pybullet")
env.reset(seed=0)
env.action_space.seed(0)
env.step(env.action_space.sample())
env.close()
import hpac_gym
absent = [name for name in ("agents", "experiments", "tools") if importlib.util.find_spec(name) is None]
print(json.dumps({"package": hpac_gym.__file__, "absent": absent}))
"""
    # -I: no PYTHONPATH, and an output that waits in buffers, where PyBullet's own prints must not
    # come out at the end.
    seen = json.loads(run(clean_python, "-I", "-c", script, cwd=tmp_path).splitlines()[-1])
    package = Path(seen["package"]).parent
    assert package.is_relative_to(clean_python.parents[1])
    assert (package / "assets").is_dir()
    assert seen["absent"] == ["agents", "experiments", "tools"]


def test_without_pybullet_everything_runs_on_mujoco_and_asking_for_pybullet_is_one_line(
    clean_python, tmp_path
):
    script = """
import sys
sys.modules["pybullet"] = None
import gymnasium
env = gymnasium.make("hpac_gym:HPAC-Grasp-v0")
env.reset(seed=0)
env.step(env.action_space.sample())
from hpac_gym.errors import HpacError
try:
    gymnasium.make("HPAC-Grasp-v0", engine="pybullet")
except HpacError as error:
    print(error)
"""
    (line,) = run(clean_python, "-I", "-c", script, cwd=tmp_path).splitlines()
    assert "pybullet" in line
    assert "engine='mujoco'" in line


HEAVY = ("scipy", "mujoco", "pybullet", "torch", "trimesh", "hpac_gym.tasks", "hpac_gym.envs")


def test_package_model_bridge_and_policy_file_need_neither_scipy_nor_an_engine():
    script = (
        "import sys, hpac_gym, hpac_gym.model, hpac_gym.bridge, hpac_gym.policies; "
        f"print([name for name in sys.modules if name.startswith({HEAVY!r})])"
    )
    assert run(sys.executable, "-c", script, cwd=ROOT) == "[]\n"


def test_the_wheel_compiles_its_firmware_at_first_use_and_says_when_it_cannot(
    clean_python, tmp_path
):
    command = [clean_python.with_name("hpac"), "clear", "--port"]
    # Empty where set: a checkout's build, another compiler, a path to the checkout.
    names = ("HPAC_FIRMWARE_BUILD", "CC", "PYTHONPATH")
    clean = os.environ | dict.fromkeys(names, "") | {"XDG_CACHE_HOME": str(tmp_path)}
    for port in ("virtual", "host"):
        assert "state idle" in run(*command, port, cwd=tmp_path, env=clean)
    assert [path.name for path in tmp_path.glob("hpac_gym/firmware/*/*")] != []
    without = subprocess.run(
        [*map(str, command), "host"],
        env=clean | {"CC": "none"},
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert without.returncode == 2
    assert "there is no C compiler 'none'" in without.stderr
    assert len(without.stderr.splitlines()) == 1
