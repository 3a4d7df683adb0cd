"""Nested models by held-out error: what is there is recommended and no more, and nobody sees what he is judged by."""

import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.assessment import comparison
from calib.assessment.comparison import (
    DH,
    FRAMES,
    OFFSETS,
    OWN,
    PLACEMENTS,
    TERMS,
    ModelComparison,
    compare_models,
    nested_models,
    paired,
)
from calib.assessment.validation import ChosenRows, HeldOut, cross_validate, held_out, row_groups
from calib.foundations.errors import IdentificationError, JobError, MeasurementError
from calib.identification.identify import residuals_of
from calib.identification.targets import Target
from calib.presentation.command_tables import comparison_sentences, comparison_sheet
from calib.robot.terms.harmonic import harmonic
from scripts.studies import model_comparison as script
from tests.support import machines, touching
from tests.support.gears import geared

Array = np.ndarray
UR10 = ("example:ur_description/urdf/ur10_robot.urdf", "tool0")
SIGMA = 5e-5
DATASETS = os.environ.get("CALIB_DATASETS")


def measured(seed: int, n: int, *, placed: bool, waves: bool = False, observes: str = "position") -> calib.Measurements:
    """A UR10 with wrong zeros, perhaps wrong placements, perhaps a gear that is uneven."""
    rng = np.random.default_rng([seed, 5])
    robot, plain = machines.load(*UR10), machines.arm(*UR10)
    arm = plain.moved(rng) if placed else plain.moved(rng, length=0.0, angle=0.0)
    if waves:

        def extra(u: Array) -> Array:
            found = np.zeros_like(u)
            found[:, 1] = 3e-4 * np.cos(3 * u[:, 1] - 0.4)
            return found

        arm = geared(arm, extra)
    true = machines.Machine(arm, machines.anywhere(rng), {"tool": machines.pose((0.05, 0.02, 0.15))})
    return true.measure(robot, plain.draw(rng, n), observes, rng=rng, sigma=SIGMA, sigma_angle=SIGMA)


def compared(data: calib.Measurements, folds: int = 5, terms: bool = True, **free: object) -> ModelComparison:
    model = machines.model(machines.load(*UR10), **(free or {"offsets": "all", "placements": "all"}))
    models = nested_models(model, [data])
    if not terms:
        del models[TERMS]
    return compare_models(models, data, scheme=folds, choose=[TERMS] if terms else [])


def names(found: ModelComparison) -> list[str]:
    return [judged.name for judged in found.models]


@pytest.mark.parametrize("seed", range(4))
def test_a_machine_whose_zeros_alone_are_wrong_asks_for_offsets(seed: int) -> None:
    found = compared(measured(seed, 60, placed=False), terms=seed == 0)
    assert found.recommended.name == OFFSETS
    assert found.models[0].difference > 5 * found.models[0].standard_error


@pytest.mark.parametrize("seed", range(3))
def test_a_machine_with_wrong_placements_asks_for_placements(seed: int) -> None:
    found = compared(measured(seed, 60, placed=True), terms=seed == 0)
    assert found.recommended.name == PLACEMENTS
    assert names(found)[:3] == [FRAMES, OFFSETS, PLACEMENTS]
    assert [judged.rank for judged in found.models[:3]] == [9, 13, 27]


def test_a_machine_with_an_uneven_gear_asks_for_joint_terms() -> None:
    found = compared(measured(1, 150, placed=True, waves=True))
    assert found.recommended.name == TERMS
    assert {term.name for term in harmonic("shoulder_lift_joint", 3)} <= set(found.recommended.terms)
    assert found.recommended.model.terms == found.recommended.terms
    assert not next(judged for judged in found.models if judged.name == PLACEMENTS).no_worse
    first, *_ = comparison_sentences(found)
    assert re.match(r"\d+ joint terms are chosen with all rows: ", first)
    assert found.recommended.terms[0] in first


def test_dh_parameters_stand_where_the_model_has_them() -> None:
    found = compared(measured(2, 60, placed=True), terms=False, dh="all")
    placements = compared(measured(2, 60, placed=True), terms=False)
    assert names(found) == [FRAMES, OFFSETS, DH]
    assert found.recommended.name == DH
    # The same machines in other words, but for weak priors.
    for one, other in zip(found.models, placements.models, strict=True):
        assert one.held_out.rms == pytest.approx(other.held_out.rms, rel=1e-5)


def test_models_that_are_the_same_in_other_words_are_one_and_the_shorter_wins() -> None:
    robot, data = machines.load(*UR10), measured(3, 60, placed=True)
    models = {
        "long": calib.error_model(robot, offsets="all", placements="all"),
        "short": machines.model(robot, dh="all"),
    }
    found = compare_models(models, data, scheme=4)
    assert found.models[0].rank == found.models[1].rank
    assert found.recommended.name == "short"


def test_joint_terms_are_chosen_also_where_nobody_says_so() -> None:
    robot, data = machines.load(*UR10), measured(1, 80, placed=False, waves=True)
    models = nested_models(calib.error_model(robot, offsets="all"), [data])
    del models[PLACEMENTS]
    found = {m.name: m for m in compare_models(models, data, scheme=2).models}
    assert found[TERMS].terms
    # A model of that name with terms of its own is judged as it is.
    given = calib.error_model(robot, offsets="all", terms={"gain": "all"})
    (own,) = compare_models({TERMS: given}, data, scheme=2).models
    assert not own.terms


def test_what_the_job_frees_is_judged_too_where_it_is_something_else() -> None:
    robot, data = machines.load(*UR10), measured(0, 40, placed=True)
    full = calib.error_model(robot, offsets="all", placements="all")
    assert list(nested_models(full, [data])) == [FRAMES, OFFSETS, PLACEMENTS, TERMS]
    some = calib.error_model(robot, offsets="all", placements=["elbow_joint"])
    assert list(nested_models(some, [data])) == [FRAMES, OFFSETS, PLACEMENTS, TERMS, OWN]
    known = calib.error_model(robot, offsets="all", base="fixed", tool="fixed")
    assert list(nested_models(known, [data])) == [OFFSETS, PLACEMENTS, TERMS]


def test_neither_the_order_of_rows_nor_the_world_moves_the_comparison() -> None:
    data = measured(4, 60, placed=True, waves=True)
    order = np.random.default_rng(0).permutation(len(data))
    T = machines.anywhere(np.random.default_rng(1))
    assert data.position is not None
    moved = replace(data, position=data.position @ T[:3, :3].T + T[:3, 3])
    first, again, *others = (compared(one, 3) for one in (data, data, moved.subset(order)))
    assert again.records() == first.records()
    for other in others:
        assert names(other) == names(first)
        assert other.recommended.name == first.recommended.name
        assert other.recommended.terms == first.recommended.terms
        for one, two in zip(first.models, other.models, strict=True):
            assert two.held_out.rms == pytest.approx(one.held_out.rms, rel=1e-5)
            assert two.standard_error == pytest.approx(one.standard_error, rel=1e-4, abs=1e-12)


def test_a_pose_is_judged_by_both_its_quantities_in_units_of_the_least() -> None:
    found = compared(measured(5, 40, placed=True, observes="pose"), 4, terms=False, offsets="all", tool="pose")
    assert found.unit == "1"
    least = {q: min(judged.rms[q].rms for judged in found.models) for q in ("position", "orientation")}
    for judged in found.models:
        relative = [judged.rms[q].rms / least[q] for q in least]
        assert judged.held_out.rms == pytest.approx(np.sqrt(np.mean(np.square(relative))))


def test_joint_terms_are_chosen_without_the_rows_they_are_judged_by(monkeypatch: pytest.MonkeyPatch) -> None:
    data = measured(6, 30, placed=False)
    again = data.subset([*range(30), *range(10)])  # ten poses twice
    chose: list[list[int]] = []
    choose = comparison.choose_from

    def spied(rows: ChosenRows, model: calib.ErrorModel, **options: object) -> object:
        chose.append(sorted(rows.sets[0].lines.tolist()))
        return choose(rows, model, offered=[], **options)

    monkeypatch.setattr(comparison, "choose_from", spied)
    model = calib.error_model(machines.load(*UR10), offsets="all")
    compare_models({"with terms": model}, again, scheme=3, choose=["with terms"])
    everything = sorted(again.lines.tolist())
    assert chose[0] == everything
    left_out = [set(everything) - set(rows) for rows in chose[1:]]
    assert len(left_out) == 3
    # Every row is unseen once, and no visit of a pose is seen while the other is held out.
    assert sorted(line for lines in left_out for line in lines) == sorted(set(everything))


# Paired differences. -----------------------------------------------------------------------------------------------


def test_the_standard_error_of_a_difference_is_that_of_repetitions() -> None:
    rng = np.random.default_rng(0)
    group = np.repeat(np.arange(150), 2)
    found, alone = [], []
    for _ in range(400):
        shared = rng.standard_normal(150)
        a, b = (np.repeat(shared + size * rng.standard_normal(150), 2) ** 2 for size in (0.4, 0.2))
        found.append(paired(a, b, group))
        alone.append(held_out(a, group).standard_error)
    differences, errors = np.transpose(found)
    assert np.mean(differences) == pytest.approx(np.sqrt(1.16) - np.sqrt(1.04), rel=0.05)
    assert np.mean(errors) == pytest.approx(np.std(differences), rel=0.1)
    assert np.mean(errors) < 0.7 * np.mean(alone)


def test_a_difference_to_nothing_is_the_figure_itself() -> None:
    squares = np.random.default_rng(0).standard_normal(60) ** 2
    group = np.arange(60) // 3
    assert paired(squares, squares, group) == (0.0, 0.0)
    figure = held_out(squares, group)
    assert HeldOut(*paired(squares, np.zeros(60), group)) == HeldOut(
        pytest.approx(figure.rms), pytest.approx(figure.standard_error)
    )


# All kinds of observation, places and groups. ------------------------------------------------------------------------


def test_a_socket_is_held_out_as_a_whole_and_found_where_the_model_puts_it() -> None:
    lab = touching.lab(1, noise=1e-5)
    data = lab.sockets(12)
    model = machines.model(lab.robot, offsets="all", base="fixed", prior_angle=1e-2, prior_length=1e-3)
    found = compare_models({"offsets": model}, data)
    assert (found.groups, found.folds) == (3, 3)
    squares = []
    for t in range(3):
        fit = calib.identify(model, touched(data, [k for k in range(3) if k != t]))
        tips = machines.predicted(fit, data.readings[data.target == t])[:, :3, 3]
        squares.append(np.sum((tips - tips.mean(axis=0)) ** 2, axis=1))
    assert found.recommended.held_out.rms == pytest.approx(np.sqrt(np.mean(squares)), rel=1e-6)


def touched(data: calib.Measurements, sockets: list[int]) -> calib.Measurements:
    """The rows of some sockets, as if there were no others."""
    rows = data.subset(np.isin(data.target, sockets))
    return replace(
        rows,
        targets=tuple(data.targets[k] for k in sockets),
        target=np.array([sockets.index(t) for t in rows.target]),
    )


def test_the_only_socket_of_a_tool_is_held_out_by_its_poses() -> None:
    """Without its rows nothing would be known of the tool; another tool's two sockets stay whole."""
    lab = touching.lab(1, noise=1e-5)
    data = lab.sockets(12)
    alone = touched(data, [0])
    seen = lab.positions(24)
    groups = row_groups([replace(alone, tools=("cone",)), seen], places=True)
    assert len(np.unique(groups)) == 36
    both = [replace(alone, tools=("cone",)), replace(touched(data, [1, 2]), tools=("ball",))]
    assert sorted(np.bincount(row_groups(both, places=True))) == [1] * 12 + [12, 12]
    model = machines.model(lab.robot, offsets="all", base="fixed", prior_angle=1e-2, prior_length=1e-3)
    assert compare_models({"offsets": model}, [alone, seen]).groups == 36


def test_what_is_known_of_a_socket_holds_while_it_is_held_out() -> None:
    lab = touching.lab(2, noise=1e-5)
    data = lab.sockets(8)
    data = replace(data, group=tuple(data.targets[t] for t in data.target))  # else each of its rows is one by itself
    known = {name: Target(machines.pose(c)) for name, c in touching.SOCKETS.items()}
    model = machines.model(
        lab.robot,
        offsets="all",
        base="fixed",
        targets=known,
        relations=[touching.between("distance", "a", "b")],
    )
    found = compare_models({"offsets": model}, data).recommended
    squares = []
    for t, name in enumerate(data.targets):
        kept = touched(data, [k for k in range(3) if k != t])
        own = {other: known[other] for other in kept.targets}
        fit = calib.identify(replace(model, targets=own, relations=()), kept)
        tips = machines.predicted(fit, data.readings[data.target == t])[:, :3, 3]
        squares.append(np.sum((tips - touching.SOCKETS[name]) ** 2, axis=1))
    assert found.held_out.rms == pytest.approx(np.sqrt(np.mean(squares)), rel=1e-4)


def test_of_three_known_sockets_no_fold_lacks_one() -> None:
    """Two leave a free base to turn about the line between them: no model foretold the third one."""
    lab = touching.lab(2, noise=1e-5)
    model = machines.model(lab.robot, offsets="all", targets=lab.known(*touching.SOCKETS))
    found = compare_models({"offsets": model}, lab.sockets(8))
    assert found.groups == 24
    assert found.recommended.held_out.rms < 0.01


def test_many_kinds_at_once() -> None:
    lab = touching.lab(3, noise=1e-5)
    sets = [lab.positions(24), lab.sockets(6), lab.planes(8), lab.distances(8), lab.sphere(8), lab.pairs(8)]
    model = calib.error_model(lab.robot, offsets="all", placements="all")
    models = nested_models(model, sets)
    del models[TERMS]
    found = compare_models(models, sets, scheme=3)
    assert found.recommended.name == PLACEMENTS
    assert set(found.recommended.rms) == {"position", "socket", "plane", "distance", "sphere", "pair_distance"}
    assert found.rows == 74


def test_a_table_may_be_held_out_as_a_whole() -> None:
    data = measured(7, 40, placed=False)
    model = calib.error_model(machines.load(*UR10), offsets="all")
    whole = cross_validate(model, data, count=4, model_sigmas=[2e-4])
    parts = [data.subset(range(39)), data.subset([39])]
    found = cross_validate(model, parts, count=4, losses=["linear", "linear"], model_sigmas=[2e-4, 2e-4])
    np.testing.assert_allclose(np.concatenate(found.residuals), whole.residuals[0], rtol=0, atol=1e-9)
    rows = ChosenRows(tuple(parts), [1e-4, None], ["huber", "linear"])
    kept = rows.some([np.ones(39, dtype=np.bool_), np.zeros(1, dtype=np.bool_)])
    assert kept.which == (0,)
    assert kept.losses == ["huber"]
    assert kept.model_sigmas == [1e-4]


def test_a_tool_that_is_in_one_group_alone_cannot_be_judged() -> None:
    data = measured(8, 30, placed=False)
    other = replace(data, tools=("tool", "rare"), tool=np.array([*([0] * 29), 1]))
    with pytest.raises(MeasurementError, match="'rare' has rows in one fold alone"):
        cross_validate(calib.error_model(machines.load(*UR10), offsets="all"), other, count=3)


def test_each_group_by_itself() -> None:
    data = measured(9, 36, placed=False)
    named = replace(data, group=tuple("abcd"[n % 4] for n in range(36)))
    model = calib.error_model(machines.load(*UR10), offsets="all")
    found = compare_models({"offsets": model}, named, scheme="leave-one-group-out")
    assert (found.groups, found.folds) == (4, 4)
    squares = []
    for word in "abcd":
        out = np.array([g == word for g in named.group or ()])
        fit = calib.identify(model, data.subset(~out))
        (r,) = residuals_of(fit, [data.subset(out)], fit.machine)
        squares.append(np.sum(r**2, axis=1))
    assert found.recommended.held_out.rms == pytest.approx(np.sqrt(np.mean(squares)), rel=1e-9)


# What cannot be compared, and what is told on the way. ---------------------------------------------------------------


def test_a_model_that_the_rows_cannot_tell_is_refused_and_the_others_are_judged() -> None:
    found = compared(measured(10, 9, placed=False), 3, terms=False)
    assert set(found.refused) == {PLACEMENTS}
    assert names(found) == [FRAMES, OFFSETS]
    model = calib.error_model(machines.load(*UR10), offsets="all", placements="all")
    with pytest.raises(IdentificationError, match="no model can be identified; all: "):
        compare_models({"all": model}, measured(10, 9, placed=False), scheme=3)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"scheme": 1}, "folds: 1 is not a number from 2"),
        ({"scheme": "leave-one-out"}, "scheme: 'leave-one-out' is neither a number of folds nor"),
        ({"choose": ["nobody"]}, "choose: 'nobody' is not one of the models, offsets"),
    ],
)
def test_wrong_options_are_said(options: dict[str, object], said: str) -> None:
    model = calib.error_model(machines.load(*UR10), offsets="all")
    with pytest.raises(JobError, match=said):
        compare_models({"offsets": model}, measured(0, 20, placed=False), **options)  # type: ignore[arg-type]


def test_of_very_many_groups_none_is_held_out_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("calib.assessment.comparison._MOST_FITTED", 399)
    model = calib.error_model(machines.load(*UR10), offsets="all")
    with pytest.raises(
        JobError, match=r"20 rows are of 20 groups.* to 400 rows in all, and 399 are allowed; say a num"
    ):
        compare_models({"offsets": model}, measured(0, 20, placed=False), scheme="leave-one-group-out")


def test_nothing_to_compare_and_nothing_to_hold_out_are_said() -> None:
    data = measured(0, 20, placed=False)
    with pytest.raises(JobError, match="there is none to judge"):
        compare_models({}, data)
    model = calib.error_model(machines.load(*UR10), offsets="all")
    for scheme in (5, "leave-one-group-out"):
        with pytest.raises(MeasurementError, match="one pose or one group"):
            compare_models({"offsets": model}, data.subset([0, 0, 0]), scheme=scheme)  # type: ignore[arg-type]


def test_progress_tells_every_fit_and_how_many_are_left() -> None:
    told: list[tuple[str, int]] = []
    data, robot = measured(0, 20, placed=False), machines.load(*UR10)
    models = {"frames": calib.error_model(robot), "offsets": calib.error_model(robot, offsets="all")}
    compare_models(models, data, scheme=2, progress=lambda text, left: told.append((text, left)))
    assert [left for _, left in told] == [6, 5, 4, 3, 2, 1]
    assert [text for text, _ in told[3:]] == ["offsets: all rows", "offsets: fold 1 of 2", "offsets: fold 2 of 2"]


def test_of_very_many_rows_there_are_fewer_folds_where_nobody_says(monkeypatch: pytest.MonkeyPatch) -> None:
    data, models = measured(0, 40, placed=False), {"frames": calib.error_model(machines.load(*UR10))}
    assert compare_models(models, data).folds == 10
    monkeypatch.setattr(comparison, "_VERY_MANY_ROWS", 39)
    assert compare_models(models, data).folds == 5
    assert compare_models(models, data, scheme=10).folds == 10


@pytest.mark.skipif(DATASETS is None, reason="CALIB_DATASETS does not name a folder of real measurements (ur10_leica)")
def test_on_a_real_ur10_the_recommended_model_has_the_lowest_error_within_one_standard_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = script.compared(Path(str(DATASETS)) / "ur10_leica", 3)
    lowest = min(found.models, key=lambda judged: judged.held_out.rms)
    assert found.recommended.held_out.rms <= lowest.held_out.rms + lowest.held_out.standard_error
    assert found.recommended.name == TERMS
    assert found.groups < found.rows == 1495


def test_of_very_many_rows_some_of_every_pose_are_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(comparison, "_ENOUGH_ROWS", 60)
    data = measured(0, 40, placed=False)
    found = compared(data.subset(np.tile(np.arange(40), 5)), terms=False)
    assert (found.rows, found.all_rows, found.groups) == (60, 200, 40)
    assert "60 rows of 200, taken at random, in 40 groups" in comparison_sheet(found).caption
    assert found.recommended.name == OFFSETS
