"""An object's URDF as text; ``make generate`` writes the committed files.

Dimensions, masses and their sources come from ``data/objects.toml`` and
``data/held_out_objects.toml``. An object's frame has its origin at the centre of its bounding box;
its centre of mass follows from its solids."""

import tempfile
from functools import cache
from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np

from hpac_gym.body.object_models import ObjectModel
from hpac_gym.body.solids import Solid
from hpac_gym.body.urdf import HEADER, add_inertial, add_shape, text_of
from hpac_gym.model.checks import Array


def object_urdf(model: ObjectModel) -> str:
    """An object as URDF text: one link, with the same shapes for display and collision."""
    robot = Xml.Element("robot", name=model.name)
    Xml.SubElement(
        Xml.SubElement(robot, "material", name="surface"), "color", rgba=text_of(model.color)
    )
    link = Xml.SubElement(robot, "link", name=model.name)
    add_inertial(link, model.center_of_mass, model.inertia, model.mass)
    for index, solid in enumerate(model.solids):
        place = solid.center, _rpy(solid.rotation)
        form, size = _form(solid, index)
        add_shape(link, "visual", *place, form, size, "surface")
        add_shape(link, "collision", *place, form, size)
    Xml.indent(robot)
    return HEADER + Xml.tostring(robot, encoding="unicode") + "\n"


@cache
def object_urdf_file(model: ObjectModel) -> Path:
    """URDF file of an object, a temporary one for this process."""
    folder = Path(tempfile.mkdtemp(dir=_folder().name))
    for index, solid in enumerate(model.solids):
        if solid.hull is not None:
            corners = "".join(f"v {text_of(corner)}\n" for corner in solid.hull.vertices)
            faces = "".join(f"f {a} {b} {c}\n" for a, b, c in solid.hull.faces + 1)
            (folder / _mesh_name(index)).write_text(corners + faces, encoding="utf-8")
    path = folder / f"{model.name}.urdf"
    path.write_text(object_urdf(model), encoding="utf-8")
    return path


@cache
def _folder() -> tempfile.TemporaryDirectory:
    return tempfile.TemporaryDirectory(prefix="hpac_objects_")


def _mesh_name(index: int) -> str:
    return f"hull_{index}.obj"


def _form(solid: Solid, index: int) -> tuple[str, dict[str, str]]:
    if solid.kind == "hull":
        return "mesh", {"filename": _mesh_name(index)}
    if solid.kind == "box":
        return "box", {"size": text_of(solid.size)}
    if solid.kind == "sphere":
        return "sphere", {"radius": text_of([solid.radius])}
    length = solid.size[2] - (2 * solid.radius if solid.kind == "capsule" else 0.0)
    return solid.kind, {"radius": text_of([solid.radius]), "length": text_of([length])}


def _rpy(rotation: Array) -> tuple[float, float, float]:
    """Roll, pitch and yaw of a rotation matrix, Rz(yaw) Ry(pitch) Rx(roll); pitch within ±π/2
    [rad].
    """
    pitch = np.arcsin(-np.clip(rotation[2, 0], -1.0, 1.0))
    if abs(rotation[2, 0]) > 1 - 1e-12:
        return 0.0, float(pitch), float(np.arctan2(-rotation[0, 1], rotation[1, 1]))
    return (
        float(np.arctan2(rotation[2, 1], rotation[2, 2])),
        float(pitch),
        float(np.arctan2(rotation[1, 0], rotation[0, 0])),
    )
