"""DH tables: against a product of matrices written out here, there and back, and as the books print them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yourdfpy
from numpy.typing import NDArray

import calib
from calib import dh
from calib.dh import DhRow, DhTable
from calib.foundations.choices import Convention
from calib.foundations.errors import RobotError
from calib.robot.urdf import parse_urdf
from tests.support import machines
from tests.support.dh_tables import CONVENTIONS, QUARTER, product, random_table, robot_of

Array = NDArray[np.float64]

ROOT = Path(__file__).resolve().parents[2]


def draw(rng: np.random.Generator, table: DhTable, n: int = 20) -> Array:
    return rng.uniform(-3.0, 3.0, (n, sum(row.type != "fixed" for row in table.rows)))


def numbers(table: DhTable) -> Array:
    return np.array([(row.a, row.d, row.alpha, row.theta, row.beta) for row in table.rows])


def close(a: Array, b: Array) -> None:
    np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-12)


# ---- there and back


@pytest.mark.parametrize(("convention", "joint"), [("standard", "j1"), ("modified", "j2")])
def test_a_number_beyond_what_a_table_may_hold_is_told_with_file_and_joint(convention: Convention, joint: str) -> None:
    joints = "".join(
        f'<joint name="j{k}" type="continuous"><parent link="l{k - 1}"/><child link="l{k}"/><axis xyz="0 0 1"/>'
        f'<origin xyz="{x} 0 0" rpy="0.3 0 0"/></joint>'
        for k, x in ((1, 0), (2, 9e5))
    )
    links = "".join(f'<link name="l{k}"/>' for k in range(3))
    robot = calib.load_robot(parse_urdf(f'<robot name="far">{links}{joints}</robot>'.encode(), "far.urdf"), "l2")
    sentence = rf"^far\.urdf: DH table: joint '{joint}' has a 900000 m; allowed is -10000 to 10000 m\.$"
    with pytest.raises(RobotError, match=sentence):
        dh.dh_of(robot, convention)


@pytest.mark.parametrize("convention", CONVENTIONS)
@pytest.mark.parametrize("back", CONVENTIONS)
def test_a_hundred_tables_to_urdf_and_back_have_the_same_tips(convention: str, back: str) -> None:
    rng = np.random.default_rng(3)
    for _ in range(100):
        table = random_table(rng, convention, plain=False)
        robot, q = robot_of(table), draw(rng, table)
        close(robot.tips(q), product(table, q))
        close(product(dh.dh_of(robot, back), q), product(table, q))


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_a_hundred_plain_tables_come_back_as_the_same_numbers(convention: str) -> None:
    rng = np.random.default_rng(4)
    for _ in range(100):
        table = random_table(rng, convention, plain=True)
        # A modified table may put any a and alpha before joint 1; here frame 0 carries it, as Craig draws it.
        if convention == "modified":
            table = replace(table, rows=(replace(table.rows[0], a=0.0, alpha=0.0, beta=0.0), *table.rows[1:]))
        again = dh.dh_of(robot_of(table), convention)
        assert [(row.joint, row.type) for row in again.rows] == [(row.joint, row.type) for row in table.rows]
        turns = np.abs(np.exp(1j * numbers(again)[:, 2:]) - np.exp(1j * numbers(table)[:, 2:]))
        assert turns.max() < 1e-12
        close(numbers(again)[:, :2], numbers(table)[:, :2])
        close(again.base, table.base)
        close(again.tool, table.tool)


def test_yourdfpy_reads_the_same_arm(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    table = random_table(rng, "modified", plain=False)
    (tmp_path / "arm.urdf").write_bytes(dh.dh_to_urdf(table, 'an "arm" & more'))
    arm = machines.arm(str(tmp_path / "arm.urdf"), "tip")
    q = draw(rng, table)
    np.testing.assert_allclose(arm.tips(q), product(table, q), atol=1e-12)
    assert yourdfpy.URDF.load(str(tmp_path / "arm.urdf")).validate()


def test_limits_are_a_turn_each_way_unless_given() -> None:
    table = DhTable("standard", (DhRow("a", "revolute", 0.3, 0, 0, 0), DhRow("b", "prismatic", 0, 0, 0, 0)))
    urdf = parse_urdf(dh.dh_to_urdf(table, limits={"b": (0.0, 0.2)}), "table")
    assert [(urdf.joint(j).lower, urdf.joint(j).upper) for j in "ab"] == [(-2 * np.pi, 2 * np.pi), (0.0, 0.2)]


# ---- robots that were not written as tables


@pytest.mark.parametrize("convention", CONVENTIONS)
@pytest.mark.parametrize("name", [name for name in machines.INLINE if name != "mimic"])
def test_any_serial_arm_has_a_table(name: str, convention: str) -> None:
    robot = machines.load(machines.INLINE[name], "tip")
    table = dh.dh_of(robot, convention)
    q = np.random.default_rng(0).uniform(-2.0, 2.0, (20, len(robot.readings)))
    close(product(table, q), robot.tips(q))
    close(robot_of(table).tips(q), robot.tips(q))


@pytest.mark.parametrize("convention", CONVENTIONS)
@pytest.mark.parametrize(
    ("example", "tip"),
    [
        ("ur_description/urdf/ur5_robot.urdf", "tool0"),
        ("panda_description/urdf/panda.urdf", "panda_hand_tcp"),
        ("kinova_description/robots/kinova.urdf", "j2s6s200_end_effector"),
        ("z1_description/urdf/z1.urdf", None),
        ("tiago_description/robots/tiago.urdf", "wrist_ft_tool_link"),
        ("baxter_description/urdf/baxter.urdf", "left_gripper"),
    ],
)
def test_robots_of_the_world_have_tables(example: str, tip: str | None, convention: str) -> None:
    robot = calib.load_robot(f"example:{example}", tip)
    q = np.random.default_rng(0).uniform(-2.0, 2.0, (20, len(robot.readings)))
    close(product(dh.dh_of(robot, convention), q), robot.tips(q))


@pytest.mark.parametrize("convention", CONVENTIONS)
@pytest.mark.parametrize("size", [1e-15, 1e-13, 1e-11, 1e-9, 1e-6, 1e-4, 3e-3])
def test_axes_that_are_hardly_parallel_give_an_exact_table_of_ordinary_numbers(size: float, convention: str) -> None:
    rng = np.random.default_rng(0)
    robot = calib.load_robot("example:ur_description/urdf/ur10_robot.urdf", "tool0")
    for _ in range(5):
        badly = calib.Deviations(rng.normal(scale=size, size=(len(robot.chain), 6)), np.zeros(6))
        placements = [
            joint.placement @ machines.pose(d[:3], d[3:])
            for joint, d in zip(robot.chain, badly.placements, strict=True)
        ]
        made = replace(
            robot,
            chain=tuple(replace(j, placement=P) for j, P in zip(robot.chain, placements, strict=True)),
        )
        table = dh.dh_of(made, convention)
        q = rng.uniform(-3.0, 3.0, (20, 6))
        close(product(table, q), made.tips(q))
        assert np.abs(numbers(table)[:, :2]).max() < 1.0


def rows(table: DhTable) -> list[tuple[float, ...]]:
    """(a, d) in mm and (alpha, theta) in degrees, rounded as one prints them."""
    return [
        tuple(round(float(v), 3) + 0.0 for v in (1e3 * r.a, 1e3 * r.d, np.degrees(r.alpha), np.degrees(r.theta)))
        for r in table.rows
    ]


def test_known_robots_come_out_as_they_are_printed() -> None:
    ur10 = dh.dh_of(calib.load_robot("example:ur_description/urdf/ur10_robot.urdf", "tool0"))
    # Universal Robots' table, in the ROS description's sense of x: a2, a3 and alpha have the other sign.
    assert rows(ur10) == [
        (0, 127.3, -90, 0),
        (612, 0, 0, 0),
        (572.3, 0, 0, 0),
        (0, 163.941, -90, 0),
        (0, 115.7, 90, 0),
        (0, 92.2, 0, 180),
    ]
    panda = dh.dh_of(calib.load_robot("example:panda_description/urdf/panda.urdf", "panda_link8"), "modified")
    # Franka Emika's documentation, with the flange's d in the last row.
    assert rows(panda) == [
        (0, 333, 0, 0),
        (0, 0, -90, 0),
        (0, 316, 90, 0),
        (82.5, 0, 90, 0),
        (-82.5, 384, -90, 0),
        (0, 0, 90, 0),
        (88, 107, 90, 0),
    ]
    for table in (ur10, panda):
        np.testing.assert_array_equal(table.base, np.eye(4))
        np.testing.assert_array_equal(table.tool, np.eye(4))


def test_document_2_is_read_off_its_urdf() -> None:
    table = dh.dh_of(calib.load_robot(ROOT / "robots/arm_cmm/arm_cmm.urdf"))
    d, alpha = (100, 150, 450, 100, 350, 100, 150), (-90, 90, 90, -90, -90, 90, 0)
    assert rows(table) == [(0, x, y, 0) for x, y in zip(d, alpha, strict=True)]
    assert [row.joint for row in table.rows] == [*(f"joint_{k}" for k in range(1, 7)), "handle_mount"]
    assert table.rows[-1].type == "fixed"
    np.testing.assert_array_equal(table.tool, np.eye(4))


def test_a_mimic_joint_has_no_place_in_a_table() -> None:
    with pytest.raises(RobotError, match=r"joint 'level' mimics 'lift', and in a DH table every joint moves by itself"):
        dh.dh_of(machines.load(machines.INLINE["mimic"], "tip"))


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_links_of_the_arm_itself_leave_it_one_arm(convention: str) -> None:
    """As the link of a payload, or of a camera; what stands behind the tip, or on another branch, is another arm."""
    urdf = ROOT / "robots" / "arm_cmm" / "arm_cmm.urdf"
    one, more = calib.load_robot(urdf, tip="probe"), calib.load_robot(urdf, tip="probe", links=["link_5"])
    assert dh.dh_of(more, convention).rows == dh.dh_of(one, convention).rows
    with pytest.raises(RobotError, match="a DH table is of one arm, not of 2 links"):
        dh.dh_of(more.with_tip("link_5"), convention)


# ---- files


def test_a_table_written_reads_back_equal(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    path = tmp_path / "table.csv"
    for k in range(50):
        table = random_table(rng, CONVENTIONS[k % 2], plain=False)
        tiny = replace(table.rows[0], joint='a, "b" #c', a=float(rng.uniform() * 10.0 ** -rng.integers(0, 300)))
        table = replace(table, rows=(tiny, *table.rows[1:]))
        path.write_text(dh.write_dh(table))
        again = dh.read_dh(path)
        assert again.rows == table.rows
        assert again.convention == table.convention
        np.testing.assert_allclose(again.base, table.base, atol=1e-15)
        np.testing.assert_allclose(again.tool, table.tool, atol=1e-15)


def test_a_file_looks_as_one_would_write_it(tmp_path: Path) -> None:
    text = (
        "convention, standard\njoint, type, a [mm], d [mm], alpha [deg], theta [deg]\nj, revolute, 0, 350, -90, 0.1\n"
    )
    (tmp_path / "t.csv").write_text(text)
    table = dh.read_dh(tmp_path / "t.csv")
    assert table.rows == (DhRow("j", "revolute", 0.0, 0.35, -QUARTER, float(np.radians(0.1))),)
    assert dh.write_dh(table) == text


def test_what_may_be_left_out(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("# an arm\ntheta [rad],alpha [mrad],a [m],d [inch]\r\n\r\n0.5,1e3,-.1,1\n0,0,0,0\n")
    table = dh.read_dh(tmp_path / "t.csv", "modified")
    assert table.convention == "modified"
    assert table.rows[0] == DhRow("joint_1", "revolute", -0.1, 0.0254, 1.0, 0.5)
    assert table.rows[1].joint == "joint_2"


ROW = "j, revolute, 1, 2, 3, 4\n"
HEADER = "joint, type, a [mm], d [mm], alpha [deg], theta [deg]\n"


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "t.csv: has no header line, like 'joint, type, a [mm], d [mm], alpha [deg], theta [deg]'."),
        (HEADER, "t.csv: has a header and no rows."),
        ("a, d [mm]\n1,2\n", "t.csv:1: column 'a' has no unit; write one in brackets, like 'a [mm]'."),
        ("a [deg], d [mm]\n1,2\n", "t.csv:1: column 'a': unit 'deg' is not a unit of length; allowed are m, cm, mm, "),
        ("a [mm], d [mm], alpha [deg]\n1,2,3\n", "t.csv:1: there is no column 'theta'; a DH table has a, d, alpha, "),
        ("a [mm], a [mm]\n1,2\n", "t.csv:1: column 'a' appears more than once."),
        ("joint [mm]\n1\n", "t.csv:1: column 'joint' holds words and takes no unit, but has [mm]."),
        ("alfa [deg]\n1\n", "t.csv:1: column 'alfa [deg]' is not one of joint, type, a, d, alpha, theta, beta."),
        (HEADER + "j, revolute, 1, 2, 3\n", "t.csv:2: the header has 6 cells and this row has 5."),
        (HEADER + "j, revolute, 1, 2, 3, nan\n", "t.csv:2: column 'theta': 'nan' is not a number like 12.5 or 1.25e1."),
        (HEADER + "j, revolute, 1, 2, 3, 1e999\n", "t.csv:2: DH table: joint 'j' has a number that is not finite."),
        (
            HEADER + "j, revolute, 1, 2, 3, 1e300\n",
            "t.csv:2: DH table: joint 'j' has theta 1.74533e+298 rad; allowed is -10000 to 10000 rad.",
        ),
        (HEADER + "j, revolut, 1, 2, 3, 4\n", "t.csv:2: column 'type': 'revolut' is not one of revolute, prismatic, f"),
        (HEADER + ", revolute, 1, 2, 3, 4\n", "t.csv:2: column 'joint': the cell is empty."),
        (
            HEADER + "j\x1f1, revolute, 1, 2, 3, 4\n",
            r"t.csv:2: column 'joint': 'j\x1f1' has a character that cannot be printed.",
        ),
        (HEADER + "j, fixed, 1, 2, 3, 4\n", "t.csv: DH table: no joint moves; a table needs a revolute or a prismatic"),
        (HEADER + ROW * 2, "t.csv: DH table: joint 'j' has more than one row."),
        (HEADER + '"j, revolute\n', "t.csv:2: a quote is not closed, or something follows it."),
        ("convention, craig\n" + HEADER + ROW, "t.csv:1: DH convention: 'craig' is not one of standard, modified."),
        ("convention\n" + HEADER + ROW, "t.csv:1: 'convention' needs one word, like 'convention, standard'."),
        (
            "base, 1 mm\n" + HEADER + ROW,
            "t.csv:1: 'base' needs six cells with units, x, y, z, roll, pitch, yaw, like '10 mm'",
        ),
        (
            "tool, 1, 2, 3, 4, 5, 6\n" + HEADER + ROW,
            "t.csv:1: tool: '1' has no unit; allowed are m,",
        ),
        ("base, 1\nbase, 2\n" + HEADER, "t.csv:2: 'base' appears more than once."),
        ("convention, standard\n" + HEADER + ROW, "t.csv: states the standard convention, and was "),
    ],
)
def test_a_wrong_file_is_refused_in_a_sentence(text: str, sentence: str, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(RobotError) as caught:
        dh.read_dh(tmp_path / "t.csv", "modified" if text.startswith("convention, standard") else None)
    assert str(caught.value).removeprefix(f"{tmp_path}/").startswith(sentence)
    assert str(caught.value).endswith(".")


def test_bytes_that_are_no_text_are_refused(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_bytes(b"\xff\xfea\0")
    with pytest.raises(RobotError, match=r"is not UTF-8 text; save it as UTF-8\.$"):
        dh.read_dh(tmp_path / "t.csv")
    with pytest.raises(RobotError, match=r"there is no such file\.$"):
        dh.read_dh(tmp_path / "u.csv")


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"convention": "classic"}, r"^DH convention: 'classic' is not one of standard, modified\.$"),
        ({"base": np.diag([1.0, 1.0, -1.0, 1.0])}, r"^DH table: the base is not a rigid placement \(4, 4\)\.$"),
        ({"tool": np.eye(3)}, r"^DH table: the tool is not a rigid placement \(4, 4\)\.$"),
    ],
)
def test_a_wrong_table_is_refused_in_a_sentence(change: dict[str, object], sentence: str) -> None:
    table = DhTable("standard", (DhRow("j", "revolute", 0, 0, 0, 0),))
    with pytest.raises(RobotError, match=sentence):
        replace(table, **change)


def test_joint_names_that_make_no_urdf_are_refused() -> None:
    with pytest.raises(RobotError, match="flange_mount"):
        dh.dh_to_urdf(DhTable("standard", (DhRow("flange_mount", "revolute", 0, 0, 0, 0),)))


@pytest.mark.parametrize("mark", [";", "\t"])
def test_a_table_with_other_separators_is_told_that_commas_are_needed(mark: str, tmp_path: Path) -> None:
    text = mark.join(["a [mm]", "d [mm]", "alpha [deg]", "theta [deg]"]) + "\n" + mark.join(["0,5", "1", "90", "0"])
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(RobotError, match=r"t.csv:1: cells of a DH table are separated by commas, and not by"):
        dh.read_dh(tmp_path / "t.csv")
