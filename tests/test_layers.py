"""The layer table of docs/architecture.md, read from the imports of every module."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "hpac_gym"
MODULES = sorted(PACKAGE.rglob("*.py"))

# What a layer may import of this package, and from outside of it beside the standard library. An
# engine's folder is a layer of its own, and so is the adapter to Stable-Baselines3. The package's
# own __init__.py and its benchmark of speed stand above all of them; `hpac` is the command beside
# it.
BELOW_TASKS = {"errors", "model", "body", "physics"}
BELOW_ENVS = BELOW_TASKS | {"tasks"}
LAYERS = {
    "errors": set(),
    "progress": set(),
    "output": {"errors"},
    "model": {"errors"},
    "body": {"errors", "output", "model"},
    "physics": {"errors", "model", "body"},
    "physics.pybullet": BELOW_TASKS,
    "physics.mujoco": BELOW_TASKS,
    "tasks": BELOW_TASKS,
    "envs": BELOW_ENVS,
    "envs.sb3": BELOW_ENVS | {"envs"},
    "bridge": {"errors", "model"},
    "policies": {"errors", "output", *BELOW_ENVS, "envs"},
    "evaluation": {"errors", "output", "progress", *BELOW_ENVS, "envs", "policies"},
    "study": {"errors", "output", "progress", *BELOW_TASKS},
}
NEEDS = {
    "errors": set(),
    "progress": set(),
    "output": set(),
    "model": {"numpy"},
    "body": {"numpy", "coacd", "trimesh"},
    "physics": {"numpy", "hpac"},
    "physics.pybullet": {"numpy", "pybullet"},
    "physics.mujoco": {"numpy", "mujoco"},
    "tasks": {"numpy", "scipy", "gymnasium"},
    "envs": {"numpy", "gymnasium"},
    "envs.sb3": {"numpy", "gymnasium", "stable_baselines3"},
    "bridge": {"numpy", "serial", "hpac"},
    "policies": {"numpy", "gymnasium", "onnx", "onnxruntime"},
    "evaluation": {"numpy", "gymnasium", "PIL", "minari", "lerobot", "hpac"},
    "study": {"numpy", "scipy", "matplotlib", "hpac"},
}
ENGINES = {"physics.pybullet": "pybullet", "physics.mujoco": "mujoco"}
CHOOSER = "hpac_gym.physics.simulation"
"""The one module that imports an engine's folder, once it is asked for."""
WORKSHOP = {"agents", "tools", "tests"}


def module_name(path: Path) -> str:
    """The dotted name under which ``path`` is imported."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def imports_of(path: Path, lazy: bool = True) -> tuple[str, ...]:
    """The dotted names that a module imports, relative ones resolved and submodules spelled out;
    with those in functions.
    """
    return tuple(_imports_of(path, lazy))


def _imports_of(path: Path, lazy: bool) -> Iterator[str]:
    package = module_name(path).split(".")
    package = package if path.name == "__init__.py" else package[:-1]
    tree = ast.parse(path.read_text(encoding="utf-8"))
    inside = {
        node
        for f in ast.walk(tree)
        if isinstance(f, ast.FunctionDef | ast.AsyncFunctionDef)
        for node in ast.walk(f)
    }
    for node in ast.walk(tree):
        if node in inside and not lazy:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parts = package[: len(package) - node.level + 1] if node.level else []
            parts += node.module.split(".") if node.module else []
            yield from (".".join([*parts, alias.name]) for alias in node.names)
        elif isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
            if getattr(node.func, "attr", getattr(node.func, "id", "")) in {
                "import_module",
                "__import__",
            }:
                yield str(node.args[0].value)


def layer_of(name: str) -> str | None:
    """The layer of a dotted name of this package; None for its root and its commands."""
    parts = name.split(".")
    return next((layer for layer in (".".join(parts[1:3]), *parts[1:2]) if layer in LAYERS), None)


IN_LAYERS = [path for path in MODULES if layer_of(module_name(path))]


@pytest.mark.parametrize("path", IN_LAYERS, ids=module_name)
def test_a_module_imports_only_layers_below_its_own(path):
    layer = layer_of(module_name(path))
    own = [name for name in imports_of(path) if name.split(".")[0] in {"hpac_gym"} | WORKSHOP]
    upward = [name for name in own if layer_of(name) not in LAYERS[layer] | {layer}]
    if module_name(path) == CHOOSER:
        upward = [name for name in upward if layer_of(name) not in ENGINES]
    assert not upward, f"{module_name(path)} is in '{layer}' and imports {upward}"


@pytest.mark.parametrize("path", IN_LAYERS, ids=module_name)
def test_a_module_needs_only_what_its_layer_may(path):
    layer = layer_of(module_name(path))
    outside = (
        {name.split(".")[0] for name in imports_of(path)} - {"hpac_gym"} - sys.stdlib_module_names
    )
    assert outside <= NEEDS[layer], (
        f"{module_name(path)} is in '{layer}' and imports {sorted(outside - NEEDS[layer])}"
    )


@pytest.mark.parametrize(("folder", "engine"), ENGINES.items())
def test_only_its_folder_names_an_engine(folder, engine):
    modules = [*MODULES, *(ROOT / "agents").rglob("*.py")]
    named = {
        module_name(path)
        for path in modules
        if any(name.split(".")[0].startswith(engine) for name in imports_of(path))
    }
    assert {layer_of(name) for name in named} <= {folder}, named


def test_one_module_imports_the_engines_and_only_once_it_is_asked():
    path = ROOT.joinpath(*CHOOSER.split(".")).with_suffix(".py")
    assert {layer_of(name) for name in imports_of(path)} >= set(ENGINES)
    assert not {layer_of(name) for name in imports_of(path, lazy=False)} & set(ENGINES)


def test_the_command_imports_without_the_package():
    """Nor anything else beside the standard library: the list of commands is there at once."""
    assert {
        name.split(".")[0] for name in imports_of(ROOT / "hpac.py", lazy=False)
    } <= sys.stdlib_module_names


def test_the_package_does_not_know_the_workshop():
    assert not [
        path for path in MODULES for name in imports_of(path) if name.split(".")[0] in WORKSHOP
    ]


def test_what_names_no_engine_imports_without_one():
    layers = ("model", "body", "physics", "tasks", "envs", "bridge")
    names = [name for name in map(module_name, IN_LAYERS) if layer_of(name) in layers]
    assert {layer_of(name) for name in names} == set(layers)
    script = f"""
import importlib, sys

class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {{"pybullet", "mujoco"}}:
            raise ImportError(f"{{name}} is refused")

sys.meta_path.insert(0, Refuse())
for name in {[name for name in names if not name.endswith("__main__")]!r}:
    importlib.import_module(name)
"""
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
