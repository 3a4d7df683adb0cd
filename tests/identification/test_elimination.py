"""Unknowns of some rows only, whatever they are: eliminated block by block, with the answers of the whole Jacobian."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import calib
from calib.assessment.outliers import outliers
from calib.identification import elimination
from calib.identification.arrow import Inverse, Split
from calib.identification.identifiability import RANK_TOLERANCE, directions_of
from calib.identification.initialisation.problem import initial_problem
from calib.identification.machine import Layout, values_at
from calib.identification.observability import observability
from calib.identification.parameters import scales
from calib.identification.relations import Relation
from calib.identification.set_ups import SetUp
from calib.identification.system import Problem, evaluate
from tests.support import cameras, machines
from tests.support.machines import Array, Rng, anywhere, pose

UR5 = ("example:ur_description/urdf/ur5_robot.urdf", "tool0")
SIGMA = 5e-5


@pytest.fixture
def all_that_can_be(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Blocks are eliminated however little that saves."""
    monkeypatch.setattr(elimination, "_MUCH", 0)
    monkeypatch.setattr(elimination, "_WORTH_IT", np.inf)
    yield


class Cell:
    """A badly made arm that stands in many places, has many tools, and is measured to anchors and by a tracker."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.robot = machines.load(*UR5)
        self.arm = machines.arm(*UR5).moved(self.rng, length=0.3e-3, angle=0.5e-3, zero=2e-3)
        self.bases = [anywhere(self.rng) for _ in range(40)]
        self.anchors = self.rng.uniform(-3.0, 3.0, (40, 3))
        self.tools = [pose(self.rng.uniform(-0.2, 0.3, 3)) for _ in range(40)]

    def rows(self, setup: list[int], tool: list[int], anchor: list[int] | None = None) -> dict[str, object]:
        """Positions, or lengths to anchors, of rows of set-ups and tools."""
        n = len(setup)
        q = self.arm.draw(self.rng, n)
        placed = np.array([self.bases[s] for s in setup]) @ self.arm.tips(q) @ np.array([self.tools[k] for k in tool])
        x = placed[:, :3, 3]
        found: dict[str, object] = {f"{r.name} [rad]": q[:, k] for k, r in enumerate(self.robot.readings)}
        found |= {"setup": [f"s{k}" for k in setup], "tool": [f"tool{k}" for k in tool]}
        if anchor is None:
            x = x + self.rng.normal(scale=SIGMA, size=x.shape)
            return found | {f"{axis} [m]": x[:, k] for k, axis in enumerate("xyz")}
        lengths = np.linalg.norm(x - self.anchors[anchor], axis=1) + self.rng.normal(scale=SIGMA, size=n)
        return found | {"length [m]": lengths, "target": [f"a{k}" for k in anchor]}

    def positions(self, setup: list[int], tool: list[int]) -> calib.Measurements:
        return calib.read_measurements(self.rows(setup, tool), self.robot, "position", sigma=SIGMA)

    def lengths(
        self, setup: list[int], tool: list[int], anchor: list[int], offset: str | None = None
    ) -> calib.Measurements:
        return calib.read_measurements(
            self.rows(setup, tool, anchor), self.robot, "distance", sigma=SIGMA, offset=offset
        )

    def model(self, known: calib.Known | None = None) -> calib.ErrorModel:
        return calib.error_model(
            self.robot, offsets="all", placements="all", tool="position", known=known or calib.Known()
        )


def ints(values: NDArray[np.integer]) -> list[int]:
    return [int(v) for v in values]


def crossed(seed: int) -> tuple[calib.ErrorModel, list[calib.Measurements]]:
    """Rows about any set-up, tool and anchor: three tables, two of lengths with offsets of their own, and priors.

    The last set-up has one row, and so has the last anchor; two anchors are at a known distance.
    """
    cell = Cell(seed)
    rng, n = cell.rng, 150
    setup, tool, anchor = (ints(rng.integers(0, k, n)) for k in (7, 3, 9))
    first = cell.positions([*setup, 7], [*tool, 0])
    bars = [cell.lengths(setup, tool[::-1], anchor, offset="bar")]
    bars.append(cell.lengths([0, *setup[::-1]], [1, *tool], [9, *anchor], offset="rod"))
    priors = {"s1": SetUp(cell.bases[1] @ pose((1e-3, 0, 0)), 2e-3, 1e-3)}
    gauge = Relation("distance", ("a2", "a5"), float(np.linalg.norm(cell.anchors[2] - cell.anchors[5])), 1e-3)
    return cell.model(calib.Known(setups=priors, relations=[gauge])), [first, *bars]


def of_their_own(seed: int) -> tuple[calib.ErrorModel, list[calib.Measurements]]:
    """Every set-up has an anchor of its own, which joins them to one block."""
    cell = Cell(seed)
    setup = ints(np.repeat(np.arange(12), 12))
    tool = ints(cell.rng.integers(0, 2, len(setup)))
    return cell.model(), [cell.positions(setup, tool), cell.lengths(setup, tool, setup)]


def many_tools(seed: int) -> tuple[calib.ErrorModel, list[calib.Measurements]]:
    """Many tools, each of few rows, and few set-ups; one tool is of one row only."""
    cell = Cell(seed)
    tool = ints(np.repeat(np.arange(20), 8))
    return cell.model(), [cell.positions([*ints(cell.rng.integers(0, 2, len(tool))), 0], [*tool, 20])]


def many_tables(seed: int) -> tuple[calib.ErrorModel, list[calib.Measurements]]:
    """Every table of lengths has an offset of its own."""
    cell = Cell(seed)
    some = [ints(cell.rng.integers(0, 4, 12)) for _ in range(25)]
    lengths = [cell.lengths([0] * 12, [0] * 12, anchor, offset=f"bar {k}") for k, anchor in enumerate(some)]
    return cell.model(), [cell.positions([0] * 30, [0] * 30), *lengths]


CASES = {"crossed": crossed, "set-ups with targets": of_their_own, "tools": many_tools, "offsets": many_tables}


def covariance_of(rows: Array) -> Array:
    """The inverse of the normal equations of rows (q, p), with more digits than others have: where a set-up of one row
    is known to metres only, the singular values of all rows together lose the last ones.
    """
    lengths = np.linalg.norm(rows, axis=0)
    Q, p = (rows / lengths).astype(np.longdouble), rows.shape[1]
    R, inverse = np.zeros((p, p), np.longdouble), np.zeros((p, p), np.longdouble)
    for j in range(p):
        for _ in range(2):
            shares = Q[:, :j].T @ Q[:, j]
            Q[:, j] -= Q[:, :j] @ shares
            R[:j, j] += shares
        R[j, j] = np.sqrt(np.sum(Q[:, j] ** 2))
        Q[:, j] /= R[j, j]
    for j in reversed(range(p)):
        inverse[j] = (np.eye(p)[j] - R[j, j + 1 :] @ inverse[j + 1 :]) / R[j, j]
    inverse /= lengths[:, None]
    return np.asarray(inverse @ inverse.T, dtype=np.float64)


def in_blocks(problem: Problem, split: Split) -> list[set[str]]:
    """What is in every block, less the component's name."""
    names = [parameter.name for parameter in problem.parameters]
    return [{names[k].rpartition(".")[0] or names[k] for k in own[own >= 0]} for own in split.blocks]


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.usefixtures("all_that_can_be")
def test_steps_covariances_and_ranks_are_those_of_the_whole_jacobian(name: str, seed: int) -> None:
    model, sets = CASES[name](seed)
    problem = initial_problem(model, sets)
    split, p = problem.split, len(problem.parameters)
    assert len(split.blocks) > 1
    s = scales(problem.parameters)
    x = values_at(problem.model.robot, problem.parameters, problem.reference)
    x = x + np.random.default_rng(seed).normal(scale=0.3, size=p) * s
    sigmas = [data.sigma for data in problem.measurements]
    mine, whole = (evaluate(problem, sigmas, x, given) for given in (split, Split.none(p)))
    for a, b in zip(mine.residuals, whole.residuals, strict=True):
        np.testing.assert_array_equal(a, b)
    hold = np.array([parameter.hold for parameter in problem.parameters])
    off = np.random.default_rng(seed).normal(size=p) * hold
    found, dense = (Inverse.of(e.rows.whole.held(hold, off)) for e in (mine, whole))
    exact = covariance_of(whole.rows.whole.held(hold, off).rest[:, :-1])
    sigma = np.sqrt(np.diag(exact))
    np.testing.assert_allclose((found.step - dense.step) / np.maximum(sigma, np.abs(dense.step)), 0.0, atol=1e-9)
    np.testing.assert_allclose((found.covariance.of() - exact) / (sigma[:, None] * sigma), 0.0, atol=1e-9)
    np.testing.assert_allclose(found.covariance.variances, sigma**2, rtol=1e-9)
    for own, other in zip(mine.rows.components, whole.rows.components, strict=True):
        assert found.used(own) == pytest.approx(dense.used(other), rel=1e-9)
    # What neither data nor stated priors tell.
    stated = np.where([q.prior is not None for q in problem.parameters], hold, 0.0)
    rows = [e.rows.whole.held(stated, np.zeros(p)) for e in (mine, whole)]
    ranks = [directions_of(own.reduced(RANK_TOLERANCE)).rank for own in rows]
    assert ranks[0] == ranks[1] < p
    dense_rows = rows[1].rest[:, :-1]
    null = np.linalg.svd(dense_rows)[2][ranks[1] :]
    # Every direction that the whole Jacobian does not see, the blocks do not see.
    for direction in null:
        assert rows[0].after(direction, 0.0) < 1e-9 * float(np.sum(dense_rows**2))


@pytest.mark.usefixtures("all_that_can_be")
@pytest.mark.parametrize("name", CASES)
def test_no_row_is_about_two_blocks(name: str) -> None:
    model, sets = CASES[name](3)
    problem = initial_problem(model, sets)
    block_of = problem.split.block_of
    things = elimination.Things.of(Layout.of(problem.model.robot, problem.reference))
    of_thing = np.full(things.number + 1, -1)
    of_thing[things.of_parameters(problem.parameters)] = block_of
    for data in problem.measurements:
        for row in things.seen_by(data):
            blocks = {int(of_thing[thing]) for thing in row if thing >= 0} - {-1}
            assert len(blocks) < 2


@pytest.mark.usefixtures("all_that_can_be")
def test_what_is_eliminated_follows_from_what_rows_are_about() -> None:
    def blocks(name: str) -> tuple[list[set[str]], set[str]]:
        model, sets = CASES[name](4)
        problem = initial_problem(model, sets)
        names = [parameter.name for parameter in problem.parameters]
        return in_blocks(problem, problem.split), {names[k].rpartition(".")[0] for k in problem.split.common}

    found, common = blocks("set-ups with targets")
    assert sorted(map(sorted, found)) == sorted(sorted((f"base.s{k}", f"target.a{k}")) for k in range(12))
    # Both tools were used in every place.
    assert {"tool.tool0", "tool.tool1"} <= common
    found, common = blocks("tools")
    assert sorted(map(sorted, found)) == sorted([f"tool.tool{k}"] for k in range(21))
    assert {"base.s0", "base.s1"} <= common
    found, common = blocks("crossed")
    # Eight set-ups have more unknowns than anchors that nothing is known of; related anchors stay common. The last
    # anchor has one row, and goes with its set-up.
    assert sorted(map(sorted, found)) == sorted([["base.s0", "target.a9"], *([f"base.s{k}"] for k in range(1, 8))])
    assert {"target.a2", "target.a5", "tool.tool0"} <= common


def test_of_few_set_ups_nothing_but_targets_is_eliminated() -> None:
    model, sets = crossed(1)
    problem = initial_problem(model, sets)
    assert all(len(own) == 1 and own.pop().startswith("target.") for own in in_blocks(problem, problem.split))


def spread_out(rng: Rng, n: int) -> tuple[calib.ErrorModel, list[calib.Measurements]]:
    cell = Cell(int(rng.integers(100)))
    setup = ints(rng.permutation(np.repeat(np.arange(n), 9)))
    few = [*setup, n]
    model = calib.error_model(cell.robot, offsets=[r.name for r in cell.robot.readings[1:-1]], tool="position")
    return model, [cell.positions(few, [0] * len(few))]


def test_a_fit_is_the_same_as_with_nothing_eliminated(monkeypatch: pytest.MonkeyPatch) -> None:
    """Thirty places of one arm, of one of which one row tells less than its six unknowns."""
    model, sets = spread_out(np.random.default_rng(8), 30)
    fit = calib.identify(model, sets)
    assert len(fit.spread.split.blocks) == 31
    monkeypatch.setattr(Problem, "split", property(lambda problem: Split.none(len(problem.parameters))))
    whole = calib.identify(model, sets)
    assert fit.converged
    assert whole.converged
    assert (fit.rank, fit.numerical_rank) == (whole.rank, whole.numerical_rank)
    assert len(fit.null_space) == len(whole.null_space)
    seen = ~whole.unidentifiable & ~fit.unidentifiable
    assert np.count_nonzero(seen) > 180
    assert fit.unidentifiable[[k for k, q in enumerate(fit.parameters) if q.name.startswith("base.s30.")]].any()
    sigmas = np.sqrt(np.diag(whole.covariance))
    np.testing.assert_allclose((fit.values - whole.values)[seen] / sigmas[seen], 0.0, atol=1e-4)
    np.testing.assert_allclose(fit.sigmas[seen], whole.sigmas[seen], rtol=1e-5)
    assert fit.noise[0].total == pytest.approx(whole.noise[0].total, rel=1e-6)


@pytest.mark.usefixtures("all_that_can_be")
def test_rows_groups_and_jumps_are_judged_as_with_nothing_eliminated(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every anchor is common, and seen from set-ups that are blocks; two of them jump, and a file is told otherwise."""
    cell = Cell(5)
    n, rng = 500, cell.rng
    setup, tool, anchor = (ints(rng.integers(0, k, n)) for k in (9, 2, 4))
    first = cell.positions(setup[:200], tool[:200])
    lengths = cell.lengths(setup, tool, anchor)
    moved = lengths.value.copy()
    for name, size in (("a1", 2e-3), ("a2", 1.5e-3)):
        moved[np.flatnonzero(lengths.target == lengths.targets.index(name))[60:]] += size
    sets = [first, replace(lengths, value=moved, where="other")]
    # Of anchors at a known distance either half may be the one that has moved.
    gauge = Relation("distance", ("a1", "a3"), float(np.linalg.norm(cell.anchors[1] - cell.anchors[3])), 1e-3)
    model = cell.model(calib.Known(relations=[gauge]))
    fit = calib.identify(model, sets)
    split = fit.spread.split
    assert {fit.parameters[k].kind for k in split.blocks[split.real]} == {"base"}
    assert {fit.parameters[k].kind for k in split.common} > {"target", "tool"}
    found = outliers(fit)
    monkeypatch.setattr(Problem, "split", property(lambda problem: Split.none(len(problem.parameters))))
    whole = outliers(calib.identify(model, sets))
    assert {jump.target for jump in found.moved} == {jump.target for jump in whole.moved} == {"a1", "a2"}
    assert [jump.target for jump in found.jumps] == [jump.target for jump in whole.jumps]
    for mine, other in zip(found.jumps, whole.jumps, strict=True):
        assert (mine.line, mine.rows) == (other.line, other.rows)
        assert mine.gain == pytest.approx(other.gain, rel=1e-5)
        np.testing.assert_allclose(mine.shift, other.shift, rtol=1e-4, atol=1e-7)
    for a, b in zip(found.rows[:8], whole.rows[:8], strict=True):
        assert a.p == pytest.approx(b.p, rel=1e-2, abs=1e-300)
    for group, same in zip(found.groups, whole.groups, strict=True):
        assert (group.kind, group.name, group.freedom, group.differs) == (
            same.kind,
            same.name,
            same.freedom,
            same.differs,
        )
        assert group.gain == pytest.approx(same.gain, rel=1e-4)
        assert group.differs_gain == pytest.approx(same.differs_gain, rel=1e-4)


def thirty_tools(seed: int) -> tuple[calib.ErrorModel, list[calib.Measurements]]:
    """Thirty tools, measured from five set-ups, crossed, and of one tool too few rows."""
    cell = Cell(seed)
    tool = ints(np.repeat(np.arange(30), 8))
    return cell.model(), [cell.positions([*ints(cell.rng.integers(0, 5, len(tool))), 0], [*tool, 30])]


def boards(seed: int) -> tuple[calib.ErrorModel, list[calib.Measurements]]:
    """Boards seen by a camera on an arm, of which a tracker measured another tool from many places."""
    cell = Cell(seed)
    model, data = photographs(cell.rng, 4, 4)
    setup = ints(np.repeat(np.arange(20), 8))
    return model, [data, cell.positions(setup, [0] * len(setup))]


@pytest.mark.usefixtures("all_that_can_be")
@pytest.mark.parametrize("make", [*CASES.values(), thirty_tools, boards], ids=lambda make: str(make.__name__))
def test_what_is_identifiable_and_how_well_does_not_depend_on_what_is_eliminated(
    make: Callable[[int], tuple[calib.ErrorModel, list[calib.Measurements]]], monkeypatch: pytest.MonkeyPatch
) -> None:
    model, sets = make(7)
    fit, seen = calib.identify(model, sets), observability(model, sets)
    monkeypatch.setattr(Problem, "split", property(lambda problem: problem.targets_apart))
    plain, plainly = calib.identify(model, sets), observability(model, sets)
    assert len(fit.spread.split.common) < len(plain.spread.split.common)
    np.testing.assert_array_equal(fit.unidentifiable, plain.unidentifiable)
    assert 0 < np.count_nonzero(fit.unidentifiable) < len(fit.parameters)
    assert (fit.rank, fit.numerical_rank) == (plain.rank, plain.numerical_rank)
    assert len(fit.null_space) == len(plain.null_space)
    assert fit.null_basis.shape == plain.null_basis.shape
    projections = [own.null_basis @ own.null_basis.T for own in (fit, plain)]
    np.testing.assert_allclose(*projections, atol=1e-7)
    np.testing.assert_allclose(fit.singular_values[: fit.rank], plain.singular_values[: fit.rank], rtol=1e-6)
    assert seen.condition == pytest.approx(plainly.condition, rel=1e-6)
    assert seen.indices == pytest.approx(plainly.indices, rel=1e-6)


def photographs(rng: Rng, boards: int, each: int) -> tuple[calib.ErrorModel, calib.Measurements]:
    """Photographs of boards by a camera on the tip of an arm that does not repeat."""
    robot = machines.load(*UR5)
    true = cameras.scene(rng, machines.arm(*UR5).moved(rng, length=0.3e-3, angle=0.5e-3, zero=2e-3), "tip", sigma=0.05)
    columns: dict[str, list[object]] = {}
    for k in range(boards):
        there = replace(true, target=true.target @ pose(rng.uniform(-0.2, 0.2, 3), rng.uniform(-0.3, 0.3, 3)))
        off = np.array([pose(rng.normal(scale=2e-4, size=3), rng.normal(scale=5e-4, size=3)) for _ in range(each)])
        own = there.columns(there.draw(rng, each), rng, 0.05, off)
        own |= {"target": [f"b{k}"] * (each * len(cameras.BOARD)), "setup": ["s0"] * (each * len(cameras.BOARD))}
        for name, values in own.items():
            columns.setdefault(name, []).extend(np.asarray(values).tolist())
    model = calib.error_model(robot, offsets="all", placements="all", tool="pose")
    return model, calib.read_measurements(columns, robot, "pixels", instrument=true.camera)


def test_photographs_that_err_together_are_weighed_as_with_nothing_eliminated(monkeypatch: pytest.MonkeyPatch) -> None:
    model, data = photographs(np.random.default_rng(3), 6, 6)
    fit = calib.identify(model, data)
    assert len(fit.spread.split.blocks) == 6
    monkeypatch.setattr(Problem, "split", property(lambda problem: Split.none(len(problem.parameters))))
    whole = calib.identify(model, data)
    (own,), (same,) = fit.together, whole.together
    assert own is not None
    assert same is not None
    assert own.length == pytest.approx(2e-4, rel=0.3)
    assert own.angle == pytest.approx(5e-4, rel=0.3)
    assert (own.length, own.angle, own.variance) == pytest.approx((same.length, same.angle, same.variance), rel=1e-6)
    seen = ~whole.unidentifiable
    np.testing.assert_allclose(fit.values[seen], whole.values[seen], atol=1e-9)
    np.testing.assert_allclose(fit.spread.variances[seen], np.diag(whole.covariance)[seen], rtol=2e-5)
    np.testing.assert_allclose(fit.sigmas[seen], whole.sigmas[seen], rtol=1e-4)


def test_a_stream_keeps_its_set_ups_common() -> None:
    """How rows in time err together is found for common unknowns."""
    model, sets = spread_out(np.random.default_rng(8), 30)
    (data,) = initial_problem(model, sets).measurements
    timed = replace(data, times=np.arange(len(data), dtype=np.float64))
    problem = initial_problem(model, [timed])
    assert not len(problem.split.blocks)
