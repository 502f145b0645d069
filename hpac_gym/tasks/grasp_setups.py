"""Episodes of HPAC-Grasp before they begin: settings, and the draw of a named grasp."""

from dataclasses import dataclass, field, fields, replace

import numpy as np
from scipy.spatial.transform import Rotation

from hpac_gym.body.objects import ObjectSpec
from hpac_gym.model import HPAC, Hand
from hpac_gym.physics.engine import SceneSetup
from hpac_gym.settings import check_bounds, setting
from hpac_gym.tasks.grasp_data import NamedGrasp, Variant
from hpac_gym.tasks.phases import Timetable

PALM_SURFACE = 0.0125
"""Distance of the palm's surface from the yz-plane of the hand frame [m]."""

OBJECT_RANGES = ("radius", "sphere_radius", "half_height", "mass", "friction")
"""Fields of `GraspConfig` that draw the object itself."""


@dataclass(frozen=True, slots=True)
class GraspWeights:
    """Weights of the dense reward terms."""

    thumb: float = 0.1
    finger: float = 0.05
    opposed: float = 0.2
    push: float = -0.3
    carry: float = 0.5
    effort: float = -0.01
    success: float = 10.0
    failure: float = -5.0


@dataclass(frozen=True, slots=True)
class GraspConfig:
    """Uniform sampling ranges of an episode, drop criterion, and reward weights.

    Raises:
        ParameterError: A number or a range leaves its bounds.
    """

    radius: tuple[float, float] = setting(
        (0.010, 0.030), "half width of a box, radius of a cylinder [m]", bounds=(0.002, 0.06)
    )
    sphere_radius: tuple[float, float] = setting(
        (0.020, 0.033),
        "radius of a sphere, a golf ball's to a tennis ball's; smaller ones roll off before the hand closes [m]",
        bounds=(0.002, 0.06),
    )
    half_height: tuple[float, float] = setting(
        (0.030, 0.060), "half-height of a box or cylinder [m]", bounds=(0.005, 0.15)
    )
    mass: tuple[float, float] = setting((0.05, 0.25), "mass of the object [kg]", bounds=(1e-3, 2.0))
    friction: tuple[float, float] = setting(
        (0.6, 1.0),
        "Coulomb coefficient of the object's surface; the hand's skin multiplies it by 0.9",
        bounds=(0.05, 3.0),
    )
    gap: tuple[float, float] = setting(
        (0.003, 0.030), "distance from the palm to the object [m]", bounds=(0.0, 0.1)
    )
    towards_thumb: tuple[float, float] = setting(
        (-0.030, 0.035),
        "place of the object's centre along y of the hand frame [m]",
        bounds=(-0.1, 0.1),
    )
    beyond_wrist: tuple[float, float] = setting(
        (0.095, 0.140),
        "place of the object's centre along z of the hand frame [m]",
        bounds=(0.02, 0.25),
    )
    box_yaw: tuple[float, float] = setting(
        (-0.8, 0.8), "yaw of a box about the vertical [rad]", bounds=(-np.pi, np.pi)
    )
    thumb_preshape: float = setting(
        1.2, "initial CMC, at which the thumb opposes the fingers [rad]", bounds=(0.0, 1.57)
    )
    drop_distance: float = setting(
        0.06, "displacement in the hand beyond which an object is dropped [m]", bounds=(5e-3, 1.0)
    )
    timetable: Timetable = field(default_factory=Timetable)
    weights: GraspWeights = field(default_factory=GraspWeights)

    def __post_init__(self) -> None:
        check_bounds(self, "config")


RANGES = tuple(
    entry.name
    for entry in fields(GraspConfig)
    if "bounds" in entry.metadata and entry.name != "drop_distance"
)
"""Fields of `GraspConfig` that draw an episode."""


def setup_of_grasp(
    grasp: NamedGrasp,
    variant: Variant,
    rng: np.random.Generator,
    hand: Hand = HPAC,
    spread: float = 1.0,
) -> SceneSetup:
    """Draw one episode of a named grasp, with `spread` times its position and yaw noise."""
    model = variant.object or grasp.object
    spec = ObjectSpec(
        model.shape,
        tuple(variant.scale * half for half in model.half_extents),
        variant.mass * model.mass,
        variant.friction * grasp.friction,
        model.name,
        variant.scale,
    )
    noise = spread * rng.uniform(-1.0, 1.0, 4)
    gap = grasp.support.gap and tuple((np.array(grasp.support.gap) * variant.scale).tolist())
    return SceneSetup(
        spec,
        np.array(grasp.position) + noise[:3] * grasp.position_noise,
        float(noise[3] * grasp.yaw_noise),
        grasp.preshape,
        hand,
        hand_quaternion=quaternion_from_rpy(grasp.hand_rpy),
        object_quaternion=quaternion_from_rpy(grasp.object_rpy),
        support=replace(grasp.support, gap=gap),
    )


def quaternion_from_rpy(rpy: tuple[float, float, float]) -> tuple[float, float, float, float]:
    """The quaternion xyzw of URDF's fixed-axis roll, pitch, yaw: Rz(yaw) Ry(pitch) Rx(roll)."""
    x, y, z, w = Rotation.from_euler("xyz", rpy).as_quat().tolist()
    return x, y, z, w
