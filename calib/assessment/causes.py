"""What is wrong where a fit is doubted: what leaves least, where it is taken for otherwise than the job says.

A few rows that lie far off, a length that is stated wrong, of rows or between targets, and a prior that holds the arm
where it is not, bend a whole fit: what is left then looks like a base or a target that moved, and checks that are made
for those say so. So a fit that is doubted is tried once with such rows passed over, by a robust loss, or with the tool
or set-up by which all of them lie near the rest, once with lengths that are stated free, each of its own, once without
what is stated between targets, and once without the priors that are stated. This last one is tried where nothing is
doubted, too, if more is left than the instrument has: what a prior that is far too narrow leaves is taken for noise,
under which rows do not contradict the prior. A cause is named where it brings the scatter to half or less, of rows held
out as well, and all checks of what else may be wrong then pass; of several, that which leaves least. What is stated
between targets is a cause where rows miss it by more than chance. Rows that lie far off, all by one motion of base,
tool or a joint, are no such rows: something moved. A row that is held out may be one as well: it bends nothing, but
what is left of all held out is then nearly its own.
"""

from collections.abc import Callable, Iterator, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import fields, replace
from typing import NamedTuple

import numpy as np

from calib.assessment.checks.of_fit import ROUNDING
from calib.assessment.checks.of_rows import FAR, MANY, RARELY, SURE
from calib.assessment.influence import Residue
from calib.assessment.judged import JudgedSet
from calib.assessment.priors import with_unit
from calib.assessment.stretches import Stretch, stretches
from calib.foundations.arrays import Array, BoolArray, IntArray, read_only_view
from calib.foundations.chance import bound, exceeded
from calib.foundations.errors import CalibError
from calib.foundations.units import DEG, MM
from calib.foundations.words import counted, first_of, noun, shown
from calib.identification.fit import Fit
from calib.identification.identify import identify, identify_near, residuals_of
from calib.identification.initialisation.problem import with_common_names
from calib.identification.losses import Loss
from calib.identification.machine import values_at
from calib.identification.parameters import Parameter, scales
from calib.identification.relations import Relation
from calib.identification.system import Problem, related
from calib.measurement.kinds import QUANTITIES
from calib.measurement.measurements import Measurements
from calib.measurement.scalars import Scalar

# Of more rows or parameters nothing is tried, nor where the search was long.
_MOST_ROWS, _MOST_PARAMETERS, _MOST_EVALUATIONS = 3000, 300, 60
# A cause brings the scatter of what is left to this share or less.
LEAST_LEFT = 0.5
_LISTED = 3
_STRONGEST: Loss = "cauchy"
# Of more targets each table has one length in common.
_MOST_TARGETS = 10
# Of more rows, exchanged names are those of the others.
_MOST_NAMED = 0.4
_ROLES = {"distance": "offset", "pair_distance": "offset", "sphere": "radius"}


# What names rows, tool or set-up, and the number of that of each row.
_Named = tuple[str, IntArray]


class Cause(NamedTuple):
    """What explains what is left: ``fit`` is as it is then, ``sets`` are as that leaves them; ``left``: of squares."""

    sentence: str
    fit: Fit
    sets: tuple[JudgedSet, ...]
    left: float


def causes(fit: Fit, sets: Sequence[JudgedSet], *, doubted: bool) -> tuple[Cause, ...]:
    """Return what may explain what a fit leaves, the one that leaves least first; priors alone if it is not doubted.

    Nothing of a fit of other rows than these sets are, of levels; of very many rows or parameters, or where the search
    was long.
    """
    own = [one for one in sets if one.use == "identification"]
    rows = sum(map(len, fit.measurements))
    costly = rows > _MOST_ROWS or len(fit.parameters) > _MOST_PARAMETERS
    if (
        costly
        or fit.evaluations > _MOST_EVALUATIONS
        or [len(one.data) for one in own] != [len(data) for data in fit.measurements]
    ):
        return ()
    every = (_far_off, _other_lengths, _other_relations, _without_priors)
    tried = every if doubted else (_without_priors,) if _is_more_left(fit) else ()
    found = [one for find in tried if (one := find(fit, sets)) is not None]
    return tuple(sorted(found, key=lambda one: one.left))


def _judged(fit: Fit, sets: Sequence[JudgedSet], tables: Sequence[Measurements]) -> tuple[JudgedSet, ...]:
    """Return tables, of the same ``sets`` each by itself, as a fit leaves them."""
    before, after = (residuals_of(fit, tables, machine) for machine in (fit.nominal, fit.machine))
    every = zip(sets, tables, before, after, strict=True)
    return tuple(JudgedSet(one.use, one.file, data, b, a) for one, data, b, a in every)


def _anew(
    fitted: Callable[[], Fit], sets: Sequence[JudgedSet], tables: Sequence[Measurements]
) -> tuple[Fit, tuple[JudgedSet, ...]] | None:
    """Return another fit, and tables as it leaves them, as :func:`_judged`; None where there is none that converged."""
    try:
        found = fitted()
        judged = _judged(found, sets, tables)
    except CalibError:
        return None
    return (found, judged) if found.converged else None


# ---- rows that lie far off


def _far_off(fit: Fit, sets: Sequence[JudgedSet]) -> Cause | None:
    """Return what is left if rows that lie far off are of another tool or set-up, or else if they are passed over.

    The loss is the strongest one: a table with that passes over its own already, and one with a weaker one not quite.
    """
    anew = _anew(lambda: _by_loss(fit), sets, [one.data for one in sets])
    return None if anew is None else _other_names(fit, sets, *anew) or _passed_over(fit, sets, *anew)


def _passed_over(fit: Fit, sets: Sequence[JudgedSet], found: Fit, by_loss: Sequence[JudgedSet]) -> Cause | None:
    """Return what is left if rows that lie far off are passed over: of the fit by a robust loss, of others as they are.

    ``found``: that fit, and ``by_loss``: the tables as it leaves them.
    """
    judged = list(by_loss)
    parts, told, left = stretches(Residue.of(found, {})), [], []
    fitted = [k for k, one in enumerate(sets) if one.use == "identification"]
    own = dict(zip(fitted, found.measurements, strict=True))
    losses = dict(zip(fitted, fit.losses, strict=True))
    for k, (one, doubted) in enumerate(zip(tuple(judged), sets, strict=True)):
        scale, rest = _scales(one), one
        far = _far(one, scale)
        if not far.any() or np.mean(far) > MANY or (k in own and losses[k] == _STRONGEST):
            continue
        if k not in own:  # targets that are found from held-out rows are elsewhere without these
            (rest,) = _judged(found, [one], [one.data.subset(np.flatnonzero(~far))])
        now = rest.after[~far] if k in own else rest.after
        share = float(np.sum((now / scale) ** 2)) / max(float(np.sum((doubted.after / scale) ** 2)), 1e-300)
        if share > LEAST_LEFT**2:
            continue
        if any(part.data is own.get(k) and _are_one_motion(part, far) for part in parts):
            continue
        judged[k] = rest
        told.append(_rows_said(one, far, share))
        left.append(share)
    return Cause(" ".join(told), found, tuple(judged), min(left)) if told else None


def _by_loss(fit: Fit) -> Fit:
    """Return the fit by the strongest loss."""
    if all(loss == _STRONGEST for loss in fit.losses):
        return fit
    model = fit.model.within(fit.measurements)
    losses = [_STRONGEST] * len(fit.measurements)
    return replace(identify_near(fit, model, fit.measurements, losses=losses), model=fit.model)


def _far(one: JudgedSet, scale: Array) -> BoolArray:
    """Return which rows (N,) of a table lie far off, for standard deviations (d,) of its numbers."""
    squares = (one.after / scale) ** 2
    sizes = [(q.columns, q.columns.stop - q.columns.start) for q in QUANTITIES[one.data.kind]]
    return np.asarray(np.any([np.sum(squares[:, own], axis=1) > FAR**2 * d for own, d in sizes], axis=0))


def _are_one_motion(part: Stretch, far: BoolArray) -> bool:
    """Return whether a motion of base, tool or a joint explains rows (N,): then they are another machine's."""
    rows = far[part.row.astype(np.intp)]
    r = part.r[rows].ravel()
    for Z in (part.by_base, part.by_tool, *np.moveaxis(part.by_joint[..., None], 2, 0)):
        D = Z[rows].reshape(len(r), -1)
        rest = r - D @ np.linalg.lstsq(D, r, rcond=None)[0]
        left, freedom = float(rest @ rest), len(r) - D.shape[1]
        gained = (float(r @ r) - left) / max(left, part.least) * freedom
        if freedom > 0 and left < LEAST_LEFT**2 * float(r @ r) and exceeded(gained, D.shape[1], freedom) < RARELY:
            return True
    return False


def _scales(one: JudgedSet) -> Array:
    """Return the standard deviations (d,) of a table's numbers as most of its rows tell them."""
    scale = np.empty(one.after.shape[1])
    for quantity in QUANTITIES[one.data.kind]:
        squares = np.sum(one.after[:, quantity.columns] ** 2, axis=1)
        d = quantity.columns.stop - quantity.columns.start
        scale[quantity.columns] = max(float(np.sqrt(np.median(squares) / bound(0.5, d))), ROUNDING)
    return scale


def _rows_said(one: JudgedSet, far: BoolArray, share: float) -> str:
    """Return what is said of rows that lie far off."""
    errors = np.linalg.norm(one.after[:, QUANTITIES[one.data.kind][0].columns], axis=1)
    worst = np.flatnonzero(far)[np.argsort(-errors[far], kind="stable")][:_LISTED]
    lines = ", ".join(str(line) for line in sorted(one.data.lines[worst].tolist()))
    many = int(far.sum())
    which = f"{noun(many, 'row')} {lines}" if many <= _LISTED else f"{many} rows, {lines} the farthest,"
    it, lie = ("it", "lies") if many == 1 else ("them", "lie")
    # What is held out takes no part in a fit, whatever the loss.
    robustly = f', and let such rows weigh little: loss = "{_STRONGEST}"' if one.use == "identification" else ""
    return (
        f"{one.file}: {which} {lie} far from the rest, and without {it} what is left scatters "
        f"{1.0 / np.sqrt(share):.2g} times less: look at {it}{robustly}."
    )


def _other_names(fit: Fit, sets: Sequence[JudgedSet], found: Fit, by_loss: Sequence[JudgedSet]) -> Cause | None:
    """Return what is left if all rows that lie far off are of the tool or set-up by which they lie near the rest.

    ``found``: the fit by a robust loss, and ``by_loss``: the tables as it leaves them.
    """
    first = fit.measurements[0]
    if max(len(first.tools), len(first.setups)) < 2:
        return None
    tables = list(with_common_names(fit.model, (first, *(one.data for one in sets)))[1:])
    which = dict[int, tuple[BoolArray, _Named]]()
    for k, one in enumerate(by_loss):
        scale = _scales(one)
        far = _far(one, scale)
        if np.mean(far) > _MOST_NAMED:
            return None
        if far.any():
            named = _named_otherwise(found, tables[k].subset(np.flatnonzero(far)), one, scale)
            if named is None:
                return None
            which[k] = far, named
            tables[k] = _by_names(tables[k], far, *named)
    own = [data for data, one in zip(tables, sets, strict=True) if one.use == "identification"]

    def so_named() -> Fit:
        return replace(identify(fit.model.within(own), own, losses=fit.losses), model=fit.model)

    anew = _anew(so_named, sets, tables) if which else None
    if anew is None:
        return None
    told, left = [], []
    for k, (far, (what, _)) in which.items():
        now, before = (float(np.sum((one.after / _scales(by_loss[k])) ** 2)) for one in (anew[1][k], sets[k]))
        left.append(now / max(before, 1e-300))
        told.append(_names_said(anew[1][k], far, what, left[-1]))
    return Cause(" ".join(told), *anew, min(left)) if max(left) <= LEAST_LEFT**2 else None


def _named_otherwise(found: Fit, far: Measurements, one: JudgedSet, scale: Array) -> _Named | None:
    """Return by what tools, or set-ups, rows that lie ``far`` off (n,) lie near; None where not all of them do."""
    for what, names in (("tool", found.measurements[0].tools), ("setup", found.measurements[0].setups)):
        every = np.ones(len(far), dtype=np.bool_)
        named = [_by_names(far, every, what, np.full(len(far), k)) for k in range(len(names))]
        after = residuals_of(found, named, found.machine)
        if np.any([~_far(one._replace(after=r), scale) for r in after], axis=0).all():
            return what, np.argmin([np.sum((r / scale) ** 2, axis=1) for r in after], axis=0)
    return None


def _by_names(data: Measurements, rows: BoolArray, what: str, numbers: IntArray) -> Measurements:
    """Return a table in which some ``rows`` (N,) are of other tools, or set-ups, by their numbers (n,)."""
    named = (data.tool if what == "tool" else data.setup).copy()
    named[rows] = numbers
    every = read_only_view(named)
    return replace(data, tool=every) if what == "tool" else replace(data, setup=every)


def _names_said(one: JudgedSet, far: BoolArray, what: str, share: float) -> str:
    """Return what is said of rows that lie ``far`` off (N,) by the names of their tools or set-ups."""
    said, names, number = ("tool", one.data.tools, one.data.tool)
    if what == "setup":
        said, names, number = ("set-up", one.data.setups, one.data.setup)
    rows = np.flatnonzero(far)
    each = [f"row {one.data.lines[k]} {shown(names[number[k]])}" for k in rows]
    it, fit = ("it names", "fits") if len(rows) == 1 else ("they name", "fit")
    return (
        f"{one.file}: {counted(len(rows), 'row')} {fit} another {said} than {it}: "
        f"{', '.join(first_of(each, _LISTED))}. So named, what is left scatters {1.0 / np.sqrt(share):.2g} times less: "
        "are names exchanged?"
    )


# ---- lengths that are stated wrong


def _other_lengths(fit: Fit, sets: Sequence[JudgedSet]) -> Cause | None:
    """Return what is left if lengths that are stated are each longer by what fits best."""
    split = [list(_freed(data)) for data in fit.measurements]
    free = {data.scalars[k].name for parts in split for data, k in parts if k is not None}
    if not free:
        return None
    tables = [data for parts in split for data, _ in parts]
    losses = [loss for parts, loss in zip(split, fit.losses, strict=True) for _ in parts]
    every = [(one, data) for one in sets for data, _ in _freed(one.data)]

    def longer() -> Fit:
        return replace(identify(fit.model.within(tables), tables, losses=losses), model=fit.model)

    anew = _anew(longer, [one for one, _ in every], [data for _, data in every])
    if anew is None:
        return None
    found, judged = anew
    now, before = (
        sum(float(np.sum(r**2)) for r, data in zip(residuals, of, strict=True) if data.kind in _ROLES)
        for residuals, of in ((found.residuals, found.measurements), (fit.residuals, fit.measurements))
    )
    share = now / max(before, 1e-300)
    if share > LEAST_LEFT**2:
        return None
    wrong = _wrong(found, free)
    return Cause(" ".join(_lengths_said(own) for own in wrong.values()), found, judged, share) if wrong else None


def _wrong(found: Fit, free: AbstractSet[str]) -> dict[str, list[tuple[Measurements, float]]]:
    """Return by file the rows whose lengths surely are others than is stated, and by how much longer they would be."""
    value_of = {
        p.name: (float(v), float(s)) for p, v, s in zip(found.parameters, found.values, found.sigmas, strict=True)
    }
    wrong: dict[str, list[tuple[Measurements, float]]] = {}
    for data, r in zip(found.measurements, found.residuals, strict=True):
        for name in free & {data.scalars[k].name for k in data.uses.values()}:
            value, sigma = value_of[name]
            # Where the size of the arm is not known, nor is that of a length beside it, but for what it leaves.
            if abs(value) > SURE * max(sigma if sigma > 0.0 else 0.0, float(np.std(r))):
                wrong.setdefault(data.where, []).append((data, value))
    return wrong


def _freed(data: Measurements) -> Iterator[tuple[Measurements, int | None]]:
    """Yield rows with an unknown number of their own for what is stated of them, and which of their scalars that is."""
    role = _ROLES.get(data.kind)
    if role is None or role in data.uses or not len(data):
        yield data, None
        return
    each = [data.target == t for t in np.unique(data.target)]
    for rows in each if len(each) <= _MOST_TARGETS else [np.ones(len(data), dtype=np.bool_)]:
        part = data.subset(np.flatnonzero(rows))
        what = data.targets[part.target[0]] if len(each) <= _MOST_TARGETS and part.target[0] >= 0 else data.where
        scalar = Scalar(f"length.{what} as stated.{role}", "m", size=1e-3, weak_prior=10.0)
        yield (
            replace(part, scalars=(*part.scalars, scalar), uses={**part.uses, role: len(part.scalars)}),
            len(part.scalars),
        )


def _lengths_said(wrong: Sequence[tuple[Measurements, float]]) -> str:
    """Return what is said of lengths of a file that would be longer by so much each."""
    wrong = sorted(wrong, key=lambda one: -abs(one[1]))
    first = wrong[0][0]
    names = [repr(data.targets[data.target[0]]) for data, _ in wrong if data.target[0] >= 0][:_LISTED]
    more = len(wrong) - len(names)
    which = (", ".join(names) + (f" and {more} more" if more and names else "")) or "its gauges"
    several = len(wrong) > 1
    if first.kind == "sphere":
        data, value = wrong[0]
        stated = float(np.median(data.value[:, 0]))
        said = (
            f"{which} {'were' if several else 'was'} touched {(stated + value) / MM:.4g} mm from the centre and not "
            f"{stated / MM:.4g} mm, the half of ball and diameter: is a radius told as a diameter, or "
            "a diameter as a radius"
        )
    else:
        each = ", ".join(f"{-value / MM:+.4g} mm" for _, value in wrong[:_LISTED])
        said = f"lengths to {which} are off by {each}: is what belongs to all of them counted"
    return f"{first.where}: what is left is explained if {said}? length_offset lets this be found."


# ---- what is stated between targets


def _other_relations(fit: Fit, sets: Sequence[JudgedSet]) -> Cause | None:
    """Return what is left if distances, angles and steps between targets are what rows say."""
    if not fit.model.relations:
        return None
    model = replace(fit.model, relations=())

    def without() -> Fit:
        found = identify_near(fit, model.within(fit.measurements), fit.measurements, losses=fit.losses)
        return replace(found, model=model)

    anew = _anew(without, sets, [one.data for one in sets])
    if anew is None:
        return None
    found, judged = anew
    missed, variance = _of_relations(found, fit.model.relations)
    wrong = np.abs(missed) > SURE * np.sqrt(1.0 + variance)
    if not wrong.any():
        return None
    said = ", and ".join(
        _relation_said(fit.model.relations[k], fit.model.relations[k].sigma * float(missed[k]))
        for k in np.flatnonzero(wrong)
    )
    # Of what they are missed by, chance would leave so much.
    share = float(np.max((1.0 + variance[wrong]) / missed[wrong] ** 2))
    return Cause(f"What is left is explained if {said}: measure that again.", found, judged, share)


def _of_relations(fit: Fit, relations: Sequence[Relation]) -> tuple[Array, Array]:
    """Return by how much a fit misses relations (k,), stated minus found, and the variance of that, in their sigmas.

    Rows that do not show how large all is, as touches, do not contradict a length alone: the null space counts.
    """
    frames, deviations = fit.machine.frames, fit.machine.deviations
    problem = Problem(fit.model, fit.parameters, frames, fit.measurements, deviations, tuple(relations), fit.losses)
    found = related(problem, values_at(fit.model.robot, fit.parameters, frames, deviations))
    J = found[:, :-1] / scales(fit.parameters)
    unseen = np.sum((J @ fit.along_null_space.factor) ** 2, axis=1)
    return found[:, -1], np.einsum("kp,pq,kq->k", J, fit.covariance, J) + unseen


def _relation_said(relation: Relation, missed: float) -> str:
    """Return what is said of a relation that is missed by so much, stated minus found."""
    what = {"distance": "distance between", "angle": "angle between", "offset": "step from"}[relation.kind]
    unit, of, digits = ("deg", DEG, 3) if relation.kind == "angle" else ("mm", MM, 2)
    first, second = map(repr, relation.targets)
    seems, stated = (f"{value / of:.{digits}f} {unit}" for value in (relation.value - missed, relation.value))
    between = "to" if relation.kind == "offset" else "and"
    return f"the {what} {first} {between} {second} is {seems} where {stated} is stated"


# ---- priors that hold the arm where it is not


def _is_more_left(fit: Fit) -> bool:
    """Return whether a cause may bring the scatter down as far as is asked for, or nothing is known of the noise."""
    return any(not noise.chi_square * LEAST_LEFT**2 < 1.0 for noise in fit.noise)


def _without_priors(fit: Fit, sets: Sequence[JudgedSet]) -> Cause | None:
    """Return what is left if the arm may be as far from its URDF as the data say, whatever priors are stated."""
    held = [p for p in fit.parameters if p.of_robot and p.is_stated]
    if not held:
        return None
    priors = fit.model.priors
    stated = [field.name for field in fields(priors) if isinstance(getattr(priors, field.name), float)]
    model = replace(fit.model, priors=replace(priors, **dict.fromkeys(stated)))

    def without() -> Fit:
        found = identify(model.within(fit.measurements), fit.measurements, losses=fit.losses)
        return replace(found, model=model)

    anew = _anew(without, sets, [one.data for one in sets])
    if anew is None:
        return None
    found, judged = anew
    share = 0.0
    for use in {one.use for one in sets}:
        pairs = [(new, old) for new, old in zip(judged, sets, strict=True) if old.use == use]
        now, before = (sum(float(np.sum((pair[k].after / _scales(pair[0])) ** 2)) for pair in pairs) for k in (0, 1))
        # Rows that are fitted lose a part of what is left to numbers that are free.
        spent = _freedom(fit) / max(_freedom(found), 1e-300) if use == "identification" else 1.0
        share = max(share, spent * now / max(before, 1e-300))
    if share > LEAST_LEFT**2:
        return None
    value_of = dict(zip((p.name for p in found.parameters), found.values, strict=True))
    farthest = max(held, key=lambda p: abs(value_of.get(p.name, 0.0)) / (p.prior or 1.0))
    return Cause(_priors_said(farthest, value_of[farthest.name]), found, judged, share)


def _freedom(fit: Fit) -> float:
    """Return the degrees of freedom of what is left."""
    return sum(noise.degrees_of_freedom for noise in fit.noise)


def _priors_said(parameter: Parameter, value: float) -> str:
    """Return what is said of stated priors, by the parameter that they hold back most."""
    assert parameter.prior is not None, "it is held"
    stated = with_unit(parameter.prior, parameter.unit)
    return (
        "What is left is explained if the arm is farther from its URDF than error_model.prior lets it be, "
        f"{parameter.name} by {with_unit(value, parameter.unit, '+')} where {stated} "
        'is stated: state how far it may really be, or write "learned".'
    )
