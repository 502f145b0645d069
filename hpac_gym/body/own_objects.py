"""User-supplied objects: a mesh or URDF file, decomposed into convex parts that both engines
collide.

CoACD computes the parts once; they are cached in a file beside the mesh, so that only the first
call is slow."""

import hashlib
import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from numbers import Real
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

import numpy as np

from hpac_gym.body.geometry import rotation_about, rotation_from_rpy
from hpac_gym.body.object_models import ObjectModel
from hpac_gym.body.objects import GREY, ObjectSpec
from hpac_gym.body.solids import Hull, Solid, bounds_of
from hpac_gym.errors import ParameterError, install
from hpac_gym.model.checks import Array
from hpac_gym.output import OutputError, writable_file, write_text
from hpac_gym.progress import waiting

MESHES = (".stl", ".obj", ".ply", ".off")
MIN_SIDE = 0.002
MAX_SIDE = 0.4
"""Smallest and largest side of the bounding box [m]: limited by contact softness and by the
observation bounds.
"""
MAX_MASS = 5.0
MAX_FRICTION = 2.0
"""Largest mass [kg] and Coulomb coefficient."""
MAX_SCALE = 1000.0

_COMMON = {"max_convex_hull": 32, "decimate": True, "seed": 0}
DETAILS = {
    "coarse": _COMMON
    | {
        "threshold": 0.2,
        "max_ch_vertex": 32,
        "preprocess_resolution": 20,
        "resolution": 300,
        "mcts_nodes": 5,
        "mcts_iterations": 5,
        "mcts_max_depth": 1,
    },
    "fine": _COMMON | {"threshold": 0.05, "max_ch_vertex": 64},
}
"""Settings of CoACD by detail; chosen: seconds and minutes for a mug."""
_MANY_FACES = 1000
"""A coarse decomposition of more faces first remeshes them at its resolution."""
_CONVEX = 0.99
"""A mesh that fills at least this fraction of its convex hull is not decomposed."""
_CORNERS = 256
"""A convex mesh with more corners keeps those that lie outermost in so many directions, and along
its axes: more would slow PyBullet down.
"""
_UP = {"z": np.eye(3), "y": rotation_about((1, 0, 0), math.pi / 2)}


def own_object(
    path: str | os.PathLike[str],
    mass: float | None = None,
    friction: float = 0.6,
    scale: float = 1.0,
    up: str = "z",
    detail: str = "coarse",
    folder: str | os.PathLike[str] | None = None,
) -> ObjectSpec:
    """Load an object from a file, for ``gymnasium.make("HPAC-Grasp-v0", object=...)`` or a
    `SceneSetup`.

    Args:
        path: a closed mesh (.stl, .obj, .ply, .off), or a URDF in which all joints are fixed.
        mass: total mass [kg], spread evenly over the volume. None is the sum of a URDF's masses.
        friction: Coulomb coefficient of its surface, to be multiplied by the skin's.
        scale: factor from the file's lengths to metres: 0.001 for a mesh in mm.
        up: axis of the file that points up: "z" or "y".
        detail: "coarse", or "fine" for a closer decomposition, which takes minutes for a mug.
        folder: folder in which the convex parts of meshes are cached, as ``{stem}.hulls.json``;
            None is beside each mesh.

    Raises:
        ParameterError: No such file, mesh not closed, no volume, too small or too large, an
            inadmissible mass, friction, scale or axis, or the packages of the extra
            `objects` are missing.
        OutputError: The parts cannot be written.
    """
    path = Path(path)
    if not path.is_file():
        raise ParameterError(f"no object file '{path}'")
    for name, value, most in (
        ("friction", friction, MAX_FRICTION),
        ("scale", scale, MAX_SCALE),
        ("mass", mass, MAX_MASS),
    ):
        if name != "mass" or mass is not None:
            _check_positive(f"'{path}'", name, value, most)
    for name, given, known in (("up", up, _UP), ("detail", detail, DETAILS)):
        if given not in list(known):
            raise ParameterError(f"{name} {given!r} is not one of {', '.join(known)}")
    how = _Decomposition(DETAILS[detail], folder)
    if path.suffix.lower() == ".urdf":
        solids, stated_mass = _of_urdf(path, scale, how)
        mass = stated_mass if mass is None else mass
    else:
        solids = _of_mesh(path, np.full(3, scale), how)
    if mass is None:
        raise ParameterError(f"'{path}' says no mass: give one in kg")
    _check_positive(f"'{path}'", "mass", mass, MAX_MASS)
    return _spec(path, [solid.moved(_UP[up]) for solid in solids], mass, friction)


def as_object(given: ObjectSpec | Mapping[str, Any]) -> ObjectSpec:
    """The object that an option `object` gives: a spec, or a mapping of the arguments of
    `own_object`.

    Raises:
        ParameterError: It is neither, or `own_object` refuses it.
        OutputError: As in `own_object`.
    """
    try:
        if isinstance(given, Mapping):  # with a shape it is a spec, as a dataset keeps it
            given = (ObjectSpec if "shape" in given else own_object)(**given)
    except TypeError as error:
        raise ParameterError(f"object {given!r}: {error}") from None
    if not isinstance(given, ObjectSpec):
        raise ParameterError(
            f"object {given!r} is neither an ObjectSpec, as own_object gives one, nor a dictionary for it"
        )
    owner = f"a {given.shape}"
    _check_sides(owner, 2 * np.array(given.half_extents))
    _check_positive(owner, "mass", given.mass, MAX_MASS)
    _check_positive(owner, "friction", given.friction, MAX_FRICTION)
    return given


def _check_sides(owner: str, size: Array, hint: str = "") -> None:
    """Refuse a bounding box with a side, shape (3,) [m], that is too small or too large."""
    if not (size.min() >= MIN_SIDE and size.max() <= MAX_SIDE):
        sides = " x ".join(f"{side:.3g}" for side in size)
        raise ParameterError(
            f"{owner} is {sides} m: sides must be {MIN_SIDE} to {MAX_SIDE} m{hint}"
        )


def _check_positive(owner: str, name: str, value: Any, most: float) -> None:
    """Refuse a value that is not a positive number of at most `most`."""
    if not (isinstance(value, Real) and 0 < value <= most):
        unit = " kg" if name == "mass" else ""
        raise ParameterError(
            f"{name} {value!r}{unit} of {owner} must be a number greater than 0 and at most {most:g}{unit}"
        )


def _spec(path: Path, solids: list[Solid], mass: float, friction: float) -> ObjectSpec:
    """Spec of an object of given mass [kg], made of solids whose mass fields still hold their
    volumes.
    """
    low, high = bounds_of(solids)
    size = high - low
    _check_sides(f"'{path}'", size, "; scale=0.001 is for a file in mm")
    density = mass / sum(solid.mass for solid in solids)
    middle = (low + high) / 2
    parts = tuple(
        replace(solid, mass=density * solid.mass, center=solid.center - middle) for solid in solids
    )
    x, y, z = size.tolist()
    model = ObjectModel(path.stem, f"own object {path.name}", (x, y, z), mass, "box", GREY, parts)
    return ObjectSpec("box", model.half_extents, mass, friction, model)


# Meshes ------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Decomposition:
    """How meshes are decomposed, and where their parts are cached; None is beside each mesh."""

    settings: Mapping[str, Any]
    folder: str | os.PathLike[str] | None


def _of_mesh(path: Path, scale: Array, how: _Decomposition) -> list[Solid]:
    """The convex parts of a mesh, each with its volume as its mass; a mirroring scale turns the
    faces over.
    """
    if path.suffix.lower() not in MESHES:
        raise ParameterError(f"'{path}' is not one of {', '.join(MESHES)}, nor a .urdf")
    kept = (path.parent if how.folder is None else Path(how.folder)) / f"{path.stem}.hulls.json"
    made_from = {"sha256": hashlib.sha256(path.read_bytes()).hexdigest(), "coacd": how.settings}
    parts = _kept(kept, made_from)
    if parts is None:
        try:
            writable_file(kept)
        except OutputError as error:
            raise OutputError(
                f"{error}: convex parts are kept there, or in folder= (--set object.folder=)"
            ) from None
        parts = _decomposed(path, how.settings)
        write_text(kept, json.dumps(made_from | {"parts": parts}))
    order = -1 if np.prod(scale) < 0 else 1
    return [
        _hull(np.array(corners) * scale, np.array(faces)[:, ::order]) for corners, faces in parts
    ]


def _kept(path: Path, made_from: dict[str, Any]) -> list | None:
    """Parts cached in a file; None unless it was made from the same mesh with the same settings."""
    try:
        cache = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    same = isinstance(cache, dict) and all(
        cache.get(key) == value for key, value in made_from.items()
    )
    return cache.get("parts") if same else None


def _decomposed(path: Path, settings: Mapping[str, Any]) -> list:
    """Corners and faces of the convex parts of a mesh, in the file's unit."""
    try:
        import coacd
        import trimesh
    except ImportError as error:
        raise ParameterError(
            f"own_object needs the package {error.name}: {install('objects')}"
        ) from None
    try:
        mesh = trimesh.load_mesh(path)
    except Exception as error:  # the reader may raise anything on a broken file
        raise ParameterError(
            f"'{path}' cannot be read as a mesh: {next(iter(str(error).splitlines()), repr(error))}"
        ) from None
    if not (
        isinstance(mesh, trimesh.Trimesh) and len(mesh.faces) and np.isfinite(mesh.vertices).all()
    ):
        raise ParameterError(f"'{path}' has no triangles with finite corners")
    mesh.merge_vertices(merge_tex=True, merge_norm=True)  # split where a texture has a seam
    if np.ptp(mesh.vertices, axis=0).min() < 1e-9 * np.ptp(mesh.vertices, axis=0).max():
        raise ParameterError(f"'{path}' is flat: it has no volume")
    if not mesh.is_watertight:
        raise ParameterError(
            f"'{path}' is not watertight: every edge must belong to two triangles; close its holes first"
        )
    if not mesh.is_volume:
        mesh.fix_normals()
    if not mesh.volume > 1e-9 * np.prod(mesh.extents):
        raise ParameterError(f"'{path}' has no volume")
    whole = mesh.convex_hull
    parts = [whole]
    if mesh.volume < _CONVEX * whole.volume:
        coacd.set_log_level("error")
        remeshed = "preprocess_resolution" in settings and len(mesh.faces) > _MANY_FACES
        settings = {**settings, "preprocess_mode": "on"} if remeshed else settings
        with waiting(f"convex parts of {path.name}"):
            convex = coacd.run_coacd(coacd.Mesh(mesh.vertices, mesh.faces), **settings)
        parts = [trimesh.convex.convex_hull(corners) for corners, _ in convex]
        if remeshed:  # which changes the size a little
            low, high = trimesh.util.concatenate(parts).bounds
            for part in parts:
                share = (part.vertices - low) / (high - low)
                part.vertices = mesh.bounds[0] + share * mesh.extents
    elif len(whole.vertices) > _CORNERS:
        parts = [trimesh.convex.convex_hull(_outermost(whole.vertices))]
    return [(part.vertices.tolist(), part.faces.tolist()) for part in parts]


def _outermost(corners: Array) -> Array:
    """The corners that lie outermost in `_CORNERS` directions, on a spiral about a sphere, and along
    the axes.
    """
    step = np.arange(_CORNERS) + 0.5
    height = 1 - 2 * step / _CORNERS
    turn = math.pi * (1 + math.sqrt(5)) * step
    around = np.sqrt(1 - height**2) * (np.cos(turn), np.sin(turn))
    ways = np.hstack([(*around, height), np.eye(3), -np.eye(3)])
    return corners[np.unique((corners / np.ptp(corners, axis=0) @ ways).argmax(axis=0))]


def _hull(corners: Array, faces: Array) -> Solid:
    volume, centre, _ = Hull(corners, faces).moments()
    x, y, z = np.ptp(corners, axis=0).tolist()
    return Solid("hull", volume, (x, y, z), centre, np.eye(3), hull=Hull(corners - centre, faces))


# URDF --------------------------------------------------------------------------


def _of_urdf(path: Path, scale: float, how: _Decomposition) -> tuple[list[Solid], float | None]:
    """Collision shapes of a URDF, each with its volume as its mass, and the sum of its link masses;
    None if it has none.
    """
    try:
        robot = Xml.parse(path).getroot()
        solids = _of_links(path, robot, how)
        mass = sum(float(entry.get("value")) for entry in robot.findall("link/inertial/mass"))
    except ParameterError:
        raise
    except (Xml.ParseError, AttributeError, IndexError, TypeError, ValueError) as error:
        raise ParameterError(f"'{path}' is not a URDF: {error}") from None
    if not solids:
        raise ParameterError(f"'{path}' has no collision shape")
    return [solid.scaled(scale, scale**3) for solid in solids], mass or None


def _of_links(path: Path, robot: Xml.Element, how: _Decomposition) -> list[Solid]:
    parents = {}
    for joint in robot.findall("joint"):
        if joint.get("type") != "fixed":
            raise ParameterError(
                f"joint {joint.get('name')!r} of '{path}' is {joint.get('type')}: all joints must be fixed"
            )
        parents[joint.find("child").get("link")] = joint.find("parent").get("link"), *_origin(joint)
    solids = []
    for link in robot.findall("link"):
        rotation = np.eye(3)
        place = np.zeros(3)
        name = link.get("name")
        for _ in parents:
            if name in parents:
                name, turn, offset = parents[name]
                rotation = turn @ rotation
                place = turn @ place + offset
        if name in parents:
            raise ParameterError(f"joints of '{path}' form a ring through link {name!r}")
        for shape in link.findall("collision"):
            turn, offset = _origin(shape)
            for solid in _of_geometry(path, shape.find("geometry")[0], how):
                if not all(side > 0 for side in solid.size):
                    sides = " x ".join(f"{side:g}" for side in solid.size)
                    raise ParameterError(
                        f"a {solid.kind} of '{path}' is {sides} m: sides must be greater than 0 m"
                    )
                solids.append(solid.moved(rotation @ turn, rotation @ offset + place))
    return solids


def _origin(element: Xml.Element) -> tuple[Array, Array]:
    """Rotation, shape (3, 3), and translation, shape (3,), of an element's origin."""
    origin = element.find("origin")
    xyz, rpy = (
        (0.0,) * 3 if origin is None else _numbers(origin.get(key, "0 0 0"))
        for key in ("xyz", "rpy")
    )
    return rotation_from_rpy(rpy), np.array(xyz)


def _of_geometry(path: Path, form: Xml.Element, how: _Decomposition) -> list[Solid]:
    if form.tag == "mesh":
        name = form.get("filename", "")
        mesh = path.parent / name.removeprefix("file://")
        if not mesh.is_file():
            raise ParameterError(f"no mesh file '{mesh}', which '{path}' names")
        return _of_mesh(mesh, np.array(_numbers(form.get("scale", "1 1 1"))), how)
    if form.tag == "box":
        x, y, z = _numbers(form.get("size"))
        return [Solid("box", x * y * z, (x, y, z), np.zeros(3), np.eye(3))]
    if form.tag not in ("sphere", "cylinder", "capsule"):
        raise ParameterError(
            f"'{path}' has a shape {form.tag!r}, which is not one of box, cylinder, sphere, capsule, mesh"
        )
    radius = float(form.get("radius"))
    length = float(form.get("length", 0.0))
    if length < 0:
        raise ParameterError(
            f"a {form.tag} of '{path}' is {length:g} m long: it must be at least 0 m"
        )
    ball = 4 / 3 * math.pi * radius**3
    tube = math.pi * radius**2 * length
    wide = 2 * radius
    whole, volume = {
        "sphere": (wide, ball),
        "cylinder": (length, tube),
        "capsule": (length + wide, ball + tube),
    }[form.tag]
    return [Solid(form.tag, volume, (wide, wide, whole), np.zeros(3), np.eye(3))]


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(map(float, text.split()))
