"""DH parameters of the error model: exact at any size, with the ranks and null spaces of the theory."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib import dh
from calib.dh import DhRow, DhTable
from calib.foundations.errors import JobError
from calib.identification.error_model import corrected_dh
from calib.identification.machine import Frames, machine
from calib.identification.observability import Observability, observability
from calib.identification.system import Problem
from calib.machine.urdf import calibrated_urdf
from calib.robot.robot import Coupling
from calib.robot.urdf import parse_urdf
from tests.support import jacobians, machines
from tests.support.dh_tables import CONVENTIONS, product, random_table, robot_of

UR10 = ("example:ur_description/urdf/ur10_robot.urdf", "tool0")
PANDA = ("example:panda_description/urdf/panda.urdf", "panda_hand_tcp")
ARM_CMM = Path(__file__).resolve().parents[2] / "robots" / "arm_cmm" / "arm_cmm.urdf"
SERIAL = {"ur10": UR10, "panda": PANDA} | {
    name: (text, "tip") for name, text in machines.INLINE.items() if name != "mimic"
}
ONE = Frames(np.eye(4)[None], np.eye(4)[None])

Array = machines.Array


def alone(robot: calib.Robot, **options: object) -> calib.ErrorModel:
    """All of the table free (or what ``options`` say), base and tool known."""
    return machines.model(robot, **({"dh": "all", "base": "fixed", "tool": "fixed"} | options))


def changed(model: calib.ErrorModel, x: Array) -> DhTable:
    """The nominal table with parameter values added to the numbers that their names say, offsets to theta or d."""
    assert model.dh is not None
    # All rows and the base and tool that belong to them: a printed table leaves empty rows at its end out.
    nominal = replace(model.dh.table(), rows=model.dh.rows)
    rows = {row.joint: row for row in nominal.rows}
    for parameter, value in zip(model.parameters(), x, strict=True):
        joint, _, number = parameter.name.rpartition(".")
        if number == "offset":
            number = "d" if rows[joint].type == "prismatic" else "theta"
        rows[joint] = replace(rows[joint], **{number: getattr(rows[joint], number) + value})
    return replace(nominal, rows=tuple(rows.values()))


def at(model: calib.ErrorModel, x: Array) -> calib.Deviations:
    return machine(model.robot, model.parameters(), ONE, x).deviations


def assert_exact(robot: calib.Robot, convention: str, rng: np.random.Generator) -> calib.ErrorModel:
    model = alone(robot, dh_convention=convention)
    q = rng.uniform(-3.0, 3.0, (10, len(robot.readings)))
    for size in (0.0, 1e-3, 1.0):
        x = rng.uniform(-size, size, len(model.parameters()))
        table = changed(model, x)
        tips = model.robot.tips(q, at(model, x))
        np.testing.assert_allclose(tips, product(table, q), rtol=0.0, atol=1e-12)
        filled = corrected_dh(model, at(model, x))
        np.testing.assert_allclose(product(filled, q), tips, rtol=0.0, atol=1e-12)
        for row, expected in zip(filled.rows, table.rows, strict=False):
            np.testing.assert_allclose(
                [getattr(row, n) for n in ("a", "d")], [getattr(expected, n) for n in ("a", "d")], atol=1e-12
            )
    return model


# ---- exact


@pytest.mark.parametrize("convention", CONVENTIONS)
@pytest.mark.parametrize("name", SERIAL)
def test_parameters_are_exact_at_any_size(name: str, convention: str) -> None:
    assert_exact(machines.load(*SERIAL[name]), convention, np.random.default_rng(1))


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_parameters_of_random_tables_are_exact_at_any_size(convention: str) -> None:
    """Nearly parallel axes too, whose beta is not zero to begin with."""
    rng = np.random.default_rng(2)
    betas = cuts = 0
    for _ in range(40):
        table = random_table(rng, convention, plain=rng.random() < 0.7)
        model = assert_exact(robot_of(table), convention, rng)
        betas += any(parameter.name.endswith(".beta") for parameter in model.parameters())
        cuts += len(model.robot.chain) > len(model.urdf_robot.chain)
    assert min(betas, cuts) > 5


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_columns_match_central_differences(convention: str) -> None:
    rng = np.random.default_rng(3)
    tables = [random_table(rng, convention, plain=True) for _ in range(5)]
    for robot in (machines.load(*UR10), *map(robot_of, tables)):
        model = alone(robot, dh_convention=convention, base="pose", tool="pose")
        parameters = model.parameters()
        data = poses(robot, rng, 6, "pose")
        problem = Problem(
            model, parameters, Frames(machines.anywhere(rng)[None], machines.anywhere(rng, 0.3)[None]), (data,)
        )
        x = rng.uniform(-0.3, 0.3, len(parameters))
        jacobians.check(problem, x, least=1e-2)


def poses(robot: calib.Robot, rng: np.random.Generator, n: int = 6, observes: str = "position") -> calib.Measurements:
    """Measurements at random readings of a point beside the last axis."""
    readings = rng.uniform(-2.5, 2.5, (n, len(robot.readings)))
    columns: dict[str, object] = {
        f"{reading.name} [{'m' if reading.dimension == 'length' else 'rad'}]": readings[:, k]
        for k, reading in enumerate(robot.readings)
    }
    tips = robot.tips(readings) @ machines.pose((0.05, 0.02, 0.1))
    columns |= {f"{axis} [m]": tips[:, k, 3] for k, axis in enumerate("xyz")}
    if observes == "pose":
        x, y, z, w = machines.Rotation.from_matrix(tips[:, :3, :3]).as_quat().T
        columns |= {"qw": w, "qx": x, "qy": y, "qz": z}
    return calib.read_measurements(columns, robot, observes, sigma=(1e-4, 1e-4 if observes == "pose" else None))


# ---- what is free, and how it is called


def names(model: calib.ErrorModel) -> list[str]:
    return [parameter.name for parameter in model.parameters()]


def test_names_of_a_universal_robot() -> None:
    model = alone(machines.load(*UR10))
    assert names(model) == [
        *(f"shoulder_pan_joint.{n}" for n in ("a", "d", "alpha")),
        *(f"{joint}_joint.{n}" for joint in ("shoulder_lift", "elbow") for n in ("a", "alpha", "beta")),
        *(f"wrist_{k}_joint.{n}" for k in (1, 2, 3) for n in ("a", "d", "alpha")),
        *(f"{joint.name}.offset" for joint in model.robot.chain if joint.type == "revolute"),
    ]
    units = {p.name.rpartition(".")[2]: p.unit for p in model.parameters()}
    assert units == {"a": "m", "d": "m", "alpha": "rad", "beta": "rad", "offset": "rad"}
    assert all(p.of_robot for p in model.parameters())


def test_a_modified_table_has_a_and_alpha_in_the_row_of_the_axis_they_lead_to() -> None:
    model = alone(machines.load(*UR10), dh_convention="modified")
    assert [n for n in names(model) if n.endswith("beta")] == ["elbow_joint.beta", "wrist_1_joint.beta"]
    assert [n for n in names(model) if n.startswith("elbow")] == [
        f"elbow_joint.{n}" for n in ("a", "alpha", "beta", "offset")
    ]


def test_fixed_joints_of_the_tail_have_a_theta_of_their_own_and_prismatic_ones_too() -> None:
    assert [n for n in names(alone(calib.load_robot(ARM_CMM))) if n.startswith("handle")] == [
        f"handle_mount.{n}" for n in ("a", "d", "alpha", "theta")
    ]
    scara = alone(machines.load(machines.INLINE["scara"], "tip"))
    assert [n for n in names(scara) if n.startswith("quill")] == [
        f"quill.{n}" for n in ("a", "alpha", "theta", "beta", "offset")
    ]


@pytest.mark.parametrize(
    ("wish", "found"),
    [
        (["joint_2"], ["joint_2.a", "joint_2.d", "joint_2.alpha", "joint_2.offset"]),
        (
            ["joint_[12].a", "*.alpha"],
            [
                "joint_1.a",
                "joint_1.alpha",
                "joint_2.a",
                *(f"joint_{k}.alpha" for k in range(2, 7)),
                "handle_mount.alpha",
            ],
        ),
        (["joint_*.theta"], [f"joint_{k}.offset" for k in range(1, 7)]),
        (
            ["*.d", "handle_mount.theta"],
            [*(f"joint_{k}.d" for k in range(1, 7)), "handle_mount.d", "handle_mount.theta"],
        ),
    ],
)
def test_numbers_are_chosen_by_row_number_and_glob(wish: list[str], found: list[str]) -> None:
    assert names(alone(calib.load_robot(ARM_CMM), dh=wish)) == found


def test_offsets_and_placements_of_other_joints_may_be_free_beside_them() -> None:
    model = alone(
        calib.load_robot(ARM_CMM), dh=["joint_1.a"], offsets=["joint_1"], placements=["joint_5.rx", "joint_1"]
    )
    assert names(model) == [
        *(f"joint_1.{c}" for c in ("tx", "ty", "tz", "rx", "ry")),
        "joint_5.rx",
        "joint_1.a",
        "joint_1.offset",
    ]


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"dh": "some"}, 'dh: \'some\' is not "all", "none" or a list of names.'),
        ({"dh": ["elbow_joint.q"]}, "dh: 'elbow_joint.q' matches no joint of the arm; did you mean 'elbow_joint."),
        (
            {"dh": ["elbow_joint.d"]},
            "dh: 'elbow_joint.d' slides along an axis that is parallel to the next, where beta is",
        ),
        ({"dh_convention": "craig"}, "dh_convention: 'craig' is not one of standard, modified."),
        ({"dh_parallel": -1.0}, "dh_parallel: -1.0 is not an angle between 0 and 0.5 rad."),
        (
            {"dh": ["elbow_joint.alpha"], "placements": ["wrist_1_joint.tz"]},
            "placements: 'wrist_1_joint.tz' and the DH parameter 'elbow_joint.alpha' move the same frame; free one or",
        ),
    ],
)
def test_a_wrong_wish_is_refused_in_a_sentence(options: dict[str, object], sentence: str) -> None:
    with pytest.raises(JobError) as caught:
        alone(machines.load(*UR10), **options)
    assert str(caught.value).startswith(sentence)


# ---- what can be seen


def seen(robot: calib.Robot, observes: str = "position", n: int = 80, **options: object) -> Observability:
    model = machines.model(robot, **({"dh": "all", "tool": "pose" if observes == "pose" else "position"} | options))
    return observability(model, [poses(robot, np.random.default_rng(0), n, observes)])


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_ranks_of_six_turning_joints(convention: str) -> None:
    generic = robot_of(
        DhTable(
            "standard",
            tuple(DhRow(f"j{k}", "revolute", 0.1 + 0.05 * k, 0.3 - 0.04 * k, 1.1 - 0.4 * k, 0.2) for k in range(6)),
        )
    )
    for robot in (generic, machines.load(*UR10)):
        assert seen(robot, dh_convention=convention).rank == 27
        assert seen(robot, "pose", dh_convention=convention).rank == 30


def test_a_table_sees_what_all_placements_see() -> None:
    for name, (text, tip) in SERIAL.items():
        robot = machines.load(text, tip)
        data = [poses(robot, np.random.default_rng(0), 80, "pose")]
        whole = calib.error_model(robot, offsets="all", placements="all", tool="pose")
        table = machines.model(robot, dh="all", tool="pose")
        assert observability(table, data).rank == observability(whole, data).rank, name


DOCUMENT_2 = ["joint_*", "handle_mount.d"]


def test_document_2_has_25_parameters_and_rank_23() -> None:
    robot = calib.load_robot(ARM_CMM)
    model = alone(robot, dh=DOCUMENT_2)
    assert len(model.parameters()) == 25
    found = observability(model, [poses(robot, np.random.default_rng(0), 80)])
    assert found.rank == 23
    # Rows 6 and 7: the probe sits 150 mm along the last axis.
    told = [direction.shares for direction in found.undetermined]
    lever = {frozenset(s): s for s in told}
    offset = lever[frozenset({"joint_6.offset", "joint_6.a"})]
    assert abs(offset["joint_6.a"] / offset["joint_6.offset"]) == pytest.approx(0.150)
    twist = lever[frozenset({"joint_6.alpha", "joint_6.d"})]
    assert abs(twist["joint_6.d"] / twist["joint_6.alpha"]) == pytest.approx(0.150)


def test_document_2_with_base_and_tool_has_34_parameters_and_rank_27() -> None:
    robot = calib.load_robot(ARM_CMM)
    found = seen(robot, dh=DOCUMENT_2)
    assert (len(found.parameters), found.rank) == (34, 27)


# ---- the machine identified


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_what_is_identified_is_the_table_and_its_urdf(convention: str) -> None:
    rng = np.random.default_rng(5)
    robot = machines.load(*UR10)
    true = machines.Machine(
        machines.arm(*UR10).moved(rng), machines.anywhere(rng), {"tool": machines.pose((0.05, 0.02, 0.1))}
    )
    model = machines.model(robot, dh="all", dh_convention=convention, tool="pose")
    fit = calib.identify(model, true.measure(robot, true.arm.draw(rng, 60), "pose", sigma=0.0))
    assert fit.converged
    unseen = true.arm.draw(rng, 100)
    assert machines.miss(fit, true, unseen) < 1e-12

    tips = fit.model.robot.tips(unseen, fit.machine.deviations)
    np.testing.assert_allclose(
        product(corrected_dh(fit.model, fit.machine.deviations), unseen), tips, rtol=0.0, atol=1e-12
    )
    in_urdf = fit.model.urdf_deviations(fit.machine.deviations)
    np.testing.assert_allclose(robot.tips(unseen, in_urdf), tips, rtol=0.0, atol=1e-12)
    again = calib.load_robot(parse_urdf(calibrated_urdf(robot, in_urdf), "calibrated"), robot.tip)
    np.testing.assert_allclose(again.tips(unseen), tips, rtol=0.0, atol=1e-9)
    # Its axes are no longer parallel, and a second calibration starts from there.
    assert_exact(again, convention, rng)
    np.testing.assert_allclose(product(dh.dh_of(again, convention), unseen), again.tips(unseen), rtol=0.0, atol=1e-12)


def test_mimicking_arms_may_free_their_tables_numbers_but_have_no_table() -> None:
    robot = machines.load(machines.INLINE["mimic"], "tip")
    model = alone(robot)
    rng = np.random.default_rng(0)
    x, q = rng.uniform(-0.3, 0.3, len(model.parameters())), rng.uniform(-2.0, 2.0, (5, len(robot.readings)))
    deviations = at(model, x)
    np.testing.assert_allclose(
        robot.tips(q, model.urdf_deviations(deviations)), model.robot.tips(q, deviations), rtol=0.0, atol=1e-12
    )
    with pytest.raises(JobError, match=r"^dh: .*joint 'level' mimics 'lift', and in a DH table every joint moves by"):
        corrected_dh(model, deviations)


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_the_row_of_a_coupled_joint_takes_over_its_multiples_of_offsets(convention: str) -> None:
    text = machines.INLINE["mimic"].replace('<mimic joint="lift" multiplier="-1" offset="0.1"/>', "")
    couplings = [Coupling("level", {"lift": -1.0, "swing": 0.2}, 0.1)]
    robot = calib.load_robot(parse_urdf(text.encode(), "coupled"), "tip", couplings=couplings)
    model = alone(robot, dh_convention=convention)
    rng = np.random.default_rng(0)
    deviations = at(model, rng.uniform(-0.3, 0.3, len(model.parameters())))
    q = rng.uniform(-2.0, 2.0, (5, 6))  # of all joints but level, which stands third
    positions = np.insert(q, 2, 0.2 * q[:, 0] - q[:, 1] + 0.1, axis=1)
    tips = product(corrected_dh(model, deviations), positions)
    np.testing.assert_allclose(tips, model.robot.tips(q, deviations), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_links_on_the_way_are_where_they_were_also_where_axes_are_nearly_parallel(convention: str) -> None:
    # Such a row has a beta, and its frame stands in two steps.
    text = machines.INLINE["scara"].replace('rpy="0 0 0"', 'rpy="0.002 -0.001 0.3"')
    links = [joint.child for joint in parse_urdf(text.encode(), "scara").joints][:-1]
    robot = calib.load_robot(parse_urdf(text.encode(), "scara"), "tip", links=links)
    model = alone(robot, dh_convention=convention)
    rng = np.random.default_rng(0)
    deviations = at(model, rng.uniform(-0.3, 0.3, len(model.parameters())))
    q = rng.uniform(-2.0, 2.0, (5, len(robot.readings)))
    assert model.dh is not None and any(row.beta for row in model.dh.rows)
    for link in links:
        np.testing.assert_allclose(
            model.robot.with_tip(link).tips(q, deviations),
            robot.with_tip(link).tips(q, model.urdf_deviations(deviations)),
            rtol=0.0,
            atol=1e-12,
        )


def test_a_machine_that_no_table_holds_is_refused() -> None:
    robot = calib.load_robot(ARM_CMM)
    model = alone(robot, dh=["joint_1.a"], placements=["joint_5.ry"])
    with pytest.raises(
        JobError, match=r"^dh: joint 'joint_5' has a deviation that is no parameter of a standard DH tab"
    ):
        corrected_dh(model, at(model, np.array([1e-3, 1e-3])))
    with pytest.raises(JobError, match=r"^dh: no DH parameter is free, so there is no DH table"):
        corrected_dh(alone(robot, dh="none"), robot.no_deviations())


def test_placements_of_base_and_tool_go_into_those_of_the_table() -> None:
    rng = np.random.default_rng(0)
    table = DhTable(
        "standard",
        tuple(DhRow(f"joint_{k}", "revolute", 0.1 * k, 0.2, 0.5 * k, 0.3) for k in (1, 2, 3)),
        machines.anywhere(rng),
        machines.anywhere(rng),
    )
    model = alone(robot_of(table), placements=["base_mount", "joint_1", "tool_mount"])
    x, q = rng.uniform(-0.3, 0.3, len(model.parameters())), rng.uniform(-3.0, 3.0, (5, 3))
    tips = model.robot.tips(q, at(model, x))
    np.testing.assert_allclose(product(corrected_dh(model, at(model, x)), q), tips, rtol=0.0, atol=1e-12)
