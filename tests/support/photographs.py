"""Rendered photographs of a small camera, quick to make and to read."""

from scripts.simulate import photographs as simulation


def small_session(seed: int, images: int) -> simulation.Session:
    """Return a session of a UR5 whose photographs have 640 x 360 pixels."""
    some = simulation.session(seed, images)
    lens = simulation.Lens(fx=452.0, fy=451.0, cx=322.0, cy=177.0, size=(640, 360))
    return simulation.Session(some.arm, lens, some.sheet, some.look, some.camera, some.board, some.readings)
