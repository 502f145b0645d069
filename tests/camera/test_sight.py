"""From where docs/camera.md puts the camera, no other digit hides a tag of the swept finger."""

import numpy as np
import pytest

from experiments.strips import STAND_OFF
from hpac_gym.body.geometry import Capsule, link_poses, load_geometry
from hpac_gym.calibration.driver import OUT_OF_SIGHT
from hpac_gym.camera.sheet import CHAINS
from hpac_gym.model import HPAC, JOINT_INDEX, SERVO_INDEX, elastic_joints_from_servo

SIDE = {"index_mcp": 0.3, "middle_mcp": 0.3, "ring_mcp": -0.3, "pinky_mcp": -0.3}
HALF = 0.007


def links(joint_pos):
    """Position, rotation and capsule of every link."""
    return {
        phalanx.joint: (*pose, phalanx.capsule)
        for digit in load_geometry().digits
        for phalanx, pose in zip(
            digit.phalanges,
            link_poses(digit, [joint_pos[JOINT_INDEX[p.joint]] for p in digit.phalanges]),
            strict=True,
        )
    }


def hides(start, end, radius, point, camera):
    """Whether a capsule is between a point and the camera."""
    way = np.linspace(0.0, 0.5, 120)[:, None] * (camera - point) + point
    along = np.clip((way - start) @ (end - start) / np.dot(end - start, end - start), 0, 1)
    nearest = start + along[:, None] * (end - start)
    return bool((np.linalg.norm(way - nearest, axis=1) < radius).any())


def hidden(servo, moved, share):
    """Tags of a swept finger that some link or the palm hides at a share of its range."""
    command = np.zeros(6)
    for name in moved:
        command[SERVO_INDEX[name]] = HPAC.servo_max[SERVO_INDEX[name]]
    command[SERVO_INDEX[servo]] = share * HPAC.servo_max[SERVO_INDEX[servo]]
    placed = links(elastic_joints_from_servo(command, HPAC))
    camera = np.array([0.05, SIDE[servo], 0.12])
    solids = [
        (position + rotation @ capsule.start, position + rotation @ capsule.end, capsule.radius)
        for position, rotation, capsule in placed.values()
    ] + [
        (np.array(solid.start), np.array(solid.end), solid.radius)
        for solid in load_geometry().palm_solids
        if isinstance(solid, Capsule)
    ]
    found = set()
    for joint in CHAINS[servo][1:]:
        position, rotation, capsule = placed[joint]
        middle = np.array([-(capsule.radius + STAND_OFF), 0.0, np.mean([capsule.end[2], 0.0])])
        for x, z in np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]]) * HALF:
            point = position + rotation @ (middle + np.array([x, 0.0, z]))
            if any(hides(*solid, point, camera) for solid in solids):
                found.add(joint)
    return found


@pytest.mark.parametrize("servo", SIDE)
def test_a_finger_s_tags_are_seen_over_its_whole_range(servo):
    moved = [OUT_OF_SIGHT[servo]] if servo in OUT_OF_SIGHT else []
    for share in np.linspace(0, 1, 11):
        assert not hidden(servo, moved, share), share


@pytest.mark.parametrize("servo", OUT_OF_SIGHT)
def test_they_are_not_while_the_neighbour_is_open(servo):
    assert any(hidden(servo, [], share) for share in np.linspace(0, 1, 11))
