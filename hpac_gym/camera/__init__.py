"""Printed tags before a camera: the sheet, its detection, the object's pose and the joints' angles.

OpenCV is loaded by what needs it, so that commands can tell their help without it."""

from types import ModuleType

from hpac_gym.errors import HpacError


class CameraError(HpacError, RuntimeError):
    """OpenCV is missing, a camera gives no picture, its file is malformed, or tags do not show what
    they must.
    """


def opencv() -> ModuleType:
    """The module `cv2`.

    Raises:
        CameraError: It is not installed.
    """
    try:
        import cv2
    except ModuleNotFoundError:
        raise CameraError(
            "tags need OpenCV: pip install 'hpac_gym[camera]' (no module cv2)"
        ) from None
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)
    return cv2
