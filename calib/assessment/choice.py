"""Which joint terms a machine needs: forward selection, stopped by what it says of poses that it never saw.

The choice is made in the linearised system of geometry and all candidates (:mod:`calib.assessment.linearised`). Step by
step the candidate enters that lowers the sum of squares most for each of its coefficients, geometry being fitted again.
Each fold goes its own way without having seen the rows it is judged by (T. Hastie, R. Tibshirani, J. Friedman, *The
elements of statistical learning*, 2009, 7.10.2), and the one-standard-error rule says how many steps all rows then
take.

Terms must not harm, so that they are judged twice: by poses held out at random, and, as neighbours in joint space have
much the same errors, by whole neighbourhoods. No step is taken that does not hold for neighbourhoods, and none that
makes the 95 % quantile or the largest error larger. Where the fit with them does not converge, half of them are taken
back, until one does.

A parameter without a prior of its own is held by its weak one, at the geometric fit. Of very many rows the choice looks
at some, as many of every group as of the others. Fits, before and after it, take them all.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from calib.assessment.all_harmonics import AllHarmonics, Offer, better
from calib.assessment.linearised import Candidate, Errors, Judged, LinearisedSystem
from calib.assessment.validation import (
    ChosenRows,
    HeldOut,
    folds,
    held_out,
    largest_unharmed,
    neighbourhoods,
    poses_between,
    row_groups,
    smallest_unharmed,
    some_rows,
)
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array
from calib.foundations.brief import brief
from calib.foundations.choices import FOLDS
from calib.foundations.linear import one_thread
from calib.identification.error_model import ErrorModel, with_terms
from calib.identification.fit import Fit
from calib.identification.identify import identify, identify_near
from calib.identification.losses import Loss
from calib.measurement.kinds import QUANTITIES
from calib.measurement.measurements import Measurements, as_sets
from calib.measurement.poses import poses_of
from calib.robot.conditions import joined
from calib.robot.joint_terms import ordered, parts
from calib.robot.robot import Robot
from calib.robot.terms import KINDS, JointTerm, kind_of

_AS_OFFERED: Mapping[str, object] = MappingProxyType({})
# Rows that a choice looks at.
_ENOUGH_ROWS = 10_000
# So many groups of rows there must be for each coefficient.
_GROUPS_EACH = 2
# By how many times the error of geometry alone may be larger away from what was measured than at poses held out.
_FORETOLD = 2.0
# What shows where it was measured makes errors of poses held out this much smaller, ...
_SHOWS = 0.87
# ... and what does not must make predictions between places scatter this much less.
_STEADIER = 0.8
# Less noise than this, in m, rad or px, is none.
_NO_NOISE = 1e-9


@dataclass(frozen=True, slots=True)
class Step:
    """One step of the selection: the candidate that enters, and what is said of rows held out from then on.

    ``added`` is None for the first, geometry alone. ``held_out``: in standard deviations of the noise that the
    geometric fit shows, rows that lie off weighing less where a loss says so; ``rms``: of every quantity, in SI units.
    ``away``: as ``held_out``, whole neighbourhoods being held out; None of steps that poses do not allow. ``optimism``:
    of every component of the data, how many times the mean squared error of rows held out is that of rows fitted to;
    empty of steps that may not be taken.
    """

    added: Candidate | None
    held_out: HeldOut
    rms: Mapping[str, float]
    away: HeldOut | None = None
    optimism: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class Weighed:
    """Compliance by measured torques against compliance by masses: what either says of rows held out.

    In standard deviations of the noise that the geometric fit shows. ``by_torques``: whether these are taken: where
    they are better by more than a standard error. Masses need no column where the machine is used.
    """

    masses: HeldOut
    torques: HeldOut

    @property
    def by_torques(self) -> bool:
        """Whether measured torques are taken."""
        return self.torques.rms < self.masses.rms - self.masses.standard_error

    @property
    def sentence(self) -> str:
        """What was taken, and why."""
        better, worse = (self.torques, self.masses) if self.by_torques else (self.masses, self.torques)
        why = f"error of rows held out {better.rms / worse.rms:.3f} of that by"
        if self.by_torques:
            return f"compliance by measured torques: {why} masses"
        if better.rms <= worse.rms:
            return f"compliance by masses: {why} measured torques"
        return (
            f"compliance by masses: by measured torques the error of rows held out is {worse.rms / better.rms:.3f} of "
            "that, which may be chance, and their columns would be needed wherever the machine is used"
        )

    def record(self) -> dict[str, object]:
        """Return it as plain data."""
        return {
            "by_masses": self.masses.rms,
            "by_torques": self.torques.rms,
            "standard_error": self.masses.standard_error,
            "taken": "torques" if self.by_torques else "masses",
            "because": self.sentence,
        }


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """Made by :func:`choose_terms`. ``taken``: how many of the ``steps`` after the first are taken.

    ``geometric``: the fit without terms from which they start; ``fit``: with those that are taken. ``rows``: how many
    of its rows the choice looked at, and ``offered`` how many candidates. ``taken_back``: how many steps more the data
    allow, with which no fit converged. ``weighed``: how measured torques stood against masses, where rows have torques.
    """

    __repr__ = brief

    steps: tuple[Step, ...]
    taken: int
    geometric: Fit
    fit: Fit
    rows: int
    offered: int
    taken_back: int = 0
    weighed: Weighed | None = None
    all_harmonics: AllHarmonics | None = None

    @property
    def spent(self) -> tuple[float, ...]:
        """Degrees of freedom of every component of the data that the choice has spent; empty where it took none."""
        return self.fit.spent

    @property
    def model(self) -> ErrorModel:
        """The error model with the chosen terms."""
        return self.fit.model

    @property
    def terms(self) -> tuple[JointTerm, ...]:
        """The chosen terms, in the order of the robot's readings; those of links come last."""
        if self.all_harmonics is not None and self.all_harmonics.taken:
            return self.all_harmonics.terms
        return ordered(self.geometric.robot, _terms(self.steps[: self.taken + 1]))

    @property
    def steps_taken(self) -> tuple[bool, ...]:
        """Which of the steps are taken, from the first one on; all harmonics take the place of gains."""
        terms = set(self.terms)
        return tuple(k <= self.taken and terms.issuperset(_terms([step])) for k, step in enumerate(self.steps))

    def records(self) -> list[dict[str, object]]:
        """Return one plain record for every step, in SI units."""
        return [
            {
                "added": [] if step.added is None else [term.name for term in step.added.terms],
                "held_out": step.held_out.rms,
                "standard_error": step.held_out.standard_error,
                "rms": dict(step.rms),
                "away": None if step.away is None else step.away.rms,
                "taken": taken,
            }
            for step, taken in zip(self.steps, self.steps_taken, strict=True)
        ]


class _Selected(NamedTuple):
    """Steps of one selection ``among`` candidates: those that ``entered``, and what rows held out say of them."""

    among: tuple[int, ...]
    entered: tuple[int, ...]
    near: Judged


def candidates(
    robot: Robot, measurements: Sequence[Measurements] = (), options: Mapping[str, object] = _AS_OFFERED
) -> tuple[Candidate, ...]:
    """Return what may enter, reading by reading, then what is of links: all that each kind of terms offers.

    They need what rows of ``measurements`` say, or masses and all readings: a kind that these could not show is not
    offered. Masses that the URDF states in a way that cannot be used are as good as none. ``options`` as a job has
    them, such as ``harmonic_orders``.
    """
    told, of = joined([(len(data), end.conditions) for data in measurements for end in data.ends]), parts(robot)
    # Masses need all readings: what hangs on another arm pulls at the torso, too.
    kinds = [kind for kind in KINDS if kind.masses == "none" or not any(data.absent for data in measurements)]
    offered = {group[0]: group for kind in kinds for group in kind.offered(of, told, options)}
    return tuple(Candidate(offered[first]) for first in ordered(robot, offered))


@checked
def choose_terms(
    model: ErrorModel,
    measurements: Measurements | Sequence[Measurements],
    *,
    offered: Sequence[Candidate] | None = None,
    count: int = FOLDS,
    model_sigmas: Sequence[float | None] | None = None,
    losses: Sequence[Loss] | None = None,
    geometric: Fit | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Choice:
    """Choose joint terms for the geometry of ``model`` by grouped cross-validation over ``count`` folds.

    Once of poses at random, and once of neighbourhoods in joint space. Of more than 10 000 rows it looks at as many,
    the same ones every time. ``offered``: those to choose from, by default :func:`candidates` of the robot, for a DH
    table but those of links; where they are given, all harmonics at once are not offered beside. ``model_sigmas`` and
    ``losses`` as in :func:`calib.identify`, whose errors this raises, and MeasurementError when all rows are of one
    group. ``geometric``: the fit of ``model`` without terms to these measurements with these options, where it is known
    already. Where poses are in a few places with nothing between them, the widths of chosen terms are learned, unless a
    prior is stated.
    """
    sets = as_sets(measurements)
    rows = ChosenRows(sets, model_sigmas, losses)
    return choose_from(rows, model, offered=offered, count=count, geometric=geometric, progress=progress)


def choose_from(
    rows: ChosenRows,
    model: ErrorModel,
    *,
    offered: Sequence[Candidate] | None = None,
    count: int = FOLDS,
    geometric: Fit | None = None,
    like: Choice | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Choice:
    """Choose as :func:`choose_terms` does; the widths of all harmonics are sought near those of a choice by more rows.

    ``like``: that choice, for the same machine.
    """
    with one_thread():
        if geometric is None:
            progress("choosing joint terms: fitting geometry")
            plain = with_terms(model, ())
            geometric = identify(plain, rows.sets, model_sigmas=rows.model_sigmas, losses=rows.losses)
        sets = geometric.measurements
        group = row_groups(sets)
        looked_at = some_rows(sets, group, _ENOUGH_ROWS)
        near = neighbourhoods(sets, group, count, [reading.turns for reading in model.robot.readings])
        group, place = (np.unique(numbers[looked_at], return_inverse=True)[1] for numbers in (group, near.number))
        chosen_from = _offered(model, sets) if offered is None else tuple(offered)
        costs = _costs(chosen_from, apart=near.apart)
        system = LinearisedSystem(geometric, chosen_from, rows.losses, looked_at, costs, rows.model_sigmas)
        progress("choosing joint terms: linearising")
        fold, blocks = folds(group, count), folds(place, count)
        products = system.products(fold)
        largest = (int(group.max()) + 1) // _GROUPS_EACH

        def selected(among: Sequence[int]) -> _Selected:
            order = system.way(products, among, most=largest, lasting=True).order
            return _Selected(tuple(among), order, system.judged(fold, group, products, among, len(order), progress))

        ways = [selected(among) for among in _ways_to_wind_up(chosen_from)]
        weighed = None
        if len(ways) > 1:
            weighed = Weighed(*(figures[smallest_unharmed(figures)] for figures in (way.near.figures for way in ways)))
        among, entered, held = ways[-1 if weighed is not None and weighed.by_torques else 0]
        figures, rms = held.figures, held.errors.rms
        most, away = smallest_unharmed(figures), list[HeldOut]()
        elsewhere: Judged | None = None
        if most:
            progress("choosing joint terms: judging away from what was measured")
            elsewhere = system.judged(blocks, place, system.products(blocks), among, most)
            away = elsewhere.figures
            # Where rows are so few that geometry alone is foretold far worse away, that says nothing of terms.
            if away[0].rms <= _FORETOLD * figures[0].rms:
                most = largest_unharmed(away, apart=near.apart)
            if near.apart and most and figures[most].rms > _SHOWS * figures[0].rms:
                whole = system.way(products, among, steps=most).values
                scatter = system.scatter(poses_between(sets, looked_at, place), whole, elsewhere.values[:, : most + 1])
                most = most if scatter[most] < _STEADIER * scatter[0] else 0

        def far() -> Judged:
            return elsewhere or system.judged(blocks, place, system.products(blocks), among, 0)

        harmonics = None
        if offered is None and not near.apart and geometric.model.priors.harmonics in (None, "learned"):
            begin = () if like is None or like.all_harmonics is None else like.all_harmonics.widths
            harmonics = _all_harmonics(system, chosen_from, entered[:most], largest, begin, held, far, progress)
        # Where nothing is taken, nobody asks what it costs.
        optimism = list[tuple[float, ...]]()
        if most or (harmonics is not None and harmonics.taken):
            optimism = _optimism(system, held, held.errors, system.way(products, among, steps=most).values)
        steps = tuple(
            Step(
                None if k == 0 else chosen_from[entered[k - 1]],
                figure,
                {name: float(v[k]) for name, v in rms.items()},
                away[k] if k < len(away) else None,
                optimism[k] if k < len(optimism) else (),
            )
            for k, figure in enumerate(figures)
        )
        found = Choice(steps, most, geometric, geometric, len(group), len(chosen_from), 0, weighed, harmonics)
        return _fitted(found, rows, count, near.apart, progress)


def _fitted(choice: Choice, rows: ChosenRows, folds: int, apart: bool, progress: Callable[[str], None]) -> Choice:
    """Return the choice with a fit that converges: with all harmonics, where these are taken, or with fewer steps."""
    geometric, harmonics = choice.geometric, choice.all_harmonics

    again = partial(identify_near, model_sigmas=rows.model_sigmas, losses=rows.losses)

    def fitted(model: ErrorModel, choice: Choice) -> Fit:
        progress(f"choosing joint terms: fitting {len(choice.terms)} coefficients")
        chosen = with_terms(model, choice.terms)
        fit = again(geometric, chosen, rows.sets)
        spent = _spent(choice, fit, folds)
        return again(fit, chosen, rows.sets, spent=spent) if fit.converged and any(spent) else fit

    if harmonics is not None and harmonics.taken:
        learning = replace(geometric.model, priors=replace(geometric.model.priors, harmonics="learned"))
        fit = fitted(learning, choice)
        if fit.converged:
            return replace(choice, fit=fit)
        choice = replace(choice, all_harmonics=replace(harmonics, taken=False))
    begun, most = _with_learned_widths(geometric.model) if apart else geometric.model, choice.taken
    while choice.taken:
        fit = fitted(begun, choice)
        if fit.converged:
            return replace(choice, fit=fit)
        choice = replace(choice, taken=choice.taken // 2, taken_back=most - choice.taken // 2)
    return choice


def _all_harmonics(
    system: LinearisedSystem,
    offered: Sequence[Candidate],
    entered: Sequence[int],
    largest: int,
    begin: Sequence[float],
    near: Judged,
    far: Callable[[], Judged],
    progress: Callable[[str], None],
) -> AllHarmonics | None:
    """Return how all harmonics with learned widths predict beside what ``entered``; None where they are not offered.

    Judged by poses held out, ``near``, and by neighbourhoods, ``far``, if geometry alone foretells these. ``begin``:
    widths near which those are sought, as :class:`Offer` has them.
    """
    by_reading = dict[str, list[int]]()
    for k, one in enumerate(offered):
        if kind_of(one.terms[0]).key == "harmonics":
            by_reading.setdefault(one.terms[0].reading, []).append(k)
    if not by_reading:
        return None

    def kept(order: Sequence[int]) -> tuple[int, ...]:
        """Return the candidates beside all harmonics: a gain says what these say, but grows without limit."""
        first = [(k, offered[k].terms[0]) for k in order[: len(entered)]]
        return tuple(k for k, term in first if not (kind_of(term).grows and term.reading in by_reading))

    columns = np.array([[system.columns([k]) for k in own] for own in by_reading.values()], dtype=np.intp)
    offer = Offer.of(system.known, columns, near.products, system.columns(kept(entered)), largest, begin)
    if offer is None:
        return None
    progress("choosing joint terms: judging all harmonics with learned widths")

    def told(of: Judged) -> tuple[HeldOut, Errors, bool]:
        values = offer.values(of.products, [system.columns(kept(way.order)) for way in of.ways])
        errors = system.errors(of.products, of.fold, values[:, None])
        surely = better(errors.squares[0], of.errors.squares[len(entered)], of.group)
        return held_out(errors.squares[0], of.group), errors, surely

    held, errors, taken = told(near)
    away: HeldOut | None = None
    if taken:
        progress("choosing joint terms: judging them away from what was measured")
        elsewhere = far()
        away, _, taken = told(elsewhere)
        taken &= elsewhere.figures[0].rms <= _FORETOLD * near.figures[0].rms
    readings = tuple(name for k, name in enumerate(by_reading) if k in offer.kept)
    harmonics = [k for name in readings for k in by_reading[name][: offer.order]]
    every = (term for k in dict.fromkeys((*kept(entered), *harmonics)) for term in offered[k].terms)
    terms = ordered(system.robot, every)
    rms, widths = float(next(iter(errors.rms.values()))[0]), tuple(offer.start.widths.tolist())
    optimism: tuple[float, ...] = ()
    if taken:
        whole = offer.of_all(near.products, system.columns(kept(entered)))
        (optimism,) = _optimism(system, near, errors, whole[None])
    return AllHarmonics(readings, offer.order, terms, held, away, rms, taken, widths, optimism)


def _optimism(system: LinearisedSystem, near: Judged, held_out: Errors, whole: Array) -> list[tuple[float, ...]]:
    """Return, after every step and of every component, errors held out over those of what all rows find, ``whole``."""
    by_all = np.broadcast_to(whole, (len(near.products), *whole.shape))
    fitted = system.errors(near.products, near.fold, by_all).by_component
    ratios = held_out.by_component[: len(fitted)] / np.where(fitted > 0.0, fitted, np.inf)
    return [tuple(own) for own in ratios.tolist()]


def _spent(choice: Choice, fit: Fit, folds: int) -> tuple[float, ...]:
    """Return the degrees of freedom of every component that a choice has spent, beside those of a fit itself.

    A fit to n numbers with u parameters has residuals of ``s^2 (n - u) / n`` on average, and foretells what it was not
    fitted to with errors of ``s^2 n / (n - u)``. Where the model was chosen by the same rows, the former are smaller
    and the latter larger than that: as if more parameters had been fitted (J. Ye, *JASA* 93, 1998). Geometry, which
    nobody chose, says what these errors are of rows as they are here.
    """
    harmonics = choice.all_harmonics
    after = (choice.steps[choice.taken] if harmonics is None or not harmonics.taken else harmonics).optimism
    numbers = [
        r[:, q.columns].size for r, d in zip(fit.residuals, fit.measurements, strict=True) for q in QUANTITIES[d.kind]
    ]

    again = [_repeated(d) for d in fit.measurements for _ in QUANTITIES[d.kind]]

    def without_choice(n: int, freedom: float, again: float) -> float:
        # What is measured again at a pose is held out with it, and tells of the noise alone.
        held, used = (1.0 - 1.0 / folds) * n, n - freedom
        return (1.0 + used / max(held - again * used, again)) * n / max(freedom, 1.0)

    found = []
    noises = zip(numbers, fit.noise_by_rows, choice.geometric.noise_by_rows, strict=True)
    for k, (n, one, plain) in enumerate(noises):
        as_usual = [without_choice(n, noise.degrees_of_freedom, again[k]) for noise in (one, plain)]
        before = choice.steps[0].optimism[k]
        more = after[k] / before * as_usual[1] / as_usual[0] if before > 0.0 else 1.0
        left = one.total if one.model > 0.0 else np.sqrt(one.chi_square) * one.instrument
        # What the instrument's noise explains needs no other, and what is left of rows without noise is rounding.
        shows = more > 1.0 and more * left**2 > one.total**2 > _NO_NOISE**2
        # A choice fits differences between poses, and none of what is measured again at one.
        between = max(one.degrees_of_freedom - n * (1.0 - 1.0 / again[k]), 0.0)
        found.append(between * (1.0 - 1.0 / more) if shows else 0.0)
    return tuple(found)


def _repeated(data: Measurements) -> float:
    """Return how often each pose, or thing at a pose, was measured on average."""
    return len(data) / (1 + int(poses_of(data, pieces=True).max(initial=0)))


def _with_learned_widths(model: ErrorModel) -> ErrorModel:
    """Return a model whose joint terms have learned priors where none is stated.

    Poses in a few places hardly tell many terms from each other, and what they grow to there goes on beyond.
    """
    stated = model.priors
    return replace(
        model,
        priors=replace(
            stated,
            harmonics=stated.harmonics or "learned",
            elastic=stated.elastic or "learned",
            elastic_sliding=stated.elastic_sliding or "learned",
        ),
    )


def _terms(steps: Sequence[Step]) -> tuple[JointTerm, ...]:
    """Return the terms that enter by some steps."""
    return tuple(term for step in steps if step.added is not None for term in step.added.terms)


def _offered(model: ErrorModel, measurements: Sequence[Measurements]) -> tuple[Candidate, ...]:
    """Return all candidates for a model: links do not give way in frames of a DH table."""
    every = candidates(model.urdf_robot, measurements)
    return every if model.dh is None else tuple(one for one in every if not kind_of(one.terms[0]).of_link)


def _ways_to_wind_up(offered: Sequence[Candidate]) -> list[list[int]]:
    """Return the candidates to select among: all, or those without measured torques and those without masses.

    Both say what drives hold, so that one of them is taken for all.
    """
    of = [kind_of(one.terms[0]).key for one in offered]
    every = range(len(offered))
    if "torque" not in of or not {"elastic", "moments"} & set(of):
        return [list(every)]
    return [[k for k in every if of[k] != "torque"], [k for k in every if of[k] not in ("elastic", "moments")]]


def _costs(offered: Sequence[Candidate], *, apart: bool) -> Array:
    """Return how many coefficients each candidate counts as: its own.

    Of poses in places with nothing between them one more where it grows with the reading: beyond these places it grows
    on, and a wave of two coefficients that says as much there does not.
    """
    return np.array([len(one.terms) + (apart and kind_of(one.terms[0]).grows) for one in offered], dtype=np.float64)
