"""The exceptions of hpac_gym: one hierarchy; each is also a built-in type.

Messages contain the value, the bound and the unit, so that a command can print them unchanged.
"""

EXTRA_OF = {
    "coacd": "objects",
    "cv2": "camera",
    "imageio": "video",
    "imageio_ffmpeg": "video",
    "jax": "sbx",
    "lerobot": "lerobot",
    "matplotlib": "study",
    "minari": "data",
    "moviepy": "video",
    "onnx": "onnx",
    "onnxruntime": "onnx",
    "PIL": "grasps",
    "ray": "nodes",
    "rich": "train",
    "sb3_contrib": "train",
    "sbx": "sbx",
    "stable_baselines3": "train",
    "tensorboard": "train",
    "torch": "train",
    "trimesh": "objects",
}
"""The optional dependencies of this project by package: the name of the extra that installs it."""


def install(extra: str) -> str:
    """The command that installs an extra, or several: the package is on no index yet."""
    return f"pip install '.[{extra}]' in a checkout of hpac_gym"


class HpacError(Exception):
    """Base class of every error that this library raises deliberately."""


class ShapeError(HpacError, ValueError):
    """An array has the wrong shape or contains a value that is not finite."""


class WorkspaceError(HpacError, ValueError):
    """A joint, synergy, servo or action value lies outside the hand's workspace."""


class ParameterError(HpacError, ValueError):
    """A hand parameter or a parameter file is missing, malformed or unphysical."""


class EpisodeError(HpacError, RuntimeError):
    """A call is invalid in the present state of an environment: before reset, after the end, or
    after close.
    """


class PolicyError(HpacError, ValueError):
    """A policy is unknown, or its file is missing, damaged or made for another environment."""


class EnvError(HpacError, ValueError):
    """An environment id is unknown, an option of it is invalid, or its spaces are not supported."""


class DatasetError(HpacError, ValueError):
    """A folder does not contain a dataset, or exists already."""
