"""The links of a hand in the browser, and of the ghosts that predictions lay over it."""

import numpy as np
import viser
from scipy.spatial.transform import Rotation
from trimesh import Trimesh

from hpac_gym.body.geometry import Phalanx, rotation_from_rpy
from hpac_gym.model import DIGITS, JOINT_INDEX
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import HAND_POSITION, SceneSetup
from hpac_gym.view.meshes import Color, hand_meshes

STRONG = 20.0
"""Tension from which on a tendon has its strongest colour [N]."""
SLACK_COLOR = np.array([70, 110, 190])
PULLED_COLOR = np.array([255, 150, 20])
"""Colours of a slack and of a pulled tendon, which differ for colour-blind people too, RGB."""


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
            if not ghost:
                self._add_tendon(server, path, phalanx)
        look = {"color": color, "opacity": 0.35} if ghost else {}
        for index, (link, mesh, own) in enumerate(hand_meshes(geometry)):
            if not (ghost and link == "palm"):
                add_mesh(server, f"{paths[link]}/mesh_{index}", mesh, own, **look)

    def _add_tendon(self, server: viser.ViserServer, path: str, phalanx: Phalanx) -> None:
        """A tendon is drawn along the palmar side of a link."""
        reach = 1.08 * phalanx.capsule.radius
        ends = np.array([[[reach, 0.0, 0.0], [reach, 0.0, phalanx.capsule.end[2]]]])
        line = server.scene.add_line_segments(
            f"{path}/tendon", ends, tuple(SLACK_COLOR), thickness=0.0022
        )
        self._tendons[phalanx.joint.split("_")[0]].append(line)

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
