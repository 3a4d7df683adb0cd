"""Every registered kind of joint terms: what jobs, files, parameters and reports ask of it, and its derivatives."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.assessment.choice import candidates
from calib.assessment.linearised import Candidate
from calib.foundations.errors import JobError, RobotError
from calib.identification.parameters import TERM_WIDTH
from calib.job.schema import ErrorModelSection
from calib.presentation.sheets import SHOWN
from calib.robot import transmission
from calib.robot.conditions import NO_CONDITIONS, Conditions
from calib.robot.joint_terms import foreign, ordered, parts
from calib.robot.robot import Deviations, Robot, TipModel
from calib.robot.terms import KINDS, NAMED, JointTerm, Kind, kind_of
from tests.robot.test_transmission import twist
from tests.support import machines

Array = np.ndarray
DOCS = Path(__file__).resolve().parents[2] / "docs"
UR10 = machines.load("example:ur_description/urdf/ur10_robot.urdf", "tool0")
GANTRY = machines.load(machines.INLINE["gantry"], "tip")
ALL = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.key)
ROWS = 5
# Who frees these knows that they are soft; the choice leaves them out.
NEVER_OFFERED = ("torsion", "lateral", "lateral_moments")


def chosen(kind: Kind, robot: Robot = UR10, selection: object = "all") -> tuple[JointTerm, ...]:
    return kind.chosen(selection, parts(robot), {"harmonic_orders": (1, 3)})


def every_term(kind: Kind) -> tuple[JointTerm, ...]:
    return (*chosen(kind), *(term for word in kind.words for term in chosen(kind, selection=word)))


def drawn(kind: Kind) -> tuple[Robot, Deviations, Array, Conditions]:
    """A badly made robot with all terms of a kind, ten times as large as ordinary ones, and rows."""
    rng = np.random.default_rng(KINDS.index(kind))
    robot = calib.error_model(UR10, terms=every_term(kind)).robot
    sizes = np.array([kind.coefficient(term, "angle").typical_size for term in robot.terms])
    placements = rng.normal(scale=1e-3, size=(len(robot.chain), 6))
    d = Deviations(placements, np.zeros(len(robot.moving)), 10.0 * sizes * rng.uniform(-1, 1, len(sizes)))
    told = Conditions(rng.choice([-1.0, 1.0], (ROWS, 6)), rng.uniform(10, 30, ROWS), rng.uniform(-50, 50, (ROWS, 6)))
    return robot, d, rng.uniform(-2.0, 2.0, (ROWS, 6)), told.in_time(rng.uniform(0.0, 7200.0, ROWS))


@ALL
def test_many_rows_are_moved_a_part_at_a_time(kind: Kind, monkeypatch: pytest.MonkeyPatch) -> None:
    """Else bases of 8000 terms at 20 000 rows are a gigabyte, and another where they are made."""
    robot, d, readings, conditions = drawn(kind)
    whole = robot.tips(readings, d, conditions)
    made: list[int] = []
    bases = transmission.Transmission.bases

    def seen(own: transmission.Transmission, readings: Array, conditions: Conditions) -> transmission.Bases:
        made.append(len(readings))
        return bases(own, readings, conditions)

    monkeypatch.setattr(transmission.Transmission, "bases", seen)
    monkeypatch.setattr(transmission, "_AT_ONCE", 1)
    assert np.abs(robot.tips(readings, d, conditions) - whole).max() < 1e-12
    assert made == [1] * ROWS


def test_names_and_keys_are_of_one_kind() -> None:
    names = [name for kind in KINDS for name in kind.names]
    keys = [key for kind in KINDS for key in (kind.key, *kind.options)]
    assert len(set(names)) == len(names) == len(NAMED)
    assert len(set(keys)) == len(keys)
    assert all(NAMED[name] is kind for kind in KINDS for name in kind.names)


@ALL
def test_of_no_rows_there_are_no_poses(kind: Kind) -> None:
    """A set-up or a tool that has none was asked for its poses, and bending told no number from no rows."""
    robot, d, q, told = drawn(kind)
    none = np.zeros(0, dtype=np.intp)
    assert robot.tips(q[none], d, told.subset(none)).shape == (0, 4, 4)
    tips, by_reading = TipModel(robot, d).driven(q[none], told.subset(none))
    assert (tips.shape, by_reading.shape) == ((0, 4, 4), (0, 6, 6))


@ALL
def test_a_jobs_key_chooses_it(kind: Kind) -> None:
    assert set(ErrorModelSection.model_fields) >= {kind.key, *kind.options}
    for word in (*kind.words, "all"):
        section = ErrorModelSection.model_validate({kind.key: word})
        model = calib.error_model(UR10, terms=section.chosen_terms)
        assert {kind_of(term) for term in model.robot.terms} == {kind}
        assert model.robot.terms == ordered(UR10, kind.chosen(word, parts(UR10), section.chosen_terms))
    assert calib.error_model(UR10, terms=ErrorModelSection().chosen_terms).terms == ()
    first = chosen(kind)[0]
    some = calib.error_model(UR10, terms={kind.key: [first.reading]}).robot.terms
    assert {(kind_of(term), term.reading) for term in some} == {(kind, first.reading)}


@ALL
def test_a_parameter_has_its_name_unit_and_size(kind: Kind) -> None:
    terms = every_term(kind)
    model = calib.error_model(UR10, terms=terms)
    found = [parameter for parameter in model.parameters() if parameter.kind == "term"]
    assert [parameter.name for parameter in found] == [term.name for term in terms]
    for parameter, term in zip(found, terms, strict=True):
        assert term.name.startswith(f"{term.reading or 'arm'}.{term.kind}")
        assert (parameter.unit, parameter.scale) == kind.coefficient(term, "angle")
        assert parameter.unit in SHOWN
        assert parameter.weak_prior == TERM_WIDTH * parameter.scale
    for dimension, name in kind.priors.items():
        if dimension == "angle":
            held = calib.error_model(UR10, terms=terms, priors=calib.Priors(**{name: 2e-5}))
            assert {p.prior for p in held.parameters() if p.kind == "term"} == {2e-5}
            learning = replace(held, priors=calib.Priors(**{name: "learned"}))
            assert None not in {p.group for p in learning.parameters() if p.kind == "term"}


@ALL
def test_what_it_may_not_be_of_is_refused_in_a_sentence(kind: Kind) -> None:
    with pytest.raises(JobError, match=f"^{kind.key}: 'nowhere' matches no joint of the arm; "):
        calib.error_model(UR10, terms={kind.key: ["nowhere"]})
    with pytest.raises(JobError, match=rf"^{kind.key}: 5 is not .*\"none\" or a list of names\.$"):
        calib.error_model(UR10, terms={kind.key: 5})
    assert foreign(UR10, [JointTerm("nowhere", kind.names[0])])
    assert foreign(UR10, [replace(term, order=1 - min(term.order, 1)) for term in chosen(kind)])
    assert not foreign(UR10, every_term(kind))
    if not kind.of_link and "length" not in kind.coefficients:
        with pytest.raises(JobError, match=f"^{kind.key}: 'bridge' slides, and {kind.only}"):
            calib.error_model(GANTRY, terms={kind.key: ["bridge"]})
        assert foreign(GANTRY, [replace(chosen(kind)[0], reading="bridge")])
    if kind.of_link:
        with pytest.raises(JobError, match=f"^{kind.key}: links bend and expand between joints of the URDF"):
            calib.error_model(UR10, placements=calib.dh.Free(), terms={kind.key: "all"})


@ALL
def test_it_is_offered_where_rows_show_it(kind: Kind) -> None:
    _, _, _, told = drawn(kind)
    offered = kind.offered(parts(UR10), told, {"harmonic_orders": (1, 3)})
    unknown = kind.masses == "unknown" or kind.key in NEVER_OFFERED
    assert bool(offered) == (not unknown)
    assert not foreign(UR10, [term for group in offered for term in group])
    for group in offered:
        assert Candidate(group).name == f"{group[0].owner}: {kind.said(group[0])}"
    needed = any(kind.lacking(term, 0, NO_CONDITIONS) for term in chosen(kind))
    assert bool(kind.offered(parts(UR10), NO_CONDITIONS, {})) == (not needed and not unknown)
    weightless = kind.offered(parts(machines.load(machines.INLINE["skew"], "tip")), NO_CONDITIONS, {})
    assert bool(weightless) == (not needed and kind.masses != "stated" and kind.key not in NEVER_OFFERED)
    named = {kind_of(term) for one in candidates(UR10) for term in one.terms}
    assert (kind in named) == (not needed and not unknown)


@ALL
def test_it_asks_for_the_conditions_that_it_needs(kind: Kind) -> None:
    robot, d, u, told = drawn(kind)
    robot.tips(u, d, told)
    if column := kind.lacking(robot.terms[0], 0, NO_CONDITIONS):
        with pytest.raises(RobotError, match=f"needs '{column}' for every row"):
            robot.tips(u, d)
    else:
        robot.tips(u, d)


@ALL
def test_derivatives_by_amounts_match_central_differences(kind: Kind) -> None:
    robot, d, u, told = drawn(kind)
    motion = robot.motion(u, d, told)
    assert np.abs(motion.by_terms).max() > 0.0
    for t, term in enumerate(robot.terms):
        # As large a step as moves the tip by some 1e-5.
        h = 1e-5 / max(float(np.abs(motion.by_terms[:, :, t]).max()), 1e-2)
        step = h * (np.arange(len(robot.terms)) == t)
        ends = [robot.tips(u, replace(d, terms=d.terms + s), told) for s in (step, -step)]
        numeric = twist(motion.placement, *ends) / (2.0 * h)
        largest = max(float(np.abs(numeric).max()), 1e-2)
        np.testing.assert_allclose(motion.by_terms[:, :, t], numeric, rtol=0, atol=1e-8 * largest, err_msg=term.name)


@ALL
def test_slopes_by_the_reading_match_central_differences(kind: Kind) -> None:
    """Exactly, or for those that are left out: a typical coefficient changes the reading's motion by less than 1 %."""
    robot, d, u, told = drawn(kind)
    names = [reading.name for reading in robot.readings]
    for t, term in enumerate(robot.terms):
        if kind.of_link:
            continue
        coefficient = kind.coefficient(term, "angle").typical_size
        alone = TipModel(robot, Deviations(d.placements, d.offsets, coefficient * (np.arange(len(d.terms)) == t)))
        assert alone._terms is not None
        k, h = names.index(term.reading), 1e-5
        step = h * (np.arange(len(names)) == k)
        ends = [alone._terms.moved(v, told)[:, k] for v in (u + step, u - step)]
        stated = alone._terms.slopes(u)
        left = stated[:, k] - (ends[0] - ends[1]) / (2.0 * h)
        exact = kind.masses == "none"
        assert np.abs(left).max() < (1e-9 if exact else 1e-2)
        assert np.all(np.delete(stated, k, axis=1) == 1.0)


@ALL
def test_docs_tell_of_it(kind: Kind) -> None:
    formats, joint_terms = ((DOCS / name).read_text(encoding="utf-8") for name in ("formats.md", "joint_terms.md"))
    assert all(f"`{key}`" in formats or f"`error_model.{key}`" in formats for key in (kind.key, *kind.options))
    for name in kind.names:
        assert f".{name}" in joint_terms
    for term in chosen(kind):
        assert kind.coefficient(term, "angle").unit in joint_terms
