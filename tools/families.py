"""The families of procedural objects: convex parts in the shapes of handheld objects.

A family is a function that samples the parts of one object: lengths, and densities with a realistic
mass distribution (a steel head on a wooden handle, a partly filled bottle). All ranges are CHOSEN
after everyday objects; no generated object is a real one."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

Part = dict[str, Any]
Family = Callable[[np.random.Generator], list[Part]]


def box(
    x: float,
    y: float,
    z: float,
    density: float,
    at: tuple[float, float, float] = (0, 0, 0),
    turn: float = 0.0,
) -> Part:
    """A box with sides and centre [mm] and density [g/cm³], optionally turned about z [rad]."""
    part = {"kind": "box", "mass": density * x * y * z * 1e-6, "size": [x, y, z], "center": at}
    return part | ({"turn": turn} if turn else {})


def cylinder(
    radius: float,
    length: float,
    density: float,
    at: tuple[float, float, float] = (0, 0, 0),
    axis: str = "z",
) -> Part:
    """A cylinder [mm, g/cm³]."""
    return {
        "kind": "cylinder",
        "mass": density * math.pi * radius**2 * length * 1e-6,
        "radius": radius,
        "length": length,
        "center": at,
        "axis": axis,
    }


def ball(radius: float, density: float, at: tuple[float, float, float] = (0, 0, 0)) -> Part:
    """A sphere [mm, g/cm³]."""
    return {
        "kind": "sphere",
        "mass": density * 4 / 3 * math.pi * radius**3 * 1e-6,
        "radius": radius,
        "center": at,
    }


def ring(
    radius: float,
    wall: float,
    length: float,
    density: float,
    at: tuple[float, float, float] = (0, 0, 0),
    staves: int = 16,
) -> Part:
    """A tube about z, made of flat staves [mm, g/cm³]."""
    volume = math.pi * (radius**2 - (radius - wall) ** 2) * length
    return {
        "kind": "ring",
        "mass": density * volume * 1e-6,
        "radius": radius,
        "inner_radius": radius - wall,
        "length": length,
        "center": at,
        "staves": staves,
    }


def hollow(radius: float, share: float, length: float, density: float) -> Part:
    """A tube whose wall is a share of its radius."""
    return ring(radius, share * radius, length, density)


def drawn(rng: np.random.Generator, *ranges: tuple[float, float]) -> list[float]:
    """A number within each of these ranges, in their order."""
    return [rng.uniform(*bounds) for bounds in ranges]


def spread(rng: np.random.Generator, *ranges: tuple[float, float]) -> list[float]:
    """The same, with uniform logarithms."""
    return [math.exp(rng.uniform(math.log(low), math.log(high))) for low, high in ranges]


def single(
    make: Callable[..., Part], *ranges: tuple[float, float], draw: Callable = drawn, **how: str
) -> Family:
    """A family of single solids, with ranges of their lengths and density."""
    return lambda rng: [make(*draw(rng, *ranges), **how)]


def stack(*parts: tuple[Callable[..., Part], tuple[float, ...], float]) -> list[Part]:
    """Parts on top of each other, each given by its function, its lengths with the height last
    [mm], and its density.
    """
    solids = []
    height = 0.0
    for make, lengths, density in parts:
        solids.append(make(*lengths, density, at=(0, 0, height + lengths[-1] / 2)))
        height += lengths[-1]
    return solids


def bottle(rng: np.random.Generator) -> list[Part]:
    radius, neck, fill = drawn(rng, (19, 33), (9, 14), (0.15, 1.0))
    return stack(
        (cylinder, (radius, rng.uniform(65, 130)), fill),
        (cylinder, ((radius + neck) / 2, rng.uniform(8, 18)), fill),
        (cylinder, (neck, rng.uniform(12, 32)), 0.4),
        (cylinder, (neck + rng.uniform(1, 4), rng.uniform(10, 18)), 0.6),
    )


def jar(rng: np.random.Generator) -> list[Part]:
    radius = rng.uniform(20, 33)
    lid = (cylinder, (radius + rng.uniform(-3, 2), rng.uniform(9, 18)), 0.8)
    return stack((cylinder, (radius, rng.uniform(40, 95)), rng.uniform(0.4, 1.3)), lid)


def mug(rng: np.random.Generator) -> list[Part]:
    radius, height, wall, reach, clay, width, bar = drawn(
        rng, (29, 34.5), (65, 110), (3, 5), (26, 38), (1.0, 2.3), (8, 14), (6, 9)
    )
    drop = rng.uniform(0.28, 0.36) * height
    return [
        ring(radius, wall, height, clay, staves=12),
        cylinder(0.97 * (radius - wall), wall, clay, (0, 0, (wall - height) / 2)),
        *(box(reach, width, bar, clay, (radius + reach / 2 - 2, 0, z)) for z in (-drop, drop)),
        box(bar, width, 2 * drop - bar, clay, (radius + reach - 2 - bar / 2, 0, 0)),
    ]


def cup(rng: np.random.Generator) -> list[Part]:
    radius, height, wall, made_of = drawn(rng, (25, 34.5), (65, 120), (2, 4), (0.9, 2.5))
    wall_part = ring(radius, wall, height, made_of, staves=15)
    return [
        wall_part,
        cylinder(0.97 * (radius - wall), 1.5 * wall, made_of, (0, 0, (1.5 * wall - height) / 2)),
    ]


def hammer(rng: np.random.Generator) -> list[Part]:
    length, thick, head, side = drawn(rng, (170, 260), (20, 30), (65, 105), (18, 26))
    handle = box(
        length, thick, rng.uniform(0.6, 1.0) * thick, rng.uniform(0.5, 1.1), (-length / 2, 0, 0)
    )
    return [handle, box(side, head, side, rng.uniform(3.0, 7.85), (side / 2, 0, 0))]


def screwdriver(rng: np.random.Generator) -> list[Part]:
    handle, shank = drawn(rng, (75, 110), (60, 130))
    grip = cylinder(rng.uniform(11, 18), handle, rng.uniform(0.9, 1.3), (handle / 2, 0, 0), "x")
    return [grip, cylinder(rng.uniform(2.5, 4.5), shank, 7.85, (-shank / 2, 0, 0), "x")]


def fruit(rng: np.random.Generator) -> list[Part]:
    radius, longer, density = drawn(rng, (22, 33), (0.15, 0.55), (0.2, 0.95))
    ends = rng.uniform(0.62, 0.85) * radius
    place = (1 + longer) * radius - ends
    return [ball(radius, density), *(ball(ends, density, (0, 0, z)) for z in (-place, place))]


def banana(rng: np.random.Generator) -> list[Part]:
    bend, length, thick, density = drawn(rng, (90, 160), (20, 30), (22, 36), (0.4, 1.0))
    turns = [(index - 2) * length / bend for index in range(5)]
    widths = [0.6 * thick, 0.9 * thick, thick, 0.9 * thick, 0.6 * thick]
    return [
        box(
            1.1 * length,
            width,
            0.9 * width,
            density,
            (bend * math.sin(turn), bend * (1 - math.cos(turn)), 0),
            turn,
        )
        for turn, width in zip(turns, widths, strict=True)
    ]


def knob(rng: np.random.Generator) -> list[Part]:
    head = (cylinder, (rng.uniform(18, 33), rng.uniform(12, 28)), rng.uniform(0.6, 2.7))
    return stack((cylinder, (rng.uniform(8, 14), rng.uniform(15, 40)), rng.uniform(0.8, 2.7)), head)


def brush(rng: np.random.Generator) -> list[Part]:
    handle, head, width, thick, wood, hair = drawn(
        rng, (80, 140), (50, 110), (20, 60), (9, 16), (0.5, 1.1), (14, 32)
    )
    return [
        box(handle, rng.uniform(0.3, 0.6) * width + 6, 1.2 * thick, wood, (-handle / 2, 0, 0)),
        box(head, width, thick, wood, (head / 2, 0, 0)),
        box(0.9 * head, 0.85 * width, hair, 0.25, (head / 2, 0, -(thick + hair) / 2)),
    ]


def flashlight(rng: np.random.Generator) -> list[Part]:
    radius, body, head = drawn(rng, (11, 18), (70, 120), (20, 40))
    wider = radius + rng.uniform(3, 12)
    made_of = rng.uniform(0.9, 2.2)
    return [
        cylinder(radius, body, made_of, (-body / 2, 0, 0), "x"),
        cylinder((radius + wider) / 2, 12, made_of, (6, 0, 0), "x"),
        cylinder(wider, head, made_of, (12 + head / 2, 0, 0), "x"),
    ]


def spanner(rng: np.random.Generator) -> list[Part]:
    length, thick, steel = drawn(rng, (100, 180), (9, 15), (2.7, 7.85))
    heads = [
        cylinder(rng.uniform(14, 25), 1.2 * thick, steel, (x * length / 2, 0, 0)) for x in (-1, 1)
    ]
    return [box(length, rng.uniform(14, 24), thick, steel, (0, 0, 0)), *heads]


def remote(rng: np.random.Generator) -> list[Part]:
    length, thick = drawn(rng, (90, 190), (14, 28))
    batteries = box(
        0.4 * length, rng.uniform(25, 45), thick, rng.uniform(0.8, 2.0), (-0.2 * length, 0, 0)
    )
    return [
        batteries,
        box(0.6 * length, rng.uniform(35, 62), thick, rng.uniform(0.4, 1.0), (0.3 * length, 0, 0)),
    ]


def dumbbell(rng: np.random.Generator) -> list[Part]:
    grip, head, radius, density = drawn(rng, (90, 120), (18, 40), (18, 30), (0.9, 3.0))
    ends = [
        cylinder(radius, head, density, (side * (grip + head) / 2, 0, 0), "x") for side in (-1, 1)
    ]
    return [cylinder(rng.uniform(9, 15), grip, density, axis="x"), *ends]


def spray_bottle(rng: np.random.Generator) -> list[Part]:
    width, depth, height, neck, fill, head = drawn(
        rng, (50, 80), (36, 60), (80, 130), (11, 16), (0.1, 0.9), (55, 85)
    )
    return [
        box(width, depth, height, fill, (0, 0, height / 2)),
        cylinder(neck, 30, 0.5, (0, 0, height + 15)),
        box(head, 26, 24, 0.6, (0.2 * head, 0, height + 42)),
        box(10, 16, 34, 0.6, (0.35 * head, 0, height + 13)),
    ]


def cone(rng: np.random.Generator) -> list[Part]:
    radius, slice_height, density = drawn(rng, (24, 34.5), (11, 20), (0.4, 1.5))
    return stack(
        *((cylinder, (radius * (1 - 0.14 * index), slice_height), density) for index in range(6))
    )


def plug(rng: np.random.Generator) -> list[Part]:
    side, length, apart = drawn(rng, (28, 50), (30, 55), (12, 20))
    body = box(
        length, side, rng.uniform(0.6, 1.0) * side, rng.uniform(0.8, 1.4), (-length / 2, 0, 0)
    )
    pins = [
        cylinder(rng.uniform(2, 4), 19, 8.5, (9.5, side_of * apart / 2, 0), "x")
        for side_of in (-1, 1)
    ]
    return [
        body,
        *pins,
        cylinder(rng.uniform(3, 5), rng.uniform(20, 40), 1.3, (-length - 10, 0, 0), "x"),
    ]


def toy_truck(rng: np.random.Generator) -> list[Part]:
    length, width, wheel, bed, cab = drawn(rng, (80, 140), (36, 58), (9, 14), (12, 25), (22, 40))
    wheels = [cylinder(wheel, width + 6, 0.9, (x * length * 0.32, 0, 0), "y") for x in (-1, 1)]
    body = box(length, width, bed, rng.uniform(0.3, 0.8), (0, 0, 0.4 * wheel + bed / 2))
    return [
        body,
        *wheels,
        box(0.3 * length, 0.9 * width, cab, 0.4, (0.3 * length, 0, 0.4 * wheel + bed + cab / 2)),
    ]


FAMILIES: dict[str, tuple[Family, tuple[float, float]]] = {
    "bottle": (bottle, (0.4, 0.8)),
    "jar": (jar, (0.4, 0.7)),
    "can": (single(cylinder, (24, 34.5), (60, 135), (0.1, 1.05)), (0.4, 0.7)),
    "carton": (single(box, (35, 110), (22, 62), (60, 170), (0.15, 0.8)), (0.45, 0.7)),
    "mug": (mug, (0.4, 0.7)),
    "cup": (cup, (0.4, 0.8)),
    "hammer": (hammer, (0.5, 0.9)),
    "screwdriver": (screwdriver, (0.5, 1.0)),
    "fruit": (fruit, (0.4, 0.8)),
    "ball": (single(ball, (18, 34.5), (0.08, 1.2)), (0.5, 1.0)),
    "banana": (banana, (0.4, 0.8)),
    "bar": (single(cylinder, (7, 20), (90, 240), (0.3, 1.4), axis="x"), (0.4, 0.9)),
    "square bar": (single(box, (90, 240), (14, 40), (14, 40), (0.3, 1.2)), (0.4, 0.9)),
    "tube": (single(hollow, (13, 32), (0.08, 0.25), (60, 200), (0.7, 1.4)), (0.4, 0.8)),
    "knob": (knob, (0.4, 0.9)),
    "brush": (brush, (0.5, 0.8)),
    "disc": (single(cylinder, (20, 34.5), (14, 32), (0.5, 2.7)), (0.5, 1.0)),
    "roll": (single(hollow, (24, 34.5), (0.3, 0.55), (15, 50), (0.5, 1.4)), (0.5, 0.9)),
    "flashlight": (flashlight, (0.4, 0.8)),
    "spanner": (spanner, (0.4, 0.6)),
}
"""Families of the training set and of part of the held-out set: function that samples the parts,
and friction range.
"""
NEW_FAMILIES: dict[str, tuple[Family, tuple[float, float]]] = {
    "dumbbell": (dumbbell, (0.5, 1.0)),
    "spray bottle": (spray_bottle, (0.4, 0.8)),
    "cone": (cone, (0.4, 0.8)),
    "plug": (plug, (0.4, 0.8)),
    "toy truck": (toy_truck, (0.4, 0.7)),
    "remote": (remote, (0.4, 0.8)),
}
"""Families that only the held-out set contains."""


PLAIN: dict[str, tuple[Family, tuple[float, float]]] = {
    "plain cylinder": (single(cylinder, (6, 41), (12, 300), (0.05, 8), draw=spread), (0.4, 0.8)),
    "plain block": (single(box, *[(10, 220)] * 3, (0.05, 8), draw=spread), (0.4, 0.8)),
    "plain ball": (single(ball, (10, 41), (0.05, 3), draw=spread), (0.4, 0.9)),
}
"""Plain solids as thin, tall, flat and heavy as things that people hold: pens, cans, cartons, nuts."""
