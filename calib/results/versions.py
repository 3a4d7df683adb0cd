"""Which versions have made a result."""

import platform
from importlib.metadata import PackageNotFoundError, version

from calib.foundations.version import __version__

_LIBRARIES = ("pin", "numpy", "scipy", "meshcat", "trimesh")


def versions() -> dict[str, str | None]:
    """Return the versions of this package, of Python and of the libraries that matter; None where one is not known."""
    return {
        "calib": __version__,
        "python": platform.python_version(),
        **{name: _version(name) for name in _LIBRARIES},
    }


def _version(distribution: str) -> str | None:
    try:
        return version(distribution)
    except PackageNotFoundError:  # conda and system packages know it by another name
        return None
