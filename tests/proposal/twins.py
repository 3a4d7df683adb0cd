"""Synthetic twins of files that people have, with what is to be read from each: written before the reader was.

``expected`` is what the columns are; or what is asked (``asks``), where two readings fit alike and nothing tells; or
a part of the sentence with which a file is refused that holds no measurement of the arm.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from calib.robot.robot import TipModel
from tests.support.people import PANDA, UR10, angles, quaternions, robot, session, text

URDF_OF = {"UR10": UR10, "Panda": PANDA}


@dataclass(frozen=True)
class Expected:
    """Titles of the joints in the arm's order, of x, y, z, and of the orientation; and their units."""

    joints: Sequence[str]
    angle: str
    position: Sequence[str] = ()
    length: str = "mm"
    orientation: Sequence[str] = ()
    convention: str | None = None  # of angles and matrices
    observes: str = "position"
    words: dict[str, str] = field(default_factory=dict)  # others of our columns
    ignore: Sequence[str] | None = None
    says: str = ""  # a part of one of the reasons


@dataclass(frozen=True)
class Twin:
    name: str
    contents: Callable[[], bytes | str]
    expected: Expected | None = None
    asks: str = ""
    refuses: str = ""
    robot: str = "UR10"
    answers: dict[str, object] = field(default_factory=dict)  # with these nothing is asked any more


def S(**options):  # type: ignore[no-untyped-def]
    return session(UR10, "tool0", **options)


J = [f"J{k}" for k in range(1, 7)]
XYZ = ["X", "Y", "Z"]
UR = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint"]


def numbered(form: str, first: int = 1, count: int = 6) -> list[str]:
    return [form.format(k) for k in range(first, first + count)]


def degrees() -> np.ndarray:
    return np.degrees(S().readings)


def mm() -> np.ndarray:
    return 1e3 * S().position


def places(first: str, second: str, share: float) -> list[str]:
    return [first] * round(40 * share) + [second] * (40 - round(40 * share))


def moved_mm(share: float) -> np.ndarray:
    """Points of which the last were measured from another place."""
    turn = Rotation.from_rotvec([0.2, -0.4, 2.2]).as_matrix()
    later = np.array(places("", "later", share)) == "later"
    return np.where(later[:, None], 1e3 * (S().position @ turn.T + (3.0, 1.0, -0.5)), mm())


def other_tool_mm() -> np.ndarray:
    """Points of which every other one was measured on another tool, 0.4 m away."""
    aside = 1e3 * S().rotation @ np.array((0.1, -0.3, 0.25))
    return mm() + np.where(np.arange(40)[:, None] % 2, aside, 0.0)


def posed(titles: list[str], convention: str, joints: list[str] = J) -> str:
    return text([*joints, *XYZ, *titles], [degrees(), mm(), angles(S().rotation, convention)])


def simple(titles: Sequence[str] | None, **options: object) -> str:
    return text(titles, [degrees(), mm()], **options)  # type: ignore[arg-type]


PLAIN = Expected(J, "deg", XYZ)


def with_quaternion(titles: list[str], order: str) -> str:
    return text([*J, *XYZ, *titles], [degrees(), mm(), quaternions(S().rotation, order)])


def matrix(titles: list[str] | None, rows: int) -> str:
    T = np.zeros((40, 4, 4))
    T[:, :3, :3], T[:, :3, 3], T[:, 3, 3] = S().rotation, S().position * 1e3, 1.0
    return text(None if titles is None else [*J, *titles], [degrees(), T[:, :rows].reshape(40, -1)])


SLIPPED = "J1,J2,J3,J4,J5,J6,X,Y,Z\n"
COUNT = np.arange(1, 41)
STAMPS = [f"2024-03-0{1 + k % 9}T10:00:{k:02}" for k in range(40)]

TWINS = [
    # ---- names and units as they are written
    Twin(
        "our own header",
        lambda: text([*(f"{j} [rad]" for j in UR), "x [mm]", "y [mm]", "z [mm]"], [S().readings, mm()]),
        Expected([f"{j} [rad]" for j in UR], "rad", ["x [mm]", "y [mm]", "z [mm]"]),
    ),
    Twin("no units", lambda: simple([*J, *XYZ]), PLAIN),
    Twin(
        "units in parentheses",
        lambda: simple([*(f"{j} (deg)" for j in J), "X (mm)", "Y (mm)", "Z (mm)"]),
        Expected([f"{j} (deg)" for j in J], "deg", ["X (mm)", "Y (mm)", "Z (mm)"]),
    ),
    Twin(
        "units behind underscores",
        lambda: simple([*(f"A{k}_deg" for k in range(1, 7)), "X_mm", "Y_mm", "Z_mm"]),
        Expected(numbered("A{}_deg"), "deg", ["X_mm", "Y_mm", "Z_mm"]),
    ),
    Twin(
        "units behind slashes",
        lambda: simple([*(f"q{k}/°" for k in range(1, 7)), "x/mm", "y/mm", "z/mm"]),
        Expected(numbered("q{}/°"), "deg", ["x/mm", "y/mm", "z/mm"]),
    ),
    Twin(
        "radians and metres, counted from 0",
        lambda: text([*numbered("q{}", 0), "x", "y", "z"], [S().readings, S().position]),
        Expected(numbered("q{}", 0), "rad", ["x", "y", "z"], "m"),
    ),
    Twin(
        "inches",
        lambda: text([*J, "X [in]", "Y [in]", "Z [in]"], [degrees(), S().position / 0.0254]),
        Expected(J, "deg", ["X [in]", "Y [in]", "Z [in]"], "inch"),
    ),
    Twin(
        "centimetres that nobody wrote",
        lambda: text([*J, *XYZ], [degrees(), 1e2 * S().position]),
        Expected(J, "deg", XYZ, "cm"),
    ),
    Twin(
        "any case",
        lambda: simple([*(name.upper() for name in UR), "x", "Y", "z"]),
        Expected([name.upper() for name in UR], "deg", ["x", "Y", "z"]),
    ),
    Twin(
        "joint names in another order",
        lambda: text([*UR[::-1], "x", "y", "z"], [S().readings[:, ::-1], S().position]),
        Expected(UR, "rad", ["x", "y", "z"], "m"),
    ),
    # ---- how the bytes are
    Twin(
        "tabs and degree signs",
        lambda: simple([*(f"{j} [°]" for j in J), "X [mm]", "Y [mm]", "Z [mm]"], separator="\t"),
        Expected([f"{j} [°]" for j in J], "deg", ["X [mm]", "Y [mm]", "Z [mm]"]),
    ),
    Twin("semicolons and decimal commas", lambda: simple([*J, *XYZ], separator=";", comma=True), PLAIN),
    Twin("blanks", lambda: simple([*J, *XYZ], separator="  "), PLAIN),
    Twin("UTF-16", lambda: simple([*J, *XYZ], separator="\t").encode("utf-16"), PLAIN),
    Twin(
        "cp1252",
        lambda: simple([*(f"{j} [°]" for j in J), *XYZ], separator=";", comma=True).encode("cp1252"),
        Expected([f"{j} [°]" for j in J], "deg", XYZ),
    ),
    Twin(
        "comment lines of an exporter",
        lambda: simple([*J, *XYZ], before="// Exported 2024-03-01 10:00\n// Units: mm\n% station 1\n\n"),
        PLAIN,
    ),
    Twin(
        "a title and a station before the header",
        lambda: simple([*J, *XYZ], before="Robot calibration, cell 4\nOperator: A\n"),
        PLAIN,
    ),
    Twin(
        "a line of units below the header",
        lambda: simple([*J, *XYZ]).replace("\n", "\ndeg,deg,deg,deg,deg,deg,mm,mm,mm\n", 1),
        PLAIN,
    ),
    Twin("a header behind a comment sign", lambda: "# " + simple([*J, *XYZ], separator=" "), PLAIN),
    Twin(
        "no header, joints first",
        lambda: simple(None),
        Expected(numbered("column {}"), "deg", ["column 7", "column 8", "column 9"]),
    ),
    Twin(
        "no header, the point first",
        lambda: text(None, [S().position, S().readings], separator=" "),
        Expected(numbered("column {}", 4), "rad", ["column 1", "column 2", "column 3"], "m"),
    ),
    Twin(
        "no header, numbered rows",
        lambda: text(None, [COUNT, degrees(), mm(), angles(S().rotation, "abc")]),
        Expected(
            numbered("column {}", 2),
            "deg",
            numbered("column {}", 8, 3),
            orientation=numbered("column {}", 11, 3),
            convention="ZYX",
            observes="pose",
            ignore=["column 1"],
        ),
    ),
    # ---- more columns than are needed
    Twin(
        "more columns",
        lambda: text(
            ["No", "Date", *J, *XYZ, "Temperature", "Remark"],
            [COUNT, STAMPS, degrees(), mm(), 20.0 + 0.1 * COUNT, ["ok"] * 40],
        ),
        Expected(J, "deg", XYZ, ignore=["No", "Date", "Temperature", "Remark"]),
    ),
    Twin(
        "a goal beside what was measured",
        lambda: text(
            ["Goal x", "Goal y", "Goal z", *UR, "measurement_x", "measurement_y", "measurement_z"],
            [S().flange[:, :3, 3], S().readings, mm()],
        ),
        Expected(
            UR,
            "rad",
            ["measurement_x", "measurement_y", "measurement_z"],
            ignore=["Goal x", "Goal y", "Goal z"],
        ),
    ),
    Twin(
        "standard deviations between the coordinates",
        lambda: text(
            [*J, "x", "std_x", "y", "std_y", "z", "std_z"],
            [degrees(), *(c for k in range(3) for c in (mm()[:, k], np.full(40, 0.01 + k)))],
        ),
        Expected(J, "deg", ["x", "y", "z"], words={f"sigma_{axis} [mm]": f"std_{axis}" for axis in "xyz"}, ignore=[]),
    ),
    Twin(
        "commanded and actual joints",
        lambda: text([*numbered("cmd_J{}"), *numbered("act_J{}"), *XYZ], [degrees() + 1e-3, degrees(), mm()]),
        Expected(numbered("act_J{}"), "deg", XYZ, ignore=numbered("cmd_J{}")),
    ),
    Twin(
        "velocities and torques beside positions",
        lambda: text(
            [*numbered("joint_{}_position"), *numbered("joint_{}_velocity"), *numbered("joint_{}_effort"), *XYZ],
            [S().readings, 0.0 * S().readings, 3.0 + S().readings, S().position],
        ),
        Expected(
            numbered("joint_{}_position"),
            "rad",
            XYZ,
            "m",
            words={f"tau_{name} [Nm]": effort for name, effort in zip(UR, numbered("joint_{}_effort"), strict=True)},
        ),
    ),
    Twin(
        "a controller that computed the point",
        lambda: text([*J, *XYZ], [degrees(), 1e3 * S().flange[:, :3, 3]]),
        Expected(J, "deg", XYZ, says="computed"),
    ),
    # ---- more than one place, more than one tool
    Twin(
        "two set-ups",
        lambda: text([*J, *XYZ, "setup"], [degrees(), moved_mm(0.6), places("A", "B", 0.6)]),
        Expected(J, "deg", XYZ, ignore=[]),
    ),
    Twin(
        "two tools by turns",
        lambda: text([*J, *XYZ, "tool"], [degrees(), other_tool_mm(), ["ball", "cone"] * 20]),
        Expected(J, "deg", XYZ, ignore=[]),
    ),
    Twin(
        "stations under a word of their own",
        lambda: text([*J, *XYZ, "Station"], [degrees(), moved_mm(0.6), places("7", "8", 0.6)]),
        asks="setup",
        answers={"columns": {"setup": "Station"}},
    ),
    Twin(
        "a tracker that was moved, and nothing says so",
        lambda: text([*J, *XYZ], [degrees(), moved_mm(0.5)]),
        asks="setup",
    ),
    # ---- orientations of controllers
    Twin(
        "KUKA",
        lambda: posed(["A", "B", "C"], "abc", numbered("A{}")),
        Expected(numbered("A{}"), "deg", XYZ, orientation=["A", "B", "C"], convention="abc", observes="pose"),
    ),
    Twin(
        "FANUC",
        lambda: posed(["W", "P", "R"], "wpr"),
        Expected(J, "deg", XYZ, orientation=["W", "P", "R"], convention="wpr", observes="pose"),
    ),
    Twin(
        "Yaskawa",
        lambda: posed(["Rx", "Ry", "Rz"], "xyz"),
        Expected(J, "deg", XYZ, orientation=["Rx", "Ry", "Rz"], convention="xyz", observes="pose"),
    ),
    Twin(
        "Staubli",
        lambda: posed(["RX", "RY", "RZ"], "XYZ"),
        Expected(J, "deg", XYZ, orientation=["RX", "RY", "RZ"], convention="XYZ", observes="pose"),
    ),
    Twin(
        "Kawasaki",
        lambda: posed(["O", "A", "T"], "ZYZ", numbered("JT{}")),
        Expected(numbered("JT{}"), "deg", XYZ, orientation=["O", "A", "T"], convention="ZYZ", observes="pose"),
    ),
    Twin(
        "Universal Robots",
        lambda: text(
            [*numbered("actual_q_{}", 0), *numbered("actual_TCP_pose_{}", 0)],
            [S().readings, S().position, np.radians(angles(S().rotation, "rotation_vector"))],
            separator=" ",
        ),
        Expected(
            numbered("actual_q_{}", 0),
            "rad",
            numbered("actual_TCP_pose_{}", 0, 3),
            "m",
            numbered("actual_TCP_pose_{}", 3, 3),
            "rotation_vector",
            "pose",
        ),
    ),
    Twin(
        "ABB",
        lambda: text([*numbered("rax_{}"), *XYZ, *numbered("q{}", 1, 4)], [degrees(), mm(), quaternions(S().rotation)]),
        Expected(numbered("rax_{}"), "deg", XYZ, orientation=numbered("q{}", 1, 4), observes="pose"),
    ),
    Twin(
        "ROS",
        lambda: with_quaternion(["quat_x", "quat_y", "quat_z", "quat_w"], "xyzw"),
        Expected(J, "deg", XYZ, orientation=["quat_w", "quat_x", "quat_y", "quat_z"], observes="pose"),
    ),
    Twin(
        "roll, pitch, yaw",
        lambda: posed(["roll", "pitch", "yaw"], "rpy"),
        Expected(J, "deg", XYZ, orientation=["roll", "pitch", "yaw"], convention="rpy", observes="pose"),
    ),
    Twin(
        "yaw first",
        lambda: posed(["yaw", "pitch", "roll"], "ZYX"),
        Expected(J, "deg", XYZ, orientation=["yaw", "pitch", "roll"], convention="ZYX", observes="pose"),
    ),
    Twin(
        "sixteen numbers of a matrix",
        lambda: matrix([f"T{i}{j}" for i in range(1, 5) for j in range(1, 5)], 4),
        Expected(
            J,
            "deg",
            ["T14", "T24", "T34"],
            orientation=[f"T{i}{j}" for i in range(1, 4) for j in range(1, 4)],
            convention="matrix",
            observes="pose",
            ignore=["T41", "T42", "T43", "T44"],
        ),
    ),
    Twin(
        "no header, twelve numbers of a matrix",
        lambda: matrix(None, 3),
        Expected(
            numbered("column {}"),
            "deg",
            ["column 10", "column 14", "column 18"],
            orientation=[f"column {k}" for k in (7, 8, 9, 11, 12, 13, 15, 16, 17)],
            convention="matrix",
            observes="pose",
        ),
    ),
    Twin(
        "Dobot",
        lambda: text(
            ["j1", "j2", "j3", "j4", "j5", "j6", "x", "y", "z", "Rx", "Ry", "Rz", "user", "tool", "ecoKey"],
            [degrees(), mm(), angles(S().rotation, "xyz"), *(np.zeros(40),) * 3],
        ),
        Expected(
            numbered("j{}"),
            "deg",
            ["x", "y", "z"],
            orientation=["Rx", "Ry", "Rz"],
            convention="xyz",
            observes="pose",
            ignore=["user", "ecoKey"],
        ),
    ),
    # ---- other kinds
    Twin(
        "sockets",
        lambda: sockets("hole"),
        Expected(J, "deg", observes="socket", words={"target": "hole"}),
    ),
    Twin(
        "sockets without a header",
        lambda: sockets(None),
        Expected(numbered("column {}"), "deg", observes="socket", words={"target": "column 7"}),
    ),
    Twin(
        "numbered sockets without a header, before the joints and behind a counter",
        lambda: sockets(None, 4.0),
        Expected(numbered("column {}", 3), "deg", observes="socket", words={"target": "column 2"}),
    ),
    Twin(
        "joints without a header and a word that nothing touches",
        lambda: text(None, [degrees(), ["left", "right"] * 20]),
        asks="observes",
    ),
    Twin(
        "distances",
        lambda: text(
            [*J, "anchor", "length"],
            [degrees(), ["a"] * 40, 1e3 * np.linalg.norm(S().position - [2.0, -1.0, 0.0], axis=1)],
        ),
        Expected(J, "deg", observes="distance", words={"target": "anchor", "length [mm]": "length"}),
    ),
    # ---- another arm, with a gripper beyond it
    Twin(
        "seven joints and X, Y, Z of an arm with fingers",
        lambda: text(
            [*numbered("J{}", 1, 7), *XYZ],
            [
                np.degrees(session(PANDA, "panda_hand_tcp").readings),
                1e3 * session(PANDA, "panda_hand_tcp").position,
            ],
        ),
        Expected(numbered("J{}", 1, 7), "deg", XYZ),
        robot="Panda",
    ),
    # ---- where two readings fit alike, or none does
    Twin(
        "two measured points in a row",
        lambda: text(
            [*J, "x1", "y1", "z1", "x2", "y2", "z2"],
            [degrees(), mm(), 1e3 * (S().position + S().rotation @ [0.05, 0.0, 0.02])],
        ),
        asks="position",
        answers={"columns": {"x": "x2"}},
    ),
    Twin(
        "four rows, beyond limits and reach in other units", lambda: text([*J, *XYZ], [degrees()[:4], mm()[:4]]), PLAIN
    ),
    Twin(
        "four rows without units, of which two would do",
        lambda: text([*J, *XYZ], [S().readings[:4], mm()[:4]]),
        asks="angles",
        answers={"angles": "rad", "lengths": "mm"},
    ),
    Twin(
        "an arm that hardly turns, without an order of its angles",
        lambda: text(
            [*J, *XYZ, "r1", "r2", "r3"],
            [
                np.degrees(S(still=True).readings),
                1e3 * S(still=True).position,
                angles(S(still=True).rotation, "ZYX"),
            ],
        ),
        Expected(J, "deg", XYZ, ignore=["r1", "r2", "r3"]),
    ),
    Twin(
        "two logs of the joints that agree",
        lambda: text([*numbered("a_J{}"), *numbered("b_J{}"), *XYZ], [degrees() + 1e-3, degrees(), mm()]),
        asks="joints",
        answers={"columns": {"shoulder_pan_joint": "b_J1"}},
    ),
    Twin(
        "another robot's file",
        lambda: text([*J, *XYZ], [degrees()[:, ::-1], mm()]),
        asks="columns",
    ),
    Twin("joints alone", lambda: text(J, [degrees()]), asks="observes"),
    Twin("points alone", lambda: text(["Point", *XYZ], [COUNT, mm()]), refuses="no column"),
    Twin("not of a robot", lambda: "image,red_x,red_y\na.jpg,1.5,2.5\nb.jpg,3,4\n", refuses="no column"),
    Twin(
        "seven columns for six joints",
        lambda: text([*numbered("J{}", 1, 7), *XYZ], [np.hstack([degrees(), degrees()[:, :1]]), mm()]),
        asks="joints",
    ),
    Twin(
        "pixels",
        lambda: text([*J, "u", "v"], [degrees(), 300.0 + 10.0 * S().position[:, :2]]),
        refuses="no table says of which camera; from photographs, calib import images writes table and job",
    ),
]


@cache
def touched() -> tuple[np.ndarray, list[str]]:
    """Readings in degrees at which a wrist touches two sockets by turns, and their names; a search finds them."""
    model, chance = TipModel(robot(UR10, "tool0")), np.random.default_rng(3)
    tool, rows, names = np.array([0.03, -0.05, 0.12]), [], []
    goals = {"left": np.array([0.7, 0.2, 0.3]), "right": np.array([0.5, -0.5, 0.4])}
    while len(rows) < 24:
        name = list(goals)[len(rows) % 2]

        def off(q: np.ndarray, goal: np.ndarray = goals[name]) -> np.ndarray:
            T = model.tips(q[None])[0]
            return T[:3, :3] @ tool + T[:3, 3] - goal

        found = least_squares(off, chance.uniform(-2.0, 2.0, 6))
        if found.cost < 1e-16 and np.abs(found.x).max() < 6.0:
            rows.append(np.degrees(found.x))
            names.append(name)
    return np.array(rows) + 1e-3 * chance.standard_normal((24, 6)), names


def sockets(title: str | None, first: float | None = None) -> str:
    joints, names = touched()
    if first is not None:
        return text(None, [np.arange(24), [first + (name == "left") for name in names], joints])
    return text(None if title is None else [*J, title], [joints, names])
