"""An object of one's own: files from outside become convex parts that both engines collide, or one
clear line.
"""

import json
import pickle
import sys
import time
from dataclasses import replace

import coacd
import gymnasium
import mujoco
import numpy as np
import pytest
import trimesh

from hpac_gym.body import own_meshes, own_objects
from hpac_gym.body.objects import ObjectSpec, Support
from hpac_gym.body.own_objects import own_object
from hpac_gym.envs import GraspAny, GraspError, ScriptedClosure
from hpac_gym.errors import ParameterError
from hpac_gym.model import HPAC
from hpac_gym.output import OutputError
from hpac_gym.physics.engine import SceneSetup, matrix_from_quaternion
from hpac_gym.physics.mujoco.engine import MuJoCoEngine
from hpac_gym.physics.simulation import ENGINES, make_engine
from hpac_gym.tasks.occlusion import inside
from tests.envs.episodes import run

L_SHAPE = [(0, 0), (60, 0), (60, 20), (20, 20), (20, 80), (0, 80)]
"""Corners of an L in the xz-plane [mm]: a foot and a shaft, both 20 thick."""
CUT = [(0, 1, 2), (0, 2, 3), (0, 3, 5), (3, 4, 5)]
DEPTH = 40.0
"""[mm]"""
WEDGE = trimesh.Trimesh(
    [[0, 0, 0], [0, 40, 0], [60, 0, 0], [0, 0, 120]], [[0, 1, 2], [0, 2, 3], [0, 3, 1], [2, 1, 3]]
)
"""A convex mesh, which is its own single part, found without CoACD [mm]."""
BOX = ObjectSpec("box", (0.02, 0.02, 0.05), 0.1, 0.8)
CAN = ObjectSpec("cylinder", (0.03, 0.03, 0.06), 0.3, 0.7)
SPEC = {"shape": "box", "half_extents": [0.02, 0.02, 0.05], "mass": 0.1, "friction": 0.8}


def l_mesh() -> trimesh.Trimesh:
    """The L, from y = 0 to its depth [mm]."""
    mesh = trimesh.creation.extrude_triangulation(L_SHAPE, CUT, DEPTH)
    return mesh.apply_transform([[1, 0, 0, 0], [0, 0, -1, DEPTH], [0, 1, 0, 0], [0, 0, 0, 1]])


@pytest.fixture
def ell(tmp_path):
    path = tmp_path / "ell.stl"
    l_mesh().export(path)
    return path


@pytest.fixture
def wedge(tmp_path):
    path = tmp_path / "ell.stl"
    WEDGE.export(path)
    return path


@pytest.fixture(scope="module")
def decomposed(tmp_path_factory):
    """A folder with the parts of `ell`."""
    folder = tmp_path_factory.mktemp("parts")
    l_mesh().export(folder / "ell.stl")
    own_object(folder / "ell.stl", mass=0.1, scale=0.001)
    return folder


def test_a_mesh_becomes_convex_parts_with_its_volume_mass_and_inertia(ell, decomposed):
    spec = own_object(ell, mass=0.12, scale=0.001, folder=decomposed)
    assert "model=ObjectModel('ell', 0.06 × 0.04 × 0.08 m, 0.12 kg, 2 solids)" in repr(spec)
    model = spec.model
    assert sum(solid.hull.moments()[0] for solid in model.solids) == pytest.approx(
        0.04 * (0.06 * 0.02 + 0.02 * 0.06), rel=0.02
    )
    np.testing.assert_allclose(model.size, (0.06, 0.04, 0.08), atol=1e-5)
    # Foot 60 x 20 and shaft 20 x 60, of one density: mass centre 10 mm beside and 10 mm below the
    # middle of the box around.
    np.testing.assert_allclose(model.center_of_mass, (-0.01, 0.0, -0.01), atol=2e-4)
    foot = ((0.06, 0.02), (0.0, -0.03))
    shaft = ((0.02, 0.06), (-0.02, 0.01))
    about_y = sum(
        0.06 * ((x * x + z * z) / 12 + (place[0] + 0.01) ** 2 + (place[1] + 0.01) ** 2)
        for (x, z), place in (foot, shaft)
    )
    assert model.inertia[1, 1] == pytest.approx(about_y, rel=0.01)


def test_a_coarse_decomposition_is_the_default_and_a_fine_one_follows_the_mesh(
    tmp_path, monkeypatch
):
    """A torus of 2,304 faces: coarse in seconds, with its hole; the setting is kept with its parts."""
    path = tmp_path / "ring.stl"
    trimesh.creation.torus(25.0, 8.0, major_sections=48, minor_sections=24).export(path)
    asked = []
    run_coacd = coacd.run_coacd
    monkeypatch.setattr(
        coacd, "run_coacd", lambda mesh, **how: asked.append(how) or run_coacd(mesh, **how)
    )
    begun = time.process_time()
    model = own_object(path, mass=0.1, scale=0.001).model
    assert time.process_time() - begun < 20.0
    np.testing.assert_allclose(model.size, (0.066, 0.066, 0.016), atol=1e-4)
    assert not any(inside(solid, np.zeros((1, 3))) for solid in model.solids)
    assert asked[0]["preprocess_mode"] == "on"
    own_object(path, mass=0.1, scale=0.001)
    assert len(asked) == 1
    monkeypatch.setitem(own_objects.DETAILS, "fine", own_objects.DETAILS["coarse"] | {"seed": 1})
    own_object(path, mass=0.1, scale=0.001, detail="fine")
    assert [how["seed"] for how in asked] == [0, 1]
    with pytest.raises(ParameterError, match="detail 'exact' is not one of coarse, fine"):
        own_object(path, mass=0.1, scale=0.001, detail="exact")


def test_a_mesh_of_bodies_that_overlap_keeps_its_size(tmp_path):
    """CoACD makes its surface anew by itself, which is a little larger."""
    foot = trimesh.creation.box((60.0, 20.0, 20.0))
    leg = trimesh.creation.box((18.0, 18.0, 75.0))
    leg.apply_translation((-18.0, 0.0, 32.5))
    trimesh.util.concatenate([foot, leg]).export(tmp_path / "l.stl")
    model = own_object(tmp_path / "l.stl", mass=0.1, scale=0.001).model
    np.testing.assert_allclose(model.size, (0.06, 0.02, 0.08), atol=1e-5)


def test_a_round_mesh_keeps_few_of_its_corners_and_its_size(tmp_path):
    """A ball of 10,242 corners, as wide as long and half as high."""
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=30.0)
    mesh.apply_scale([1.0, 1.0, 0.5])
    mesh.export(tmp_path / "stone.stl")
    model = own_object(tmp_path / "stone.stl", mass=0.1, scale=0.001).model
    (solid,) = model.solids
    assert len(solid.hull.vertices) < 300
    np.testing.assert_allclose(model.size, (0.06, 0.06, 0.03), rtol=1e-5)
    assert solid.hull.moments()[0] == pytest.approx(1e-9 * mesh.volume, rel=0.03)


@pytest.mark.parametrize("given", [CAN, None], ids=str)
def test_grasp_any_takes_it_in_the_poses_in_which_it_comes_to_rest(given, ell, decomposed):
    if given is None:
        given = own_object(ell, mass=0.08, friction=0.9, scale=0.001, folder=decomposed)
    task = GraspAny(object=given)
    (thing,) = task.setups.objects
    assert thing.model.mass == pytest.approx(given.mass)
    assert thing.friction == given.friction
    assert sum(pose.share for pose in thing.poses) > 0.5
    seen = {
        (setup.object.model.name, setup.object_quaternion)
        for setup in (task.setup(np.random.default_rng(seed), HPAC) for seed in range(20))
    }
    assert {name for name, _ in seen} == {thing.name}
    assert 1 <= len(seen) <= len(thing.poses)


def test_grasp_any_holds_a_can_of_ones_own():
    with gymnasium.make("HPAC-GraspAny-v1", object=CAN, engine="mujoco") as env:
        held = [run(env, env.unwrapped.task.script(), seed=seed)[0][-1] for seed in range(3)]
    assert all(info["is_success"] for info in held)
    assert {info["object"] for info in held} == {"own cylinder"}


def test_the_decomposition_is_kept_beside_the_file_or_where_it_is_asked_for(
    wedge, tmp_path, monkeypatch
):
    own_object(wedge, mass=0.1, scale=0.001)
    assert {path.name for path in tmp_path.iterdir()} == {"ell.stl", "ell.hulls.json"}
    monkeypatch.setitem(sys.modules, "coacd", None)
    again = own_object(wedge, mass=0.2, scale=0.0005, up="y")
    np.testing.assert_allclose(again.model.size, (0.03, 0.06, 0.02), atol=1e-5)
    with pytest.raises(
        ParameterError, match=r"needs the package coacd: pip install '\.\[objects\]' in a checkout"
    ):
        own_object(wedge, mass=0.1, scale=0.001, folder=tmp_path / "parts")
    monkeypatch.undo()
    own_object(wedge, mass=0.1, scale=0.001, folder=tmp_path / "parts")
    assert [path.name for path in (tmp_path / "parts").iterdir()] == ["ell.hulls.json"]


def test_a_folder_that_cannot_be_written_is_told_with_the_way_out_before_the_work(
    wedge, monkeypatch
):
    monkeypatch.setattr(own_meshes, "_decomposed", None)
    with pytest.raises(
        OutputError, match=r"'/proc/none': .*, or in folder= \(--set object.folder=\)"
    ):
        own_object(wedge, mass=0.1, scale=0.001, folder="/proc/none")


DAMAGED = ([], 3, [[[[0, 0]], [[0, 0, 0]]]], [[[[0, 0, 0]], [[9]]]])


@pytest.mark.parametrize(
    "kept", ["{ half a fi", {"sha256": "of another mesh"}, *({"parts": parts} for parts in DAMAGED)]
)
def test_parts_that_are_damaged_or_of_another_mesh_of_the_name_are_made_anew(kept, wedge):
    own_object(wedge, mass=0.1, scale=0.001)
    file = wedge.with_name("ell.hulls.json")
    made = file.read_text()
    file.write_text(kept if isinstance(kept, str) else json.dumps(json.loads(made) | kept))
    own_object(wedge, mass=0.1, scale=0.001)
    assert file.read_text() == made


def urdf(geometry: str, mass: str = "0.1") -> str:
    """Text of a URDF of one link."""
    shape = f"<collision><geometry>{geometry}</geometry></collision>"
    return f"<robot name='x'><link name='a'><inertial><mass value='{mass}'/></inertial>{shape}</link></robot>"


HOLED = trimesh.Trimesh(l_mesh().vertices, l_mesh().faces[1:])
FLAT = trimesh.Trimesh([[0, 0, 0], [9, 0, 0], [0, 9, 0]], [[0, 1, 2], [0, 2, 1]])
BAD_FILES = {
    "a hole": (
        "hole.stl",
        HOLED.export(file_type="stl_ascii"),
        "'.*hole.stl' is not watertight: every edge must belong to two triangles",
    ),
    "flat": (
        "flat.stl",
        FLAT.export(file_type="stl_ascii"),
        "'.*flat.stl' is flat: it has no volume",
    ),
    "no triangles": (
        "none.stl",
        "solid x\nendsolid x\n",
        "'.*none.stl' (cannot be read as a mesh|has no triangles)",
    ),
    "not a mesh": ("text.obj", "hello", "'.*text.obj' (cannot be read as a mesh|has no triangles)"),
    "not finite": ("nan.obj", "v 0 0 0\nv nan 0 1\nv 0 1 0\nf 1 2 3\n", "'.*nan.obj'"),
    "not XML": ("bad.urdf", "<robot", "'.*bad.urdf' is not a URDF"),
    "no shape": (
        "empty.urdf",
        "<robot name='x'><link name='a'/></robot>",
        "'.*empty.urdf' has no collision shape",
    ),
    "no number": (
        "word.urdf",
        "<robot name='x'><link name='a'><collision><geometry><sphere radius='big'/></geometry></collision></link></robot>",
        "'.*word.urdf' is not a URDF: could not convert",
    ),
    "no mesh": (
        "lost.urdf",
        "<robot name='x'><link name='a'><collision><geometry><mesh filename='no.stl'/></geometry></collision></link></robot>",
        "no mesh file '.*no.stl', which '.*lost.urdf' names",
    ),
    "a hinge": (
        "hinge.urdf",
        "<robot name='x'><link name='a'/><link name='b'/><joint name='j' type='revolute'><parent link='a'/><child link='b'/>"
        "</joint></robot>",
        "joint 'j' of '.*hinge.urdf' is revolute: all joints must be fixed",
    ),
    "another kind": (
        "thing.step",
        "",
        "'.*thing.step' is not one of .stl, .obj, .ply, .off, nor a .urdf",
    ),
    "another kind of mesh": (
        "dae.urdf",
        urdf("<mesh filename='dae.urdf'/>"),
        "'.*dae.urdf' is not one of .stl, .obj",
    ),
    "a ring of joints": (
        "ring.urdf",
        "<robot name='x'><link name='a'/><link name='b'/><joint type='fixed'><parent link='a'/><child link='b'/></joint>"
        "<joint type='fixed'><parent link='b'/><child link='a'/></joint></robot>",
        "joints of '.*ring.urdf' form a ring through link 'a'",
    ),
    "no size": (
        "zero.urdf",
        urdf("<sphere radius='0'/>"),
        "a sphere of '.*zero.urdf' is 0 x 0 x 0 m: sides must be",
    ),
    "a negative size": (
        "less.urdf",
        urdf("<box size='-.04 1 1'/>"),
        "a box of '.*less.urdf' is -0.04 x 1 x 1 m: sides must be",
    ),
    "a negative length": (
        "short.urdf",
        urdf("<capsule radius='0.02' length='-0.03'/>"),
        "a capsule of '.*short.urdf' is -0.03 m long: it must be at least 0 m",
    ),
    "a size that is not a number": (
        "nan.urdf",
        urdf("<box size='nan 1 1'/>"),
        "a box of '.*nan.urdf' is nan x 1 x 1 m",
    ),
}


@pytest.mark.parametrize(("name", "text", "message"), BAD_FILES.values(), ids=list(BAD_FILES))
def test_a_bad_file_is_one_clear_line(name, text, message, tmp_path):
    (tmp_path / name).write_text(text)
    with pytest.raises(ParameterError, match=message) as caught:
        own_object(tmp_path / name, mass=0.1)
    assert "\n" not in str(caught.value)
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("name", ["thing.stl", "thing.urdf"])
def test_a_file_that_cannot_be_read_is_one_clear_line(name, tmp_path):
    (tmp_path / name).symlink_to("/proc/self/mem")
    with pytest.raises(ParameterError, match=rf"{name}'.*: Input/output error$"):
        own_object(tmp_path / name, mass=0.1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"scale": 1.0},
            r"ell.stl' is 60 x 40 x 120 m: sides must be 0.002 to 0.4 m; scale=0.001 is for a file in mm",
        ),
        ({"scale": 1e-5}, r"sides must be 0.002 to 0.4 m"),
        (
            {"scale": 0.0},
            r"scale 0.0 of '.*ell.stl' must be a number greater than 0 and at most 1000",
        ),
        (
            {"mass": -0.3},
            r"mass -0.3 kg of '.*ell.stl' must be a number of at least 0.0001 and at most 5 kg",
        ),
        ({"mass": float("nan")}, r"mass nan kg"),
        ({"mass": None}, r"'.*ell.stl' says no mass: give one in kg"),
        (
            {"friction": -1.0},
            r"friction -1.0 of '.*ell.stl' must be a number greater than 0 and at most 2",
        ),
        ({"mass": "0.3"}, r"mass '0.3' kg of '.*ell.stl' must be a number of at least"),
        ({"scale": None}, r"scale None of '.*ell.stl' must be a number greater than 0"),
        ({"up": "w"}, r"up 'w' is not one of z, y"),
    ],
)
def test_a_bad_argument_is_one_clear_line(wedge, change, message):
    with pytest.raises(ParameterError, match=message):
        own_object(wedge, **{"mass": 0.1, "scale": 0.001} | change)


@pytest.mark.parametrize("mass", ["70", "-0.1", "nan"])
def test_the_mass_that_a_urdf_says_is_checked_as_one_that_is_given(mass, tmp_path):
    (tmp_path / "box.urdf").write_text(urdf("<box size='.04 .04 .1'/>", mass))
    with pytest.raises(
        ParameterError,
        match=rf"mass {mass}\.?0? kg of '.*box.urdf' must be a number .* at most 5 kg",
    ):
        own_object(tmp_path / "box.urdf")
    assert own_object(tmp_path / "box.urdf", mass=0.2).mass == 0.2


def test_a_capsule_without_a_length_is_a_sphere(tmp_path):
    (tmp_path / "ball.urdf").write_text(urdf("<capsule radius='.03' length='0'/>"))
    (solid,) = own_object(tmp_path / "ball.urdf").model.solids
    assert (solid.kind, solid.size, solid.mass) == ("sphere", (0.06, 0.06, 0.06), 0.1)


URDF = """<robot name="mallet">
  <link name="handle">
    <inertial><mass value="0.05"/></inertial>
    <collision><origin xyz="0 0 0.05"/><geometry><cylinder radius="0.01" length="0.1"/></geometry></collision>
  </link>
  <link name="head">
    <inertial><mass value="0.07"/></inertial>
    <collision><geometry><mesh filename="ell.stl" scale="0.0005 0.0005 0.0005"/></geometry></collision>
  </link>
  <joint name="weld" type="fixed"><origin xyz="0 0 0.1" rpy="0 0 1.5707963"/><parent link="handle"/><child link="head"/></joint>
</robot>
"""


def test_a_urdf_is_read_with_its_fixed_joints_its_meshes_and_its_masses(ell, decomposed):
    (ell.parent / "mallet.urdf").write_text(URDF)
    model = own_object(ell.parent / "mallet.urdf", folder=decomposed).model
    assert model.mass == pytest.approx(0.12)
    assert {solid.kind for solid in model.solids} == {"cylinder", "hull"}
    low, high = model.turned_bounds(np.eye(3))
    # The L is turned: 20 mm deep along -x, 30 along y.
    np.testing.assert_allclose(high - low, (0.03, 0.04, 0.14), atol=1e-5)
    assert own_object(
        ell.parent / "mallet.urdf", mass=0.3, scale=0.5, folder=decomposed
    ).model.size[2] == pytest.approx(0.07)


def test_a_mirrored_mesh_is_as_heavy_as_the_mesh(ell, decomposed):
    """A mirror image has a mass centre on the other side, and the same moments of inertia."""
    models = []
    for side in ("0.001", "-0.001"):
        (ell.parent / "one.urdf").write_text(
            urdf(f"<mesh filename='ell.stl' scale='{side} 0.001 0.001'/>")
        )
        models.append(own_object(ell.parent / "one.urdf", folder=decomposed).model)
    assert all(
        solid.mass > 0 and solid.hull.moments()[0] > 0 for model in models for solid in model.solids
    )
    np.testing.assert_allclose(
        models[1].center_of_mass, models[0].center_of_mass * [-1, 1, 1], atol=1e-9
    )
    np.testing.assert_allclose(np.diag(models[1].inertia), np.diag(models[0].inertia), rtol=1e-9)


@pytest.mark.pybullet
def test_both_engines_load_its_mass_inertia_and_extents(ell, decomposed, tmp_path, monkeypatch):
    """Whatever file of its hulls' name is in the working directory."""
    import pybullet

    monkeypatch.chdir(tmp_path)
    trimesh.creation.box((0.3, 0.3, 0.3)).export("hull_0.obj")
    spec = own_object(ell, mass=0.12, scale=0.001, folder=decomposed)
    wanted = np.linalg.eigvalsh(spec.model.inertia)
    engine = MuJoCoEngine(1)
    engine.reset([0], [SceneSetup(spec, np.array([0.06, 0.0, 0.12]))])
    model, _ = engine.single(0)
    body = model.body("object")
    assert body.mass[0] == pytest.approx(0.12)
    np.testing.assert_allclose(sorted(body.inertia), wanted, rtol=1e-6)
    corners = []
    for index in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH):
        mesh = model.mesh(model.geom_dataid[index])
        (w, x, y, z) = model.geom_quat[index]
        rotation = matrix_from_quaternion((x, y, z, w))
        start = mesh.vertadr[0]
        count = mesh.vertnum[0]
        corners.append(model.geom_pos[index] + model.mesh_vert[start : start + count] @ rotation.T)
    np.testing.assert_allclose(
        np.ptp(np.concatenate(corners), axis=0), (0.06, 0.04, 0.08), atol=1e-5
    )
    other = make_engine("pybullet")
    other.reset([0], [SceneSetup(spec, np.array([0.06, 0.0, 0.12]))])
    scene = other.scenes[0]
    loaded = pybullet.getDynamicsInfo(scene.object.body, -1, scene.world.client)
    assert loaded[0] == pytest.approx(0.12)
    np.testing.assert_allclose(sorted(loaded[2]), wanted, rtol=1e-4)
    low, high = pybullet.getAABB(scene.object.body, -1, scene.world.client)
    assert max(np.subtract(high, low)) < 0.2  # 0.08 m and Bullet's margin
    other.close()


@pytest.mark.parametrize("engine", ENGINES)
def test_the_hand_grasps_it_with_the_scripted_closure(engine, ell, decomposed):
    """Upright, its shaft between thumb and fingers."""
    spec = own_object(ell, mass=0.08, friction=0.9, scale=0.001, folder=decomposed)
    with gymnasium.make("HPAC-Grasp-v0", object=spec, engine=engine) as env:
        assert any(run(env, ScriptedClosure(), seed=seed)[0][-1]["is_success"] for seed in range(6))


def test_an_environment_and_its_object_survive_json_and_pickle(ell, decomposed):
    given = {"path": str(ell), "mass": 0.08, "scale": 0.001, "folder": str(decomposed)}
    for thing in (CAN, given):
        with gymnasium.make("HPAC-Grasp-v0", object=thing, engine="mujoco") as env:
            again = gymnasium.envs.registration.EnvSpec.from_json(env.spec.to_json())
            wanted = env.reset(seed=3)[0]
        with gymnasium.make(again) as env:
            np.testing.assert_array_equal(env.reset(seed=3)[0], wanted)
    # On PyBullet a vector environment sends it to its processes.
    spec = pickle.loads(pickle.dumps(own_object(**given)))
    vector = gymnasium.make_vec("HPAC-Grasp-v0", num_envs=2, object=spec, engine="mujoco")
    np.testing.assert_array_equal(vector.reset(seed=[3, 4])[0][0], wanted)
    vector.close()


def test_a_mesh_is_closed_though_its_texture_has_seams(tmp_path):
    """As Blender writes it: a corner once for each place in the texture."""
    cube = trimesh.creation.box((0.03, 0.03, 0.03))
    corners = "".join(f"v {x} {y} {z}\n" for x, y, z in cube.vertices)
    places = "".join(f"vt {number / 36} 0.5\n" for number in range(36))
    faces = "".join(
        "f " + " ".join(f"{corner + 1}/{3 * row + k + 1}" for k, corner in enumerate(face)) + "\n"
        for row, face in enumerate(cube.faces)
    )
    (tmp_path / "cube.obj").write_text(corners + places + faces)
    found = own_object(tmp_path / "cube.obj", mass=0.1, folder=tmp_path)
    np.testing.assert_allclose(found.half_extents, 0.015, rtol=0.01)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        (
            {"object": "mug.stl"},
            ParameterError,
            r"object 'mug.stl' is neither an ObjectSpec, as own_object gives",
        ),
        (
            {"object": {"path": "no_such.stl", "mass": 0.1}},
            ParameterError,
            r"no object file 'no_such.stl'",
        ),
        (
            {"object": {"weight": 0.1}},
            ParameterError,
            r"object {'weight': 0.1}: got an unexpected keyword argument 'weight'",
        ),
        (
            {"object": SPEC | {"half_extents": [0.02, 0.02]}},
            ParameterError,
            r"object half_extents = \[0.02, 0.02\] m must be 3 values within \]0, inf\[ m",
        ),
        (
            {"object": SPEC | {"half_extents": 0.02}},
            ParameterError,
            r"object half_extents = 0.02 m must be 3 values",
        ),
        ({"object": SPEC | {"mass": -1.0}}, ParameterError, r"object mass = -1.0 kg must be"),
        (
            {"object": SPEC | {"friction": float("nan")}},
            ParameterError,
            r"object friction = nan must be a number within \]0, inf\[",
        ),
        ({"object": SPEC | {"shape": "cone"}}, ParameterError, r"shape 'cone' is not one of"),
        ({"object": SPEC | {"model": 3}}, ParameterError, r"model 3 is not one of beverage_can"),
        ({"object": SPEC | {"model": "mug"}}, ParameterError, r"model 'mug' is not one of bev"),
        (
            {"object": SPEC | {"half_extents": [2.0, 2.0, 2.0]}},
            ParameterError,
            r"a box is 4 x 4 x 4 m: sides must be 0.002 to 0.4 m",
        ),
        (
            {"object": SPEC | {"mass": 1e6}},
            ParameterError,
            r"mass 1000000.0 kg of a box must be a number of at least 0.0001 and at most 5 kg",
        ),
        (
            {"id": "HPAC-GraspAny-v1", "object": replace(BOX, mass=1e-12)},
            ParameterError,
            r"mass 1e-12 kg of a box must be a number of at least 0.0001 and",
        ),
        (
            {"object": BOX, "grasp": "hook"},
            GraspError,
            r"grasp 'hook' has its own object: give either grasp or object",
        ),
        ({"object": BOX, "variant": "large"}, GraspError, r"variant 'large' needs a named grasp"),
        (
            {"id": "HPAC-GraspAny-v1", "object": replace(BOX, half_extents=(0.1, 0.1, 0.1))},
            ParameterError,
            "exclude every pose of the object, 0",
        ),
        (
            {"id": "HPAC-GraspAny-v1", "object": CAN, "objects": "real"},
            ParameterError,
            r"object and objects 'real' were given: give either",
        ),
        (
            {"id": "HPAC-GraspAny-v1", "object": 3},
            ParameterError,
            "object 3 is neither an ObjectSpec",
        ),
    ],
)
def test_a_bad_object_of_an_environment_is_one_clear_line(options, error, message):
    with pytest.raises(error, match=message):
        gymnasium.make(**{"id": "HPAC-Grasp-v0"} | options)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"half_width": (0.01, float("nan"))}, r"support half_width = \(0.01, nan\) m must be 2"),
        (
            {"gap": (0.03, float("nan"))},
            r"support gap = \(0.03, nan\) m must be 2 values greater than 0 m",
        ),
        ({"gap": (0.03,)}, r"support gap = \(0.03,\) m must be 2 values greater than 0 m"),
        ({"wall_height": 0.0}, r"support wall_height = 0.0 m must be a number within \]0, inf\["),
        ({"table_height": float("inf")}, r"support table_height = inf m must be a number"),
    ],
)
def test_a_bad_support_is_one_clear_line(change, message):
    with pytest.raises(ParameterError, match=message):
        Support(**{"half_width": (0.01, 0.01)} | change)
    assert len(Support((0.01, 0.01), gap=(float("inf"), 0.03)).boxes(0.1)) == 3


def test_a_scale_of_an_own_object_is_refused(ell, decomposed):
    spec = own_object(ell, mass=0.08, friction=0.9, scale=0.001, folder=decomposed)
    with pytest.raises(
        ParameterError, match=r"scale 1.1 of ell: an object of one's own has the scale 1 here"
    ):
        replace(spec, scale=1.1)
    with pytest.raises(ParameterError, match=r"config size = \(0.8, 1.2\): .* has its own size"):
        GraspAny(config={"size": [0.8, 1.2]}, object=spec)
