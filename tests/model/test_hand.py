"""Hand files and hands as values: sources, errors that name file and field, immutability,
copies.
"""

import copy
import pickle
import re
import tomllib
from dataclasses import FrozenInstanceError, replace
from functools import cached_property
from importlib.resources import files

import numpy as np
import pytest

from hpac_gym.errors import ParameterError
from hpac_gym.model import (
    HPAC,
    JOINTS,
    Hand,
    ServoCommand,
    hand_to_toml,
    load_hand,
    servo_from_action,
)
from hpac_gym.model.calibration import Calibration, Friction
from hpac_gym.model.files import hand_from_toml

TEXT = (files("hpac_gym.model") / "data" / "hpac.toml").read_text(encoding="utf-8")
TABLE = tomllib.loads(TEXT)
DERIVED = [name for name, kind in vars(Hand).items() if isinstance(kind, cached_property)]


@pytest.fixture
def hand_file(tmp_path):
    """Writes a hand file whose text is the nominal one with one pattern replaced, and returns its
    path.
    """

    def write(pattern: str, text: str):
        changed, count = re.subn(pattern, text, TEXT, count=1, flags=re.MULTILINE)
        assert count == 1, pattern
        path = tmp_path / "hand.toml"
        path.write_text(changed, encoding="utf-8")
        return path

    return write


def test_a_written_hand_is_read_again(tmp_path):
    ring = replace(HPAC.digits["ring"], d2=0.031)
    changed = replace(
        HPAC,
        name='a "quoted" hand 🖐',
        cmc_gain=0.98,
        digits={**HPAC.digits, "ring": ring},
        sources={"d1": "a caliper", "my note": "kept,\n\x7f too", "größe": "M"},
        calibration=Calibration((0.01,) * 6, (Friction(1e-3, 0.03), *[Friction(2e-3)] * 4)),
    )
    path = tmp_path / "hand.toml"
    for hand in (HPAC, changed):
        path.write_text(hand_to_toml(hand), encoding="utf-8")
        assert load_hand(path) == hand
        assert dict(load_hand(path).sources) == dict(hand.sources)
    assert "[calibration]" not in hand_to_toml(HPAC)


def test_a_hand_with_numbers_and_arrays_of_numpy_is_a_hand_like_any_other():
    """It is written, read, compared and kept like one of Python's own numbers."""
    zero = np.radians([1.0, 0, 0, 0, 0, 0])
    index = HPAC.digits["index"]
    given = replace(
        HPAC,
        digits=HPAC.digits
        | {
            "index": replace(
                index,
                d1=np.float64(index.d1),
                joint_radius=np.array(index.joint_radius),
                path_length=list(index.path_length),
            )
        },
        workspace=HPAC.workspace | {"ring_mcp": np.array([0.0, 1.25])},
        rate_limit=np.int64(2),
        calibration=Calibration(zero, [Friction(np.float32(0.0))] * 5),
    )
    assert hand_from_toml(hand_to_toml(given), "text") == replace(
        HPAC, calibration=Calibration(tuple(zero.tolist()))
    )
    assert given.digits["index"] == index
    assert given.is_calibrated
    zero[0] = 0.0
    assert given.is_calibrated
    assert not replace(HPAC, calibration=Calibration([0.0] * 6)).is_calibrated


def test_every_field_of_the_file_has_a_source():
    fields = {field for digit in TABLE["digits"].values() for field in digit}
    fields |= {*TABLE["servo"], *TABLE["cmc"], "workspace"}
    assert fields == set(TABLE["sources"])
    assert all(
        text.startswith(("published", "derived", "chosen", "ratios published"))
        for text in TABLE["sources"].values()
    )
    assert dict(HPAC.sources) == TABLE["sources"]
    chosen = {"d1", "d2", "servo_radius", "path_length", "spring_stiffness", "drive_stiffness"}
    assert all(HPAC.sources[field].startswith("chosen") for field in chosen)


FAULTS = [
    ("missing field", r"^d2 = 0.030\n", "", r"digit thumb is missing or does not know d2$"),
    (
        "text for a number",
        r"^d1 = 0.012$",
        'd1 = "12 mm"',
        r"digit thumb d1 = '12 mm' m must be a number within \]0, ",
    ),
    (
        "truth for a number",
        r"^d1 = 0.012$",
        "d1 = true",
        r"digit thumb d1 = True m must be a number",
    ),
    (
        "negative number",
        r"^d1 = 0.012$",
        "d1 = -0.012",
        r"digit thumb d1 = -0\.012 m must be a number within \]0, ",
    ),
    (
        "zero",
        r"^spring_stiffness = 200.0",
        "spring_stiffness = 0",
        r"thumb spring_stiffness = 0\.0 N/m must be a number within \]0, ",
    ),
    (
        "NaN",
        r"^drive_stiffness = 2.5e5",
        "drive_stiffness = nan",
        r"thumb drive_stiffness = nan N/m must be",
    ),
    (
        "infinity",
        r"^tendon_stiffness = 1800.0",
        "tendon_stiffness = inf",
        r"thumb tendon_stiffness = inf N must be",
    ),
    (
        "negative in a list",
        r"\[0.0060, 0.0075\]",
        "[0.0060, -0.0075]",
        r"thumb joint_radius = \[0\.006, -0\.0075\] m must be values within \]0, ",
    ),
    (
        "list too short",
        r"\[0.0060, 0.0075\]",
        "[0.0060]",
        r"thumb joint_radius = \(0\.006,\) must have 2 entries",
    ),
    (
        "number for a list",
        r"^path_length = \[0.050\]",
        "path_length = 0.050",
        r"thumb path_length = 0\.05 m must be values",
    ),
    (
        "text for an angle",
        r"^alpha_deg = 150.0",
        'alpha_deg = "wide"',
        r"thumb alpha_deg = 'wide' must be a number",
    ),
    (
        "angle too wide",
        r"^alpha_deg = 150.0",
        "alpha_deg = 181.0",
        r"thumb alpha = 3\.15\d* rad must be a number within \]0, 3\.14159\] rad",
    ),
    (
        "guides too narrow",
        r"^alpha_deg = 150.0",
        "alpha_deg = 60.0",
        r"thumb: workspace \[0\.0, 1\.25\] rad must lie within",
    ),
    (
        "unknown digit field",
        r"^d1 = 0.012$",
        "d1 = 0.012\nd3 = 0.1",
        r"digit thumb is missing or does not know d3",
    ),
    (
        "unknown table",
        r"^\[servo\]",
        "[motor]\nx = 1\n[servo]",
        r"the file is missing or does not know motor",
    ),
    (
        "missing digit",
        r"^\[digits\.pinky\][^[]*(\[[^[]*)*?(?=^\[workspace)",
        "",
        r"digits is missing or does not know pinky",
    ),
    ("missing table", r"^\[cmc\]\n(^cmc.*\n)+", "", r"the file is missing or does not know cmc"),
    ("wrong schema", r"^schema = 1", "schema = 2", r"schema 2 is not 1"),
    ("no schema", r"^schema = 1\n", "", r"schema None is not 1"),
    ("not TOML", r"^schema = 1", "schema: 1", r"not TOML"),
    (
        "unknown joint",
        r"^ring_pip = ",
        "ring_pop = ",
        r"workspace is missing or does not know ring_pip, ring_pop",
    ),
    (
        "bounds upside down",
        r"^ring_pip = .*$",
        "ring_pip = [1.59, 0.0]",
        r"workspace of ring_pip = \[1\.59, 0\.0\] rad must be \[min, max\]",
    ),
    (
        "three bounds",
        r"^ring_pip = .*$",
        "ring_pip = [0, 1, 2]",
        r"workspace of ring_pip = \[0\.0, 1\.0, 2\.0\] rad must be \[min, max\]",
    ),
    (
        "degrees",
        r"^ring_mcp = .*$",
        "ring_mcp = [0.0, 71.6]",
        r"digit ring: workspace \[0\.0, 71\.6\] rad must lie within",
    ),
    (
        "no rate",
        r"^rate_limit = \d.*$",
        "rate_limit = 0.0",
        r"rate_limit = 0\.0 rad/s must be a number within \]0, 100\] rad/s",
    ),
    (
        "millimetres",
        r"\[0.0060, 0.0075\]",
        "[6.0, 7.5]",
        r"digit thumb: length = 7\.5 m, allowed at most 1 m",
    ),
    (
        "an integer that no float holds",
        r"^rate_limit = \d.*$",
        f"rate_limit = {10**400}",
        r"rate_limit = inf rad/s must be",
    ),
    (
        "an integer that Python does not read",
        r"^rate_limit = \d.*$",
        f"rate_limit = {'9' * 5000}",
        r"not TOML: Exceeds the limit",
    ),
    ("a source that is no text", r"^d1 = \".*$", "d1 = 3", r"\[sources\] d1 must be text, not 3"),
    (
        "a servo that winds up",
        r"^cmc_gain = 1.0$",
        "cmc_gain = 1e-9",
        r"servo angle = 1.*e\+09 rad, allowed at most 3\.14159 rad",
    ),
]


@pytest.mark.parametrize(
    ("pattern", "text", "message"), [row[1:] for row in FAULTS], ids=[row[0] for row in FAULTS]
)
def test_a_faulty_hand_file_is_told_in_one_line_with_its_path(hand_file, pattern, text, message):
    path = hand_file(pattern, text)
    with pytest.raises(ParameterError, match=message) as caught:
        load_hand(path)
    assert str(caught.value).startswith(f"hand file {path}: ")
    assert "\n" not in str(caught.value)


def test_a_hand_file_that_cannot_be_read_is_told_with_its_path(tmp_path):
    with pytest.raises(ParameterError, match=r"none\.toml: No such file"):
        load_hand(tmp_path / "none.toml")
    with pytest.raises(ParameterError, match=r"Is a directory"):
        load_hand(tmp_path)
    (tmp_path / "latin.toml").write_bytes(b"schema = 1 # \xe9")
    with pytest.raises(ParameterError, match=r"latin\.toml: not UTF-8"):
        load_hand(tmp_path / "latin.toml")


def test_a_hand_needs_exactly_its_digits_and_joints():
    with pytest.raises(ParameterError, match="thumb"):
        replace(
            HPAC, digits={name: digit for name, digit in HPAC.digits.items() if name != "thumb"}
        )
    with pytest.raises(ParameterError, match="not one of thumb, index"):
        replace(HPAC.digits["index"], name="sixth")
    with pytest.raises(ParameterError, match="its index has the numbers of digit ring"):
        replace(HPAC, digits={**HPAC.digits, "index": HPAC.digits["ring"]})


@pytest.mark.parametrize("name", DERIVED)
def test_derived_arrays_are_cached_and_read_only(name):
    array = getattr(HPAC, name)
    assert getattr(HPAC, name) is array
    with pytest.raises(ValueError, match="read-only"):
        array[...] = 0


def test_hands_digits_and_commands_are_immutable_copies_of_what_they_were_made_of():
    servo = np.full(6, 0.1)
    workspace = dict(HPAC.workspace)
    command = ServoCommand(servo, 0.05)
    hand = replace(HPAC, workspace=workspace)
    for value, field in ((hand, "rate_limit"), (hand.digits["index"], "d1"), (command, "duration")):
        with pytest.raises(FrozenInstanceError):
            setattr(value, field, 1.0)
    with pytest.raises(ValueError, match="read-only"):
        command.servo[0] = 1.0
    for mapping in (hand.digits, hand.workspace, hand.sources):
        with pytest.raises(TypeError):
            mapping["index"] = None
    servo[0] = 1.0
    workspace["index_mcp"] = (0.0, 0.1)
    assert command.servo[0] == 0.1
    assert hand == HPAC


@pytest.mark.parametrize(
    "duplicate", [copy.copy, copy.deepcopy, lambda hand: pickle.loads(pickle.dumps(hand))]
)
def test_a_copied_or_pickled_hand_is_equal_and_computes_the_same(duplicate):
    action = np.linspace(-1, 1, 6)
    twin = duplicate(HPAC)
    assert isinstance(twin, Hand)
    assert twin == HPAC
    assert dict(twin.sources) == dict(HPAC.sources)
    assert (servo_from_action(action, twin) == servo_from_action(action)).all()
    command = pickle.loads(pickle.dumps(ServoCommand(servo_from_action(action), 0.05)))
    assert (command.servo == servo_from_action(action)).all()


def test_digits_and_workspace_keep_their_order_however_given():
    shuffled = replace(
        HPAC,
        digits=dict(reversed(HPAC.digits.items())),
        workspace=dict(sorted(HPAC.workspace.items(), reverse=True)),
    )
    assert list(shuffled.digits) == list(HPAC.digits)
    assert tuple(shuffled.workspace) == JOINTS
    assert shuffled == HPAC


def test_servo_range_takes_a_hobby_servo_less_than_a_half_turn():
    """sources: the servo radius is chosen so that Table I takes 75 to 80 of 180 degrees; the CMC is
    direct, 90.
    """
    degrees = np.degrees(HPAC.servo_max)
    assert (HPAC.servo_min == 0).all()
    assert ((degrees[:5] > 75) & (degrees[:5] < 80)).all()
    assert degrees[5] == pytest.approx(90, abs=0.1)


def test_a_whole_number_in_a_hand_file_is_the_same_number():
    text = hand_to_toml(HPAC)
    assert "tension_limit = 40.0" in text
    assert hand_to_toml(hand_from_toml(text.replace("= 40.0", "= 40"), "")) == text
