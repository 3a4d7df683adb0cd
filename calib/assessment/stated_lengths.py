"""Lengths and places that are stated: those that rows contradict, and those that no row checks.

What a job states without a standard deviation is taken as exact: the radius of a ball, an offset of all lengths that is
not free, where an anchor or a plane is. If it is wrong the whole fit bends, and hardly anything is left of it: regions
do not count it. So each is taken for one unknown more. Where rows then ask for another value, by more than chance, and
the tool would be elsewhere by more than is stated of it, they contradict it.

Where they do not say what it is, the tool rests on it. Faces of a known block that are touched from one side each are
as far from the tool as the ball's radius: if that is wrong, the base moves by as much along every normal, and no
residual tells. Were the number to be found as well, its standard deviation would be that of what the parameters do not
take up of it. It is named if the tool were far less certain then.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from calib.assessment.causes import LEAST_LEFT
from calib.assessment.checks.of_rows import RARELY
from calib.assessment.influence import Residue
from calib.assessment.scores import Asked, asked
from calib.assessment.stretches import Stretch, as_means
from calib.foundations.arrays import Array
from calib.foundations.units import MM
from calib.foundations.words import listed, noun
from calib.identification.parameters import scales
from calib.identification.tool_motions import tool_motions
from calib.machine.calibrated import CalibratedMachine
from calib.machine.tool_uncertainty import by_pair, tool_uncertainty
from calib.measurement.checks import Finding
from calib.measurement.measurements import Measurements

# Kinds whose residual is a length that one number makes longer, and the unknown that it may be.
_OFFSET, _RADIUS = ("distance", "pair_distance"), ("plane", "sphere")
# Kinds of which rows tell from many places where a target is. Of one place, errors of the arm look like that.
_PLACED = ("distance", "indicator", "plane")
# In m: how far a length may be off where nothing is known of it.
_WEAK = 10.0 * MM
# The tool is said to rest on a length if it would be so many times less certain without.
_TIMES = 2.0
# Standard deviations of the tool by which it would be elsewhere by what rows ask for.
_PULL = 1.0
# In m: what users are told the effect of.
_TOLD = 0.1 * MM
_MORE = "Measure the ball; more faces that look opposite ways, touches all around, or positions, would check it."
# So many rows of a set tell where tools are; of more targets some are looked at. In m: smaller errors are rounding.
_ENOUGH, _MOST_TARGETS, _ROUNDING = 200, 100, 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class _Stated:
    """Something that is stated: rows that have it, and what a metre more of it does to them, ``by`` (n, d, k) of each.

    ``what``: it is called so. ``checked``: how rows may check it; empty where they surely do. ``cure``: what lets it be
    found.
    """

    what: str
    parts: tuple[Stretch, ...]
    by: tuple[Array, ...]
    checked: str
    cure: str


class StatedNumbers:
    """What is stated of lengths and places, beside the rows of a fit.

    ``residue`` and its ``parts``; ``known``: the calibrated machine.
    """

    def __init__(self, residue: Residue, parts: Sequence[Stretch], known: CalibratedMachine) -> None:
        # Rows of one pose are one: what the model leaves there is no other length.
        self._poses = [(as_means(part, part.pose), np.bincount(part.pose)) for part in parts]
        self._residue, self._known = residue, known
        self._rows = [_some(part) for part in parts if part.data.kind != "pixels"]
        self._stated = (*self._lengths(), *self._places())
        self._certain = self._covariances() if self._stated else np.zeros((0, 3, 3))

    def contradicted(self, *, wrong: bool) -> list[Finding]:
        """Return what rows contradict most surely, where the tool would be elsewhere; nothing else.

        ``wrong``: whether another check says what is wrong, as of places one does. It may look like that, but for a
        length that explains most of what is left.
        """
        found = [(asked(one.parts, one.by, self._residue.C), one) for one in self._stated]
        sure = [
            (ask, one)
            for ask, one in found
            if ask.chance * len(found) < RARELY
            and not (wrong and (ask.left > LEAST_LEFT**2 or not one.checked))
            and np.sqrt(np.median(self._pull(self._moved(ask.follows)))) > _PULL
        ]
        if not sure:
            return []
        ask, one = min(sure, key=lambda each: each[0].chance)
        return [Finding.warning("stated-contradicted", self._contradiction(ask, one))]

    def unchecked(self) -> tuple[str, ...]:
        """Return a sentence for every length that no row checks, and on which the place of the tool rests."""
        return tuple(said for one in self._stated if one.checked and (said := self._rests_on(one)))

    # ---- what is stated

    def _lengths(self) -> Iterator[_Stated]:
        """Yield the ball of every tool that touched, and what is common to the lengths of every table."""
        touched = [(k, part.data, part.row.astype(np.intp)) for k, (part, _) in enumerate(self._poses)]
        touched = [(k, data, rows) for k, data, rows in touched if data.kind in _RADIUS]
        tools = self._residue.fit.measurements[0].tools
        for number, tool in enumerate(tools):
            every = [(k, d, (d.tool[rows] == number) & (d.value[rows, 0] > 0.0), rows) for k, d, rows in touched]
            every = [one for one in every if one[2].any()]
            if not every or any("radius" in data.uses for _, data, _, _ in every):
                continue
            names = dict.fromkeys(d.targets[t] for _, d, own, rows in every for t in np.unique(d.target[rows[own]]))
            which = f" of the tool {tool!r}" if len(tools) > 1 else ""
            ball = "ball and sphere" if all(data.kind == "sphere" for _, data, _, _ in every) else "the ball"
            what = f"The radius of {ball}{which} where {listed(tuple(names))} {noun(len(names), 'was', 'were')} touched"
            parts = tuple(self._poses[k][0] for k, *_ in every)
            balls = tuple(self._longer(k, own) for k, _, own, _ in every)
            yield _Stated(what, parts, balls, _MORE, "Measure the ball.")
        for k, (part, _) in enumerate(self._poses):
            if part.data.kind in _OFFSET and "offset" not in part.data.uses:
                offset = (self._longer(k, np.ones(len(part.r))),)
                what = f"The offset that all lengths of {part.data.where} may have in common, here 0,"
                more = "Measure it; other lengths, or positions, would check it."
                yield _Stated(what, (part,), offset, more, "length_offset lets it be found.")

    def _longer(self, k: int, own: Array) -> Array:
        """Return what a metre more does to poses (n, 1, 1) of a part whose length it is, ``own`` (n,)."""
        (part, many), fit = self._poses[k], self._residue.fit
        rows = part.row.astype(np.intp)
        i = next(i for i, data in enumerate(fit.measurements) if data is part.data)
        weights = self._residue.w[i][rows] * many
        return np.asarray((own * np.sqrt(weights) / self._residue.sigma[i][rows, 0])[:, None, None])

    def _places(self) -> Iterator[_Stated]:
        """Yield the targets that are stated to be somewhere on the floor."""
        stated = {name for name, target in self._residue.fit.model.targets.items() if target.height_is_known}
        for part, _ in self._poses:
            if part.data.kind not in _PLACED:
                continue
            target = part.data.target[part.row.astype(np.intp)]
            for t in np.unique(target)[:_MOST_TARGETS]:
                name = part.data.targets[t]
                if name in stated and name not in part.data.target_links:
                    by = part.by_base[:, :, :3] * (target == t)[:, None, None]
                    what = f"{part.data.where}: the place of {name!r}"
                    yield _Stated(what, (part,), (by,), "", f"Without what is stated of {name!r} it is found.")

    # ---- what is said of it

    def _contradiction(self, ask: Asked, one: _Stated) -> str:
        far = float(np.sqrt(np.mean(np.sum(self._moved(ask.follows) ** 2, axis=1))))
        off = float(np.linalg.norm(ask.sizes))
        return (
            f"{one.what} is not what rows say: it seems {off / MM:.2g} mm off, and then the tool is {far / MM:.2g} mm "
            f"elsewhere (rms), which regions do not count. {one.cure}"
        )

    def _rests_on(self, one: _Stated) -> str:
        C = self._residue.C
        both = list(zip(one.parts, (D[:, :, 0] for D in one.by), strict=True))
        follows = -C @ np.sum([np.einsum("ndk,nd->k", part.J, D) for part, D in both], axis=0)
        squares = sum(float(np.sum(D**2)) + float(np.sum(D * (part.J @ follows))) for part, D in both)
        variance = 1.0 / (max(squares, 0.0) + 1.0 / _WEAK**2)
        moves = self._moved(follows)
        if not variance * np.median(self._pull(moves)) >= _TIMES**2 - 1.0:
            return ""
        far = float(np.sqrt(np.mean(np.sum(moves**2, axis=1))))
        sigma = float(np.sqrt(variance))
        checked = f"rows check it to {sigma / MM:.2g} mm only" if sigma < 0.5 * _WEAK else "no row checks it"
        return (
            f"{one.what} is taken as stated, and {checked}: if it is {_TOLD / MM:g} mm off, the tool is "
            f"{far * _TOLD / MM:.2g} mm elsewhere, which regions do not count. {one.checked}"
        )

    # ---- where tools are

    def _pull(self, moves: Array) -> Array:
        """Return the squares (n,) of how many standard deviations it is that tools move by ``moves`` (n, 3), in m.

        In the direction in which they move, which may be the only one that is known.
        """
        # An arm that moves in a plane has no error across it.
        certain = self._certain + _ROUNDING**2 * np.eye(3)
        return np.asarray(np.einsum("ni,ni->n", moves, np.linalg.solve(certain, moves[:, :, None])[:, :, 0]))

    def _moved(self, follows: Array) -> Array:
        """Return how tools move (n, 3), for some rows of all parts, if parameters move by ``follows`` (k,), scaled."""
        fit, judged = self._residue.fit, self._residue.judged
        step = np.zeros((len(fit.parameters), 1))
        step[judged, 0] = follows * scales(fit.parameters)[judged]
        return np.concatenate([tool_motions(fit, rows, step)[:, :, 0] for rows in self._rows])

    def _covariances(self) -> Array:
        """Return the stated covariances (n, 3, 3) of the tool's position at the same rows, in m^2."""
        found = []
        for data in self._rows:
            own = np.empty((len(data), 3, 3))
            for setup, tool, rows in by_pair(data):
                conditions = data.conditions.subset(rows)
                told = tool_uncertainty(self._known.at(setup), data.readings[rows], tool, conditions=conditions)
                own[rows] = told.covariance[:, :3, :3]
            found.append(own)
        return np.concatenate(found)


def _some(part: Stretch) -> Measurements:
    """Return rows of a part, of many some, that stand for all."""
    rows = part.row.astype(np.intp)
    return part.data.subset(rows[:: -(-len(rows) // _ENOUGH)])
