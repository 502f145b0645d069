"""The rooms of docs/architecture.md, read from the imports of every module."""

import ast
import sys
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from tests.processes import ROOT, python

# From bottom to top, with what each room may import from outside beside the standard library. A
# module imports its own room and the rooms before it. An engine's folder belongs to `physics`.
ROOMS = {
    "errors": set(),
    "settings": set(),
    "output": set(),
    "progress": {"tqdm"},
    "command": set(),
    "registration": {"gymnasium"},
    "figures": {"matplotlib", "cycler"},
    "model": {"numpy"},
    "body": {"numpy", "coacd", "trimesh"},
    "bridge": {"numpy", "serial"},
    "camera": {"numpy", "scipy", "cv2", "matplotlib"},
    "calibration": {"numpy", "scipy", "matplotlib"},
    "physics": {"numpy", "scipy", "pybullet", "mujoco", "triton"},
    "tasks": {"numpy", "scipy", "gymnasium"},
    "view": {"numpy", "scipy", "trimesh", "viser"},
    "envs": {"numpy", "gymnasium", "stable_baselines3"},
    "policies": {"numpy", "gymnasium", "onnx", "onnxruntime", "stable_baselines3"},
    "evaluation": {"numpy", "scipy", "gymnasium", "PIL", "minari", "lerobot", "tqdm"},
    "deploy": {"numpy", "scipy", "gymnasium", "matplotlib"},
    "virtual": {"numpy", "scipy"},
    "posture": {"numpy", "matplotlib"},
    "show": {"imageio", "imageio_ffmpeg"},
    "hpac_gym": set(),
    "hpac": set(),
}
WORKSHOP = ("agents", "experiments", "tools")
"""Not in the wheel, from bottom to top; each imports everything before it, and anything."""
ENGINES = {"pybullet", "mujoco"}


def name_of(path: Path) -> str:
    """The dotted name under which a module is imported."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


PATHS = {
    name_of(path): path
    for folder in ("hpac_gym", *WORKSHOP)
    for path in sorted((ROOT / folder).rglob("*.py"))
} | {"hpac": ROOT / "hpac.py"}
PACKAGE = [name for name in PATHS if name.split(".")[0] not in WORKSHOP]


@cache
def imports_of(name: str, lazy: bool = True) -> list[str]:
    """The dotted names that a module imports, members spelled out; with those in functions."""
    tree = ast.parse(PATHS[name].read_text(encoding="utf-8"))
    functions = [
        node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    ]
    inside = {node for function in functions for node in ast.walk(function)}
    found = []
    for node in ast.walk(tree):
        if node in inside and not lazy:
            continue
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{name} has a relative import"
            found += [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
            if getattr(node.func, "attr", getattr(node.func, "id", "")) == "import_module":
                found.append(str(node.args[0].value))
    return found


def module_of(imported: str) -> str | None:
    """The module of this project that an imported name belongs to; None for others."""
    while imported and imported not in PATHS:
        imported = imported.rpartition(".")[0]
    return imported or None


def room_of(name: str) -> str:
    first, *rest = name.split(".")
    return rest[0] if first == "hpac_gym" and rest else first


def modules_imported_by(name: str) -> set[str]:
    return {module for imported in imports_of(name) if (module := module_of(imported))} - {name}


def rooms_above(name: str) -> set[str]:
    """The rooms that a module imports and may not."""
    order = [*ROOMS, *WORKSHOP]
    order.remove("hpac")  # the command: above the package, and imported by nobody
    below = order[: order.index(room_of(name)) + 1] if name != "hpac" else ["command", "hpac_gym"]
    return {room_of(module) for module in modules_imported_by(name)} - {*below}


def test_no_arrow_points_upward():
    assert {name: rooms for name in PATHS if (rooms := rooms_above(name))} == {}


def test_there_is_no_circle():
    graph = {name: modules_imported_by(name) for name in PATHS}
    for name, modules in graph.items():  # a member of a package is not a circle with its __init__
        graph[name] = {module for module in modules if not name.startswith(f"{module}.")}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" → ".join(error.args[1]))


def test_a_module_needs_only_what_its_room_may():
    ours = sys.stdlib_module_names | {path.split(".")[0] for path in PATHS}
    needed = {name: {one.split(".")[0] for one in imports_of(name)} - ours for name in PACKAGE}
    wrong = {name: outside - ROOMS[room_of(name)] for name, outside in needed.items()}
    assert {name: packages for name, packages in wrong.items() if packages} == {}


@pytest.mark.parametrize("engine", sorted(ENGINES))
def test_only_its_folder_names_an_engine(engine):
    named = {
        name
        for name in PACKAGE
        if any(imported.split(".")[0] == engine for imported in imports_of(name))
    }
    assert named
    folder = f"hpac_gym.physics.{engine}"
    assert all(name == folder or name.startswith(f"{folder}.") for name in named), named


def test_one_module_imports_the_engines_and_only_once_it_is_asked():
    chooser = "hpac_gym.physics.simulation"
    folders = {f"hpac_gym.physics.{engine}" for engine in ENGINES}

    def engines_of(name: str, lazy: bool) -> set[str]:
        modules = {module_of(imported) or "" for imported in imports_of(name, lazy)}
        return {folder for folder in folders for module in modules if module.startswith(folder)}

    assert engines_of(chooser, lazy=True) == folders
    assert not engines_of(chooser, lazy=False)
    others = [name for name in PACKAGE if name != chooser and not name.startswith(tuple(folders))]
    assert not [name for name in others if engines_of(name, lazy=True)]


def test_what_names_no_engine_imports_without_one():
    rooms = ("model", "body", "bridge", "calibration", "physics", "tasks", "envs", "deploy")
    names = [
        name
        for name in PACKAGE
        if room_of(name) in rooms and not ENGINES & set(name.split(".")) and name[-3:] != "sb3"
    ]
    assert {room_of(name) for name in names} == set(rooms)
    script = f"""
import importlib, sys

class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {ENGINES!r}:
            raise ImportError(f"{{name}} is refused")

sys.meta_path.insert(0, Refuse())
for name in {names!r}:
    importlib.import_module(name)
"""
    done = python("-c", script)
    assert done.returncode == 0, done.stderr
