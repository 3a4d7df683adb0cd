"""The command line with every command, for whoever asks about all of them: the documentation, the tests."""

from calib.cli.application import app, load

__all__ = ["app"]

load()
