"""Observation ``position``: an instrument saw where a tool point was."""

from calib.identification.observations.seen import Linearised, Seen, minus_position


def residual(seen: Seen) -> Linearised:
    """Return r = x_measured - x (n, 3) in m in the instrument's axes."""
    position = seen.data.position
    assert position is not None, "positions and poses have measured positions"
    return Linearised(position[seen.rows] - seen.tools[:, :3, 3], (minus_position(),))
