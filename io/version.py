"""The version of quadrig, as it is installed."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("quadrig")
except PackageNotFoundError:
    # The rooms are on the path of a checkout that nobody installed.
    __version__ = "unknown"
