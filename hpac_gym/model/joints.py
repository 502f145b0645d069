"""Names and order of the fifteen joints and six servos; no other module defines them.

Joints follow the paper's q1…q15 (distal first within a digit), servos its 1…6. A servo carries the
name of the joint that it drives. Indices count from 0; only labels for users count from 1.
"""

DIGITS = ("thumb", "index", "middle", "ring", "pinky")
"""The five digits, in the order of the servos that flex them."""

FINGERS = DIGITS[1:]
"""The four long digits."""

JOINTS = (
    *("thumb_ip", "thumb_mp"),
    *("index_dip", "index_pip", "index_mcp"),
    *("middle_dip", "middle_pip", "middle_mcp"),
    *("ring_dip", "ring_pip", "ring_mcp"),
    *("pinky_dip", "pinky_pip", "pinky_mcp"),
    "thumb_cmc",
)
"""Joint names, the paper's q1…q15."""

SERVOS = ("thumb_mp", "index_mcp", "middle_mcp", "ring_mcp", "pinky_mcp", "thumb_cmc")
"""Servo names, the paper's 1…6: each is the joint that it drives, and a synergy coordinate."""

JOINT_INDEX = {name: index for index, name in enumerate(JOINTS)}
SERVO_INDEX = {name: index for index, name in enumerate(SERVOS)}


def digit_joints(digit: str) -> tuple[str, ...]:
    """The joints that a digit's tendon couples, root joint first, fingertip last."""
    suffixes = ("mp", "ip") if digit == "thumb" else ("mcp", "pip", "dip")
    return tuple(f"{digit}_{suffix}" for suffix in suffixes)
