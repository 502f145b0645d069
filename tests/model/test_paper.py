"""The paper's equations, table and printed figures, one test each, against its formulas written out
here.
"""

from math import acos, cos, radians, sin, sqrt

import numpy as np
import pytest

from hpac_gym.model import (
    FINGERS,
    HPAC,
    JOINT_INDEX,
    JOINTS,
    SERVO_INDEX,
    SERVOS,
    clip_to_workspace,
    elastic_deviation,
    elastic_joints_from_servo,
    joints_from_synergy,
    rigid_joints_from_servo,
    servo_from_joints,
    servo_from_synergy,
    spring_tension,
    synergy_from_servo,
    transmission_matrix,
)

TABLE_I = {
    "thumb_ip": (0.00, 0.99),
    "thumb_mp": (0.00, 1.25),
    "index_dip": (0.00, 1.31),
    "index_pip": (0.00, 1.61),
    "index_mcp": (0.00, 1.27),
    "middle_dip": (0.00, 1.28),
    "middle_pip": (0.00, 1.58),
    "middle_mcp": (0.00, 1.24),
    "ring_dip": (0.00, 1.29),
    "ring_pip": (0.00, 1.59),
    "ring_mcp": (0.00, 1.25),
    "pinky_dip": (0.00, 1.25),
    "pinky_pip": (0.00, 1.55),
    "pinky_mcp": (0.00, 1.23),
    "thumb_cmc": (0.00, 1.57),
}

SHARES = (0.0, 0.05, 0.4, 0.75, 1.0)
"""Where in its range a servo is tried."""


def servo_at(share: float) -> np.ndarray:
    return HPAC.servo_min + share * (HPAC.servo_max - HPAC.servo_min)


def of(values: np.ndarray, *joints: str) -> list[float]:
    """Entries of a 15-vector by joint name, joints of a finger in the paper's order of use."""
    return [float(values[JOINT_INDEX[joint]]) for joint in joints]


def cosine_law(digit: str, servo: float) -> float:
    """The right-hand side of Eqs. (5) and (7)."""
    p = HPAC.digits[digit]
    chord_at_rest = sqrt(p.d1**2 + p.d2**2 - 2 * p.d1 * p.d2 * cos(p.alpha))
    chord = chord_at_rest - p.servo_radius * servo
    return p.alpha - acos((p.d1**2 + p.d2**2 - chord**2) / (2 * p.d1 * p.d2))


def finger_matrix(digit: str) -> np.ndarray:
    """M of Eq. (12), entry by entry as printed."""
    p = HPAC.digits[digit]
    r_mcp, r_pip, r_dip = p.joint_radius
    l_mcp_pip, l_pip_dip = p.path_length
    c_pip = p.spring_stiffness * l_mcp_pip / (p.tendon_stiffness * r_pip)
    c_dip = p.spring_stiffness * (l_mcp_pip + l_pip_dip) / (p.tendon_stiffness * r_dip)
    return np.array(
        [
            [1, 0, 0],
            [c_pip * r_mcp, 1 + c_pip * r_pip, c_pip * r_dip],
            [c_dip * r_mcp, c_dip * r_pip, 1 + c_dip * r_dip],
        ]
    )


@pytest.mark.parametrize("finger", FINGERS)
@pytest.mark.parametrize("share", SHARES)
def test_eq_1_every_joint_of_a_finger_winds_the_same_length(finger, share):
    """Eq. (1): R_DIP q_DIP = R_PIP q_PIP = R_MCP q_MCP."""
    q_dip, q_pip, q_mcp = of(
        rigid_joints_from_servo(servo_at(share)), *(f"{finger}_{s}" for s in ("dip", "pip", "mcp"))
    )
    r_mcp, r_pip, r_dip = HPAC.digits[finger].joint_radius
    assert r_dip * q_dip == pytest.approx(r_mcp * q_mcp, abs=1e-15)
    assert r_pip * q_pip == pytest.approx(r_mcp * q_mcp, abs=1e-15)


@pytest.mark.parametrize("finger", FINGERS)
def test_eq_2_radii_5_4_5_give_angles_4_5_4(finger):
    """Eq. (2): q_DIP : q_PIP : q_MCP = 4 : 5 : 4, from R_DIP : R_PIP : R_MCP = 5 : 4 : 5."""
    r_mcp, r_pip, r_dip = HPAC.digits[finger].joint_radius
    assert (r_dip / r_mcp, r_pip / r_mcp) == pytest.approx((5 / 5, 4 / 5))
    q_dip, q_pip, q_mcp = of(
        rigid_joints_from_servo(servo_at(0.6)), *(f"{finger}_{s}" for s in ("dip", "pip", "mcp"))
    )
    assert (q_dip / q_mcp, q_pip / q_mcp) == pytest.approx((4 / 4, 5 / 4))


@pytest.mark.parametrize("digit", HPAC.digits)
def test_eq_3_chord_at_rest(digit):
    """Eq. (3): L0 = sqrt(d1² + d2² − 2 d1 d2 cos α), the distance of two points in the plane."""
    p = HPAC.digits[digit]
    apart = np.array([p.d1, 0.0]) - p.d2 * np.array([cos(p.alpha), sin(p.alpha)])
    assert p.rest_chord == pytest.approx(np.hypot(*apart), rel=1e-14)


@pytest.mark.parametrize("finger", FINGERS)
@pytest.mark.parametrize("share", SHARES)
def test_eq_4_included_angle_spans_the_shortened_chord(finger, share):
    """Eq. (4): guides placed at the included angle φ = α − q_MCP are L0 − r u apart."""
    p = HPAC.digits[finger]
    servo = servo_at(share)
    phi = p.alpha - synergy_from_servo(servo)[SERVO_INDEX[f"{finger}_mcp"]]
    apart = np.array([p.d1, 0.0]) - p.d2 * np.array([cos(phi), sin(phi)])
    wound = p.servo_radius * servo[SERVO_INDEX[f"{finger}_mcp"]]
    assert np.hypot(*apart) == pytest.approx(p.rest_chord - wound, rel=1e-12)


@pytest.mark.parametrize("root", SERVOS[:-1])
@pytest.mark.parametrize("share", SHARES)
def test_eqs_5_and_7_mcp_and_mp_of_a_servo_angle(root, share):
    """Eq. (5) for the fingers' MCP, Eq. (7) for the thumb's MP."""
    servo = servo_at(share)
    expected = cosine_law(root.partition("_")[0], servo[SERVO_INDEX[root]])
    assert synergy_from_servo(servo)[SERVO_INDEX[root]] == pytest.approx(expected, abs=1e-13)
    assert of(rigid_joints_from_servo(servo), root) == pytest.approx([expected], abs=1e-13)


def test_eq_6_thumb_radii_5_4_give_angles_4_5():
    """Eq. (6): q_IP : q_MP = 4 : 5, from R_IP : R_MP = 5 : 4."""
    r_mp, r_ip = HPAC.digits["thumb"].joint_radius
    assert r_ip / r_mp == pytest.approx(5 / 4)
    q_ip, q_mp = of(rigid_joints_from_servo(servo_at(0.6)), "thumb_ip", "thumb_mp")
    assert q_ip / q_mp == pytest.approx(4 / 5)


def test_eq_8_cmc_turns_with_its_servo():
    """Eq. (8): q_CMC = g u6 with g = 1."""
    assert HPAC.cmc_gain == 1
    for share in SHARES:
        servo = servo_at(share)
        assert of(rigid_joints_from_servo(servo), "thumb_cmc") == [servo[SERVO_INDEX["thumb_cmc"]]]


@pytest.mark.parametrize("share", SHARES[1:])
def test_eq_9_h_times_u_is_the_rigid_posture(share):
    """Eq. (9): q_ideal = H(u) u, with q_ideal from Eqs. (2), (5), (6), (7), (8)."""
    servo = servo_at(share)
    expected = np.zeros(15)
    for finger in FINGERS:
        q_mcp = cosine_law(finger, servo[SERVO_INDEX[f"{finger}_mcp"]])
        for suffix, ratio in (("mcp", 1.0), ("pip", 1.25), ("dip", 1.0)):
            expected[JOINT_INDEX[f"{finger}_{suffix}"]] = ratio * q_mcp
    q_mp = cosine_law("thumb", servo[SERVO_INDEX["thumb_mp"]])
    expected[[JOINT_INDEX["thumb_mp"], JOINT_INDEX["thumb_ip"]]] = q_mp, 0.8 * q_mp
    expected[JOINT_INDEX["thumb_cmc"]] = servo[SERVO_INDEX["thumb_cmc"]]
    assert transmission_matrix(servo) @ servo == pytest.approx(expected, abs=1e-12)


def test_eq_9_h_has_fifteen_entries_each_of_one_servo():
    """Eq. (9): H is 15 × 6 with 15 non-zero entries; rows of a finger share one column; H_15,6 =
    1.
    """
    matrix = transmission_matrix(servo_at(0.5))
    assert matrix.shape == (15, 6)
    assert np.count_nonzero(matrix) == 15
    assert matrix[14, 5] == 1
    for column, servo in enumerate(SERVOS):
        moved = servo_at(0.5)
        moved[column] *= 0.9
        changed = np.argwhere(transmission_matrix(moved) != matrix)
        assert set(changed[:, 1]) == (set() if servo == "thumb_cmc" else {column})


@pytest.mark.parametrize("digit", HPAC.digits)
def test_eq_10_spring_tension(digit):
    """Eq. (10): T_spr = k_s (R_DIP q_DIP + R_PIP q_PIP + R_MCP q_MCP); two joints for the thumb."""
    p = HPAC.digits[digit]
    joint_pos = 0.9 * HPAC.joint_max
    excursion = sum(r * q for r, q in zip(p.joint_radius, of(joint_pos, *p.joints), strict=True))
    assert spring_tension(joint_pos)[list(HPAC.digits).index(digit)] == pytest.approx(
        p.spring_stiffness * excursion
    )


@pytest.mark.parametrize("finger", FINGERS)
def test_eq_11_deviation_of_pip_and_dip(finger):
    """Eq. (11): b_j = T_spr ΣL / (EA R_j), ΣL the path from MCP to the joint; zero for MCP."""
    p = HPAC.digits[finger]
    joint_pos = 0.9 * HPAC.joint_max
    q_mcp, q_pip, q_dip = of(joint_pos, *p.joints)
    r_mcp, r_pip, r_dip = p.joint_radius
    tension = p.spring_stiffness * (r_dip * q_dip + r_pip * q_pip + r_mcp * q_mcp)
    l_mcp_pip, l_pip_dip = p.path_length
    expected = [
        0.0,
        tension * l_mcp_pip / (p.tendon_stiffness * r_pip),
        tension * (l_mcp_pip + l_pip_dip) / (p.tendon_stiffness * r_dip),
    ]
    assert of(elastic_deviation(joint_pos), *p.joints) == pytest.approx(expected, rel=1e-12)


def test_eq_11_deviation_of_mp_and_cmc_is_zero():
    """Eq. (11): the compensation term is only non-zero for the interphalangeal joints."""
    deviation = elastic_deviation(HPAC.joint_max)
    at_rest = {joint for joint in JOINTS if deviation[JOINT_INDEX[joint]] == 0}
    assert at_rest == {joint for joint in JOINTS if joint.endswith(("_mcp", "_mp", "_cmc"))}


@pytest.mark.parametrize("finger", FINGERS)
@pytest.mark.parametrize("share", SHARES)
def test_eq_12_finger_equilibrium(finger, share):
    """Eq. (12): M q_comp = [1, 1.25, 1]ᵀ q_MCP with the printed 3 × 3 M; q_comp = M⁻¹ A q_MCP."""
    joints = of(
        elastic_joints_from_servo(servo_at(share)),
        *(f"{finger}_{s}" for s in ("mcp", "pip", "dip")),
    )
    assert finger_matrix(finger) @ joints == pytest.approx(
        np.array([1, 1.25, 1]) * joints[0], abs=1e-14
    )
    inverted = np.linalg.inv(finger_matrix(finger)) @ [1, 1.25, 1] * joints[0]
    assert joints == pytest.approx(list(inverted), abs=1e-14)


@pytest.mark.parametrize("share", SHARES)
def test_eq_13_thumb_equilibrium(share):
    """Eq. (13): [[1, 0], [C R_MP, 1 + C R_IP]] [q_MP, q_IP]ᵀ = [1, 0.8]ᵀ q_MP, C = k_s L / (EA
    R_IP).
    """
    p = HPAC.digits["thumb"]
    r_mp, r_ip = p.joint_radius
    c = p.spring_stiffness * p.path_length[0] / (p.tendon_stiffness * r_ip)
    q_mp, q_ip = of(elastic_joints_from_servo(servo_at(share)), "thumb_mp", "thumb_ip")
    assert c * r_mp * q_mp + (1 + c * r_ip) * q_ip == pytest.approx(0.8 * q_mp, abs=1e-14)


def test_eq_14_clips_jointwise():
    """Eq. (14): clip(q_d, q_min, q_max), with Table I typed out here."""
    wanted = np.linspace(-0.5, 2.0, 15)
    expected = [
        min(max(q, low), high) for q, (low, high) in zip(wanted, TABLE_I.values(), strict=True)
    ]
    assert clip_to_workspace(wanted).tolist() == expected


@pytest.mark.parametrize("share", SHARES)
def test_eq_15_is_the_exact_inverse_on_the_manifold(share):
    """Eq. (15): u* = H⁺[q̃ + b(q̃)] gives back the servo angles that made the posture."""
    servo = servo_at(share)
    assert servo_from_joints(elastic_joints_from_servo(servo)) == pytest.approx(servo, abs=1e-9)


def test_eq_15_off_the_manifold_is_least_squares_per_digit():
    """Eq. (15): off the manifold the synergy minimises |A q_root − (q̃ + b)| digit by digit, by
    numpy's solver.
    """
    joint_pos = np.array(
        [0.3, 0.5, 0.9, 0.4, 0.6, 0.2, 0.8, 0.5, 0.7, 0.7, 0.7, 0.1, 0.5, 0.9, 0.8]
    )
    target = joint_pos + elastic_deviation(joint_pos)
    expected = []
    for digit, ratio in (("thumb", [1, 0.8]), *((finger, [1, 1.25, 1]) for finger in FINGERS)):
        column = np.array(ratio)[:, None]
        expected.append(
            np.linalg.lstsq(column, of(target, *HPAC.digits[digit].joints), rcond=None)[0][0]
        )
    expected.append(joint_pos[JOINT_INDEX["thumb_cmc"]])
    assert servo_from_joints(joint_pos) == pytest.approx(servo_from_synergy(expected), abs=1e-12)


def test_table_1_admissible_workspace():
    """Table I: q1…q15 in its order, with its bounds."""
    assert tuple(TABLE_I) == JOINTS
    assert list(zip(HPAC.joint_min, HPAC.joint_max, strict=True)) == list(TABLE_I.values())


def test_table_1_holds_every_posture_that_the_servos_reach():
    """Table I: the elastic posture at the upper bound of all six driven joints lies within the
    box.
    """
    posture = joints_from_synergy(HPAC.synergy_max)
    assert (posture >= HPAC.joint_min).all()
    assert (posture <= HPAC.joint_max + 1e-12).all()


def test_6_actuators_and_15_joints():
    """The abstract's 6-actuator, 15-DoF hand: servos 1…6 by what they drive."""
    assert len(JOINTS) == 15
    assert SERVOS == ("thumb_mp", "index_mcp", "middle_mcp", "ring_mcp", "pinky_mcp", "thumb_cmc")


def test_residuals_approach_2_degrees_in_the_shape_of_the_cosine_law():
    """Mean 1.15° and largest 2.0° of a deviation that grows with q_MCP: their ratio is the cosine
    law's alone.
    """
    servo = np.linspace(HPAC.servo_min, HPAC.servo_max, 2001)
    deviation = elastic_deviation(elastic_joints_from_servo(servo))[:, JOINT_INDEX["index_dip"]]
    assert deviation.mean() / deviation.max() == pytest.approx(1.15 / 2.0, abs=0.01)


def test_largest_deviation_is_the_index_dip_and_stays_below_2_degrees():
    """2.0°: no joint's elastic deviation passes it, and the index DIP's is the largest, as the
    paper's figure has it.
    """
    largest = elastic_deviation(elastic_joints_from_servo(HPAC.servo_max))
    assert JOINTS[int(largest.argmax())] == "index_dip"
    assert radians(1.5) < largest.max() < radians(2.0)


def test_each_finger_has_its_own_parameters():
    """ "Each long finger uses its own parameter set rather than sharing a common set"."""
    numbers = [
        (p.d1, p.d2, p.servo_radius, p.joint_radius, p.path_length, p.spring_stiffness)
        for p in (HPAC.digits[finger] for finger in FINGERS)
    ]
    assert len(set(numbers)) == len(FINGERS)
