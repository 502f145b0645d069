"""User-supplied objects: a mesh or URDF file, as convex parts that both engines collide."""

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from numbers import Real
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

import numpy as np

from hpac_gym.body.geometry import rotation_about, rotation_from_rpy
from hpac_gym.body.object_models import ObjectModel, Solid, bounds_of
from hpac_gym.body.objects import GREY, ObjectSpec
from hpac_gym.body.own_meshes import DETAILS, of_mesh
from hpac_gym.errors import HpacError, ParameterError
from hpac_gym.model.checks import Array
from hpac_gym.settings import check_choice

MIN_SIDE = 0.002
MAX_SIDE = 0.4
"""Smallest and largest side of the bounding box [m]: limited by contact softness and by the bounds
of the critic's `true_object_size`; the camera's sizes end at 0.2 m.
"""
MIN_MASS = 1e-4
MAX_MASS = 5.0
MAX_FRICTION = 2.0
"""Smallest (chosen) and largest mass [kg], and largest Coulomb coefficient."""
MAX_SCALE = 1000.0

Reader = Callable[[Path, Array], list[Solid]]
"""Convex parts of a mesh file with a scale, shape (3,)."""
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
    if not os.path.isfile(path):
        raise ParameterError(f"no object file '{path}'")
    for name, value, most in (
        ("friction", friction, MAX_FRICTION),
        ("scale", scale, MAX_SCALE),
        ("mass", mass, MAX_MASS),
    ):
        if name != "mass" or mass is not None:
            _check_positive(f"'{path}'", name, value, most)
    check_choice("up", up, _UP)
    check_choice("detail", detail, DETAILS)
    read = partial(of_mesh, settings=DETAILS[detail], folder=folder)
    if path.suffix.lower() == ".urdf":
        solids, stated_mass = _of_urdf(path, scale, read)
        mass = stated_mass if mass is None else mass
    else:
        solids = read(path, np.full(3, scale))
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
        reason = f"{error}".partition(") ")[2] or error  # without the name of our function
        raise ParameterError(f"object {given!r}: {reason}") from None
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
    """Refuse a value that is not a positive number of at most `most`, or a mass below `MIN_MASS`."""
    least, unit = (MIN_MASS, " kg") if name == "mass" else (0, "")
    if not (isinstance(value, Real) and 0 < value <= most and value >= least):
        low = f"of at least {least:g}" if least else "greater than 0"
        raise ParameterError(
            f"{name} {value!r}{unit} of {owner} must be a number {low} and at most {most:g}{unit}"
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


def _of_urdf(path: Path, scale: float, read: Reader) -> tuple[list[Solid], float | None]:
    """Collision shapes of a URDF, each with its volume as its mass, and the sum of its link masses;
    None if it has none.
    """
    try:
        robot = Xml.parse(path).getroot()
        solids = _of_links(path, robot, read)
        mass = sum(float(entry.get("value")) for entry in robot.findall("link/inertial/mass"))
    except HpacError:
        raise
    except (OSError, Xml.ParseError, AttributeError, IndexError, TypeError, ValueError) as error:
        reason = getattr(error, "strerror", error)
        raise ParameterError(f"'{path}' is not a URDF: {reason}") from None
    if not solids:
        raise ParameterError(f"'{path}' has no collision shape")
    return [solid.scaled(scale, scale**3) for solid in solids], mass or None


def _of_links(path: Path, robot: Xml.Element, read: Reader) -> list[Solid]:
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
            for solid in _of_geometry(path, shape.find("geometry")[0], read):
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


def _of_geometry(path: Path, form: Xml.Element, read: Reader) -> list[Solid]:
    if form.tag == "mesh":
        name = form.get("filename", "")
        mesh = path.parent / name.removeprefix("file://")
        if not os.path.isfile(mesh):
            raise ParameterError(f"no mesh file '{mesh}', which '{path}' names")
        return read(mesh, np.array(_numbers(form.get("scale", "1 1 1"))))
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
    kind = form.tag if length else form.tag.replace("capsule", "sphere")
    ball = 4 / 3 * math.pi * radius**3
    tube = math.pi * radius**2 * length
    wide = 2 * radius
    whole, volume = {
        "sphere": (wide, ball),
        "cylinder": (length, tube),
        "capsule": (length + wide, ball + tube),
    }[kind]
    return [Solid(kind, volume, (wide, wide, whole), np.zeros(3), np.eye(3))]


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(map(float, text.split()))
