"""Meshes as convex parts.

CoACD computes the parts once; they are cached in a file beside the mesh, so that only the first
call is slow."""

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hpac_gym.body.object_models import Hull, Solid
from hpac_gym.command import stopped_later
from hpac_gym.errors import ParameterError, install
from hpac_gym.model.checks import Array
from hpac_gym.output import OutputError, file_hash, writable_file, write_text
from hpac_gym.progress import waiting

MESHES = (".stl", ".obj", ".ply", ".off")
_COMMON = {"max_convex_hull": 32, "decimate": True, "seed": 0}
DETAILS = {
    "coarse": _COMMON
    | {
        "threshold": 0.2,
        "max_ch_vertex": 32,
        "preprocess_resolution": 20,
        "resolution": 300,
        "mcts_nodes": 5,
        "mcts_iterations": 5,
        "mcts_max_depth": 1,
    },
    "fine": _COMMON | {"threshold": 0.05, "max_ch_vertex": 64},
}
"""Settings of CoACD by detail; chosen: seconds and minutes for a mug."""
_MANY_FACES = 1000
"""A coarse decomposition of more faces first remeshes them at its resolution."""
_CONVEX = 0.99
"""A mesh that fills at least this fraction of its convex hull is not decomposed."""
_CORNERS = 256
"""A convex mesh with more corners keeps those that lie outermost in so many directions, and along
its axes: more would slow PyBullet down.
"""


def of_mesh(
    path: Path, scale: Array, settings: Mapping[str, Any], folder: str | os.PathLike[str] | None
) -> list[Solid]:
    """The convex parts of a mesh, each with its volume as its mass; a mirroring scale turns the
    faces over.

    Args:
        path: the mesh.
        scale: factors from the file's lengths to metres, shape (3,).
        settings: settings of CoACD, of `DETAILS`.
        folder: folder in which the parts are cached; None is beside the mesh.
    """
    if path.suffix.lower() not in MESHES:
        raise ParameterError(f"'{path}' is not one of {', '.join(MESHES)}, nor a .urdf")
    kept = (path.parent if folder is None else Path(folder)) / f"{path.stem}.hulls.json"
    made_from = {"sha256": file_hash(path, ParameterError), "coacd": settings}
    parts = _kept(kept, made_from)
    if parts is None:
        try:
            writable_file(kept)
        except OutputError as error:
            raise OutputError(
                f"{error}: convex parts are kept there, or in folder= (--set object.folder=)"
            ) from None
        parts = _decomposed(path, settings)
        write_text(kept, json.dumps(made_from | {"parts": parts}))
    order = -1 if np.prod(scale) < 0 else 1
    return [
        _hull(np.array(corners) * scale, np.array(faces)[:, ::order]) for corners, faces in parts
    ]


def _kept(path: Path, made_from: dict[str, Any]) -> list | None:
    """Parts cached in a file; None unless it was made from the same mesh with the same settings, and
    holds parts.
    """
    try:
        cache = json.loads(path.read_text(encoding="utf-8"))
        same = all(cache[key] == value for key, value in made_from.items())
        parts: list = cache["parts"]
        hulls = [_hull(np.array(corners), np.array(faces)) for corners, faces in parts]
    except (OSError, LookupError, TypeError, ValueError, RecursionError):
        return None
    return parts if same and hulls and all(hull.mass > 0 for hull in hulls) else None


def _decomposed(path: Path, settings: Mapping[str, Any]) -> list:
    """Corners and faces of the convex parts of a mesh, in the file's unit."""
    try:
        with stopped_later():
            import coacd
            import trimesh
    except ImportError as error:
        raise ParameterError(
            f"own_object needs the package {error.name}: {install('objects')}"
        ) from None
    try:
        mesh = trimesh.load_mesh(path)
    except Exception as error:  # the reader may raise anything on a broken file
        raise ParameterError(
            f"'{path}' cannot be read as a mesh: {next(iter(str(error).splitlines()), repr(error))}"
        ) from None
    if not (
        isinstance(mesh, trimesh.Trimesh) and len(mesh.faces) and np.isfinite(mesh.vertices).all()
    ):
        raise ParameterError(f"'{path}' has no triangles with finite corners")
    mesh.merge_vertices(merge_tex=True, merge_norm=True)  # split where a texture has a seam
    if np.ptp(mesh.vertices, axis=0).min() < 1e-9 * np.ptp(mesh.vertices, axis=0).max():
        raise ParameterError(f"'{path}' is flat: it has no volume")
    if not mesh.is_watertight:
        raise ParameterError(
            f"'{path}' is not watertight: every edge must belong to two triangles; close its holes first"
        )
    if not mesh.is_volume:
        mesh.fix_normals()
    if not mesh.volume > 1e-9 * np.prod(mesh.extents):
        raise ParameterError(f"'{path}' has no volume")
    whole = mesh.convex_hull
    parts = [whole]
    if mesh.volume < _CONVEX * whole.volume:
        coacd.set_log_level("error")
        if "preprocess_resolution" in settings and len(mesh.faces) > _MANY_FACES:
            settings = {**settings, "preprocess_mode": "on"}
        with waiting(f"convex parts of {path.name}"):
            convex = coacd.run_coacd(coacd.Mesh(mesh.vertices, mesh.faces), **settings)
        parts = [trimesh.convex.convex_hull(corners) for corners, _ in convex]
        low, high = trimesh.util.concatenate(parts).bounds  # a remeshed one's are a little larger
        for part in parts:
            share = (part.vertices - low) / (high - low)
            part.vertices = mesh.bounds[0] + share * mesh.extents
    elif len(whole.vertices) > _CORNERS:
        parts = [trimesh.convex.convex_hull(_outermost(whole.vertices))]
    return [(part.vertices.tolist(), part.faces.tolist()) for part in parts]


def _outermost(corners: Array) -> Array:
    """The corners that lie outermost in `_CORNERS` directions, on a spiral about a sphere, and along
    the axes.
    """
    step = np.arange(_CORNERS) + 0.5
    height = 1 - 2 * step / _CORNERS
    turn = math.pi * (1 + math.sqrt(5)) * step
    around = np.sqrt(1 - height**2) * (np.cos(turn), np.sin(turn))
    ways = np.hstack([(*around, height), np.eye(3), -np.eye(3)])
    return corners[np.unique((corners / np.ptp(corners, axis=0) @ ways).argmax(axis=0))]


def _hull(corners: Array, faces: Array) -> Solid:
    volume, centre, _ = Hull(corners, faces).moments()
    x, y, z = np.ptp(corners, axis=0).tolist()
    return Solid("hull", volume, (x, y, z), centre, np.eye(3), hull=Hull(corners - centre, faces))
