"""``hpac tags``: the sheet of tags to print, exact to the millimetre, and where each tag stands on it.

AprilTags of the family 36h11. Lengths are in mm on the sheet, from its lower left corner, x to the
right and y up, as one holds it to read it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hpac_gym.camera import opencv
from hpac_gym.model import FINGERS, digit_joints
from hpac_gym.model.checks import Array
from hpac_gym.output import OutputError, replacing

PAGE = (210.0, 297.0)
"""A4 [mm]."""
MARGIN = 3.0
"""White around a tag or a board, up to the line where it is cut: more than one module [mm]."""
FLAP = 9.0
"""Length of the flap that is folded by a right angle and glued to a phalanx [mm]."""
RULER = 100.0
"""Length of the line that checks the print's scale [mm]."""
DPI = 600
_KINDS = (".pdf", ".svg", ".png")


@dataclass(frozen=True, slots=True)
class Tag:
    """A printed tag."""

    id: int
    label: str
    size: float
    """Side of its black square [mm]."""
    centre: tuple[float, float]
    """On the sheet [mm]."""

    @property
    def corners(self) -> Array:
        """Its corners on the sheet: upper left, upper right, lower right, lower left, as OpenCV
        orders them, shape (4, 2) [mm].
        """
        return np.array(self.centre) + self.size / 2 * np.array(
            [[-1, 1], [1, 1], [1, -1], [-1, -1]]
        )


def _board(
    name: str, first: int, size: float, gap: float, centre: tuple[float, float]
) -> list[Tag]:
    """Two by two tags, from the upper left, row by row."""
    half = (size + gap) / 2
    places = [(-half, half), (half, half), (-half, -half), (half, -half)]
    return [
        Tag(first + i, name, size, (centre[0] + x, centre[1] + y))
        for i, (x, y) in enumerate(places)
    ]


OBJECT = _board("object", 0, 12.0, 3.0, (50.0, 240.0))
HAND = _board("hand", 4, 20.0, 5.0, (115.0, 240.0))
"""The boards: on the object, and on the plate of the hand."""

CHAINS = {
    "thumb_mp": ("metacarpal", *digit_joints("thumb")),
    **{f"{finger}_mcp": ("palm", *digit_joints(finger)) for finger in FINGERS},
    "thumb_cmc": ("palm", "thumb_cmc"),
}
"""What the tags of the servo's strip are glued to, by servo: a link that stands still, then the
links of the joints that the servo moves, from the palm outwards.
"""


def _strips() -> dict[str, list[Tag]]:
    strips = {}
    first = 8
    for place, (servo, links) in enumerate(CHAINS.items()):
        row, column = divmod(place, 2)
        strips[servo] = [
            Tag(first + i, link, 14.0, (24.0 + 97.0 * column + 22.0 * i, 178.0 - 58.0 * row))
            for i, link in enumerate(links)
        ]
        first += len(links)
    return strips


STRIPS = _strips()
"""The tags of each servo's sweep, in the order of `CHAINS`."""
TAGS = {tag.id: tag for tags in (OBJECT, HAND, *STRIPS.values()) for tag in tags}


def points(tags: list[Tag]) -> dict[int, Array]:
    """Corners of a board's tags in the board's frame, by id, shape (4, 3) [m]: from its centre, x to
    the right and y up as printed, z out of the paper.
    """
    middle = np.mean([tag.centre for tag in tags], axis=0)
    return {tag.id: np.pad((tag.corners - middle) * 1e-3, ((0, 0), (0, 1))) for tag in tags}


def draw(path: Path) -> None:
    """Write the sheet: PDF, SVG, or PNG of 600 dots per inch.

    Raises:
        OutputError: The file's kind is another one, or it cannot be written.
        CameraError: OpenCV is missing.
    """
    if path.suffix not in _KINDS:
        raise OutputError(f"the sheet '{path}' must end in {', '.join(_KINDS)}")
    cv2 = opencv()
    from matplotlib.figure import Figure

    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    figure = Figure(figsize=(PAGE[0] / 25.4, PAGE[1] / 25.4))
    axes = figure.add_axes((0, 0, 1, 1), xlim=(0, PAGE[0]), ylim=(0, PAGE[1]), aspect="auto")
    axes.set_axis_off()

    def write(x: float, y: float, text: str, size: float = 7, **how: object) -> None:
        axes.text(x, y, text, **{"fontsize": size, "ha": "center", "va": "center", **how})

    def cut(low: Array, high: Array) -> None:
        x, y = np.stack([low, high]).T
        axes.plot(x[[0, 1, 1, 0, 0]], y[[0, 0, 1, 1, 0]], "0.75", lw=0.3)

    for tag in TAGS.values():
        (left, bottom), (right, top) = tag.corners[[3, 1]]
        picture = cv2.aruco.generateImageMarker(family, tag.id, 8 * 40)
        axes.imshow(
            picture,
            extent=(left, right, bottom, top),
            cmap="gray",
            vmin=0,
            vmax=255,
            interpolation="none",
            aspect="auto",
        )
    for tags, name in ((OBJECT, "object"), (HAND, "hand")):
        corners = np.concatenate([tag.corners for tag in tags])
        low = corners.min(axis=0) - MARGIN
        high = corners.max(axis=0) + MARGIN
        cut(low, high)
        write(
            (low[0] + high[0]) / 2,
            high[1] + 3,
            f"{name}, ids {tags[0].id}–{tags[-1].id}, this side up",
        )
    for servo, tags in STRIPS.items():
        x, y = tags[0].centre
        write(x - 10, y + 14, f"sweep of {servo}", 8, weight="bold", ha="left")
        for tag in tags:
            low = tag.corners[3] - MARGIN
            high = tag.corners[1] + MARGIN
            cut(low - (0, FLAP), high)
            axes.plot([low[0], high[0]], [low[1]] * 2, "0.5", lw=0.4, ls="--")
            write(tag.centre[0], low[1] - 3, tag.label, 6)
            write(tag.centre[0], low[1] - 6.5, f"id {tag.id}", 6)
    write(
        105,
        285,
        "Tags of hpac_gym: print at 100 %, on card; cut along the lines, fold the dashed ones",
        9,
    )
    left = PAGE[0] / 2 - RULER / 2
    millimetre = np.arange(RULER + 1)
    axes.vlines(left + millimetre, 14, np.where(millimetre % 10, 16, 18), "k", lw=0.25)
    axes.plot([left, left + RULER], [14, 14], "k", lw=0.25)
    write(105, 10, f"this line must be {RULER:g} mm long: measure it", 8)
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=DPI, format=path.suffix[1:])
