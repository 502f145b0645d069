"""Indices into the arrays of a compiled model, found by the names of its elements."""

from __future__ import annotations

import mujoco
import numpy as np

from hpac_gym.model import DIGITS, JOINTS
from hpac_gym.physics.mjcf import fixed_tendons


class Addresses:
    """Indices into the arrays of a compiled model that `build` made.

    Attributes:
        hinge: indices of `JOINTS` among the model's joints.
        joint: positions of `JOINTS` in qpos.
        dof: positions of `JOINTS` in qvel.
        object: position of the object in qpos; −1 without a movable object.
        object_body: index of the object's body; −1 without an object.
        pose: positions in qpos of `JOINTS`, of the three slides of the wrist, and of the movable
            object's place and quaternion, as far as there are any.
        motion: positions in qvel of `JOINTS`, and of the movable object's velocity and spin.
        palm: index of the palm's body.
        hand: bodies of the hand.
        hand_geoms: geoms of the hand.
        object_geoms: geoms of the object.
        boxes: geoms of posts and walls, then the table, then the target's post.
        guides: sites of the drives' guides, fixed and moving, by digit, shape (5, 2).
        fixed: couplings, then springs.
        drives: spatial tendons, by digit.
        wraps: positions of the fixed tendons' coefficients in wrap_prm.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        bodies = [model.body(index).name for index in range(model.nbody)]
        joints = [model.joint(index).name for index in range(model.njnt)]
        geoms = [model.geom(index).name for index in range(model.ngeom)]

        def found(names: list[str], *beginnings: str) -> np.ndarray:
            rows = [
                index
                for beginning in beginnings
                for index, name in enumerate(names)
                if name.startswith(beginning)
            ]
            return np.array(rows, dtype=int)

        self.hinge = np.array([joints.index(name) for name in JOINTS])
        self.joint = model.jnt_qposadr[self.hinge]
        self.dof = model.jnt_dofadr[self.hinge]
        movable = found(joints, "object")
        self.object = int(model.jnt_qposadr[movable[0]]) if len(movable) else -1
        self.object_body = bodies.index("object") if "object" in bodies else -1
        slides = model.jnt_qposadr[found(joints, "wrist")]
        places = [model.jnt_qposadr[movable] + index for index in range(7)]
        speeds = [model.jnt_dofadr[movable] + index for index in range(6)]
        self.pose = np.concatenate([self.joint, slides, *places])
        self.motion = np.concatenate([self.dof, *speeds])
        self.palm = bodies.index("palm")
        self.hand = np.array(
            [index for index, name in enumerate(bodies) if name == "palm" or name.endswith("_link")]
        )
        self.hand_geoms = np.flatnonzero(np.isin(model.geom_bodyid, self.hand))
        self.object_geoms = found(geoms, "object_")
        self.boxes = found(geoms, "support_", "table", "target")
        self.guides = np.array(
            [
                [model.site(f"{digit}_{end}_guide").id for end in ("fixed", "moving")]
                for digit in DIGITS
            ]
        )
        self.fixed = np.array([model.tendon(name).id for name in fixed_tendons()])
        self.drives = np.array([model.tendon(f"{digit}_drive").id for digit in DIGITS])
        self.wraps = np.array(
            [model.tendon_adr[i] + k for i in self.fixed for k in range(model.tendon_num[i])]
        )
