"""The MuJoCo engine: same bits whatever is beside, scenes as they are asked for, failures that name
their world.
"""

import gc
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, replace

import mujoco
import numpy as np
import pytest

from hpac_gym.body.object_models import load_object_models
from hpac_gym.body.objects import ObjectSpec
from hpac_gym.errors import ParameterError
from hpac_gym.model import HPAC, JOINT_INDEX
from hpac_gym.physics.engine import (
    HAND_POSITION,
    PhysicsError,
    SceneSetup,
    Viewpoint,
)
from hpac_gym.physics.mujoco.engine import MuJoCoEngine
from hpac_gym.physics.settings import BODIES, WorldSettings
from hpac_gym.physics.simulation import resting_object
from hpac_gym.tasks.grasp import Grasp
from hpac_gym.tasks.grasp_data import GRASPS, NOMINAL
from tests.physics.scenes import TARGET, bits, close, named, primitive, varied
from tests.processes import ROOT, python


def test_layouts_that_no_world_has_are_forgotten(begun, monkeypatch):
    setups = varied()
    engine = MuJoCoEngine(1)
    monkeypatch.setattr("hpac_gym.physics.mujoco.engine.GROUPS_KEPT", 2)
    kept = []
    for setup in setups:
        engine.reset([0], [setup])
        kept.append(len(engine._groups))
    assert max(kept) == 2
    fresh = MuJoCoEngine(1)
    for each in (engine, fresh):
        each.reset([0], setups[:1])
    assert bits(close(engine), 0) == bits(close(fresh), 0)


def test_primitives_and_the_objects_of_all_named_grasps_and_variants_stand_on_their_supports(begun):
    names = [
        (name, variant) for name, grasp in GRASPS.items() for variant in (NOMINAL, *grasp.held_out)
    ]
    setups = [
        *(varied()[index] for index in (0, 1, 3, 5)),
        *(
            Grasp(grasp=grasp, variant=variant).setup(np.random.default_rng(0), HPAC)
            for grasp, variant in names
        ),
    ]
    simulation = begun("mujoco", *setups)
    simulation.rest(0.5)
    state = simulation.state()
    moved = np.linalg.norm(state.object_pos - [setup.position for setup in setups], axis=1)
    assert moved[:4].max() < 1e-4
    assert not [
        (name, distance)
        for name, distance in zip(names, moved[4:], strict=True)
        if distance > 1.5e-3
    ]
    assert state.supported.all()
    assert not state.touching[:4].any()
    assert not state.on_target.any()


def test_an_object_knows_its_target(begun):
    setup = primitive(target=TARGET)
    simulation = begun("mujoco", replace(setup, position=setup.target))
    simulation.rest(0.25)
    assert simulation.state().on_target[0]
    assert simulation.state().supported[0]


def test_frictions_multiply(begun):
    settings = replace(BODIES["twin"], contact_friction=0.5)
    engine = begun("mujoco", primitive(hand_settings=settings)).engine
    found: dict[str, float] = {}
    for _ in range(24):
        close(engine, 1)
        model, data = engine.single(0)
        for contact in data.contact:
            names = {model.body(model.geom_bodyid[geom]).name for geom in contact.geom}
            pair = ["hand" if name == "palm" or name.endswith("_link") else name for name in names]
            assert (
                found.setdefault(" and ".join(sorted(pair)), contact.friction[0])
                == contact.friction[0]
            )
    assert found["hand and object"] == pytest.approx(0.5 * 0.8)
    assert found["object and support"] == pytest.approx(0.8 * 0.8)
    skin = engine.single(0)[0].geom("palm_0").friction[0]
    assert skin == pytest.approx(0.5 * 0.5)


def test_mass_and_inertia_of_named_objects_scale(begun):
    for name, wanted in load_object_models().items():
        model, data = begun("mujoco", named(name)).engine.single(0)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        start = model.joint("object").dofadr[0]
        centre = 1.1 * wanted.center_of_mass
        mass = 1.2 * wanted.mass
        about_origin = 1.2 * 1.1**2 * wanted.inertia + mass * (
            centre @ centre * np.eye(3) - np.outer(centre, centre)
        )
        np.testing.assert_allclose(
            full[start : start + 3, start : start + 3], mass * np.eye(3), atol=1e-12
        )
        found = full[start + 3 : start + 6, start + 3 : start + 6]
        np.testing.assert_allclose(
            found, about_origin, atol=1e-9 * np.trace(about_origin), err_msg=name
        )


def test_contacts_of_a_world_are_the_same_whichever_were_read_before(begun):
    engine = begun("mujoco", primitive(), primitive(yaw=0.9)).engine
    close(engine, 40)
    (found, other, again) = (engine.contacts(world) for world in (0, 1, 0))
    assert not np.array_equal(found.point, other.point)
    assert all(
        np.array_equal(getattr(found, f.name), getattr(again, f.name)) for f in fields(found)
    )
    assert len(found.force) > 2


def test_slack_delays_a_finger(begun):
    slack = replace(BODIES["twin"], slack=(0.0, 2e-3, 0.0, 0.0, 0.0))
    engine = begun("mujoco", SceneSetup(None), SceneSetup(None, hand_settings=slack)).engine
    state = close(engine, 20)[-1]
    index = JOINT_INDEX["index_mcp"]
    assert state.joint_pos[0, index] - state.joint_pos[1, index] > 0.1
    np.testing.assert_allclose(
        np.delete(state.joint_pos[0] - state.joint_pos[1], [2, 3, index]), 0.0, atol=1e-3
    )


# Failures
# ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [np.nan, 1e200])
def test_a_failed_world_is_named_and_back_at_its_start_and_those_beside_it_advance(
    bad, begun, tmp_path, monkeypatch
):
    """Worlds of several layouts, which are advanced one after the other; MuJoCo writes no file."""
    monkeypatch.chdir(tmp_path)
    setups = [primitive("cylinder"), SceneSetup(None), primitive("box")]
    engine, alone = (begun("mujoco", *setups).engine for _ in range(2))
    start = engine.state()
    servo = np.full((3, 6, 6), 0.2)
    tables = np.zeros((3, 6, 6)), np.zeros((3, 6, 3))
    alone.advance(servo, *tables)
    broken = servo.copy()
    broken[[0, 1], 3, 2] = bad
    with pytest.raises(
        PhysicsError, match=r"world 0 of 3 and 1 others failed after 0\.000 s"
    ) as caught:
        engine.advance(broken, *tables)
    assert caught.value.worlds == (0, 1)
    state = engine.state()
    assert bits([state], 2) == bits([alone.state()], 2)
    assert (state.time == 6 * engine.dt).all()
    state.time = start.time
    assert [bits([state], world) for world in (0, 1)] == [bits([start], world) for world in (0, 1)]
    engine.advance(servo, *tables)
    assert not list(tmp_path.iterdir())


def test_a_setup_that_is_no_place_is_an_error(begun):
    nowhere = np.array([np.nan, 0.0, 0.0])
    simulation = begun("mujoco", primitive(), primitive(position=nowhere))
    with pytest.raises(
        PhysicsError,
        match=r"world 1 of 2 failed after 0\.000 s of its episode: MuJoCo says BADQPOS",
    ):
        simulation.rest(0.05)


def test_numbers_of_numpy_are_numbers(begun):
    """In the settings of a world, and as the mass of an object that comes to rest."""
    settings = WorldSettings(physics_hz=np.int64(120), gravity=np.float64(9.81))
    engine = begun("mujoco", primitive(), settings=settings).engine
    assert engine.single(0)[0].opt.timestep == 1 / 120
    can = ObjectSpec("cylinder", (0.03, 0.03, 0.06), np.float32(0.25), np.float64(0.7))
    assert resting_object(can).model.mass == 0.25


def test_what_mujoco_cannot_do_is_refused(begun):
    """A refused setup leaves the worlds beside it as they are."""
    simulation = begun("mujoco", primitive(), primitive())
    bad = primitive(hand_settings=replace(BODIES["twin"], tendon_friction=0.1))
    with pytest.raises(ParameterError, match=r"tendon_friction = 0.1 must be 0"):
        simulation.reset([0, 1], [primitive("sphere", fixed=True), bad])
    engine = simulation.engine
    assert engine.single(0)[0].nq == engine.single(1)[0].nq


# Pictures
# ---------------------------------------------------------------------------------------------------------


def filmed(*shapes: str) -> MuJoCoEngine:
    """An engine with a world of each object."""
    engine = MuJoCoEngine(len(shapes), visuals=True)
    engine.reset(range(len(shapes)), [primitive(shape) for shape in shapes])
    return engine


def picture(engine: MuJoCoEngine, world: int = 0, width: int = 120) -> np.ndarray:
    target = HAND_POSITION + primitive().hand_rotation @ [0.03, 0.0, 0.1]
    try:
        return engine.picture(world, Viewpoint(width=width, height=90), target)
    except PhysicsError as error:
        pytest.skip(f"no OpenGL here: {error}")


def test_pictures_show_their_world():
    engine = filmed("cylinder", "box")
    pictures = [picture(engine, world, width) for world, width in ((0, 120), (1, 120), (0, 160))]
    assert [picture.shape for picture in pictures] == [(90, 120, 3), (90, 120, 3), (90, 160, 3)]
    assert all(picture.dtype == np.uint8 for picture in pictures)
    blue, red = (picture[45, 60].astype(int) for picture in pictures[:2])
    assert blue[2] > blue[0] + 40
    assert red[0] > red[2] + 40
    engine.close()
    engine.close()


def test_an_engine_that_is_forgotten_takes_nothing_from_the_pictures_of_another():
    """In this thread and in another one, where the engine that is left is used too."""
    engines = [filmed("cylinder"), filmed("cylinder")]
    list(map(picture, engines))
    engine = filmed("box")
    expected = picture(engine)

    def forget() -> np.ndarray:
        engines.pop()
        gc.collect()
        return picture(engine)

    np.testing.assert_array_equal(forget(), expected)
    with ThreadPoolExecutor() as pool:
        np.testing.assert_array_equal(pool.submit(forget).result(), expected)
    np.testing.assert_array_equal(picture(engine), expected)


def test_a_program_may_end_with_an_engine_that_is_open_and_loads_triton_before_opengl(tmp_path):
    """PyTorch for CUDA brings it, and in the other order its LLVM and Mesa's end the process."""
    picture(filmed("box"))
    (tmp_path / "triton.py").write_text("import sys; print('mujoco.egl' in sys.modules)")
    script = """
from hpac_gym.physics.engine import HAND_POSITION, SceneSetup, Viewpoint
from hpac_gym.physics.mujoco.engine import MuJoCoEngine
kept = MuJoCoEngine(visuals=True)
kept.reset([0], [SceneSetup(None)])
kept.picture(0, Viewpoint(), HAND_POSITION)
"""
    done = python("-c", script, PYTHONPATH=f"{ROOT}{os.pathsep}{tmp_path}")
    assert (done.returncode, done.stdout, done.stderr) == (0, "False\n", "")


def test_without_opengl_a_picture_is_one_clear_line(begun, monkeypatch):
    def broken() -> type:
        raise AttributeError("'NoneType' object has no attribute\n'eglQueryDevicesEXT'")

    monkeypatch.setattr("hpac_gym.physics.mujoco.engine._gl_context", broken)
    engine = begun("mujoco", primitive()).engine
    with pytest.raises(
        PhysicsError, match=r"no OpenGL for pictures \(AttributeError: .*\): install .*libegl1"
    ) as caught:
        engine.picture(0, Viewpoint(), np.zeros(3))
    assert "\n" not in str(caught.value)
    words = ("evaluate", "--policy", "random", "--episodes", "1", "--workers", "1")
    done = python("-m", "hpac", *words, MUJOCO_GL="none")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert done.stderr.startswith("error: MUJOCO_GL = 'none' does not work here (invalid value ")
