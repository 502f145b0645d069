"""Printed tags before a camera: the sheet, its detection, the object's pose and the joints' angles.

OpenCV is loaded by what needs it, so that commands can tell their help without it."""

from types import ModuleType

from hpac_gym.errors import HpacError


class CameraError(HpacError, RuntimeError):
    """A camera gives no picture, its file is malformed, or tags do not show what they must."""


def opencv() -> ModuleType:
    """The module `cv2`, without its own messages but errors.

    Raises:
        ModuleNotFoundError: It is not installed; a command then names the extra.
    """
    import cv2

    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)
    return cv2
