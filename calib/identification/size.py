"""Whether measurements tell the size of a machine, and which direction they do not see where they do not.

A machine that is larger throughout touches sockets, planes and balls in unknown places just as well, if their places
grow with it. Noise makes such a direction look seen - a machine shrunk to a point explains every socket - so that it
must be taken out, and not be left to a threshold.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from calib.foundations import linear
from calib.foundations.arrays import Array
from calib.identification import identifiability
from calib.identification.machine import Frames, Layout
from calib.identification.parameters import Parameter, scales
from calib.identification.relations import Relation
from calib.identification.targets import SHAPES, Target
from calib.measurement.measurements import Measurements

# Two ways to move every tool are the same when they differ by less than this share.
_SAME = 1e-7
# J sees the size clearly when the growing direction lies in the row space by more than this share: of a unit direction,
# or of the robot's reach.
_CLEARLY = 0.1
# Known places, in m, agree within this.
_AGREE = 1e-9


def centre(
    measurements: Sequence[Measurements], known: Mapping[str, Target], relations: Sequence[Relation], near: Array
) -> Array | None:
    """Return the point (3,) about which all that was touched may grow; None where something tells a length.

    It is the nearest to ``near`` (3,), where the robot stands, that what is known allows.

    ``measurements`` have common names. A length tells nothing when an unknown one takes it up: that of a plane's height
    or of a set's offset, as long as it is the same in all rows. Known places tell no size unless they are at a distance
    from each other: one socket, or planes through one point.
    """
    if any(relation.kind != "angle" for relation in relations):
        return None
    taken_up: dict[tuple[str, str | int], float] = {}
    normals, heights = [np.zeros((0, 3))], [np.zeros(0)]
    for data in measurements:
        by_offset = data.offset >= 0 and data.kind in ("distance", "pair_distance", "sphere")
        if data.kind not in ("socket", "plane") and not by_offset:
            return None
        for t in sorted(set(data.target.tolist())):
            name = data.targets[t] if t >= 0 else ""
            values = data.value[data.target == t]
            own: tuple[str, str | int] = ("plane", name) if data.kind == "plane" else ("offset", data.offset)
            if values.size and np.any(values != taken_up.setdefault(own, float(values[0, 0]))):
                return None
            target = known.get(name) if t >= 0 else None
            if target is not None and target.height_is_known:
                axes = target.pose[:3, :3].T if SHAPES[data.kind] == "point" else target.pose[:3, 2:3].T
                normals.append(axes)
                # A known plane does not take up the probe's radius.
                heights.append(axes @ target.pose[:3, 3] + (values[0] if data.kind == "plane" else 0.0))
    A, b = np.concatenate(normals), np.concatenate(heights)
    found = near + np.linalg.lstsq(A, b - A @ near, rcond=_AGREE)[0]
    return np.asarray(found) if np.all(np.abs(A @ found - b) < _AGREE) else None


def without(J: Array, size: Array) -> Array:
    """Return scaled rows J (q, p) that do not see the unit direction ``size`` (p, 1).

    Far from a solution, where J sees it clearly, only what J sees of it is taken out: what J is blind to besides, such
    as a turn of the whole set-up, would be seen through it else. Near a solution nothing is left to be told apart.
    """
    found = identifiability.directions(J)
    seen = found.vectors[:, : found.rank]
    w = seen @ (seen.T @ size)
    share = float(np.linalg.norm(w))
    w = w / share if share > _CLEARLY else size
    return np.asarray(J - (J @ w) @ w.T)


class Growth:
    """Collects, row by row, how the set-up grows by one common factor about a point (3,)."""

    def __init__(self, parameters: Sequence[Parameter], about: Array, reach: float) -> None:
        self._parameters, self._about, self._reach = parameters, about, reach
        self._of_targets = np.array([parameter.kind == "target" for parameter in parameters])
        self._triangle = np.empty((0, len(parameters) + 1))

    def add(self, J: Array, moved: Sequence[tuple[Array, Array]], sigma: Array) -> None:
        """Add rows (n, d, p) with their sigmas (n, d).

        ``moved``: derivatives by the local twist (n, d, 6) and placements (n, 4, 4) of the tools, and of other ends.
        """
        grown = np.zeros((*J.shape[:2], 1))
        for twist, placed in moved:
            R, x = placed[:, :3, :3], placed[:, :3, 3] - self._about
            grown += twist[:, :, :3] @ (np.swapaxes(R, -1, -2) @ x[:, :, None])
        # What parameters, targets left out, do to a tool, beside its growing.
        rows = np.concatenate([np.where(self._of_targets, 0.0, J), grown], axis=2) / sigma[:, :, None]
        self._triangle = linear.triangle(np.concatenate([self._triangle, rows.reshape(-1, rows.shape[2])]))

    def direction(self, measurements: Sequence[Measurements], reference: Frames, at: Frames, layout: Layout) -> Array:
        """Return the unit direction (p, 1) of growing, scaled, at frames; (p, 0) where it is not to be taken out.

        That is where the robot's lengths are held, and where nothing of growing is seen: a robot that grows about the
        only point that it touches moves no row.
        """
        J, c = self._triangle[:, :-1], self._triangle[:, -1]
        z = np.linalg.lstsq(J, c, rcond=_SAME)[0]
        of_robot = [parameter.unit == "m" and parameter.kind != "target" for parameter in self._parameters]
        grown = float(np.linalg.norm((z * scales(self._parameters))[of_robot]))
        if np.linalg.norm(J @ z - c) > _SAME * np.linalg.norm(c) or grown < _CLEARLY * self._reach:
            return np.zeros((len(z), 0))
        state = self._growth_of_targets(measurements, reference, at, layout)
        for k, parameter in enumerate(self._parameters):
            if parameter.kind == "target":
                ((entry, share),) = parameter.direction
                z[k] = state[entry] / (share * scales(self._parameters)[k])
        return np.asarray(z[:, None] / np.linalg.norm(z))

    def _growth_of_targets(
        self, measurements: Sequence[Measurements], reference: Frames, at: Frames, layout: Layout
    ) -> Array:
        """Return how targets and lengths grow, as entries of the state."""
        state = np.zeros(layout.size)
        targets = state[layout.targets : layout.lengths].reshape(-1, 6)
        for data in measurements:
            for t in set(data.target.tolist()) - {-1}:
                R, away = reference.targets[t, :3, :3], at.targets[t, :3, 3] - self._about
                if SHAPES[data.kind] == "point":
                    targets[t, :3] = R.T @ away
                else:
                    # Its height alone is a parameter; with the probe's radius it is where the tool is.
                    normal = at.targets[t, :3, 2]
                    radius = data.value[data.target == t][0, 0]
                    targets[t, 2] = (normal @ away + radius) / (normal @ R[:, 2])
            if data.offset >= 0:
                # What is left of the measured length when the unknown part is taken away grows.
                state[layout.lengths + data.offset] = at.lengths[data.offset] - data.value[0, 0]
        return state
