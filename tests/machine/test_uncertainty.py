"""Doubts of a fit at the tool: exact derivatives, the null space, the file, and the identified range."""

import gc
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.foundations.chance import bound
from calib.foundations.errors import MeasurementError, OutputError
from calib.identification.parameters import scales
from calib.identification.system import Problem
from calib.machine import tool_uncertainty as tool_uncertainty_of
from calib.machine.identified import outside_identified
from calib.machine.model_file import model_json
from calib.machine.of_fit import machine_of, measured_factor
from calib.machine.tool_uncertainty import (
    common_errors,
    tool_motions,
    tool_uncertainty,
    uncertainty_map,
)
from calib.machine.uncertainty import CAUSES, rms_by_cause
from calib.machine.uncertainty_file import uncertainty_json
from calib.robot.sampling import joint_limits
from tests.support import machines
from tests.support.machines import Array, Machine, anywhere, pose

UR10 = ("example:ur_description/urdf/ur10_robot.urdf", "tool0")


def fitted(
    name: tuple[str, str] = UR10,
    observes: str = "position",
    seed: int = 0,
    *,
    rows: int = 80,
    exact: bool = False,
    **options: object,
) -> tuple[calib.Fit, Machine, machines.Arm]:
    rng = np.random.default_rng(seed)
    robot, arm = machines.load(*name), machines.arm(*name)
    built = arm if exact else arm.moved(rng)
    true = Machine(built, anywhere(rng), {"tool": pose((0.05, 0.02, 0.15), (0.3, -0.2, 0.4))})
    data = true.measure(robot, arm.draw(rng, rows), observes, rng=rng, sigma=5e-5, sigma_angle=1e-4)
    chosen = {"offsets": "all", "placements": "all", "tool": "pose" if observes == "pose" else "position"} | options
    return calib.identify(machines.model(robot, **chosen), data), true, arm


def predicted(fit: calib.Fit, x: Array, readings: Array) -> Array:
    problem = Problem(fit.model, fit.parameters, fit.nominal.frames, fit.measurements)
    machine = problem.machine(x)
    return machine.frames.base @ fit.model.robot.tips(readings, machine.deviations) @ machine.frames.tools[0]


def by_differences(fit: calib.Fit, readings: Array, step: float = 1e-6) -> Array:
    """Motion (N, 6, p) of the tool, in parameter scales of the parameters, by differences of calib's own machine."""
    columns = []
    at = predicted(fit, fit.values, readings)
    for k, scale in enumerate(scales(fit.parameters)):
        h = np.zeros(len(fit.values))
        h[k] = step * scale / 1e-3
        ahead, behind = predicted(fit, fit.values + h, readings), predicted(fit, fit.values - h, readings)
        turns = Rotation.from_matrix(np.swapaxes(at[:, :3, :3], 1, 2) @ ahead[:, :3, :3]).as_rotvec()
        turns = turns - Rotation.from_matrix(np.swapaxes(at[:, :3, :3], 1, 2) @ behind[:, :3, :3]).as_rotvec()
        moved = np.concatenate([ahead[:, :3, 3] - behind[:, :3, 3], turns], axis=1)
        columns.append(moved / (2 * h[k]) * scale)
    return np.stack(columns, axis=2)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        (UR10, {}),
        (UR10, {"observes": "pose"}),
        (UR10, {"offsets": "none", "placements": "none", "dh": "all"}),
        ((machines.INLINE["skew"], "tip"), {}),
        ((machines.INLINE["mimic"], "tip"), {"observes": "pose"}),
        (UR10, {"prior_length": 1e-3, "prior_angle": 3e-3}),
        (UR10, {"harmonics": "all", "gain": "all"}),
    ],
    ids=["positions", "poses", "dh", "skew", "mimic", "priors", "joint terms"],
)
def test_covariance_at_the_tool_is_that_of_the_parameters_by_the_derivative(
    name: tuple[str, str], options: dict[str, object]
) -> None:
    fit, _, arm = fitted(name, **options)
    readings = arm.draw(np.random.default_rng(5), 6)
    found = tool_uncertainty(machine_of(fit), readings)
    J, s = by_differences(fit, readings), scales(fit.parameters)
    expected = J @ (fit.covariance / (s[:, None] * s)) @ np.swapaxes(J, 1, 2)
    motions = tool_motions(machine_of(fit), measured_factor(fit), readings, "tool")
    np.testing.assert_allclose(
        motions @ np.swapaxes(motions, 1, 2), expected, rtol=2e-4, atol=1e-6 * np.abs(expected).max()
    )
    unseen = J @ fit.null_basis
    np.testing.assert_allclose(
        found.null_space_rms[:, 0], np.linalg.norm(unseen[:, :3], axis=(1, 2)), rtol=1e-2, atol=1e-8
    )
    np.testing.assert_allclose(
        found.null_space_rms[:, 1], np.linalg.norm(unseen[:, 3:], axis=(1, 2)), rtol=1e-2, atol=1e-8
    )


def test_positions_say_nothing_of_orientations_and_poses_do() -> None:
    readings = machines.arm(*UR10).draw(np.random.default_rng(1), 20)
    by_position, by_pose = (tool_uncertainty(machine_of(fitted(observes=o)[0]), readings) for o in ("position", "pose"))
    assert by_position.known[:, 0].all()
    assert not by_position.known[:, 1].any()
    assert by_pose.known.all()


def test_a_tool_or_a_base_that_is_added_is_not_known() -> None:
    machine = machine_of(fitted(exact=True, offsets=["elbow_joint"], placements="none")[0])
    for more in ({"tools": {**machine.tools, "new": np.eye(4)}}, {"others": {"wall": np.eye(4)}}):
        with pytest.raises(calib.RobotError, match="nothing is known; leave the uncertainty out"):
            replace(machine, **more)
        assert replace(machine, uncertainty=None, **more).uncertainty is None


def test_what_was_asked_leaves_nothing_in_memory() -> None:
    """What refers to itself waits for the collector, and holds models of tens of MB until then."""
    fit, *_ = fitted(exact=True, offsets=["elbow_joint"], placements="none")
    u, readings = machine_of(fit), np.full((1, 6), 0.3)
    gc.collect()
    gc.disable()
    try:
        tool_uncertainty(u, readings)
        left = [one for one in gc.get_objects() if type(one).__module__ == tool_uncertainty_of.__name__]
        assert not [one for one in left if type(one).__name__ in ("_Errors", "_View")]
    finally:
        gc.enable()


def test_base_and_tool_can_be_left_out() -> None:
    # Of a machine that the model knows: else base and tool make up for a part of what it leaves out.
    fit, *_ = fitted(exact=True, offsets=["elbow_joint"], placements="none")
    u, readings = machine_of(fit), np.full((1, 6), 0.3)
    whole, arm, alone = (
        tool_uncertainty(u, readings, **options)
        for options in ({}, {"base": False}, {"base": False, "tool_pose": False})
    )
    assert whole.position[0] > arm.position[0] > alone.position[0] > 0.0
    # Alone it is one angle times its lever: the distance of the tool point from the elbow's axis.
    robot, machine = fit.robot, fit.machine
    k = [p.name for p in fit.parameters].index("elbow_joint.offset")
    h = np.zeros(6)
    h[2] = 1e-6
    ends = [
        (robot.tips(readings + sign * h, machine.deviations) @ machine.frames.tools[0])[0, :3, 3] for sign in (1, -1)
    ]
    lever = np.linalg.norm(ends[0] - ends[1]) / 2e-6
    noise = tool_motions(u, measured_factor(fit), readings, "tool", base=False, tool_pose=False)[:, :3]
    assert np.linalg.norm(noise) == pytest.approx(lever * fit.sigmas[k], rel=1e-6)


def test_moving_the_world_changes_nothing_and_the_rows_only_what_may_have_drifted() -> None:
    fit, _, arm = fitted()
    readings = arm.draw(np.random.default_rng(3), 5)
    (data,) = fit.measurements
    T = anywhere(np.random.default_rng(8))
    moved = replace(data, position=data.position @ T[:3, :3].T + T[:3, 3])
    shuffled = moved.subset(np.random.default_rng(9).permutation(80))
    others = [calib.identify(fit.model, rows) for rows in (moved, shuffled)]
    here, there, mixed = (tool_uncertainty(machine_of(f), readings) for f in (fit, *others))
    np.testing.assert_allclose(there.position, here.position, rtol=1e-3)
    np.testing.assert_allclose(mixed.position, here.position, rtol=0.3)
    turned = T[:3, :3] @ here.covariance[:, :3, :3] @ T[:3, :3].T
    np.testing.assert_allclose(there.covariance[:, :3, :3], turned, rtol=1e-3, atol=1e-4 * np.abs(turned).max())


def test_errors_common_to_rows_are_those_of_single_rows() -> None:
    fit, *_ = fitted()
    u, (data,) = machine_of(fit), fit.measurements
    F = common_errors(u, data)
    assert F.shape == (80, 3, u.known_uncertainty.factor.shape[1])
    one = tool_uncertainty(u, data.readings[:3]).covariance[:, :3, :3]
    assert u.known_uncertainty.position is not None
    one = one - u.known_uncertainty.position.model**2 * np.eye(3)
    np.testing.assert_allclose(F[:3] @ np.swapaxes(F[:3], 1, 2), one, rtol=1e-9, atol=1e-20)


def test_bounds_of_regions() -> None:
    assert bound(0.95, 1, float("inf")) == pytest.approx(1.959964**2, rel=1e-6)
    assert bound(0.95, 3, 10.0) == pytest.approx(3 * 3.708265, rel=1e-6)  # F(0.95; 3, 10) of the tables


def test_a_cause_is_told_by_its_rms_over_the_poses() -> None:
    told = rms_by_cause({"instrument": np.array([[3.0, 0.0], [4.0, 2.0]])})
    assert told == {"instrument": pytest.approx([np.sqrt(12.5), np.sqrt(2.0)])}


def test_map_over_the_workspace_tells_how_far_it_is() -> None:
    fit, _, _ = fitted()
    u = machine_of(fit)
    steps: list[tuple[int, int]] = []
    found = uncertainty_map(u, 1100, progress=lambda done, of: steps.append((done, of)))
    assert steps[-1] == (1100, 1100)
    assert len(steps) > 1
    low, high = joint_limits(fit.robot).T
    assert np.all((found.readings >= low) & (found.readings <= high))
    np.testing.assert_allclose(found.sigmas[:3, 0], tool_uncertainty(u, found.readings[:3]).position, rtol=1e-12)
    tip = fit.robot.tips(found.readings[:3], fit.deviations) @ fit.machine.frames.tools[0]
    np.testing.assert_allclose(found.positions[:3], tip[:, :3, 3])


def test_unknown_tools_and_wrong_readings_are_refused() -> None:
    u = machine_of(fitted(offsets=["elbow_joint"], placements="none")[0])
    with pytest.raises(MeasurementError, match=r"there is no tool 'ball'; the calibrated one is 'tool'\."):
        tool_uncertainty(u, np.zeros((1, 6)), "ball")
    with pytest.raises(
        MeasurementError, match=r"readings of shape \(1, 5\): needs finite .* \(N, 6\), one row or more\."
    ):
        tool_uncertainty(u, np.zeros((1, 5)))


# ---- the identified range


def test_outside_the_identified_range_is_one_sentence_a_joint() -> None:
    u = machine_of(fitted(offsets=["elbow_joint"], placements="none")[0])
    u = replace(u, uncertainty=replace(u.known_uncertainty, identified=np.array([[-1.0, 1.0]] * 6)))
    inside = np.array([[1.05, -1.05, 0.0, 2 * np.pi, 0.5 - 2 * np.pi, -0.2]])
    assert outside_identified(u, inside) == ()
    outside = np.repeat(inside, 2, axis=0)
    outside[1, 2] = 1.5
    assert outside_identified(u, outside) == (
        "elbow_joint is outside the range it was identified in, -57.3 to 57.3 deg, in 1 of 2 rows; the farthest is "
        "85.94 deg.",
    )
    # In the turn in which it was told.
    outside[1, 2] = 1.5 + 2 * np.pi
    assert outside_identified(u, outside)[0].endswith("the farthest is 445.9 deg.")


# ---- the file


def written(fit: calib.Fit, folder: Path) -> Path:
    (folder / "nominal.urdf").write_bytes(fit.robot.urdf.source)
    (folder / "model.json").write_text(model_json(machine_of(fit)), encoding="utf-8")
    machine = machine_of(fit)
    contents = uncertainty_json(machine.known_uncertainty, machine.robot)
    (folder / "uncertainty.json").write_text(contents, encoding="utf-8")
    return folder


@pytest.mark.parametrize("options", [{}, {"offsets": "none", "placements": "none", "dh": "all"}], ids=["urdf", "dh"])
def test_the_file_gives_back_what_the_fit_knows(tmp_path: Path, options: dict[str, object]) -> None:
    fit, _, arm = fitted(**options)
    model = calib.load_machine(written(fit, tmp_path))
    assert model.uncertainty is not None
    readings = arm.draw(np.random.default_rng(2), 10)
    here, there = (tool_uncertainty(u, readings) for u in (machine_of(fit), model))
    np.testing.assert_allclose(there.covariance, here.covariance, rtol=1e-9, atol=1e-9 * np.abs(here.covariance).max())
    np.testing.assert_allclose(there.null_space_rms, here.null_space_rms, rtol=1e-6, atol=1e-12)
    assert model.uncertainty.position == machine_of(fit).known_uncertainty.position
    assert model.uncertainty.orientation is None
    np.testing.assert_array_equal(model.uncertainty.identified, machine_of(fit).known_uncertainty.identified)


def test_a_file_of_poses_that_leave_less_than_one_number_of_positions_is_read(tmp_path: Path) -> None:
    """Six poses have six numbers more than parameters, nearly all of them of turns."""
    fit, _, _ = fitted(observes="pose", rows=6)
    assert 0.0 < fit.noise[0].degrees_of_freedom < 1.0
    model = calib.load_machine(written(fit, tmp_path))
    assert model.uncertainty is not None
    assert model.uncertainty.position.degrees_of_freedom == 1.0


def test_a_file_of_the_first_schema_is_read(tmp_path: Path) -> None:
    fit, _, arm = fitted(offsets=["elbow_joint"], placements="none")
    folder = written(fit, tmp_path)
    contents = json.loads((folder / "uncertainty.json").read_text())
    assert contents["schema"] == 3
    later = ("causes", "waves", "wind_up", "left_out")
    contents = {key: value for key, value in contents.items() if key not in later} | {"schema": 1}
    (folder / "uncertainty.json").write_text(json.dumps(contents))
    known = calib.load_machine(folder).known_uncertainty
    assert known.left_out is None
    assert known.causes == (known.factor.shape[1], 0, 0)
    budget = tool_uncertainty(calib.load_machine(folder), arm.draw(np.random.default_rng(2), 3)).budget
    assert tuple(budget) == CAUSES
    assert not budget["parameters"].any()


def test_a_file_of_the_second_schema_has_waves_each_by_itself(tmp_path: Path) -> None:
    fit, _, arm = fitted(offsets=["elbow_joint"], placements="none")
    folder = written(fit, tmp_path)
    contents = json.loads((folder / "uncertainty.json").read_text())
    terms, columns = len(contents.pop("wind_up")), len(contents.pop("left_out"))
    contents["schema"] = 2
    contents["factor"] = [row[: len(row) - terms] for row in contents["factor"]]
    contents["causes"]["model"] -= terms
    (folder / "uncertainty.json").write_text(json.dumps(contents))
    known = calib.load_machine(folder).known_uncertainty
    assert known.left_out is not None
    assert known.left_out.wind_up.terms == ()
    np.testing.assert_array_equal(known.left_out.root, np.eye(columns - terms))
    assert tool_uncertainty(calib.load_machine(folder), arm.draw(np.random.default_rng(2), 3)).position.all()


def test_waves_of_very_many_readings_without_columns_take_no_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each is a column of the second schema: 80 kB of a hundred readings took 6 GB before they were refused."""
    fit, _, _ = fitted(offsets=["elbow_joint"], placements="none")
    folder = written(fit, tmp_path)
    contents = json.loads((folder / "uncertainty.json").read_text())
    del contents["wind_up"], contents["left_out"]
    widths = {name: [1e-4] * 100 for name in contents["waves"]["width"]}
    contents |= {"schema": 2, "waves": contents["waves"] | {"width": widths}, "causes": {"model": 1}}
    contents["factor"] = [[0.0] for _ in contents["factor"]]
    (folder / "uncertainty.json").write_text(json.dumps(contents))
    made, eye = [], np.eye
    monkeypatch.setattr(np, "eye", lambda *size: (made.append(size), eye(*size))[1])
    with pytest.raises(OutputError, match=r"is damaged, at causes\.$"):
        _ = calib.load_machine(folder).known_uncertainty
    assert (1200, 2) in made


def test_matrices_of_very_many_columns_are_told_by_fewer(tmp_path: Path) -> None:
    """A small file may have so many that products of them fill the memory; they say no more than few do."""
    fit, _, arm = fitted()
    folder, readings, rng = written(fit, tmp_path), arm.draw(np.random.default_rng(2), 5), np.random.default_rng(3)
    before = calib.load_machine(folder)
    contents = json.loads((folder / "uncertainty.json").read_text())

    def widened(*matrices: Array) -> list[Array]:
        turned = np.linalg.qr(rng.standard_normal((2000, matrices[0].shape[1])))[0].T
        return [M @ turned for M in matrices]

    factor, null_basis, root = (np.array(contents[key]) for key in ("factor", "null_basis", "left_out"))
    ends = np.cumsum([contents["causes"][cause] for cause in CAUSES[:2]])
    *parts, own = np.split(factor, [*ends, factor.shape[1] - root.shape[1]], axis=1)
    own, root = widened(own, root)
    parts = [widened(part)[0] if part.size else part for part in parts]
    contents |= {
        "causes": dict(zip(CAUSES, [parts[0].shape[1], parts[1].shape[1], parts[2].shape[1] + 2000], strict=False)),
        "factor": np.hstack([*parts, own]).tolist(),
        "null_basis": widened(null_basis)[0].tolist(),
        "left_out": root.tolist(),
    }
    (folder / "uncertainty.json").write_text(json.dumps(contents))
    after = calib.load_machine(folder)
    known = after.known_uncertainty
    n, many = len(known.factor), len(root)
    assert known.null_basis.shape == (n, n)
    assert known.left_out is not None
    assert known.left_out.columns == n + many
    assert known.factor.shape[1] == sum(known.causes) <= 4 * n + many
    here, there = (tool_uncertainty(machine, readings) for machine in (before, after))
    np.testing.assert_allclose(there.covariance, here.covariance, rtol=1e-6, atol=1e-9 * np.abs(here.covariance).max())
    np.testing.assert_allclose(there.null_space_rms, here.null_space_rms, rtol=1e-6, atol=1e-12)
    for cause in CAUSES:
        np.testing.assert_allclose(there.budget[cause], here.budget[cause], rtol=1e-6, atol=1e-12)
    assert not any(change.moved for change in calib.judging.compare(before, after).changes)


def test_a_folder_without_the_file_is_a_model_without_doubts(tmp_path: Path) -> None:
    folder = written(fitted(offsets=["elbow_joint"], placements="none")[0], tmp_path)
    (folder / "uncertainty.json").unlink()
    assert calib.load_machine(folder).uncertainty is None


def test_what_is_called_as_the_file_and_is_none_is_refused(tmp_path: Path) -> None:
    folder = written(fitted(offsets=["elbow_joint"], placements="none")[0], tmp_path)
    (folder / "uncertainty.json").unlink()
    (folder / "uncertainty.json").mkdir()
    with pytest.raises(OutputError, match=r"uncertainty.json: is not a regular file\.$"):
        calib.load_machine(folder)


def test_a_value_that_comes_twice_is_refused(tmp_path: Path) -> None:
    folder = written(fitted(offsets=["elbow_joint"], placements="none")[0], tmp_path)
    path = folder / "uncertainty.json"
    path.write_text(path.read_text().replace('"position":', '"position": null, "position":', 1))
    with pytest.raises(OutputError, match=r"uncertainty.json: .* it has 'position' twice in one object\.$"):
        calib.load_machine(folder)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda c: c.pop("factor"), "is not a file of this toolkit, or is damaged, at factor"),
        (lambda c: c["factor"].pop(), "is not of the machine in model.json"),
        (lambda c: c["null_basis"][0].append(1.0), "is not of the machine in model.json"),
        (lambda c: c["identified"].pop("elbow_joint"), "is not of the machine in model.json"),
        (
            lambda c: c["identified"].update(elbow_joint=[1.0, -1.0]),
            "is not a file of this toolkit, or is damaged, at identified.elbow_joint: the least is above the greatest",
        ),
        (lambda c: c["causes"].update(model=3), "is not a file of this toolkit, or is damaged, at causes"),
        (lambda c: c["waves"]["width"].pop("elbow_joint"), "is not of the machine in model.json"),
        (lambda c: c["waves"]["width"]["elbow_joint"].append(1e-4), "is not of the machine in model.json"),
        (lambda c: c["wind_up"][0].update(body="no_such_joint_x"), "is not of the machine in model.json"),
        (lambda c: c["wind_up"].pop(), "is not of the machine in model.json"),
        (lambda c: c["left_out"][0].append(1.0), "is not of the machine in model.json"),
        (lambda c: c.pop("left_out"), "is not a file of this toolkit, or is damaged, at left_out"),
        (
            lambda c: c["wind_up"][0].update(width=-1.0),
            "is not a file of this toolkit, or is damaged, at wind_up.0.width: -1 is below 0",
        ),
        (
            lambda c: c["waves"]["period"].update(elbow_joint=0.0),
            "is not a file of this toolkit, or is damaged, at waves.period.elbow_joint: 0 is below 1e-06",
        ),
        (
            lambda c: c["waves"]["period"].update(elbow_joint=5e-324),
            "is not a file of this toolkit, or is damaged, at waves.period.elbow_joint: 4.94066e-324 is below 1e-06",
        ),
        *(
            (
                lambda c, key=key, value=value: c["position"].update({key: value}),
                f"is not a file of this toolkit, or is damaged, at position{why}",
            )
            for key, value, why in (
                ("model", -1.0, ".model: -1 is below 0"),
                ("total", -1.0, ".total: -1 is below 0"),
                ("total", 0.0, ": its model part, 1e-05, is above its total, 0"),
                ("total", 1e7, ".total: 1e+07 is above 1e+06"),
                ("degrees_of_freedom", 0.0, ".degrees_of_freedom: 0 is below 1"),
                ("degrees_of_freedom", 1e-9, ".degrees_of_freedom: 1e-09 is below 1"),
                ("degrees_of_freedom", 1e12, ".degrees_of_freedom: 1e+12 is above 1e+09"),
            )
        ),
        (
            lambda c: c["factor"][0].__setitem__(0, 1e7),
            "is not a file of this toolkit, or is damaged, at factor.0.0: 1e+07 is above 1e+06",
        ),
        (
            lambda c: c["waves"]["width"]["elbow_joint"].__setitem__(0, -1e-4),
            "is not a file of this toolkit, or is damaged, at waves.width.elbow_joint.0: -0.0001 is below 0",
        ),
    ],
    ids=[
        "missing",
        "rows",
        "ragged",
        "joint",
        "ends",
        "causes",
        "waves",
        "orders",
        "body",
        "terms",
        "root",
        "no root",
        "width",
        "period",
        "short",
        *("model", "total", "model above total", "huge total", "freedom", "hardly any freedom", "endless freedom"),
        *("huge", "negative width"),
    ],
)
def test_a_file_of_something_else_is_refused(tmp_path: Path, change: object, why: str) -> None:
    folder = written(fitted(offsets=["elbow_joint"], placements="none")[0], tmp_path)
    contents = json.loads((folder / "uncertainty.json").read_text())
    contents["position"]["model"] = 1e-5
    change(contents)  # type: ignore[operator]
    (folder / "uncertainty.json").write_text(json.dumps(contents))
    with pytest.raises(OutputError) as caught:
        calib.load_machine(folder)
    assert str(caught.value) == f"{folder / 'uncertainty.json'}: {why}."
