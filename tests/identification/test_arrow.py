"""Targets that are eliminated one by one: the same answers as of the whole Jacobian, at a cost that grows linearly."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.assessment.outliers import outliers
from calib.identification.arrow import Arrow, Collected, Covariance, Inverse, Part, Split, gathered, turn
from calib.identification.identifiability import RANK_TOLERANCE, directions_of
from calib.identification.relations import Relation
from calib.identification.system import Problem
from tests.support import machines
from tests.support.machines import Array, Rng, pose

UR5 = ("example:ur_description/urdf/ur5_robot.urdf", "tool0")
SIGMA = 5e-5


def dense(rows: Arrow) -> Array:
    """``[J r]`` (q, p + 1) of an arrow, written out."""
    split, a = rows.split, rows.a
    found = []
    for block, head in zip(split.blocks, rows.heads, strict=True):
        for row in head:
            whole = np.zeros(split.size + 1)
            whole[block[block >= 0]] = row[:a][block >= 0]
            whole[split.common], whole[-1] = row[a:-1], row[-1]
            found.append(whole)
    for row in rows.rest:
        whole = np.zeros(split.size + 1)
        whole[split.common], whole[-1] = row[:-1], row[-1]
        found.append(whole)
    return np.array(found)


def random_rows(rng: Rng, n: int = 90) -> tuple[Split, list[Array], list[Array], Array]:
    """A split of 5 common parameters and four blocks, of 3, 1, 3 and 2; rows of two components, block -1 for none."""
    order = rng.permutation(14)
    blocks = np.array([[*order[5:8]], [order[8], -1, -1], [*order[9:12]], [*order[12:14], -1]])
    split = Split(np.sort(order[:5]), blocks)
    common, own = rng.normal(size=(n, 1, 6)), rng.normal(size=(n, 1, 3))
    block = rng.integers(-1, 4, n)
    own[block < 0] = 0.0
    own *= split.real[block][:, None] & (block >= 0)[:, None, None]
    return split, [common[::2], common[1::2]], [own[::2], own[1::2]], block


def collected(split: Split, common: list[Array], own: list[Array], block: Array, at_once: int) -> list[Collected]:
    found = []
    for k in range(2):
        which = block[k::2]
        one = Collected(np.unique(which[which >= 0]), len(split.blocks), 3, len(split.common))
        for start in range(0, len(which), at_once):
            rows = slice(start, start + at_once)
            one.add(common[k][rows], own[k][rows], which[rows])
        found.append(one)
    return found


@pytest.mark.parametrize("at_once", [1, 7, 45])
def test_rows_that_are_collected_have_the_gram_matrix_of_all(at_once: int) -> None:
    split, common, own, block = random_rows(np.random.default_rng(3))
    parts = collected(split, common, own, block, at_once)
    whole = gathered(split, [part.heads for part in parts], [part.rest for part in parts])
    every = []
    for k in range(2):
        for c, o, b in zip(common[k][:, 0], own[k][:, 0], block[k::2], strict=True):
            row = np.zeros(split.size + 1)
            row[split.common], row[-1] = c[:-1], c[-1]
            row[split.blocks[b][split.real[b]]] = o[split.real[b]] if b >= 0 else 0.0
            every.append(row)
    J = np.array(every)
    found = dense(whole)
    np.testing.assert_allclose(found.T @ found, J.T @ J, atol=1e-12 * np.abs(J.T @ J).max())


def test_turned_rows_see_the_first_columns_in_as_many_rows_alone() -> None:
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(4, 6, 5))
    rows[1, :, 0], rows[2, 1:] = 0.0, 0.0
    before = rows.copy()
    turn(rows, 3)
    assert not np.any(np.tril(rows[:, :, :3], -1))
    np.testing.assert_allclose(np.swapaxes(rows, 1, 2) @ rows, np.swapaxes(before, 1, 2) @ before, atol=1e-12)


@pytest.mark.parametrize("open_block", [False, True])
def test_step_covariance_and_used_unknowns_are_those_of_the_whole_jacobian(open_block: bool) -> None:
    """Also where a block is not determined by its rows, and priors decide."""
    rng = np.random.default_rng(4)
    split, common, own, block = random_rows(rng)
    if open_block:
        for k in range(2):
            own[k][block[k::2] == 2, :, 1:] = 0.0
    parts = collected(split, common, own, block, 20)
    whole = gathered(split, [part.heads for part in parts], [part.rest for part in parts])
    hold, off = rng.uniform(1e-3, 1.0, split.size), rng.normal(size=split.size)
    held = whole.held(hold, off)
    rows = dense(held)
    J, r = rows[:, :-1], rows[:, -1]
    inverse = Inverse.of(held)
    C = np.linalg.inv(J.T @ J)
    np.testing.assert_allclose(inverse.step, -C @ J.T @ r, rtol=1e-9, atol=1e-9 * np.abs(inverse.step).max())
    covariance = inverse.covariance
    np.testing.assert_allclose(covariance.of(), C, rtol=1e-8, atol=1e-9 * np.abs(C).max())
    np.testing.assert_allclose(covariance.variances, np.diag(C), rtol=1e-9)
    some = rng.permutation(split.size)[:6]
    np.testing.assert_allclose(covariance.of(some), C[np.ix_(some, some)], rtol=1e-8, atol=1e-9 * np.abs(C).max())
    for k in (-1, 0, 2):
        at = [*split.common, *(split.blocks[k] if k >= 0 else [])]
        turned = np.eye(len(split.common) + split.blocks.shape[1])
        (beside,) = covariance.of_rows(turned[None], np.array([k]))
        np.testing.assert_allclose(beside[: len(at), : len(at)], C[np.ix_(at, at)], atol=1e-9 * np.abs(C).max())
    scales = rng.uniform(0.1, 10.0, split.size)
    np.testing.assert_allclose(covariance.scaled(scales).of(), C * scales[:, None] * scales, rtol=1e-7, atol=1e-12)
    assert held.after(inverse.step) == pytest.approx(float(np.sum((J @ inverse.step + r) ** 2)), rel=1e-12)
    np.testing.assert_allclose(held.lengths, np.linalg.norm(J, axis=0), rtol=1e-12)
    for part in parts:
        alone = gathered(split, [part.heads], [part.rest])
        Jk = dense(Arrow(split, alone.heads, alone.rest))[:, :-1]
        assert inverse.used(Part(split, part.heads, part.rest)) == pytest.approx(
            float(np.trace(Jk @ C @ Jk.T)), rel=1e-9
        )


def test_where_no_block_remains_rows_have_no_columns_of_their_own() -> None:
    split = random_rows(np.random.default_rng(5))[0]
    with_first = np.isin(np.arange(split.size), split.blocks[:, 0])
    assert split.without(with_first).blocks.shape == Split.none(split.size).blocks.shape
    assert split.without(with_first).common.tolist() == list(range(split.size))


def test_ranks_are_those_of_the_whole_jacobian() -> None:
    split, common, own, block = random_rows(np.random.default_rng(5))
    for k in range(2):
        own[k][block[k::2] == 2, :, 2] = 0.0
        common[k][:, :, 1] = common[k][:, :, 3] - common[k][:, :, 0]
    parts = collected(split, common, own, block, 20)
    whole = gathered(split, [part.heads for part in parts], [part.rest for part in parts])
    found = directions_of(whole.reduced(RANK_TOLERANCE))
    assert found.rank == np.linalg.matrix_rank(dense(whole)[:, :-1]) == split.size - 2
    assert len(found.singular_values) == split.size


# ---- whole calibrations


def anchored(rng: Rng, m: int, n: int) -> tuple[calib.Robot, dict[str, object], Array]:
    """An arm that is badly made, and n lengths from each of m anchors."""
    robot, arm = machines.load(*UR5), machines.arm(*UR5).moved(rng, length=0.3e-3, angle=0.5e-3, zero=2e-3)
    q = arm.draw(rng, m * n)
    x = (arm.tips(q) @ pose((0.03, 0.02, 0.1)))[:, :3, 3]
    target = rng.permutation(np.repeat(np.arange(m), n))
    places = rng.uniform(-1.5, 1.5, (m, 3))
    rows: dict[str, object] = {f"{r.name} [rad]": q[:, k] for k, r in enumerate(robot.readings)}
    rows["target"] = [f"t{t}" for t in target]
    rows["length [m]"] = np.linalg.norm(x - places[target], axis=1) + rng.normal(scale=SIGMA, size=m * n)
    return robot, rows, places


@pytest.fixture
def common_only(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Nothing is eliminated: all columns are common."""
    monkeypatch.setattr(Problem, "split", property(lambda problem: Split.none(len(problem.parameters))))
    yield


def cases(rng: Rng) -> dict[str, tuple[calib.ErrorModel, list[calib.Measurements], dict[str, object]]]:
    robot, rows, places = anchored(rng, 8, 30)
    model = calib.error_model(robot, offsets="all", placements="all", tool="position")
    data = calib.read_measurements(rows, robot, "distance", sigma=SIGMA)
    halves = [data.subset(np.arange(k, 240, 2)) for k in range(2)]
    unknown = [halves[0], calib.read_measurements(rows, robot, "distance", offset="bar").subset(np.arange(1, 240, 2))]
    related = calib.error_model(
        robot,
        offsets="all",
        placements="all",
        tool="position",
        known=calib.Known(
            relations=[Relation("distance", ("t0", "t3"), float(np.linalg.norm(places[0] - places[3])), 1e-3)]
        ),
    )
    return {
        "distances": (model, [data], {}),
        "two sets, the same anchors": (model, halves, {}),
        "an unknown offset and noise": (model, unknown, {}),
        "a relation": (related, [data], {}),
        "a robust loss": (model, [data], {"losses": ["huber"]}),
        "a minimal set": (model, [data], {"null_space": "minimal"}),
    }


NAMES = tuple(cases(np.random.default_rng(7)))


@pytest.mark.parametrize("name", NAMES)
def test_a_fit_is_the_same_as_with_nothing_eliminated(name: str, request: pytest.FixtureRequest) -> None:
    model, sets, options = cases(np.random.default_rng(7))[name]
    fit = calib.identify(model, sets, **options)
    assert len(fit.spread.split.blocks) == (6 if name == "a relation" else 8)
    request.getfixturevalue("common_only")
    whole = calib.identify(model, sets, **options)
    assert not len(whole.spread.split.blocks)
    assert [p.name for p in fit.parameters] == [p.name for p in whole.parameters]
    assert fit.converged
    assert (fit.rank, fit.numerical_rank) == (whole.rank, whole.numerical_rank)
    assert [d.parameter for d in fit.null_space] == [d.parameter for d in whole.null_space]
    np.testing.assert_array_equal(fit.unidentifiable, whole.unidentifiable)
    sigmas = np.sqrt(np.diag(whole.covariance))
    seen = ~whole.unidentifiable
    # Both stop where a step is negligible: 1e-6 of a scale.
    np.testing.assert_allclose((fit.values - whole.values)[seen] / sigmas[seen], 0.0, atol=1e-4)
    np.testing.assert_allclose(fit.sigmas[seen], whole.sigmas[seen], rtol=1e-5)
    for mine, other in zip(fit.noise, whole.noise, strict=True):
        assert mine.degrees_of_freedom == pytest.approx(other.degrees_of_freedom, abs=1e-3)
        assert mine.total == pytest.approx(other.total, rel=1e-5)


def test_rows_groups_and_jumps_are_judged_as_with_nothing_eliminated(request: pytest.FixtureRequest) -> None:
    model, sets, _ = cases(np.random.default_rng(7))["two sets, the same anchors"]
    value = sets[0].value.copy()
    value[17] += 2e-3
    late = np.flatnonzero(sets[1].target == 3)[5:]
    moved = sets[1].value.copy()
    moved[late] += 1e-3
    spoilt = [replace(sets[0], value=value), replace(sets[1], value=moved, where="other")]
    found = outliers(calib.identify(model, spoilt))
    request.getfixturevalue("common_only")
    whole = outliers(calib.identify(model, spoilt))
    assert found.outlying[0].line == whole.outlying[0].line == spoilt[0].lines[17]
    assert [jump.target for jump in found.jumps] == [jump.target for jump in whole.jumps]
    assert [jump.target for jump in found.moved] == [jump.target for jump in whole.moved]
    assert sets[1].targets[3] in {jump.target for jump in found.moved}
    for kind in ("rows", "jumps", "groups"):
        for mine, other in zip(getattr(found, kind)[:8], getattr(whole, kind)[:8], strict=True):
            assert mine.p == pytest.approx(other.p, rel=1e-2, abs=1e-300), kind
    assert [(g.kind, g.name, g.freedom) for g in found.groups] == [(g.kind, g.name, g.freedom) for g in whole.groups]


def test_what_is_kept_of_the_jacobian_grows_with_the_number_of_targets() -> None:
    sizes = []
    for m in (20, 80):
        robot, rows, _ = anchored(np.random.default_rng(1), m, 6)
        model = calib.error_model(robot, offsets="all", placements="all", tool="position")
        fit = calib.identify(model, calib.read_measurements(rows, robot, "distance", sigma=SIGMA))
        problem = Problem(fit.model, fit.parameters, fit.machine.frames, fit.measurements)
        evaluation = problem.evaluate([data.sigma for data in fit.measurements], fit.values)
        kept = sum(heads.rows.size for heads in evaluation.heads) + sum(rest.size for rest in evaluation.triangles)
        spread = fit.spread
        sizes.append(kept + spread.common.size + spread.follow.size + spread.root.size)
    assert sizes[1] < 4.0 * sizes[0]


def test_a_target_that_too_few_rows_are_about_is_told_by_itself() -> None:
    robot, rows, _ = anchored(np.random.default_rng(2), 9, 30)
    model = calib.error_model(robot, offsets="all", placements="all", tool="position")
    data = calib.read_measurements(rows, robot, "distance", sigma=SIGMA)
    few = np.flatnonzero(data.target == 4)[:2]
    fit = calib.identify(model, data.subset(np.sort(np.concatenate([np.flatnonzero(data.target != 4), few]))))
    name = data.targets[4]
    own = [k for k, p in enumerate(fit.parameters) if p.name.startswith(f"target.{name}.")]
    assert fit.unidentifiable[own].any()
    assert np.isnan(fit.sigmas[own]).any()
    # Two lengths of three unknowns leave one, and what else is unknown is so with all its rows.
    whole = calib.identify(model, data)
    assert [d.parameter for d in whole.null_space] == [d.parameter for d in fit.null_space if name not in d.parameter]
    assert len(fit.null_space) == len(whole.null_space) + 1
    assert fit.rank == fit.numerical_rank == whole.rank - 1


def test_the_parts_of_numbers_make_the_whole() -> None:
    split, *_ = random_rows(np.random.default_rng(6))
    x = np.arange(14.0)
    np.testing.assert_array_equal(split.whole(*split.parts(x)), x)
    assert Covariance(Split.none(2), np.eye(2), np.zeros((0, 0, 2)), np.zeros((0, 0, 0))).of().shape == (2, 2)
