"""The solids of hand, object and supports as triangles [m], and the links of a hand in the browser.
The page shades smoothly, so that sharp edges have vertices of their own on either side."""

from collections.abc import Iterator

import numpy as np
import viser
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation
from trimesh import Trimesh, creation

from hpac_gym.body.geometry import Box, Capsule, Geometry, rotation_from_rpy
from hpac_gym.body.objects import ObjectSpec
from hpac_gym.body.urdf import COLORS
from hpac_gym.model import DIGITS, JOINT_INDEX
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import HAND_POSITION, OBJECT_COLORS, SceneSetup

AROUND = 28
"""Corners of a circle."""
Color = tuple[float, ...]
"""RGB or RGBA, each in [0, 1]."""
STRONG = 20.0
"""Tension from which on a tendon has its strongest colour [N]."""
SLACK_COLOR = np.array([70, 110, 190])
PULLED_COLOR = np.array([255, 150, 20])
"""Colours of a slack and of a pulled tendon, which differ for colour-blind people too, RGB."""


def moved(mesh: Trimesh, place: ArrayLike, turn: Rotation | None = None) -> Trimesh:
    """The mesh, which is turned, and moved by a way, shape (3,) [m]."""
    turned = mesh.vertices if turn is None else turn.apply(mesh.vertices)
    mesh.vertices = turned + place
    return mesh


def solid(kind: str, half: ArrayLike) -> Trimesh:
    """A sphere, capsule, cylinder or box about the origin with its axis along z, by the half
    extents of its bounding box, shape (3,) [m].
    """
    x, _, z = half
    if kind == "box":
        box = creation.box(2 * np.asarray(half))
        box.unmerge_vertices()
        return box
    if kind == "cylinder":
        profile = np.array([(0, -z), (x, -z), (x, -z), (x, z), (x, z), (0, z)])
    else:
        bow = np.linspace(-np.pi / 2, np.pi / 2, 16)
        ends = np.sign(bow) * max(z - x, 0.0)
        profile = np.stack([x * np.cos(bow), x * np.sin(bow) + ends], axis=1)
    # In mm: trimesh leaves out triangles smaller than 1e-8.
    return creation.revolve(1e3 * profile, sections=AROUND, process=False).apply_scale(1e-3)


def _of_hand(part: Box | Capsule) -> Trimesh:
    if isinstance(part, Box):
        return moved(solid("box", np.array(part.size) / 2), part.center)
    way = np.subtract(part.end, part.start)
    length = float(np.linalg.norm(way))
    half = (part.radius, part.radius, part.radius + length / 2)
    turn = Rotation.align_vectors([way], [[0, 0, 1]])[0] if length else None
    return moved(solid("capsule", half), np.add(part.start, part.end) / 2, turn)


def hand_meshes(geometry: Geometry) -> Iterator[tuple[str, Trimesh, Color]]:
    """Every mesh of a hand with its colour, and the link in whose frame it is."""
    for part in geometry.palm_solids:
        yield "palm", _of_hand(part), COLORS["palm" if isinstance(part, Box) else "housing"]
    for digit in geometry.digits:
        for phalanx in digit.phalanges:
            yield phalanx.link, _of_hand(phalanx.capsule), COLORS["phalanx"]
            yield phalanx.link, _of_hand(phalanx.pin), COLORS["hinge"]
        pad = solid("sphere", (1.003 * phalanx.capsule.radius,) * 3)
        yield phalanx.link, moved(pad, phalanx.capsule.end), COLORS["pad"]


def object_meshes(spec: ObjectSpec) -> Iterator[tuple[Trimesh, Color]]:
    """The solids of an object in its frame, with their colour."""
    if spec.model is None:
        yield solid(spec.shape, spec.half_extents), OBJECT_COLORS[spec.shape]
        return
    for part in spec.model.solids:
        if part.hull is not None:
            mesh = Trimesh(part.hull.vertices, part.hull.faces, process=False)
            mesh.unmerge_vertices()
        else:
            mesh = solid(part.kind, np.array(part.size) / 2)
        mesh = moved(mesh, part.center, Rotation.from_matrix(part.rotation))
        yield mesh.apply_scale(spec.scale), spec.model.color


def add_mesh(
    server: viser.ViserServer, name: str, mesh: Trimesh, rgb: Color, **look: object
) -> None:
    """Show a mesh, with its own colour and without a shadow unless `look` says otherwise."""
    given = {"color": rgb[:3], "cast_shadow": False, **look}
    server.scene.add_mesh_simple(name, mesh.vertices, mesh.faces, **given)


class Links:
    """The links of the hand, or of a ghost that a prediction lays over it.

    Args:
        server: of the page.
        setup: the scene.
        ghost: name of the ghost, and its colour, RGB of 255.

    Attributes:
        palm: frame of the palm and of all links, which hides them if it is not visible.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        setup: SceneSetup,
        ghost: str = "",
        color: tuple[int, int, int] | None = None,
    ) -> None:
        geometry = setup.geometry
        self._joints = [JOINT_INDEX[phalanx.joint] for phalanx in geometry.phalanges]
        self._turn = Rotation.from_matrix(
            [rotation_from_rpy(phalanx.rpy) for phalanx in geometry.phalanges]
        )
        self._axes = np.array([phalanx.axis for phalanx in geometry.phalanges])
        x, y, z, w = setup.hand_quaternion
        root = f"/scene/{ghost or 'hand'}"
        self.palm = server.scene.add_frame(
            root, show_axes=False, wxyz=(w, x, y, z), visible=not ghost
        )
        paths = {"palm": root}
        self._frames = []
        self._tendons: dict[str, list[viser.LineSegmentsHandle]] = {name: [] for name in DIGITS}
        for phalanx in geometry.phalanges:
            paths[phalanx.link] = path = f"{paths[phalanx.parent]}/{phalanx.link}"
            self._frames.append(
                server.scene.add_frame(path, show_axes=False, position=phalanx.origin)
            )
            if not ghost:  # a tendon is drawn along the palmar side of a link
                reach = 1.08 * phalanx.capsule.radius
                ends = np.array([[[reach, 0.0, 0.0], [reach, 0.0, phalanx.capsule.end[2]]]])
                line = server.scene.add_line_segments(
                    f"{path}/tendon", ends, tuple(SLACK_COLOR), thickness=0.0022
                )
                self._tendons[phalanx.joint.split("_")[0]].append(line)
        look = {"color": color, "opacity": 0.35} if ghost else {}
        for index, (link, mesh, own) in enumerate(hand_meshes(geometry)):
            if not (ghost and link == "palm"):
                add_mesh(server, f"{paths[link]}/mesh_{index}", mesh, own, **look)

    def pose(self, joint_pos: Array, wrist: Array) -> None:
        """Move the links."""
        self.palm.position = tuple(HAND_POSITION + wrist)
        flexed = Rotation.from_rotvec(self._axes * joint_pos[self._joints][:, None])
        for frame, turn in zip(
            self._frames, (self._turn * flexed).as_quat(scalar_first=True), strict=True
        ):
            frame.wxyz = turn

    def pull(self, tension: Array) -> None:
        """Colour the tendons by their tension, in sixteen steps."""
        share = np.rint(16 * np.clip(tension / STRONG, 0.0, 1.0)) / 16
        colors = np.rint(SLACK_COLOR + share[:, None] * (PULLED_COLOR - SLACK_COLOR))
        for lines, color in zip(self._tendons.values(), colors.astype(np.uint8), strict=True):
            for line in lines:
                line.colors = color
