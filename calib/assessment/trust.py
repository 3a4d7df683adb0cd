"""May a calibration be trusted? The verdict: a list of checks, each with its number, all of which must pass.

A finding counts where it is no accident, rows that go together allowed for, and where it is large: on a sound dense
path a gear that wobbles makes accidents of nothing. Thresholds are set by sound sessions, and shown to tell bad ones in
docs/verdicts.md, which a script writes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.assessment.backward import backward
from calib.assessment.causes import LEAST_LEFT, Cause, causes
from calib.assessment.changes import apart, drifts, elsewhere, steps
from calib.assessment.checks import of_arm, of_errors, of_fit, of_rows
from calib.assessment.checks.shown_range import shown_range
from calib.assessment.control import doubt, names_of_mirrored, placed_elsewhere, unchecked
from calib.assessment.effects import gains, ratios
from calib.assessment.in_time import delay, timing, unsettled
from calib.assessment.influence import Residue
from calib.assessment.instrument_errors import rounding, strains
from calib.assessment.judged import Check, JudgedSet
from calib.assessment.mixed_machines import mixed_machines
from calib.assessment.outliers import Outliers, outliers
from calib.assessment.own_base import OwnBase, tables_with_own_base
from calib.assessment.places import unshown
from calib.assessment.priors import HARMLESS, contradicted
from calib.assessment.stamps import stamps
from calib.assessment.stated_lengths import StatedNumbers
from calib.assessment.stretches import by_photograph, pose_by_pose, stretches
from calib.foundations.chance import exceeded
from calib.foundations.linear import one_thread
from calib.foundations.words import listed, noun
from calib.identification.fit import Fit
from calib.machine.calibrated import CalibratedMachine
from calib.machine.of_fit import machine_of
from calib.measurement.checks import Finding

_COMPLIANCE, _BY_TORQUES, _BACKLASH = ".elastic", ".torque", ".backlash"
# The model's part of a table's noise, over all noise of the others and over what its own instrument has.
_UNLIKE = 3.0
# Checks that say what is wrong, and those that say that something is.
_OF_CAUSES = frozenset(
    {
        *("explained", "stated sigma", "jump", "drift", "delay", "timing", "at rest", "gear", "axes", "groups"),
        *("set-ups", "one machine", "outliers", "lengths"),
    }
)
_OF_WHAT_IS_LEFT = _OF_CAUSES | {"improvement", "prediction", "regions"}
_NO_DOUBT = "No check asks for a cause."
_NO_CAUSE = "No few rows, no other names, no stated length and no stated prior explain what a check found."


@dataclass(frozen=True, slots=True)
class Verdict:
    """All checks, and what a reader takes home: ``shown``, for which range, and what would make it more certain."""

    checks: tuple[Check, ...]
    shown: tuple[str, ...]

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why it should not be used: sentences of the checks that have not passed."""
        return tuple(check.sentence for check in self.checks if not check.passed)


def verdict(
    fit: Fit,
    machine: CalibratedMachine,
    sets: Sequence[JudgedSet],
    found: Outliers,
    findings: Sequence[Finding] = (),
    moved: Sequence[OwnBase] = (),
) -> Verdict:
    """Judge a fit by its own tables and by those held out; ``found``: of its own rows; ``moved``: of all tables."""
    own = [judged for judged in sets if judged.use == "identification"]
    held_out = [judged for judged in sets if judged.use == "validation"]
    decisive = held_out or own
    with one_thread():
        residue = Residue.of(fit, {})
        parts = stretches(residue)
        C = residue.C
        poses = tuple(pose_by_pose(part, C) for part in parts)
        moved_more = gains(poses, C)
        by_row = (
            # Of photographs that err together a change is a part of how they do, and hardly shows mark by mark.
            of_rows.jump(steps([by_photograph(part) for part in poses], C), found),
            of_rows.drift(drifts(poses, C), fit),
            of_rows.late(*delay(poses, C)),
            of_rows.timing(timing(poses, C, fit.machine.frames.scalars), fit.model.robot),
            of_rows.at_rest(unsettled(parts, C)),
            of_rows.gear(moved_more, ratios(poses, C), fit, backward(moved_more, fit)),
            of_rows.axes(strains(poses, C), moved_more),
            of_rows.resolution(rounding(parts, fit.model.robot), fit),
        )
        priors, scale = contradicted(fit, parts), of_arm.common_scale(fit, parts)
        explained, lengths = of_errors.explained(fit, decisive), of_arm.lengths(fit, scale)
        told = (
            of_fit.convergence(fit),
            explained,
            of_errors.improvement(fit, decisive),
            of_errors.prediction(fit, machine, held_out),
            of_errors.regions(machine, held_out),
            of_fit.stated_sigma(fit),
            of_errors.independent_rows(own, held_out),
            of_errors.copies(own, held_out),
            of_fit.redundancy(fit, doubt(residue) or placed_elsewhere(fit, machine)),
            *by_row,
            of_rows.groups(found, apart(poses, C), elsewhere(poses, C), fit),
            of_rows.set_ups(moved),
            of_rows.one_machine(mixed_machines(parts), fit),
            of_rows.outliers(fit, own),
            of_rows.frozen(own),
            of_rows.in_line(fit, own),
            of_arm.joints(fit, own),
            lengths,
            of_arm.tool_and_base(fit),
            of_arm.lens(fit),
        )
        stated = StatedNumbers(residue, parts, machine)
        wrong = any(check.name in _OF_CAUSES for check in told if not check.passed)
        # Of another robot's data a fit finds large offsets too, beside other lengths.
        named = of_arm.naming_zeros(fit, findings, explained.statistic) if lengths.passed else findings
        every = (*told, of_arm.warnings((*named, *priors, *stated.contradicted(wrong=wrong))))
        inexact = stamps(parts, fit.machine.frames.scalars)
        alone = unchecked(residue, "tool")
        resting = stated.unchecked()
        if lengths.passed:
            resting = (*resting, *of_arm.as_by_scale(fit, scale))
    harmless = (one.sentence for one in priors if one.code == HARMLESS)
    shown = (*shown_range(fit, own, held_out), *unshown(fit), *harmless, *resting, *(one.sentence for one in inexact))
    if alone:
        which = f"the {noun(len(alone), 'tool')} {listed(alone)}"
        shown = (
            *shown,
            f"As many numbers were measured with {which} as it has unknowns, so nothing checks them: a mistake in "
            "one of them is in the tool. Measure one more pose with it.",
        )
    checks = tuple(inexact[0].named_in(check) for check in every) if inexact else every
    return Verdict(checks, shown)


def with_cause(found: Verdict, fit: Fit, sets: Sequence[JudgedSet]) -> Verdict:
    """Return the verdict of a fit with a check for what explains what is left, where it is doubted.

    It comes first. What other checks said to be wrong, and do not find then, is no more said.
    """
    cause = next(filter(None, (_found_with(one) for one in _causes(found, fit, sets))), None)
    if cause is None:
        said = _NO_CAUSE if found.doubts else _NO_DOUBT
        return replace(found, checks=(*found.checks, Check.idle("cause", LEAST_LEFT, said)))
    one, again = cause
    passed = {check.name for check in again.checks if check.passed}
    first = Check.of("cause", np.sqrt(one.left), LEAST_LEFT, False, one.sentence)
    checks = (
        replace(check, sentence=_instead(check)) if check.name in passed and not check.passed else check
        for check in found.checks
    )
    return replace(found, checks=(first, *checks))


def _instead(check: Check) -> str:
    return f"The check {check.name!r} does not pass, but would without that."


def _causes(found: Verdict, fit: Fit, sets: Sequence[JudgedSet]) -> tuple[Cause, ...]:
    failed = {check.name for check in found.checks if not check.passed}
    doubted = bool(failed & _OF_WHAT_IS_LEFT)
    return () if failed and not doubted else causes(fit, sets, doubted=doubted)


def _found_with(cause: Cause) -> tuple[Cause, Verdict] | None:
    """Return a cause and the verdict with it, None where something else seems wrong then too."""
    machine = machine_of(cause.fit)
    moved = tables_with_own_base(cause.fit.model, machine, cause.sets)
    again = verdict(cause.fit, machine, cause.sets, outliers(cause.fit), (), moved)
    failed = {check.name for check in again.checks if not check.passed}
    return None if failed & _OF_CAUSES else (cause, again)


def remarks(fit: Fit) -> tuple[Finding, ...]:
    """Return what a user should know of the search for a solution that may be trusted, and of the noise."""
    found = []
    for noise in fit.noise:
        share = float(np.sqrt(noise.chi_square))
        told = noise.degrees_of_freedom >= of_fit.ENOUGH and share * noise.instrument > of_fit.ROUNDING
        if told and share < 1.0 / of_fit.TOO_LARGE:
            times = 1.0 / share
            found.append(
                Finding.warning(
                    "sigma-too-large",
                    f"{fit.measurements[noise.measurements].where}: sigma seems {times:.0f} times too large: "
                    f"the {noise.quantity} residuals scatter by so much less.",
                )
            )
    found += _unlike(fit)
    found += _mirrored(fit)
    if rising := _surely(fit, _COMPLIANCE, -1.0):
        found.append(
            Finding.warning(
                "compliance-below-zero",
                f"Compliances are below zero by more than {of_rows.SURE:g} standard deviations, of "
                f"{listed(rising)}: no drive rises under weight. Check the direction of gravity, the "
                "payload and the masses of the URDF; other payloads and set-ups are not to be predicted with them.",
            )
        )
    if yielding := _surely(fit, _BY_TORQUES, -1.0):
        found.append(
            Finding.warning(
                "compliance-below-zero",
                f"Compliances by measured torques are below zero by more than {of_rows.SURE:g} standard deviations, of "
                f"{listed(yielding)}: no joint moves against what pulls at it. Check the sign of the torques: they are "
                "what a drive holds the arm with, positive where it pushes its reading up.",
            )
        )
    if (ahead := _surely(fit, _BACKLASH, 1.0)) and not _surely(fit, _BACKLASH, -1.0):
        found.append(
            Finding.warning(
                "backlash-above-zero",
                f"Backlash is above zero by more than {of_rows.SURE:g} standard deviations, of {listed(ahead)}: joints "
                "with a gap stay behind their readings. Check that the side of approach is + where a reading grew.",
            )
        )
    if not fit.converged or fit.narrowed == 1.0:
        return tuple(found)
    return (
        *found,
        Finding.warning(
            "priors-narrowed",
            f"The solver did not converge with the usual weak priors, so they were made {fit.narrowed:g} times "
            "narrower. Parameters that the data hardly determine stay that much nearer to the nominal robot, and base "
            "and tool to their start values. Predictions near the measured poses hardly change. More poses, other "
            "orientations of the tool, or priors for known values make this unnecessary.",
        ),
    )


def _surely(fit: Fit, kind: str, sign: float) -> list[str]:
    """Return the readings of which a term of this kind is surely below zero, or above."""
    return [
        parameter.name.removesuffix(kind)
        for parameter, value, sigma in zip(fit.parameters, fit.values, fit.sigmas, strict=True)
        if parameter.name.endswith(kind) and sign * value > of_rows.SURE * sigma
    ]


def _mirrored(fit: Fit) -> list[Finding]:
    """Return which targets, and tilts of an arm that moves in a plane, two places explain alike."""
    found = []
    tilts = [p.name for p, twice in zip(fit.parameters, fit.mirrored, strict=True) if twice and p.of_robot]
    if twice := names_of_mirrored(fit, "point"):
        arm = (
            ""
            if tilts
            else " The arm does not depend on them. One more length from well outside that plane tells which it is."
        )
        found.append(
            f"Lengths put the {noun(len(twice), 'target')} {listed(twice)} at two places alike, one on either side of "
            f"the plane that the tool was in: no coordinates are told.{arm}"
        )
    if tilts:
        found.append(
            f"Lengths are the same on both sides of the plane that the tool was in, with other signs of "
            f"{listed(tilts)}: these are not told. Lengths from well outside that plane tell which they are."
        )
    if turned := names_of_mirrored(fit, "frame"):
        found.append(
            f"Photographs show the {noun(len(turned), 'target')} {listed(turned)} alike if tilted to the other side, "
            "as perspective is too small to tell: no coordinates are told. The arm does not depend on them. One more "
            "photograph, from nearer or from another side, tells which it is."
        )
    return [Finding.warning("mirrored", sentence) for sentence in found]


def _unlike(fit: Fit) -> list[Finding]:
    """Return which tables the machine explains far worse than the others, as of a set-up whose load nobody told.

    A table whose sigma is not stated is left out. It is no doubt: rows of a narrow volume are explained better than
    those of a wide one, too, and regions in a set-up or with a tool of its own count it.
    """
    found = []
    stated = [noise for noise in fit.noise if noise.degrees_of_freedom >= of_fit.ENOUGH and noise.chi_square >= 0.0]
    for noise in stated:
        others = [other for other in stated if other.quantity == noise.quantity and other is not noise]
        if not others:
            continue
        freedom = sum(other.degrees_of_freedom for other in others)
        rest = sum(other.degrees_of_freedom * other.total**2 for other in others) / freedom
        square = noise.model**2 / max(rest, noise.instrument**2)
        chance = exceeded(square * noise.degrees_of_freedom, round(noise.degrees_of_freedom), freedom)
        if square > _UNLIKE**2 and chance < of_rows.RARELY:
            said = (
                f"{fit.measurements[noise.measurements].where}: the {noise.quantity} residuals scatter "
                f"{np.sqrt(square):.2g} times as much as those of the other tables, and its sigma does not say why. "
                "Check the table's tool, sigma, payload and direction of gravity. Regions count it in a set-up or "
                "with a tool of its own; in others they may be too small for rows like these."
            )
            found.append(Finding.warning("unlike-tables", said))
    return found
