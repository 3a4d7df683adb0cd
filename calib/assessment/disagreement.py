"""Targets that have moved, and groups of rows that ask for another machine than the rest.

Jumps: the unknowns of a target are doubled, one value before a row and one after it. What that gains is a score test
(C. R. Rao, 1948) on running sums, at every row, and nothing is fitted anew. It is judged by the scatter that is left.
That a model is wrong at the postures that come later looks the same.

Groups (targets, words of the column ``group``, files): a group's rows are a triangle of ``[J r]``. What leaving them
out gains (see :mod:`calib.assessment.influence`), in directions that the group sees well enough and the rest determines
as well, is the chi-squared of the difference between the two machines they ask for, with as many degrees of freedom.
Where a target is that only this group saw, does not count. It is judged by the larger of the scatter that is left and
the noise of the fit, as with too large a noise priors are held too strongly and make groups differ. A real arm is never
quite what its model says: where the noise is estimated from the scatter, groups of many rows disagree significantly
though little; a stated noise says what matters.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from calib.assessment.influence import ALONE, Influence, Residue
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, IntArray
from calib.foundations.linear import svd
from calib.identification.arrow import Arrow, Collected
from calib.identification.identifiability import NUMERICAL_TOLERANCE, RANK_TOLERANCE
from calib.identification.parameters import Parameter, scales
from calib.identification.relations import related_targets
from calib.measurement.kinds import WITH_TARGET
from calib.measurement.measurements import numbered

# On either side of a jump there are two rows; what one row does is its own.
_LEAST_ROWS = 2
# Of a target with more rows than these not every place is tried.
_MOST_SPLITS = 10_000
# What is left of a split has to be so many times what it is below zero in others, which it cannot be.
_UNSURE = 2.0
_MOST_WORDS = 1000
# Of more blocks that groups have in common it is not asked where each group has them.
_MOST_SHARED = 100

GroupKind = Literal["target", "group", "file"]


@dataclass(frozen=True, slots=True)
class Jump:
    """The likeliest place where a target has moved: after ``line`` of ``file``, by ``shift`` (SI) in ``components``.

    ``rows``: how many there are before and after. ``gain``: chi-squared, with as many degrees of freedom as components,
    against the scatter that is left. ``p``: probability of as much at one place; ``chance``: of one such place among
    all, at most. ``size``: what the shift does to a row, over the noise of the fit.
    """

    target: str
    file: str
    line: int
    rows: tuple[int, int]
    components: tuple[str, ...]
    shift: tuple[float, ...]
    gain: float
    p: float
    chance: float
    size: float

    @checked
    def is_told(self, level: float) -> bool:
        """Whether it is no accident. What is smaller than the noise of a fit is its priors', if that is too large."""
        return self.chance < level and self.size > 1.0


@dataclass(frozen=True, slots=True)
class OutlyingGroup:
    """A target, a word of the column ``group`` or a file, with its number of ``rows``.

    ``gain``: chi-squared of ``freedom`` parameter combinations that the group asks to be otherwise; ``p``: probability
    of as much; ``chance``: of one such group among all, at most. ``scatter``: standard deviation of all residuals
    without the group, over that with it. ``differs``: the one thing - a parameter of the robot, a tool, the base - that
    would best be another one in this group, and ``differs_gain`` the chi-squared that this alone explains; empty and 0
    where there is none.
    """

    kind: GroupKind
    name: str
    rows: int
    gain: float
    freedom: int
    p: float
    chance: float
    scatter: float
    differs: str
    differs_gain: float
    without: Influence


# ---- jumps


class _Split(NamedTuple):
    """What the doubled unknowns Z of a target, for its first ``before`` rows or for those after, see and gain.

    ``own`` (k, k): Z^T Z; ``T`` (k, c): Z^T J by common parameters, blocks following; ``g`` (k,): Z^T r. ``left`` (k,
    k): what is left of ``own`` when all other unknowns follow. ``later``: Z is for the rows after. ``gain``:
    chi-squared.
    """

    before: int
    own: Array
    T: Array
    g: Array
    left: Array
    later: bool
    gain: float


class _Run:
    """Walks along the ``number`` rows of one target, with ``unknowns`` that are ``columns`` (k,) of its rows."""

    def __init__(self, unknowns: Sequence[Parameter], columns: Sequence[int], number: int) -> None:
        self.unknowns = unknowns
        self.columns = list(columns)
        self.rows: list[tuple[int, int]] = []
        self._step = -(-number // _MOST_SPLITS)
        self._sum: Array | float = 0.0
        self._sums: list[Array] = []
        self._of_blocks: list[Array] = []
        self._block: list[IntArray] = []

    def add(self, i: int, rows: Array, weighted: Array, block: IntArray, follow: Array) -> None:
        """Walk over ``rows`` (n,) of set i with their ``[J r]`` (n, d, c + a + 1), of a ``block`` (n,) each.

        ``follow`` (m, a, c): how blocks follow common parameters.
        """
        Z = np.swapaxes(weighted[:, :, self.columns], -1, -2)
        c = follow.shape[2]
        common, by_own = weighted[:, :, :c], weighted[:, :, c:-1]
        if by_own.shape[2]:
            common = common + np.where(block[:, None, None] >= 0, by_own @ follow[block], 0.0)
            self._of_blocks.append(Z @ by_own)
            self._block.append(block)
        seen = np.concatenate([Z @ common, Z @ weighted[:, :, -1:], Z @ weighted[:, :, self.columns]], axis=2)
        sums = self._sum + np.cumsum(seen, axis=0)
        self._sum = sums[-1]
        self._sums.append(sums[(len(self.rows) + np.arange(1, len(rows) + 1)) % self._step == 0])
        self.rows += [(i, int(n)) for n in rows]

    def splits(self, residue: Residue, *, related: bool) -> Iterator[_Split]:
        """Yield all splits with enough rows on either side; of very many, evenly so many as are tried.

        What is known between targets holds for one of the halves; for ``related`` targets either is tried.
        """
        before = self._step * np.arange(1, len(self.rows) // self._step + 1)
        enough = (before >= _LEAST_ROWS) & (before <= len(self.rows) - _LEAST_ROWS)
        if not enough.any():
            return
        tried, c, before = np.concatenate(self._sums)[enough], len(residue.split.common), before[enough]
        for later, of_half in ((True, self._sum - tried), (False, tried)) if related else ((False, tried),):
            T, g, own = of_half[:, :, :c], of_half[:, :, c], of_half[:, :, c + 1 :]
            left = own - T @ residue.covariance.common @ np.swapaxes(T, -1, -2)
            if self._block:
                left = left - self._taken_by_blocks(residue.covariance.root, later=later)[before - 1]
            values, V = np.linalg.eigh(left)
            # Nothing is left below zero: by as much, the covariance of what the data hardly determine is off here.
            share = values[:, 0] / np.trace(own, axis1=1, axis2=2)
            can_tell = share > max(ALONE, -_UNSURE * float(share.min()))
            u = (np.swapaxes(V, -1, -2) @ g[:, :, None])[:, :, 0]
            gains = np.sum(u**2 / np.where(can_tell[:, None], values, np.inf), axis=1)
            for k, gain in enumerate(gains.tolist()):
                yield _Split(int(before[k]), own[k], T[k], g[k], left[k], later, gain)

    def _taken_by_blocks(self, root: Array, *, later: bool) -> Array:
        """Return what blocks take (n, k, k) of the doubled unknowns of the rows up to every row, or of those after it.

        A row changes what its own block takes, and nothing of what the others do.
        """
        seen, block = np.concatenate(self._of_blocks), np.concatenate(self._block)
        if later:
            seen, block = seen[::-1], block[::-1]
        order = np.argsort(block, kind="stable")
        sums, first = np.cumsum(seen[order], axis=0), np.flatnonzero(np.diff(block[order], prepend=-2))
        counts = np.diff(first, append=len(order))
        sums -= np.repeat(sums[first] - seen[order][first], counts, axis=0)
        sums = np.where(block[order][:, None, None] >= 0, sums @ root[block[order]], 0.0)
        taken = sums @ np.swapaxes(sums, -1, -2)
        change = np.diff(taken, axis=0, prepend=0.0)
        change[first] = taken[first]
        found = np.empty_like(change)
        found[order] = change
        found = np.cumsum(found, axis=0)
        return np.concatenate([found[-2::-1], np.zeros_like(found[:1])]) if later else np.asarray(found)

    def by_block(self, split: _Split) -> Mapping[int, Array]:
        """Return what the doubled unknowns of a split see of blocks (k, a), by number."""
        if not self._block:
            return {}
        some = slice(split.before, None) if split.later else slice(split.before)
        seen, block = np.concatenate(self._of_blocks)[some], np.concatenate(self._block)[some]
        return {number: seen[rows].sum(axis=0) for number, rows in numbered(block) if number >= 0}


def _shared(one: Mapping[int, Array], other: Mapping[int, Array], root: Array) -> Array | float:
    """Return what the doubled unknowns of two targets have with each other through blocks (k, l), these solved for."""
    return sum(((one[b] @ root[b]) @ (other[b] @ root[b]).T for b in one.keys() & other.keys()), start=0.0)


def jumps_of(residue: Residue, level: float) -> tuple[Jump, ...]:
    """Return the likeliest jump of every unknown target, the least likely to be an accident first.

    Those that are less likely than ``level`` are taken out, one after the other, before the rest is judged: a target
    that has moved bends the machine, and makes others seem to have moved.
    """
    sets = residue.fit.measurements
    runs, follow = _runs(residue), residue.covariance.follow
    of_number = [[runs.get(name) for name in data.targets] for data in sets]
    for block in residue.blocks() if runs else ():
        data, weighted = sets[block.measurements], block.weighted
        if data.kind not in WITH_TARGET:
            continue
        for t, own in numbered(data.target[block.rows]):
            run = of_number[block.measurements][t]
            if run is not None:
                run.add(block.measurements, block.rows.start + own, weighted[own], block.block[own], follow)
    related = related_targets(residue.fit.model.relations)
    tried = {name: list(run.splits(residue, related=name in related)) for name, run in runs.items()}
    number = sum(map(len, tried.values()))
    best = {name: max(splits, key=lambda split: split.gain) for name, splits in tried.items() if splits}
    best = {name: split for name, split in best.items() if split.gain > 0.0}
    if not best:
        return ()
    # The normal equations of all best splits together, the model's own parameters eliminated: what a split sees of
    # common parameters, blocks following, and of blocks is what it has with others.
    g, M = ({name: getattr(split, part) for name, split in best.items()} for part in ("g", "left"))
    T = {name: split.T for name, split in best.items()}
    of_blocks = {name: runs[name].by_block(split) for name, split in best.items()}
    found: list[Jump] = []
    gained, freedom = 0.0, 0
    # What splits have with the jumps that were told, and what these had left.
    told: list[tuple[Mapping[str, Array], Array]] = []
    while best:
        shifts = {name: np.linalg.solve(M[name], g[name]) for name in best}
        order = sorted(best, key=lambda name: (float(g[name] @ shifts[name]) / len(g[name]), name), reverse=True)
        for name in order:
            split, shift = best.pop(name), shifts[name]
            raw, d = float(g[name] @ shift), len(shift)
            gain = raw / float(residue.scatter(gained + raw, freedom + d))
            p = float(residue.probability(gain, d))
            found.append(_jump(residue, runs[name], name, split, shift, gain, p, min(1.0, number * p)))
            if found[-1].is_told(level):
                gained, freedom = gained + raw, freedom + d
                inverse, through = np.linalg.inv(M[name]), residue.covariance.common @ T[name].T
                across: dict[str, Array] = {}
                for other in best:
                    coupling = -T[other] @ through - _shared(of_blocks[other], of_blocks[name], residue.covariance.root)
                    for before, inverse_before in told:
                        coupling = coupling - before[other] @ inverse_before @ before[name].T
                    across[other] = coupling
                    g[other] = g[other] - coupling @ inverse @ g[name]
                    M[other] = M[other] - coupling @ inverse @ coupling.T
                told.append((across, inverse))
                break
    return tuple(sorted(found, key=lambda jump: (jump.p, jump.target)))


def _jump(
    residue: Residue, run: _Run, target: str, split: _Split, shift: Array, gain: float, p: float, chance: float
) -> Jump:
    unknowns = run.unknowns
    i, row = run.rows[split.before - 1]
    data = residue.fit.measurements[i]
    # The solution is -shift, for the half that moved.
    later = -shift if split.later else shift
    moved = len(run.rows) - split.before if split.later else split.before
    return Jump(
        target,
        residue.name(data),
        int(data.lines[row]),
        (split.before, len(run.rows) - split.before),
        tuple(parameter.name.rpartition(".")[2] for parameter in unknowns),
        tuple((later * scales(unknowns)).tolist()),
        gain,
        p,
        chance,
        float(np.sqrt(shift @ split.own @ shift / moved)),
    )


def _runs(residue: Residue) -> Mapping[str, _Run]:
    """Return a run for every unknown target, by name."""
    numbers: dict[str, list[int]] = {}
    for k, parameter in enumerate(residue.fit.parameters):
        prefix, _, rest = parameter.name.partition(".")
        if parameter.kind == "target" and prefix == "target":
            numbers.setdefault(rest.rpartition(".")[0], []).append(k)
    counts: Counter[str] = Counter()
    for data in residue.fit.measurements:
        if data.kind in WITH_TARGET:
            counts.update({data.targets[t]: len(rows) for t, rows in numbered(data.target)})
    columns = residue.split.columns
    return {
        name: _Run([residue.fit.parameters[k] for k in own], columns[own].tolist(), counts[name])
        for name, own in numbers.items()
    }


# ---- groups


def groups_of(residue: Residue) -> tuple[OutlyingGroup, ...]:
    """Return all groups of rows that are not all rows, the least likely to agree with the rest first.

    A column of more than a thousand words names rows rather than groups, and is passed over.
    """
    members = _members(residue)
    split = residue.split
    (m, a), c = split.blocks.shape, len(split.common)
    keys, seen = list(members), _blocks_of(residue, members)
    triangles = [Collected(own, m, a, c) for own in seen]
    # Of every set, the groups that every row is in.
    groups_of_row = [np.full((len(data), len(get_args(GroupKind))), -1) for data in residue.fit.measurements]
    for number, ((kind, _), of_set) in enumerate(members.items()):
        for i, rows in of_set.items():
            groups_of_row[i][rows, get_args(GroupKind).index(kind)] = number
    for block in residue.blocks() if members else ():
        weighted = block.weighted
        common = np.concatenate([weighted[:, :, :c], weighted[:, :, -1:]], axis=2)
        for of_kind in groups_of_row[block.measurements][block.rows].T:
            for number, rows in numbered(of_kind):
                if number >= 0:
                    triangles[number].add(common[rows], weighted[rows][:, :, c:-1], block.block[rows])
    # How many groups of a kind are about a block: of one that only this group saw, nobody can disagree.
    of_kind_counts: dict[GroupKind, IntArray] = {}
    for (kind, _), own in zip(keys, seen, strict=True):
        of_kind_counts.setdefault(kind, np.zeros(m, dtype=np.intp))[own] += 1
    counts = [of_kind_counts[kind] for kind, _ in keys]
    found = [
        _group(residue, *key, members[key], triangle, own[many[own] > 1], len(members))
        for key, triangle, own, many in zip(keys, triangles, seen, counts, strict=True)
    ]
    return tuple(sorted(found, key=lambda group: (np.nan_to_num(group.p, nan=1.0), group.kind, group.name)))


def _blocks_of(residue: Residue, members: Mapping[tuple[GroupKind, str], Mapping[int, IntArray]]) -> list[IntArray]:
    """Return the blocks that the rows of every group are about."""
    of_set, found = residue.whose, []
    for rows_of in members.values():
        own = np.unique(np.concatenate([of_set[i][rows] for i, rows in rows_of.items()]))
        found.append(own[own >= 0])
    return found


def _members(residue: Residue) -> Mapping[tuple[GroupKind, str], Mapping[int, IntArray]]:
    """Return the rows of every group, by set; of groups with the same rows the first, and none with all rows."""
    sets = residue.fit.measurements
    found: dict[tuple[GroupKind, str], dict[int, IntArray]] = {}

    def add(kind: GroupKind, name: str, i: int, rows: IntArray) -> None:
        of_set = found.setdefault((kind, name), {})
        of_set[i] = np.union1d(of_set.get(i, rows), rows)

    words = len({word for data in sets for word in data.group or ()})
    for i, data in enumerate(sets):
        add("file", residue.name(data), i, np.arange(len(data)))
        if data.group is not None and words <= _MOST_WORDS:
            for word, rows in _rows_of(np.array(data.group)):
                add("group", str(word), i, rows)
        if data.kind in WITH_TARGET:
            for t, rows in _rows_of(data.target):
                add("target", data.targets[t], i, rows)
    whole = sum(map(len, sets))
    kept: dict[tuple[tuple[int, bytes], ...], tuple[GroupKind, str]] = {}
    for key, of_set in found.items():
        if sum(map(len, of_set.values())) < whole:
            kept.setdefault(tuple((i, rows.tobytes()) for i, rows in of_set.items()), key)
    return {key: found[key] for key in kept.values()}


def _rows_of(labels: npt.NDArray[Any]) -> Iterator[tuple[Any, IntArray]]:
    """Yield every label, in order of appearance, and its rows."""
    names, first, number = np.unique(labels, return_index=True, return_inverse=True)
    rows = np.split(np.argsort(number, kind="stable"), np.cumsum(np.bincount(number))[:-1])
    for k in np.argsort(first):
        yield names[k], rows[k]


def _things(parameters: Sequence[Parameter]) -> Mapping[str, list[int]]:
    """Return what could be another one in a group, by number: every parameter of the robot, bases and tools."""
    found: dict[str, list[int]] = {}
    for k, parameter in enumerate(parameters):
        if not parameter.nuisance:
            name = parameter.name if parameter.of_robot else parameter.name.rpartition(".")[0]
            found.setdefault(name, []).append(k)
    return found


def _group(
    residue: Residue,
    kind: GroupKind,
    name: str,
    members: Mapping[int, IntArray],
    collected: Collected,
    shared: IntArray,
    number: int,
) -> OutlyingGroup:
    C, J, r, parameters, blocks, taken = _seen_by(residue, collected, shared)
    U, s, Vt = svd(J, full_matrices=False)
    # What the group hardly shows by itself is noise.
    seen = s > max(NUMERICAL_TOLERANCE, RANK_TOLERANCE * s.max(initial=0.0))
    # In its own principal directions the group says R x + c, and beyond them only its own scatter.
    R, c = s[seen, None] * Vt[seen], U[:, seen].T @ r
    CR = C @ R.T
    h, W = np.linalg.eigh(R @ CR)
    both = 1.0 - h > ALONE
    u = (W.T @ c)[both]
    left = 1.0 - h[both]
    q, freedom = float(np.sum(u**2 / left)), int(both.sum())
    scatter = max(float(residue.scatter(q, freedom)), 1.0)
    p = float(residue.probability(q / scatter, freedom))
    # Leaving the group out also takes away the scatter about its own machine.
    numbers = sum(len(rows) * residue.sigma[i].shape[1] for i, rows in members.items())
    alone = taken + len(h) - freedom
    all_squares = q + float(r @ r - c @ c)
    after = float(residue.scatter(all_squares, float(numbers) - alone))
    best, gain = max(_gains(C, J, r, _things(parameters)), key=lambda found: found[1], default=("", 0.0))
    return OutlyingGroup(
        kind,
        name,
        sum(map(len, members.values())),
        q / scatter,
        freedom,
        p,
        min(1.0, number * p) if np.isfinite(p) else float("nan"),
        float(np.sqrt(after / float(residue.scatter(0.0, 0.0)))),
        best,
        gain / scatter,
        residue.influence(CR @ (W[:, both] @ (u / left)), blocks),
    )


class _Seen(NamedTuple):
    """What a group sees: the covariance (k, k) of columns, ``J`` (q, k) and ``r`` (q,) of its rows.

    The columns are ``parameters``: common ones, then those of ``blocks``. ``alone``: how many directions of blocks were
    left out, which only this group saw.
    """

    C: Array
    J: Array
    r: Array
    parameters: Sequence[Parameter]
    blocks: IntArray
    alone: int


def _seen_by(residue: Residue, collected: Collected, shared: IntArray) -> _Seen:
    """Return what a group sees, by common parameters, then of blocks ``shared`` with other groups, or its only one."""
    which, heads = collected.heads
    split, c = residue.split, len(residue.split.common)
    kept = which if len(which) == 1 else shared if len(shared) <= _MOST_SHARED else shared[:0]
    mine = ~np.isin(which, kept)
    reduced = Arrow(split.of_blocks(which[mine]), heads[mine], collected.rest).reduced(RANK_TOLERANCE)
    alone = int(np.count_nonzero(reduced.root.any(axis=1)))
    a, rest = heads.shape[1], reduced.rest
    width = c + a * len(kept) + 1
    rows = np.zeros((len(kept), a, width))
    for k, of_target in enumerate(heads[~mine]):
        rows[k, :, :c], rows[k, :, -1] = of_target[:, a:-1], of_target[:, -1]
        rows[k, :, c + a * k : c + a * (k + 1)] = of_target[:, :a]
    triangle = np.concatenate([rows.reshape(-1, width), np.insert(rest, [c] * (width - c - 1), 0.0, axis=1)])
    own = split.blocks[kept]
    triangle = np.delete(triangle, c + np.flatnonzero(own.ravel() < 0), axis=1)
    columns = np.concatenate([split.common, own[own >= 0]])
    parameters = [residue.fit.parameters[k] for k in columns]
    return _Seen(residue.covariance.of(columns), triangle[:, :-1], triangle[:, -1], parameters, kept, alone)


def _gains(C: Array, J: Array, r: Array, things: Mapping[str, list[int]]) -> Iterator[tuple[str, float]]:
    """Yield for every thing what another one in the group would gain: a score test as for a jump."""
    JJ, g = J.T @ J, J.T @ r
    left, tiny = JJ - JJ @ C @ JJ, np.finfo(float).tiny
    for name, own in things.items():
        k = own[0]
        if len(own) == 1:
            can = left[k, k] > ALONE * max(JJ[k, k], tiny)
            yield name, float(g[k] ** 2 / left[k, k]) if can else 0.0
            continue
        part = np.ix_(own, own)
        values, V = np.linalg.eigh(left[part])
        can_tell = values > ALONE * max(float(np.trace(JJ[part])), tiny)
        yield name, float(np.sum((V.T @ g[own])[can_tell] ** 2 / values[can_tell]))
