"""Malformed input of every public function: a named error with value, bound and unit, one fault a
row.
"""

import numpy as np
import pytest

from hpac_gym.errors import HpacError, ParameterError, ShapeError, WorkspaceError
from hpac_gym.model import (
    HPAC,
    ServoCommand,
    action_from_synergy,
    clip_synergy,
    clip_to_workspace,
    elastic_deviation,
    elastic_joints_from_servo,
    joints_from_synergy,
    move_duration,
    rigid_joints_from_servo,
    servo_from_action,
    servo_from_joints,
    servo_from_synergy,
    spring_tension,
    stream_command,
    synergy_from_action,
    synergy_from_joints,
    synergy_from_servo,
    transmission_matrix,
)

SIX = (
    synergy_from_action,
    action_from_synergy,
    servo_from_action,
    joints_from_synergy,
    clip_synergy,
    servo_from_synergy,
    synergy_from_servo,
    rigid_joints_from_servo,
    elastic_joints_from_servo,
    transmission_matrix,
)
FIFTEEN = (
    clip_to_workspace,
    elastic_deviation,
    spring_tension,
    synergy_from_joints,
    servo_from_joints,
)
WIDTHS = [(function, 6) for function in SIX] + [(function, 15) for function in FIFTEEN]


def alone(width: int, index: int, value: float) -> np.ndarray:
    """Zeros but for one value."""
    values = np.zeros(width)
    values[index] = value
    return values


@pytest.mark.parametrize(
    ("function", "width"), WIDTHS, ids=lambda item: getattr(item, "__name__", "")
)
def test_what_is_no_array_of_finite_numbers_of_the_right_width_is_refused(function, width):
    for wrong in (np.zeros(width - 1), np.zeros((3, width + 1)), np.float64(0), np.zeros(0)):
        told = rf"\(\.\.\., {width}\), not \({', '.join(map(str, wrong.shape))}"
        with pytest.raises(ShapeError, match=told):
            function(wrong)
    for number in (np.nan, np.inf, -np.inf):
        with pytest.raises((ShapeError, WorkspaceError), match=r"finite|outside"):
            function(np.stack([np.zeros(width), alone(width, 3, number)]))
    for wrong in ("six words", None, [[0.0], [0.0, 1.0]], [10**400] * width):
        with pytest.raises((ShapeError, WorkspaceError)):
            function(wrong)
    for dtype in (complex, str, bytes, "m8[s]"):  # which NumPy would make real in silence
        with pytest.raises(ShapeError, match="not a type of real numbers"):
            function(np.zeros(width).astype(int).astype(dtype))


OUT_OF_RANGE = [
    (synergy_from_action, alone(6, 0, 1.5), r"action thumb_mp = 1\.5 .*\[-1, 1\]"),
    (synergy_from_action, alone(6, 5, -1.001), r"action thumb_cmc = -1\.001 .*\[-1, 1\]"),
    (servo_from_action, alone(6, 2, 2.0), r"action middle_mcp = 2 .*\[-1, 1\]"),
    (action_from_synergy, alone(6, 1, 1.28), r"synergy index_mcp = 1\.28 rad .*\[0, 1\.27\] rad"),
    (action_from_synergy, alone(6, 5, -0.1), r"synergy thumb_cmc = -0\.1 rad .*\[0, 1\.57\] rad"),
    (servo_from_joints, alone(15, 0, 1.0), r"joint_pos thumb_ip = 1 rad .*\[0, 0\.99\] rad"),
    (
        servo_from_joints,
        alone(15, 4, 1.289),
        r"joint_pos index_mcp = 1\.289 rad .*\[0, 1\.27\] rad",
    ),
    (servo_from_joints, alone(15, 14, -0.2), r"joint_pos thumb_cmc = -0\.2 rad .*\[0, 1\.57\] rad"),
    (servo_from_joints, alone(15, 3, 90.0), r"joint_pos index_pip = 90 rad .*\[0, 1\.61\] rad"),
    (synergy_from_servo, alone(6, 1, 4.0), r"servo index_mcp = 4 rad .*\[0, 1\.38\d*\] rad"),
    (rigid_joints_from_servo, alone(6, 0, -1.0), r"servo thumb_mp = -1 rad .*\[0, 1\.3\d*\] rad"),
    (elastic_joints_from_servo, alone(6, 4, 1e9), r"servo pinky_mcp = 1e\+09 rad .*\] rad"),
    (transmission_matrix, alone(6, 3, 5.0), r"servo ring_mcp = 5 rad .*\] rad"),
    (
        servo_from_synergy,
        alone(6, 2, 2.7),
        r"synergy middle_mcp = 2\.7 rad .*\[-0\.52\d*, 2\.61\d*\] rad",
    ),
    (
        servo_from_synergy,
        alone(6, 0, -0.6),
        r"synergy thumb_mp = -0\.6 rad .*\[-0\.52\d*, 2\.61\d*\] rad",
    ),
]


@pytest.mark.parametrize(("function", "value", "message"), OUT_OF_RANGE)
def test_a_value_out_of_range_is_told_with_name_bounds_and_unit(function, value, message):
    with pytest.raises(WorkspaceError, match=message):
        function(value)
    with pytest.raises(WorkspaceError, match=message):
        function(np.stack([np.zeros_like(value), value]))


@pytest.mark.processor
def test_a_rounding_error_past_a_bound_is_no_error():
    assert servo_from_joints(HPAC.joint_max + 5e-10) == pytest.approx(
        servo_from_joints(HPAC.joint_max), abs=1e-8
    )
    assert servo_from_action(np.ones(6) + 5e-10) == pytest.approx(HPAC.servo_max, rel=1e-14)
    with pytest.raises(WorkspaceError):
        servo_from_joints(HPAC.joint_max + 2e-9)


def test_an_action_may_pass_its_bound_by_what_float32_rounds_and_no_more():
    for sign, servo in ((1, HPAC.servo_max), (-1, HPAC.servo_min)):
        beyond = servo_from_action(np.full(6, sign * (1 + 9e-7)))
        np.testing.assert_array_equal(beyond, servo_from_action(np.full(6, float(sign))))
        assert beyond == pytest.approx(servo, abs=1e-12)
        for function in (servo_from_action, synergy_from_action):
            with pytest.raises(WorkspaceError, match=r"action thumb_mp = .* \[-1, 1\]"):
                function(np.full(6, sign * (1 + 1.1e-6)))


@pytest.mark.parametrize("duration", [0.0, -0.1, np.nan, np.inf])
def test_a_command_needs_a_finite_positive_duration(duration):
    with pytest.raises(WorkspaceError, match=r"duration = .* s must be .* 0 s"):
        ServoCommand(np.zeros(6), duration)
    with pytest.raises(WorkspaceError, match=r"duration = .* s must be .* 0 s"):
        stream_command(np.zeros(6), np.ones(6), duration)


@pytest.mark.parametrize("fault", [np.zeros(5), alone(6, 1, np.nan), np.zeros((2, 6))])
def test_a_command_and_both_ends_of_a_move_need_six_finite_angles(fault):
    with pytest.raises(ShapeError):
        ServoCommand(fault, 0.1)
    for start, end in ((fault, np.zeros(6)), (np.zeros(6), fault)):
        with pytest.raises(ShapeError):
            move_duration(start, end)
        with pytest.raises(ShapeError):
            stream_command(start, end, 0.05)


def test_every_error_is_one_of_ours_and_a_value_error():
    for error in (ParameterError, ShapeError, WorkspaceError):
        assert issubclass(error, HpacError)
        assert issubclass(error, ValueError)
