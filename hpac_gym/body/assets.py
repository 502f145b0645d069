"""Where the model files lie: inside an installed wheel, or in the checkout."""

from pathlib import Path

from hpac_gym.errors import HpacError

PACKAGE = Path(__file__).resolve().parents[1]
ASSET_FOLDERS = (PACKAGE / "assets" / "urdf", PACKAGE.parent / "assets" / "urdf")


class AssetError(HpacError, FileNotFoundError):
    """A model file is neither in the package nor in the checkout."""


def asset_path(name: str) -> Path:
    """The path of a model file such as ``hpac_hand.urdf``; the installed package is asked first.

    Raises:
        AssetError: No folder has a file of that name.
    """
    for folder in ASSET_FOLDERS:
        if (folder / name).is_file():
            return folder / name
    raise AssetError(f"no model file {name!r} in {' or '.join(str(folder) for folder in ASSET_FOLDERS)}")
