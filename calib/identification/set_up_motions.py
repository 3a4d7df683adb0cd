"""Motions of a whole set-up that its measurements do not determine: turning it, straining it, and making it larger.

A machine that is larger throughout touches sockets, planes and balls in unknown places just as well, if their places
grow with it; and everything may be turned together. Residuals make such directions look determined: a machine shrunk to
a point explains every socket, and a turn turns what sockets leave unexplained. So they must be taken out, and not be
left to a threshold.

A machine that is larger along some axes alone seldom touches the same targets exactly; a SCARA does nearly, as far as
its axes are parallel. Shrinking all touched numbers, whitened, by shares of s together saves cost in proportion to s,
whatever is true. Where the data have an information of I about such a strain, it is then off by s / I, which is more
than its standard error while I < s^2. Then it is taken out as well.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from calib.foundations import linear, rigid
from calib.foundations.arrays import Array
from calib.identification.relations import Relation
from calib.identification.targets import Target, shapes
from calib.measurement.kinds import IN_INSTRUMENT_FRAME, TOUCHES
from calib.measurement.measurements import Measurements, numbered

# Known places, in m, and directions agree within this.
_AGREE = 1e-9


class Motions(NamedTuple):
    """Motions of a whole set-up about a point (3,) that no measurement shows: turns (3, m), and whether it grows.

    ``strained``: names of unknown targets, which a strain of the machine takes along; none where none is taken out.
    ``on_links``: turns (3, m), about the link's origin, of all that links carry, by link. ``shifted``: links that carry
    nothing known; what they carry may be shifted as well, so that it turns about any axis.
    """

    about: Array
    turns: Array
    grows: bool
    on_links: Mapping[str, Array]
    shifted: tuple[str, ...] = ()
    strained: frozenset[str] = frozenset()

    @property
    def directions(self) -> int:
        """How many turns there are, of the floor and of links."""
        return sum(int(turns.shape[1]) for turns in (self.turns, *self.on_links.values()))

    def of(self, link: str | None) -> tuple[Array, Array]:
        """Return about which point (3,) all on a link, None being the floor, moves, and its turns (3, k)."""
        turns, start = np.zeros((3, self.directions)), 0
        for ground, own in ((None, self.turns), *self.on_links.items()):
            if ground == link:
                turns[:, start : start + own.shape[1]] = own
            start += own.shape[1]
        return self.about if link is None else np.zeros(3), turns


def motions(
    measurements: Sequence[Measurements], known: Mapping[str, Target], relations: Sequence[Relation], near: Array
) -> Motions | None:
    """Return the motions of a whole set-up that must be taken out; None where there are none.

    ``measurements`` have common names; ``near`` (3,): where the robot stands. Turns are only taken out where sockets
    are: a turn changes the three numbers of their residuals, and those of no other kind. What a link carries turns by
    itself, with the joint before it, also where an instrument shows where the robot is.
    """
    placed = any(data.kind in IN_INSTRUMENT_FRAME for data in measurements)
    if placed and not measurements[0].target_links:
        return None
    found = None if placed else _centre(measurements, known, relations, near)
    shape, links = shapes(measurements), measurements[0].target_links
    points = {name: known[name].pose[:3, 3] for name in shape if name in known and shape[name] == "point"}
    floor = [place for name, place in points.items() if name not in links]
    about = (floor[0] if floor else near) if found is None else found

    sat_in = {links.get(name) for data in measurements if data.kind == "socket" for name in data.seen_targets}

    def free(link: str | None) -> Array:
        if (placed and link is None) or link not in sat_in:
            return np.zeros((3, 0))
        origin = about if link is None else np.zeros(3)
        fixed = [place - origin for name, place in points.items() if links.get(name) == link]
        fixed += [
            known[name].pose[:3, 2]
            for name in shape
            if name in known and shape[name] == "plane" and links.get(name) == link
        ]
        # Turns about an axis leave what lies along it.
        axes, values, _ = linear.svd(np.concatenate([np.zeros((3, 3)), *map(rigid.skew, np.array(fixed))]).T)
        return np.asarray(axes[:, values < _AGREE])

    turns, on_links = free(None), {link: free(link) for link in dict.fromkeys(links.values())}
    held = {links.get(name) for name in shape if name in known}
    shifted = tuple(link for link, own in on_links.items() if own.shape[1] and link not in held)
    every = Motions(about, turns, found is not None, on_links, shifted, _strained(measurements, known))
    return None if found is None and not every.directions and not every.strained else every


def _strained(measurements: Sequence[Measurements], known: Mapping[str, Target]) -> frozenset[str]:
    """Return the names of unknown targets where touches of one leave less of the same noise by a smaller machine.

    None where links carry targets or a camera looks: strains of these are not told apart.
    """
    if measurements[0].target_links or any(data.kind == "pixels" for data in measurements):
        return frozenset()
    unknown = {
        (data.kind, name)
        for data in measurements
        for name in data.seen_targets
        if name not in known or not known[name].height_is_known
    }
    return frozenset(name for _, name in unknown) if any(kind in TOUCHES for kind, _ in unknown) else frozenset()


def _centre(
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
    taken_up: dict[tuple[str, str | int | None], float] = {}
    normals, heights = [np.zeros((0, 3))], [np.zeros(0)]
    for data in measurements:
        unknown = unknown_length(data)
        of_a_mark = data.kind == "pixels" and not data.of_boards
        if data.points is not None and np.ptp(data.points, axis=0).any():
            # What a scanner sees has a known size.
            return None
        if data.kind not in ("socket", "plane") and unknown is None and not of_a_mark:
            return None
        for t, rows in numbered(data.target):
            name = data.targets[t] if t >= 0 else ""
            values = data.value[rows][:, : 0 if of_a_mark else None]
            own: tuple[str, str | int | None] = ("plane", name) if data.kind == "plane" else ("length", unknown)
            if values.size and np.any(values != taken_up.setdefault(own, float(values[0, 0]))):
                return None
            target = known.get(name) if t >= 0 else None
            if target is not None and target.height_is_known:
                axes = target.pose[:3, 2:3].T if data.kind == "plane" else target.pose[:3, :3].T
                # A known plane does not take up the probe's radius.
                height = axes @ target.pose[:3, 3] + (values[0] if data.kind == "plane" else 0.0)
                if data.link_of(t) is None:
                    normals.append(axes)
                    heights.append(height)
                elif np.any(height != 0.0):
                    return None
    A, b = np.concatenate(normals), np.concatenate(heights)
    found = near + np.linalg.lstsq(A, b - A @ near, rcond=_AGREE)[0]
    return np.asarray(found) if np.all(np.abs(A @ found - b) < _AGREE) else None


def unknown_length(data: Measurements) -> int | None:
    """Return the number of the scalar that is a part of what the rows measure, where one is."""
    return data.uses.get("offset", data.uses.get("radius"))
