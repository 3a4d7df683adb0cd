"""Which model does a machine need? Nested models, judged by rows that they never saw, on the same folds.

A model with more parameters always fits its own rows better. At rows held out it does only where what it adds is there;
the simplest that is not significantly worse than the best is recommended: that of lowest rank whose error is larger by
no more than one standard error (Breiman, Friedman, Olshen, Stone, *Classification and regression trees*, 1984, 3.4.3).
Two models err at the same rows with the same noise. So the standard error is that of their paired difference, which is
far smaller than those of the two figures.

Joint terms are chosen anew in every fold, without the rows it is judged by.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from calib.assessment.choice import Choice, choose_from
from calib.assessment.validation import (
    ChosenRows,
    CrossValidation,
    HeldOut,
    folds,
    held_out,
    parts_apart,
    predict_held_out,
    row_groups,
    some_rows,
)
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, IntArray
from calib.foundations.brief import brief
from calib.foundations.choices import FOLDS
from calib.foundations.errors import IdentificationError, JobError
from calib.identification.error_model import ErrorModel, error_model, with_terms
from calib.identification.fit import Fit
from calib.identification.initialisation.problem import initial_problem
from calib.identification.losses import Loss
from calib.measurement.kinds import QUANTITIES, UNIT_OF
from calib.measurement.measurements import Measurements, as_sets

# As many folds, or each group by itself.
Scheme = int | Literal["leave-one-group-out"]

FRAMES, OFFSETS, DH, PLACEMENTS = "base and tool", "offsets", "DH parameters", "placements"
TERMS, OWN = "joint terms", "as in the job"
# Models that say the same in other parameters differ by what the solver leaves.
_SOLVED = 1e-6
# Rows that models are compared by: every one is fitted once for every fold.
_ENOUGH_ROWS = 2000
# Of tables with more rows, or with more targets, tools and set-ups, there are fewer folds, where nobody says how many.
_VERY_MANY_ROWS, _VERY_MANY_THINGS, _FEWER_FOLDS = 5000, 100, 5
# All rows of all fits of one model, where every group is held out by itself.
_MOST_FITTED = 100_000


@dataclass(frozen=True, slots=True, eq=False)
class JudgedModel:
    """One model. ``parameters``, ``rank`` and ``terms`` (where chosen, the joint terms): of the fit to all rows.

    ``rms``: of every quantity at rows held out, in SI units. ``held_out``: the figure that is judged, in ``unit`` of
    the comparison; ``difference``: how much larger it is than that of the best, and the ``standard_error`` of this.
    """

    __repr__ = brief

    name: str
    model: ErrorModel
    parameters: int
    rank: int
    terms: tuple[str, ...]
    rms: Mapping[str, HeldOut]
    held_out: HeldOut
    difference: float
    standard_error: float

    @property
    def no_worse(self) -> bool:
        """Whether it is within one standard error of the best."""
        return self.difference <= max(self.standard_error, _SOLVED * self.held_out.rms)


@dataclass(frozen=True, slots=True, eq=False)
class ModelComparison:
    """Made by :func:`compare_models`. ``models``: by rank, then by number of parameters.

    ``refused``: why a model could not be identified, by name.
    ``unit``: of the judged figures, SI; "1" where there are several quantities: the root of their mean square, each in
    units of the least error that any model makes of it. ``rows`` of ``all_rows`` were looked at; ``groups`` were held
    out together, in ``folds`` folds.
    """

    __repr__ = brief

    models: tuple[JudgedModel, ...]
    best: JudgedModel
    recommended: JudgedModel
    refused: Mapping[str, str]
    unit: Literal["m", "rad", "px", "1"]
    rows: int
    all_rows: int
    groups: int
    folds: int

    def contents(self) -> dict[str, object]:
        """Return the comparison as plain data, in SI units."""
        return {
            "rows": self.rows,
            "all_rows": self.all_rows,
            "groups": self.groups,
            "folds": self.folds,
            "unit": self.unit,
            "recommended": self.recommended.name,
            "models": self.records(),
            "refused": dict(self.refused),
        }

    def records(self) -> list[dict[str, object]]:
        """Return one plain record for every model, in SI units."""
        return [
            {
                "name": m.name,
                "parameters": m.parameters,
                "rank": m.rank,
                "terms": list(m.terms),
                "rms": {name: {"rms": f.rms, "standard_error": f.standard_error} for name, f in m.rms.items()},
                "held_out": m.held_out.rms,
                "held_out_standard_error": m.held_out.standard_error,
                "difference": m.difference,
                "difference_standard_error": m.standard_error,
                "recommended": m is self.recommended,
            }
            for m in self.models
        ]


@checked
def nested_models(model: ErrorModel, measurements: Sequence[Measurements]) -> dict[str, ErrorModel]:
    """Return models of growing size for the set-up of ``model``: its base, tools, targets and priors stay.

    Base and tool alone; all offsets; all placements, or all DH parameters where ``model`` has some; these once more,
    for joint terms to be chosen; and ``model`` itself where it is none of them. Models in which nothing is unknown for
    these measurements are left out.
    """
    bare = with_terms(model, ())
    every = error_model(bare.urdf_robot, offsets="all", placements="all")
    placements = every.placements if bare.dh is None else tuple(bare.dh.directions)
    full = replace(bare, offsets=every.offsets, placements=placements)
    found = {
        FRAMES: replace(full, offsets=(), placements=()),
        OFFSETS: replace(full, placements=()),
        PLACEMENTS if bare.dh is None else DH: full,
        TERMS: full,
    }
    known = [_freed(other) for other in found.values()]
    if _freed(model) not in known:
        found[OWN] = model
    return {name: other for name, other in found.items() if initial_problem(other, measurements).parameters}


def _freed(model: ErrorModel) -> tuple[frozenset[str], frozenset[tuple[str, str]], frozenset[str]]:
    return frozenset(model.offsets), frozenset(model.placements), frozenset(model.terms)


@checked
def compare_models(
    models: Mapping[str, ErrorModel],
    measurements: Measurements | Sequence[Measurements],
    *,
    scheme: Scheme | None = None,
    choose: Collection[str] | None = None,
    model_sigmas: Sequence[float | None] | None = None,
    losses: Sequence[Loss] | None = None,
    progress: Callable[[str, int], None] = lambda _text, _left: None,
) -> ModelComparison:
    """Compare models of one robot by grouped cross-validation, all on the same folds.

    ``scheme``: the number of folds, or "leave-one-group-out"; when None 10 folds, of more than 5000 rows, or a hundred
    targets, tools and set-ups, 5. Rows of one pose, of one socket (where there are two or more, in unknown places) and
    of one word in the column ``group`` stay together; of more than 2000 rows, 2000 are used, taken at random over all
    groups, the same ones every time. ``choose``: names of the models to which joint terms are added that
    :func:`calib.judging.choose_terms` finds, in every fold anew; when None, that of :func:`nested_models` which stands
    for them. ``model_sigmas`` and ``losses`` as in :func:`calib.identify`; every held-out row counts the same.
    ``progress`` is told each fit, and how many more there are.

    A model with more unknowns than the rows determine is refused; when all are, this raises IdentificationError. Raises
    JobError when there is no model, ``choose`` names none of them, or the scheme is none, or holds out more than
    some hundred groups; MeasurementError when all
    rows are of one group or the measurements are not of this robot.
    """
    sets = as_sets(measurements)
    if not models:
        raise JobError("models: there is none to judge.")
    if choose is None:
        choose = [name for name, model in models.items() if name == TERMS and not model.terms]
    if unknown := sorted(set(choose) - set(models)):
        raise JobError(f"choose: {unknown[0]!r} is not one of the models, {', '.join(models)}.")
    group = row_groups(sets, places=True, known={name for model in models.values() for name in model.targets})
    all_rows = len(group)
    looked_at = some_rows(sets, group, _ENOUGH_ROWS)
    rows = ChosenRows(sets, model_sigmas, losses).some_of_all(looked_at)
    group = np.unique(group[looked_at], return_inverse=True)[1]
    things = {(k, name) for d in sets for k, names in enumerate((d.targets, d.tools, d.setups)) for name in names}
    many = all_rows > _VERY_MANY_ROWS or len(things) > _VERY_MANY_THINGS
    fold = _folds(group, (_FEWER_FOLDS if many else FOLDS) if scheme is None else scheme)
    fold = parts_apart(fold, group, rows.sets)
    number = int(fold.max()) + 1
    fits: dict[str, Fit] = {}
    # Joint terms are chosen about a geometry that is often a model of its own, fitted to all folds by then.
    geometries: dict[int, list[Fit]] = {id(models[name]): [] for name in choose if not models[name].terms}
    crossed: dict[str, CrossValidation] = {}
    refused: dict[str, str] = {}
    for i, (name, model) in enumerate(models.items()):
        texts = (f"{name}: all rows", *(f"{name}: fold {k + 1} of {number}" for k in range(number)))
        left = (number + 1) * (len(models) - i)
        told = iter([(text, left - k) for k, text in enumerate(texts)])
        find = _finder(model, name in choose, told, progress, geometries.get(id(model)))
        try:
            fits[name] = find(rows)
            crossed[name] = predict_held_out(find, model, rows, group, fold)
        except IdentificationError as e:
            refused[name] = str(e)
    if not crossed:
        raise IdentificationError(f"no model can be identified; {next(iter(refused))}: {next(iter(refused.values()))}")
    terms = {name: _terms(fits[name]) if name in choose else () for name in crossed}
    return replace(_compared(fits, crossed, terms, refused, group, number), all_rows=all_rows)


def _terms(fit: Fit) -> tuple[str, ...]:
    return tuple(parameter.name for parameter in fit.parameters if parameter.kind == "term")


def _folds(group: IntArray, scheme: Scheme) -> IntArray:
    if scheme == "leave-one-group-out":
        folds(group)  # refuses a single group
        if (count := int(group.max()) + 1) * len(group) > _MOST_FITTED:
            raise JobError(
                f"scheme: {len(group)} rows are of {count} groups, and every model is fitted without each of them: to "
                f"{count * len(group)} rows in all, and {_MOST_FITTED} are allowed; say a number of folds."
            )
        return group
    if type(scheme) is not int:
        raise JobError(f'scheme: {scheme!r} is neither a number of folds nor "leave-one-group-out".')
    return folds(group, scheme)


def _finder(
    model: ErrorModel,
    choosing: bool,
    told: Iterator[tuple[str, int]],
    progress: Callable[[str, int], None],
    geometries: list[Fit] | None,
) -> Callable[[ChosenRows], Fit]:
    """Return what identifies a model from some rows, joint terms chosen from these alone, and tells of every fit.

    ``geometries``: what a model leaves there that has no terms, and one that adds terms to it takes from there, in the
    same order of rows.
    """
    whole: Fit | None = None
    by_all: Choice | None = None

    def find(rows: ChosenRows) -> Fit:
        nonlocal whole, by_all
        progress(*next(told))
        if choosing:
            known, here = geometries.pop(0) if geometries else None, model.within(rows.sets)
            choice = choose_from(rows, here, geometric=known, like=by_all)
            by_all = by_all or choice
            return choice.fit
        fit = rows.fit(model, near=whole)
        if whole is None:
            whole = fit
        if geometries is not None:
            geometries.append(fit)
        return fit

    return find


def _compared(
    fits: Mapping[str, Fit],
    crossed: Mapping[str, CrossValidation],
    terms: Mapping[str, tuple[str, ...]],
    refused: Mapping[str, str],
    group: IntArray,
    number: int,
) -> ModelComparison:
    quantities = tuple(
        dict.fromkeys(q.name for one in crossed.values() for kind in one.kinds for q in QUANTITIES[kind])
    )
    rms = {name: {q: one.figure(q) for q in quantities} for name, one in crossed.items()}
    scales = {q: min(figures[q].rms for figures in rms.values()) or 1.0 for q in quantities}
    if len(quantities) == 1:
        scales = dict.fromkeys(quantities, 1.0)
    squares = {name: _squares(one, scales) for name, one in crossed.items()}
    figures = {name: held_out(found, group) for name, found in squares.items()}
    best = min(figures, key=lambda name: figures[name].rms)
    judged = []
    for name in sorted(crossed, key=lambda name: (fits[name].rank, len(fits[name].parameters))):
        difference, standard_error = paired(squares[name], squares[best], group)
        fit = fits[name]
        judged.append(
            JudgedModel(
                name,
                fit.model,
                len(fit.parameters),
                fit.rank,
                terms[name],
                rms[name],
                figures[name],
                difference,
                standard_error,
            )
        )
    return ModelComparison(
        tuple(judged),
        best=next(m for m in judged if m.name == best),
        recommended=next(m for m in judged if m.no_worse),
        refused=dict(refused),
        unit=UNIT_OF[quantities[0]] if len(quantities) == 1 else "1",
        rows=len(group),
        all_rows=len(group),
        groups=len(np.unique(group)),
        folds=number,
    )


def _squares(crossed: CrossValidation, scales: Mapping[str, float]) -> Array:
    """Return the mean over quantities of the squared errors (N,) of all rows, each in units of its scale."""
    return np.concatenate(
        [
            np.mean(
                [np.sum((r[:, columns] / scales[name]) ** 2, axis=1) for name, _, columns in QUANTITIES[kind]], axis=0
            )
            for kind, r in zip(crossed.kinds, crossed.residuals, strict=True)
        ]
    )


def paired(squares: Array, other: Array, group: IntArray) -> tuple[float, float]:
    """Return by how much the root mean square of N squared errors exceeds that of others at the same rows.

    And its standard error, where errors are random from group (N,) to group: that of the difference of two means,
    carried over to their roots.
    """
    means = float(np.mean(squares)), float(np.mean(other))
    rms = [float(np.sqrt(mean)) for mean in means]
    n = np.bincount(group)
    spread = np.zeros(len(n))
    for sign, found, mean, root in zip((0.5, -0.5), (squares, other), means, rms, strict=True):
        if root:
            spread += sign / root * (np.bincount(group, weights=found) - n * mean)
    there = len(n)
    return rms[0] - rms[1], float(np.sqrt(np.sum(spread**2) * there / max(there - 1, 1))) / len(squares)
