"""A fit and its figures as tables and sentences for people: millimetres and degrees, each number rounded once."""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calib.assessment.metrics import Metrics
from calib.foundations.arrays import Array, IntArray
from calib.foundations.units import DISPLAY, MICRO, MM, MRAD, Display
from calib.foundations.words import counted
from calib.measurement.kinds import TOUCHES, UNIT_OF, size
from calib.presentation.report.document import Row, Sheet
from calib.robot.terms import KINDS

if TYPE_CHECKING:
    from calib.assessment.choice import Choice
    from calib.identification.fit import Fit

# What is shown of a length in m, an angle in rad, a place in a picture, and coefficients of joint terms.
SHOWN = {
    **DISPLAY,
    **{unit: Display(1.0 / MICRO, shown) for kind in KINDS for unit, shown in kind.shown.items()},
}
# What the words of tables mean that have the errors of both robots.
BEFORE = "before: nominal robot, base and tool fitted"
# A level as a table shows it: name, number of free parameters, rank, and metrics by quantity.
Level = tuple[str, int, int, Mapping[str, Metrics]]


def figure(value: float, unit: str) -> str:
    """Return a length in m or an angle in rad as text with its unit: ``0.0371 mm``."""
    factor, name = SHOWN[unit]
    return f"{value * factor:.4f} {name}"


def figures_in(unit: str, *values: float) -> tuple[str, ...]:
    """Return values in m, rad, px or units of joint terms as texts, and behind them the unit in which they are."""
    factor, name = SHOWN[unit]
    return (*(f"{value * factor:.4f}" for value in values), name)


def signed(value: float, digits: int) -> str:
    """Return a number with its sign; what is rounded to nothing has none."""
    text = f"{value:+.{digits}f}"
    return text if text.strip("+-0.") else text[1:]


def error_sheet(figures: Mapping[str, Mapping[str, Mapping[str, Metrics]]]) -> Sheet:
    """Return the before/after table of ``figures[use][when][quantity]``."""
    rows = []
    for use, whens in figures.items():
        for quantity in next(iter(whens.values())):
            for when, found in whens.items():
                m = found[quantity]
                after = when == "after"
                # What is not the tip's is named: the distance from a socket is no tip error.
                named = after and quantity not in ("position", "orientation")
                of = quantity.replace("_", " ") if named else use
                values = figures_in(m.unit, m.mean, m.rms, m.p95, m.max)
                rows.append(Row((of, when, str(m.n), *values), strong=after, ends_group=after))
    return Sheet.of(
        "Tip errors, measured minus predicted",
        ("data", "robot", ">n", ">mean", ">rms", ">p95", ">max", "unit"),
        rows,
        BEFORE,
        brief=True,
    )


def level_sheet(levels: Sequence[Level]) -> Sheet:
    """Return what every level brought."""
    rows = [
        (name, str(free), str(rank), *figures_in(m.unit, m.mean, m.rms, m.max))
        for name, free, rank, figures in levels
        for m in figures.values()
    ]
    return Sheet.of(
        "Levels",
        ("level", ">free", ">rank", ">mean", ">rms", ">max", "unit"),
        rows,
        "tip errors of the data held out, base and tool fitted anew after each level",
        brief=True,
    )


def choice_sheet(choice: "Choice") -> Sheet:
    """Return the joint terms that were chosen, in the order in which they entered, and the least held-out error."""
    start, steps = choice.steps[0].held_out.rms, choice.steps
    every = sum(map(len, choice.geometric.measurements))
    some = f"; by {choice.rows} of {every} rows, taken at random" if choice.rows < every else ""
    if choice.taken_back:
        some += f"; {choice.taken_back} more are taken back, as no fit with them converges"
    if choice.weighed is not None:
        some += f"; {choice.weighed.sentence}"
    if any(choice.spent):
        some += f"; the choice costs {sum(choice.spent):.0f} degrees of freedom beside those of its coefficients"
    quantity = next(iter(steps[0].rms))
    factor, unit = SHOWN[UNIT_OF[quantity]]
    least = min(range(len(steps)), key=lambda k: steps[k].held_out.rms)
    rows = []
    for k in dict.fromkeys((*range(choice.taken + 1), least)):
        step = steps[k]
        name = "geometry alone" if step.added is None else step.added.name
        figures = f"{step.held_out.rms / start:.4f}", f"{step.held_out.standard_error / start:.4f}"
        said = "yes" if choice.steps_taken[k] else "no: all harmonics" if k <= choice.taken else "no: the least"
        rows.append((str(k), name, *figures, f"{step.rms[quantity] * factor:.4f}", said))
    if choice.all_harmonics is not None:
        harmonics = choice.all_harmonics
        figures = f"{harmonics.held_out.rms / start:.4f}", f"{harmonics.held_out.standard_error / start:.4f}"
        said = "yes" if harmonics.taken else "no"
        name = f"all harmonics up to {harmonics.order}"
        some += f"; all harmonics: of {', '.join(harmonics.readings)}, with learned widths"
        rows.append(("or", name, *figures, f"{harmonics.rms * factor:.4f}", said))
    return Sheet.of(
        "Joint terms by what held-out data say",
        (">step", "enters", ">held out", ">std. error", f">rms [{unit}]", "taken"),
        rows,
        f"one-standard-error rule: {choice.taken} of {choice.offered} candidates; relative to geometry alone{some}",
        brief=True,
    )


def parameter_sheet(fit: "Fit") -> Sheet:
    """Return all parameters with values, sigmas and flags."""
    rows = []
    flags = fit.unidentifiable, fit.mirrored, fit.weakly_determined
    for parameter, value, sigma, unidentifiable, mirrored, weak in zip(
        fit.parameters, fit.values, fit.sigmas, *flags, strict=True
    ):
        factor, unit = SHOWN[parameter.unit]
        of_none = "at either of two places" if mirrored else "only in combination"
        known = of_none if unidentifiable else "weakly" if weak else "yes"
        sure = "-" if unidentifiable else f"{sigma * factor:.4f}"
        rows.append((parameter.name, signed(value * factor, 4), sure, unit, known))
    return Sheet.of(
        "Parameters",
        ("parameter", ">value", ">sigma", "unit", "identifiable"),
        rows,
        "sigmas are conditional on the model: they assume that it leaves out nothing but noise",
    )


_CAUSES = {
    "instrument": "instrument: noise and drift",
    "parameters": "parameters that are not determined",
    "model": "what the model leaves out",
    "residual_model": "residual model",
}


def budget_sheet(budget: Mapping[str, Sequence[float]], poses: int) -> Sheet:
    """Return what every cause adds to the tool's standard deviations, rms in m and rad over so many ``poses``."""
    (length, mm), (turn, degrees) = SHOWN["m"], SHOWN["rad"]
    total = [math.hypot(*(float(rms[k]) for rms in budget.values())) for k in range(2)]
    return Sheet.of(
        "Budget of the tool, in the instrument's frame",
        ("cause", f">position [{mm}]", f">orientation [{degrees}]"),
        [
            Row((name, f"{rms[0] * length:.4f}", f"{rms[1] * turn:.4f}"), strong=name == "all")
            for name, rms in (*((_CAUSES[cause], rms) for cause, rms in budget.items()), ("all", total))
        ],
        f"one standard deviation, all coordinates together, rms over {poses} poses; squares add up",
    )


def noise_sentences(fit: "Fit") -> tuple[str, ...]:
    """Return the noise of every set of measurements and quantity."""
    said = []
    for noise in fit.noise:
        kind = fit.measurements[noise.measurements].kind
        unit = UNIT_OF[noise.quantity]
        instrument = f"{figure(noise.instrument, unit)} instrument" if noise.instrument else "instrument not stated"
        chi = "" if np.isnan(noise.chi_square) else f", chi-square per degree of freedom {noise.chi_square:.3g}"
        of = f" of {Path(fit.measurements[noise.measurements].where).name}" if len(fit.measurements) > 1 else ""
        model = figure(noise.model, unit)
        what = noise.quantity.replace("_", " ")
        said.append(
            f"Noise of one {what} {'coordinate' if size(kind) > 1 else 'value'}{of}: {instrument}, {model} model{chi}."
        )
    return (*said, *_together(fit), *_repeats(fit))


def _repeats(fit: "Fit") -> Iterator[str]:
    """Yield how rows that repeat a pose err together, of every quantity where they do."""
    for own in fit.repeats:
        of = f" of {Path(fit.measurements[own.measurements].where).name}" if len(fit.measurements) > 1 else ""
        alone, common = (figure(size, UNIT_OF[own.quantity]) for size in (own.alone, own.common))
        what = own.quantity.replace("_", " ")
        yield (
            f"Rows{of} that repeat a pose err together: {what} errors are {alone} in each row by itself, and {common} "
            f"in all rows of a pose alike. So sigmas and regions rest on {own.poses} poses, not on {own.rows} rows."
        )


def _together(fit: "Fit") -> Iterator[str]:
    """Yield how photographs err together, of every set where they do."""
    for data, own in zip(fit.measurements, fit.together, strict=False):
        if own is not None:
            of = f" of {Path(data.where).name}" if len(fit.measurements) > 1 else ""
            yield (
                f"Marks of one photograph{of} err together, as if the arm came back to {own.length / MM:.2g} mm along "
                f"and {own.angle / MRAD:.2g} mrad about each axis; the model's part has this in it."
            )


def prior_sentences(fit: "Fit") -> tuple[str, ...]:
    """Return the standard deviations of learned priors, and how many parameters each was learned from."""
    said = []
    for prior in fit.learned:
        factor, unit = SHOWN[prior.unit]
        sigma = f"{prior.width * factor:.3g} {unit}"
        of = f"{prior.taught:.1f} of {prior.parameters}"
        what = {
            "learned": f"{sigma}, learned; the data determine {of} parameters",
            "too few": f"{sigma}, hardly learned; the data determine only {of} parameters",
            "nothing shows": f"{sigma}, too small for the data to show any of its {prior.parameters} parameters",
            "widest": f"{sigma}, the largest that is allowed, which is as good as no prior",
        }[prior.outcome]
        said.append(f"Prior of {prior.group}: {what}.")
    return tuple(said)


def rank_sentences(fit: "Fit") -> tuple[str, ...]:
    """Return what the data determine, and what was done about the rest."""
    size, held = len(fit.null_space), len(fit.held)
    weak = [p.name for p, w in zip(fit.parameters, fit.weakly_determined, strict=True) if w]
    named = (f"Weakly determined: {', '.join(weak[:6])}{' and more' if len(weak) > 6 else ''}.",) if weak else ()
    if not size:
        return (f"The data determine all {fit.rank} parameters.", *named)
    done = {
        "nearest": "among all equal fits, the machine nearest to the nominal one was taken",
        "minimal": f"{counted(held, 'parameter was', 'parameters were')} held at the nominal value, which "
        "the sigmas of all others take for exact",
    }[fit.policy]
    if any(parameter.prior is not None for parameter in fit.parameters):
        done = f"where priors do not decide, {done}"
    alike = "No prediction at poses like these depends on it."
    touched = {name for data in fit.measurements for name in data.seen_targets if data.kind in TOUCHES}
    if all(data.kind in TOUCHES for data in fit.measurements) and touched.isdisjoint(fit.model.targets):
        alike = "All equal fits predict alike what was touched, but not where the tool is."
    weak_rank = fit.rank - fit.numerical_rank
    too_weak = f", {weak_rank} of them too weakly to use" if weak_rank > 0 else ""
    return (
        f"The data determine {counted(fit.rank, 'combination')} of {counted(len(fit.parameters) + held, 'parameter')}"
        f"{too_weak}. "
        f"The null space has {counted(size, 'direction')}: {done}. {alike}",
        *named,
    )


def in_urdf_sentences(
    figures: Mapping[str, Mapping[str, Mapping[str, Metrics]]],
    alone: Mapping[str, Mapping[str, Metrics]],
    converged: bool,
) -> tuple[str, ...]:
    """Return what a person must know who takes the calibrated URDF alone, where it cannot hold the machine.

    ``figures``: metrics of the machine by use, when and quantity; ``alone``: of its URDF, by use and quantity.
    """
    lacks = "A URDF holds no closed loops, no couplings of a job and no joint terms"
    if not alone:
        return (f"{lacks}: calibrated.urdf alone needs other joint readings. model.json holds the whole machine.",)
    use = "validation" if "validation" in figures else "identification"
    rows = "held-out rows" if use == "validation" else "the fitted rows"
    said = "; ".join(
        f"its {quantity} error is {figure(found.rms, found.unit)} rms, that of the nominal robot "
        f"{figure(figures[use]['before'][quantity].rms, found.unit)}, that of model.json "
        f"{figure(figures[use]['after'][quantity].rms, found.unit)}"
        for quantity, found in alone[use].items()
    )
    doubt = () if converged else ("The fit of calibrated.urdf did not converge.",)
    best = f"{lacks}: calibrated.urdf is the best geometry without them."
    return (f"{best} On {rows}, base and tool fitted anew, {said}.", *doubt)


def correlation(fit: "Fit") -> tuple[IntArray, Array]:
    """Return which parameters (k,) are identifiable, by index, and the correlations (k, k) of their uncertainties.

    Without targets, where there are very many of them.
    """
    seen = fit.correlated
    C = fit.told_covariance(seen)
    sigma = np.sqrt(np.diag(C))
    return seen, np.asarray(C / np.outer(sigma, sigma))
