"""One arm measured in several set-ups: derivatives, truths found again, priors, and frames that only judges have."""

import tracemalloc
from dataclasses import dataclass, replace

import numpy as np
import pytest

import calib
from calib.assessment import changes
from calib.assessment.influence import Residue
from calib.assessment.stretches import stretches
from calib.foundations.errors import JobError, MeasurementError
from calib.identification import sanity, system
from calib.identification.arrow import Collected
from calib.identification.initialisation.frames import initial_frames, initialise
from calib.identification.initialisation.problem import with_common_names
from calib.identification.machine import Frames
from calib.identification.observability import rank_findings
from calib.identification.set_ups import SetUp
from calib.identification.system import Problem
from calib.machine.budget import errors_by_cause
from tests.support import jacobians, machines
from tests.support.machines import Array, anywhere, pose
from tests.support.touching import SOCKETS, UR10, Lab

PLACES = ("left", "right", "far")
SIGMA = 2e-5


@dataclass(frozen=True)
class Cell:
    """A badly made arm that was measured in three places, from one instrument's frame."""

    robot: calib.Robot
    arm: machines.Arm
    bases: dict[str, Array]
    tools: dict[str, Array]
    rng: np.random.Generator

    def machine(self, setup: str) -> machines.Machine:
        return machines.Machine(self.arm, self.bases[setup], self.tools)

    def measure(self, setup: str, n: int = 40, observes: str = "position", tool: str = "tool") -> calib.Measurements:
        found = self.machine(setup).measure(
            self.robot,
            self.arm.draw(self.rng, n),
            observes,
            points=[tool] * n,
            rng=self.rng,
            sigma=SIGMA,
            sigma_angle=SIGMA,
        )
        return found.named(setup=setup)


@pytest.fixture
def cell() -> Cell:
    rng = np.random.default_rng(11)
    robot, arm = machines.load(*UR10), machines.arm(*UR10).moved(rng)
    tools = {"tool": pose((0.05, 0.02, 0.1)), "long": pose((-0.1, 0.03, 0.25))}
    return Cell(robot, arm, {name: anywhere(rng) for name in PLACES}, tools, rng)


def misses(fit: calib.Fit, cell: Cell, setup: str, tool: str = "tool") -> float:
    q, machine = cell.arm.draw(cell.rng, 200), calib.machine_of(fit).at(setup)
    d = machine.predict(q, tool=tool)[:, :3, 3] - cell.machine(setup).see(q, [tool] * 200)[:, :3, 3]
    return float(np.sqrt(np.mean(np.sum(d**2, axis=1))))


# ---- derivatives


@pytest.mark.parametrize("observes", ["position", "pose"])
def test_columns_match_central_differences(observes: str) -> None:
    found, x = jacobians.problem(*UR10, observes, "pose", rows=9)
    (data,) = found.measurements
    data = replace(data, setups=PLACES, setup=np.array([0, 1, 2, 2, 1, 0, 0, 2, 1]))
    rng = np.random.default_rng(4)
    reference = Frames(np.stack([anywhere(rng) for _ in PLACES]), found.reference.tools)
    parameters = found.model.parameters(jacobians.TOOLS, PLACES)
    x = rng.uniform(-0.3, 0.3, len(parameters))
    again = Problem(found.model, parameters, reference, (data,))
    if data.orientation is not None:  # near what is predicted, within two radians
        at = again.machine(x)
        placed = at.frames.bases[data.setup] @ data.tips(found.model.robot, at.deviations) @ at.frames.tools[data.tool]
        turns = pose(rotvec=rng.uniform(-1.1, 1.1, (9, 3)))[:, :3, :3]
        again = replace(again, measurements=(replace(data, orientation=placed[:, :3, :3] @ turns),))
    jacobians.check(again, x)


def test_rows_in_any_order_are_the_same_problem(cell: Cell) -> None:
    model = calib.error_model(cell.robot, offsets="all")
    sets = [cell.measure("left", 12), cell.measure("right", 15)]
    one = calib.identify(model, sets, model_sigmas=[0.0, 0.0])
    both = calib.identify(model, [joined(sets, np.random.default_rng(0).permutation(27))], model_sigmas=[0.0])
    for name in (p.name for p in one.parameters):
        assert both.value(name) == pytest.approx(one.value(name), abs=1e-9)


def joined(sets: list[calib.Measurements], order: Array) -> calib.Measurements:
    """Positions of several set-ups in one table, with a column for these."""
    names = sets[0].reading_names
    columns = {f"{name} [rad]": np.concatenate([d.readings[:, k] for d in sets])[order] for k, name in enumerate(names)}
    columns |= {f"{axis} [m]": np.concatenate([d.position[:, k] for d in sets])[order] for k, axis in enumerate("xyz")}
    setup = [data.setups[0] for data in sets for _ in range(len(data))]
    columns |= {"setup": [setup[n] for n in order]}
    return calib.read_measurements(columns, calib.load_robot(*UR10), sigma=SIGMA)


# ---- truths found again


def test_the_truth_is_found_from_every_place(cell: Cell) -> None:
    sets = [cell.measure("left", 60), cell.measure("right", 50), cell.measure("far", 40)]
    fit = calib.identify(calib.error_model(cell.robot, offsets="all", placements="all"), sets)
    # One base more has six unknowns more, all of which are determined.
    assert sum(p.kind == "base" for p in fit.parameters) == 18
    one = calib.identify(calib.error_model(cell.robot, offsets="all", placements="all"), sets[:1])
    assert fit.rank == one.rank + 12
    for setup in PLACES:
        assert misses(fit, cell, setup) < 2.5 * SIGMA


@pytest.mark.parametrize(("observes", "tool"), [("position", "tool"), ("pose", "long")])
def test_two_rows_that_leave_a_base_open_leave_an_arm_as_it_is_known(cell: Cell, observes: str, tool: str) -> None:
    """Base, and tool with it, may be turned by radians, and no joint is by millimetres because of that."""
    sets = [cell.measure("left", 40, observes), cell.measure("far", 2, observes, tool)]
    of_tool = "pose" if observes == "pose" else "position"
    model = calib.error_model(cell.robot, offsets="all", placements="all", tool=of_tool)
    fit = calib.identify(model, sets)
    own = np.array([p.of_robot for p in fit.parameters]) & ~fit.unidentifiable
    assert own.sum() > 8
    np.testing.assert_allclose(fit.sigmas[own], np.sqrt(fit.spread.variances[own]), rtol=0.3)


def test_tools_that_no_place_shows_by_itself_are_shown_by_all() -> None:
    """Four rows a place, each of another tool, were said to turn the tip too little, and the tools were held."""
    rng = np.random.default_rng(5)
    robot, arm = machines.load(*UR10), machines.arm(*UR10).moved(rng)
    tools = {name: pose(rng.normal(0.0, 0.15, 3)) for name in "abcdef"}
    cell = Cell(robot, arm, {f"place {k}": anywhere(rng) for k in range(30)}, tools, rng)
    sets = [
        cell.measure(place, 1, tool=tool) for k, place in enumerate(cell.bases) for tool in np.roll([*tools], k)[:4]
    ]
    model = calib.error_model(robot, offsets="all", placements="all")
    assert rank_findings(model, sets) == ()
    common = with_common_names(model, sets)
    started = initialise(model, common)
    assert not started.unshown.any()
    # As near as the nominal arm lets them be.
    for name, tool in zip(common[0].tools, started.frames.tools, strict=True):
        assert np.linalg.norm(tool[:3, 3] - tools[name][:3, 3]) < 0.01
    # The 36 numbers of three places are too few for 18 of tools and 18 of bases, and to judge.
    assert initialise(model, with_common_names(model, sets[:12])).unshown.all()


def test_one_base_for_two_places_is_far_off(cell: Cell) -> None:
    data = cell.measure("left"), cell.measure("right")
    as_one = [replace(d, setups=("base",)) for d in data]
    model = calib.error_model(cell.robot, offsets="all")
    assert calib.assess(calib.identify(model, as_one)).judged_by["after"]["position"].rms > 0.1
    assert calib.assess(calib.identify(model, data)).judged_by["after"]["position"].rms < 5e-3


def test_sockets_of_one_floor_tie_the_places_together(cell: Cell) -> None:
    """Nothing in an instrument's frame: the first base is the frame of all, and three sockets show the other one."""
    arm, names = machines.arm(*UR10).moved(cell.rng, length=0.0, angle=0.0), tuple(SOCKETS)
    c = np.stack([SOCKETS[name] for name in names])
    other = pose((0.05, -0.1, 0.04), (0.1, -0.2, 2.5))  # the second base in the first one
    there = (np.linalg.inv(other) @ np.column_stack([c, np.ones(3)]).T).T[:, :3]
    sets = []
    for setup, places in (("left", c), ("right", there)):
        lab = Lab(machines.Machine(arm, np.eye(4), cell.tools), cell.robot, cell.rng, SIGMA)
        touched = [lab.touching(lambda x, p=p: x - p, lab.scatter(12, 3)) for p in places]
        sets.append(
            lab.read(np.concatenate(touched), "socket", target=np.repeat(names, 12).tolist()).named(setup=setup)
        )
    fit = calib.identify(calib.error_model(cell.robot, offsets="all"), sets)
    assert [p.name for p in fit.parameters if p.kind == "base"] == [
        f"base.right.{k}" for k in ("x", "y", "z", "rx", "ry", "rz")
    ]
    found = np.linalg.inv(fit.machine.frames.bases[0]) @ fit.machine.frames.bases[1]
    # But for the zero of the first joint, which turns all sockets and the other base together.
    assert np.abs(found - other).max() < 0.02
    assert max(np.abs(r).max() for r in fit.residuals) < 6 * SIGMA


# ---- what is known of a base


def test_a_prior_holds_a_base_near_where_it_is_known_to_be(cell: Cell) -> None:
    about = cell.bases["right"] @ pose((1e-3, 0, 0))
    sets = [cell.measure("left"), cell.measure("right", 2)]

    def fitted(setup: SetUp) -> calib.Fit:
        return calib.identify(
            calib.error_model(cell.robot, offsets="all", known=calib.Known(setups={"right": setup})), sets
        )

    exactly, tight, wide = (fitted(SetUp(about, *sigma)) for sigma in ((), (1e-6, 1e-6), (1.0, 1.0)))
    assert not any(p.name.startswith("base.right") for p in exactly.parameters)
    np.testing.assert_allclose(exactly.machine.frames.bases[1], about)
    assert np.abs(tight.machine.frames.bases[1] - about).max() < 1e-5
    off = np.linalg.norm((wide.machine.frames.bases[1] - about)[:3, 3])
    assert off > 1e-4  # the data, not the prior, say where it is
    assert tight.sigmas[[p.name for p in tight.parameters].index("base.right.x")] < 1.1e-6


def test_bad_set_ups_are_refused(cell: Cell) -> None:
    sets = [cell.measure("left"), cell.measure("right")]
    with pytest.raises(JobError, match="a prior of the base has a length and an angle; give both"):
        SetUp(np.eye(4), 1e-3)
    with pytest.raises(JobError, match="'moon' is in no measurement; the measurements have 'left', 'right'"):
        calib.identify(calib.error_model(cell.robot, known=calib.Known(setups={"moon": SetUp(np.eye(4))})), sets)
    fixed = calib.error_model(cell.robot, base="fixed", known=calib.Known(setups={"left": SetUp(np.eye(4))}))
    with pytest.raises(JobError, match="the pose of the base in 'right' is missing, and the base is fixed"):
        calib.identify(fixed, sets)
    with pytest.raises(MeasurementError, match="the setup is given twice, as 'right' and by column 'setup'"):
        cell.measure("left").named(setup="right")
    with pytest.raises(MeasurementError, match="there is no set-up 'moon'; the calibrated ones are 'left', 'right'"):
        calib.machine_of(calib.identify(calib.error_model(cell.robot, offsets="all"), sets)).at("moon")


# ---- frames that only those have who judge


def test_tools_and_set_ups_of_rows_held_out_alone_are_found_from_these(cell: Cell) -> None:
    fit = calib.identify(calib.error_model(cell.robot, offsets="all", placements="all"), [cell.measure("left", 60)])
    judged = calib.assess(fit, [cell.measure("right", 40, tool="long"), cell.measure("far", 40)])
    after = judged.judged_by["after"]["position"].rms
    assert after < 3 * np.sqrt(3) * SIGMA
    assert judged.judged_by["before"]["position"].rms > 10 * after


def test_a_machine_of_several_set_ups_is_the_same_after_a_file(cell: Cell, tmp_path: object) -> None:
    sets = [cell.measure("left", 60), cell.measure("right", 50, tool="long")]
    found = calib.assess(calib.identify(calib.error_model(cell.robot, offsets="all", placements="all"), sets))
    calib.save(found, tmp_path / "out")
    machine, again = calib.machine_of(found.fit), calib.load_machine(tmp_path / "out")
    q = cell.arm.draw(cell.rng, 5)
    for setup in ("left", "right"):
        for tool in ("tool", "long"):
            np.testing.assert_allclose(
                again.at(setup).predict(q, tool=tool), machine.at(setup).predict(q, tool=tool), atol=1e-12
            )
            a, b = (calib.judging.tool_uncertainty(m.at(setup), q, tool).covariance for m in (again, machine))
            np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-16)
    np.testing.assert_allclose(again.residuals(sets[1]), found.fit.residuals[1], atol=1e-9)
    with pytest.raises(MeasurementError, match="there is no set-up 'far'; the calibrated ones are 'left', 'right'"):
        again.residuals(cell.measure("far", 5))


def test_the_uncertainty_of_every_set_up_is_its_own(cell: Cell) -> None:
    """Errors of the base of a set-up with few rows are larger, and stated so; the scatter of many fits is the judge."""
    sets = [cell.measure("left", 60), cell.measure("right", 6)]
    machine = calib.machine_of(calib.identify(calib.error_model(cell.robot, offsets="all"), sets))
    q = cell.arm.draw(cell.rng, 50)
    left, right = (np.median(calib.judging.tool_uncertainty(machine.at(s), q).position) for s in ("left", "right"))
    # What the model leaves out is most of it, and common to both.
    assert right > 1.05 * left
    same = [calib.judging.tool_uncertainty(machine.at(s), q, base=False).position for s in ("left", "right")]
    np.testing.assert_allclose(*same, rtol=1e-9)


def test_a_problem_counts_a_set_up_without_rows_as_nothing(cell: Cell) -> None:
    data = cell.measure("left")
    model = calib.error_model(cell.robot, offsets="all")
    reference = Frames(np.stack([cell.bases["left"]]), np.stack([cell.tools["tool"]]))
    problem = Problem(model, model.parameters(("tool",), ("left",)), reference, (data,))
    x = np.zeros(len(problem.parameters))
    assert system.jacobian(problem, x)[0].shape == (len(data), 3, len(x))


@pytest.mark.parametrize(
    ("rows", "tool", "observes", "doubted"),
    [
        (3, "long", "position", True),
        (4, "long", "position", False),
        (3, "tool", "position", False),
        (1, "tool", "pose", False),
    ],
)
def test_a_set_up_of_as_many_numbers_as_unknowns_is_not_trusted(
    cell: Cell, rows: int, tool: str, observes: str, doubted: bool
) -> None:
    """Three positions of a tool of its own are explained exactly by several bases and tools, decimetres apart."""
    model = machines.model(cell.robot, offsets="all", placements="all")
    fit = calib.identify(model, [cell.measure("left"), cell.measure("right", rows, observes, tool)])
    found = calib.assess(fit)
    said = [doubt for doubt in found.doubts if doubt.startswith("In set-up 'right' as many numbers were measured as ")]
    assert bool(said) == doubted
    assert found.trusted == (not doubted), found.doubts


@pytest.mark.parametrize(
    ("rows", "observes", "alone"), [(1, "position", True), (2, "position", False), (1, "pose", True)]
)
def test_a_tool_of_as_many_numbers_as_unknowns_is_said_to_be_unchecked(
    cell: Cell, rows: int, observes: str, alone: bool
) -> None:
    """One place explains it, so it is no doubt; but a mistake in that row would go into the tool without a trace."""
    model = machines.model(cell.robot, offsets="all", placements="all", tool=observes)
    found = calib.assess(calib.identify(model, [cell.measure("left"), cell.measure("left", rows, observes, "long")]))
    assert found.trusted, found.doubts
    assert [sentence for sentence in found.shown if "were measured with the tool 'long' as" in sentence] == [
        "As many numbers were measured with the tool 'long' as it has unknowns, so nothing checks them: a mistake in "
        "one of them is in the tool. Measure one more pose with it."
    ] * alone


def test_frames_of_a_set_up_are_found_once_where_mistakes_are_sought(
    cell: Cell, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With 99 set-ups in a table it took seconds to find all twice."""
    found: list[object] = []

    def counted(*given: object) -> Frames:
        found.append(given)
        return initial_frames(*given)  # type: ignore[arg-type]

    monkeypatch.setattr(sanity, "initial_frames", counted)
    model, sets = (
        calib.error_model(cell.robot, offsets="all", placements="all"),
        [cell.measure(name) for name in PLACES],
    )
    assert sanity.signatures(model, sets) == ()
    assert len(found) == len(PLACES)


def test_rows_are_looked_at_once_for_the_errors_of_a_fit(cell: Cell, monkeypatch: pytest.MonkeyPatch) -> None:
    """Relations and motions of the set-up, which need no rows, were taken from all of them, reduced once more."""
    fit = calib.identify(
        calib.error_model(cell.robot, offsets="all", placements="all"), [cell.measure(name) for name in PLACES]
    )
    rows, add = 0, Collected.add

    def counted(self: Collected, more: Array, *rest: object) -> None:
        nonlocal rows
        rows += len(more)
        add(self, more, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(Collected, "add", counted)
    errors_by_cause(fit, np.tile([-1.0, 1.0], (6, 1)))
    assert rows == sum(len(data) for data in fit.measurements)


def test_changes_in_the_course_of_many_rows_take_no_memory_of_their_own(cell: Cell) -> None:
    """Of every row it was kept what it adds to each of six motions by each of all parameters, and the sums of these."""
    fit = calib.identify(
        calib.error_model(cell.robot, offsets="all", placements="all"), [cell.measure(name, 400) for name in PLACES]
    )
    residue = Residue.of(fit, {})
    tracemalloc.start()
    parts = stretches(residue)
    rows = sum(part.J.nbytes for part in parts)
    made, _ = tracemalloc.get_traced_memory()
    tracemalloc.reset_peak()
    found = changes._step_of("base", parts[0], parts[0].by_base, residue.C, 1)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert found is not None
    assert peak - made < rows
    Z, J, places = parts[0].by_base, parts[0].J, np.array([3, 50, 390])
    sums = np.cumsum(np.swapaxes(Z, 1, 2) @ J, axis=0)[places - 1]
    np.testing.assert_allclose(changes._summed(Z, J, places), sums, rtol=1e-9, atol=1e-9 * np.abs(sums).max())
