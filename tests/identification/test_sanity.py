"""Mistakes made on independently simulated machines are named; sound machines, badly made ones too, are left alone."""

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.foundations.errors import MeasurementError
from calib.identification import sanity
from calib.identification.sanity import signatures
from calib.identification.targets import Target
from calib.job.inputs import load
from calib.measurement.checks import Finding
from calib.robot.urdf import parse_urdf
from scripts.examples import ur10_leica_job as job
from tests.support import machines, touching
from tests.support.machines import Array, Machine, anywhere, pose

UR10 = ("example:ur_description/urdf/ur10_robot.urdf", "tool0")
UR5 = ("example:ur_description/urdf/ur5_robot.urdf", "tool0")
PANDA = ("example:panda_description/urdf/panda.urdf", "panda_hand_tcp")
ARMS = {"ur10": UR10, "panda": PANDA} | {name: (machines.INLINE[name], "tip") for name in ("scara", "gantry", "skew")}
LINKS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
JOINTS = {
    "ur10": tuple(f"{name}_joint" for name in LINKS),
    "panda": tuple(f"panda_joint{i}" for i in range(1, 8)),
}
TOOL = pose((0.05, 0.02, 0.15), (0.3, -0.4, 0.5))
ROWS = 45

Columns = dict[str, object]
Spoil = Callable[[Columns], Columns]


class Lab:
    """A machine with ordinary errors, 1 mm, 2 mrad and zeros 1 deg off, and the table somebody makes of it."""

    def __init__(self, name: str, observes: str = "position", seed: int = 0) -> None:
        self.rng = np.random.default_rng(seed)
        self.robot, self.arm, self.observes = machines.load(*ARMS[name]), machines.arm(*ARMS[name]), observes
        badly_made = self.arm.moved(self.rng, length=1e-3, angle=2e-3, zero=np.radians(1.0))
        self.true = Machine(badly_made, anywhere(self.rng), {"tool": TOOL})

    def columns(self, rows: int = ROWS) -> Columns:
        readings = self.arm.draw(self.rng, rows)
        poses = self.true.see(readings).copy()
        poses[:, :3, 3] += self.rng.normal(scale=5e-5, size=(rows, 3))
        return machines.table(self.arm, readings, poses, self.observes)

    def measure(self, spoil: Spoil = dict, rows: int = ROWS) -> calib.Measurements:
        return calib.read_measurements(spoil(self.columns(rows)), self.robot, self.observes)

    def model(self, **options: object) -> calib.ErrorModel:
        return machines.model(self.robot, **({"tool": "pose" if self.observes == "pose" else "position"} | options))

    def sentence(self, spoil: Spoil, **options: object) -> str:
        (finding,) = signatures(self.model(**options), [self.measure(spoil)])
        assert finding.severity == "error", finding
        return finding.sentence


def changed(columns: Columns, names: Sequence[str], change: Callable[[Array], Array]) -> Columns:
    """The columns (N, k) of some names, changed."""
    values = change(np.column_stack([columns[name] for name in names]))
    return columns | {name: values[:, k] for k, name in enumerate(names)}


def joint(name: str, change: Callable[[Array], Array], unit: str = "rad") -> Spoil:
    return lambda columns: changed(columns, [f"{name} [{unit}]"], change)


def joints(names: Sequence[str], change: Callable[[Array], Array]) -> Spoil:
    return lambda columns: changed(columns, [f"{name} [rad]" for name in names], change)


def xyz(change: Callable[[Array], Array]) -> Spoil:
    return lambda columns: changed(columns, ["x [m]", "y [m]", "z [m]"], change)


def wxyz(change: Callable[[Array], Array]) -> Spoil:
    return lambda columns: changed(columns, ["qw", "qx", "qy", "qz"], change)


def reversed_frames(columns: Columns) -> Columns:
    R = Rotation.from_quat(np.column_stack([columns[q] for q in ("qw", "qx", "qy", "qz")]), scalar_first=True)
    columns = xyz(lambda x: -R.inv().apply(x))(columns)
    return wxyz(lambda q: q * np.array([1.0, -1.0, -1.0, -1.0]))(columns)


def other_euler(meant: str, taken: str) -> Spoil:
    """The angles of convention ``meant``, made into quaternions by convention ``taken`` (capitals: intrinsic)."""

    def change(q: Array) -> Array:
        angles = Rotation.from_quat(q, scalar_first=True).as_euler(meant)
        return Rotation.from_euler(taken, angles).as_quat(scalar_first=True)

    return wxyz(change)


# ---- readings

EACH_JOINT = [(arm, name) for arm, names in JOINTS.items() for name in names]


@pytest.mark.parametrize("observes", ["position", "pose"])
@pytest.mark.parametrize(("arm", "name"), EACH_JOINT)
def test_flipped_sign(arm: str, name: str, observes: str) -> None:
    sentence = Lab(arm, observes).sentence(joint(name, np.negative))
    assert f"it looks as if {name!r} is read with the wrong sign" in sentence


@pytest.mark.parametrize("observes", ["position", "pose"])
@pytest.mark.parametrize(("degrees", "needs"), [(-90.0, "+90"), (90.0, "-90"), (180.0, "180")])
@pytest.mark.parametrize(("arm", "name"), [each for each in EACH_JOINT if each[1] not in {"panda_joint7"}])
def test_shifted_zero(arm: str, name: str, degrees: float, needs: str, observes: str) -> None:
    lab = Lab(arm, observes)
    spoil = joint(name, lambda q: q + np.radians(degrees))
    if name in (JOINTS[arm][0], JOINTS[arm][-1]):
        assert signatures(lab.model(), [lab.measure(spoil)]) == ()  # base and tool absorb it
    else:
        # Half a turn may be the sign of another joint just as well; then both are said.
        assert f"{name!r} is read from another zero and needs {needs} deg" in lab.sentence(spoil)


@pytest.mark.parametrize("observes", ["position", "pose"])
@pytest.mark.parametrize("arm", JOINTS)
def test_swapped_joints(arm: str, observes: str) -> None:
    lab = Lab(arm, observes)
    pairs = list(combinations(JOINTS[arm], 2))
    for a, b in pairs if observes == "position" else pairs[::3]:
        sentence = lab.sentence(joints([a, b], lambda q: q[:, ::-1]))
        assert f"it looks as if the columns {a!r} and {b!r} are swapped:" in sentence


@pytest.mark.parametrize("sign", ["+", "-"])
@pytest.mark.parametrize("arm", JOINTS)
def test_coupled_joints(arm: str, sign: str) -> None:
    lab, a, b = Lab(arm, "position"), *JOINTS[arm][1:3]
    # As Fanuc's J3, which is read against the floor whatever J2 does.
    spoil = joints([a, b], lambda q: np.column_stack([q[:, 0], q[:, 1] - float(f"{sign}1") * q[:, 0]]))
    assert f"{a!r} and {b!r} are coupled: the joint of {b!r} stands at {b} {sign} {a}:" in lab.sentence(spoil)


@pytest.mark.parametrize("observes", ["position", "pose"])
@pytest.mark.parametrize("arm", JOINTS)
def test_degrees_and_radians(arm: str, observes: str) -> None:
    lab = Lab(arm, observes)
    assert "degrees stand under [rad]" in lab.sentence(joints(JOINTS[arm], np.degrees))
    assert "radians stand under [deg]" in lab.sentence(joints(JOINTS[arm], np.radians))


WITHOUT_INSTRUMENT: dict[str, Callable[[touching.Lab], calib.Measurements]] = {
    "socket": lambda lab: lab.sockets(14),
    "distance": lambda lab: lab.distances(40),
    "pair_distance": lambda lab: lab.pairs(40),
    "plane": lambda lab: lab.planes(14, tuple(touching.NORMALS)),
    "sphere": lambda lab: lab.sphere(40),
}


@pytest.mark.parametrize("kind", WITHOUT_INSTRUMENT)
def test_mistakes_are_named_without_an_instrument(kind: str) -> None:
    lab = touching.lab(noise=3e-5)
    model, data, names = machines.model(lab.robot), WITHOUT_INSTRUMENT[kind](lab), JOINTS["ur10"]

    def found(factor: Array) -> tuple[Finding, ...]:
        other = data.other and replace(data.other, readings=data.other.readings @ factor)
        return signatures(model, [replace(data, readings=data.readings @ factor, other=other)])

    assert found(np.eye(6)) == ()
    for k in (1, 3, 5):
        (finding,) = found(np.diag(1.0 - 2.0 * np.eye(6)[k]))
        assert finding.severity == "error"
        assert f"it looks as if {names[k]!r} is read with the wrong sign:" in finding.sentence
    (finding,) = found(np.eye(6)[[0, 2, 1, 3, 4, 5]])
    assert f"the columns {names[1]!r} and {names[2]!r} are swapped" in finding.sentence


def test_indicators_that_count_the_other_way() -> None:
    """It was said that a joint is read from another zero, by 180 deg."""
    lab = touching.lab(noise=3e-5)
    first, second = lab.indicator(20), replace(lab.indicator(20), targets=("wall",))
    frame = touching.axis_frame(touching.unit(touching.NORMALS["floor"]))
    known = {name: Target(lab.machine.base @ frame, height_is_known=False) for name in ("floor", "wall")}
    model = replace(machines.model(lab.robot), targets=known)
    assert signatures(model, [first, second]) == ()

    def said(*sets: calib.Measurements) -> str:
        (finding,) = signatures(model, sets)
        assert finding.severity == "error"
        return finding.sentence

    backward = [replace(data, value=-data.value) for data in (first, second)]
    assert "it looks as if indicators count the other way: 'indicated' has the wrong sign, or" in said(*backward)
    assert "it looks as if the indicator counts the other way:" in said(backward[0])
    assert "it looks as if the indicator 'wall' counts the other way:" in said(first, backward[1])


def test_joints_that_slide() -> None:
    lab = Lab("gantry")
    assert "'ram' is read with the wrong sign" in lab.sentence(joint("ram", np.negative, "m"))
    names = [f"{name} [m]" for name in ("bridge", "carriage", "ram")]
    millimetres = lab.sentence(lambda columns: changed(columns, names, lambda q: 1e3 * q))
    assert "millimetres stand under [m] in all joints that slide" in millimetres


# ---- positions and orientations


@pytest.mark.parametrize("observes", ["position", "pose"])
@pytest.mark.parametrize("arm", JOINTS)
@pytest.mark.parametrize(
    ("factor", "says"),
    [
        (1e3, "millimetres stand under [m]"),
        (1e-3, "metres stand under [mm]"),
        (25.4, "millimetres stand under [inch]"),
        (1.0 / 25.4, "inches stand under [mm]"),
        (1e3 / 25.4, "inches stand under [m]"),
        (25.4e-3, "metres stand under [inch]"),
    ],
)
def test_position_units(arm: str, observes: str, factor: float, says: str) -> None:
    assert f"it looks as if {says} in x, y, z:" in Lab(arm, observes).sentence(xyz(lambda x: factor * x))


COLUMNS: list[tuple[Callable[[Array], Array], str]] = [
    (lambda x: x[:, [1, 0, 2]], "the columns x and y are swapped"),
    (lambda x: x[:, [0, 2, 1]], "the columns y and z are swapped"),
    (lambda x: x[:, [2, 1, 0]], "the columns x and z are swapped"),
    (lambda x: x * [-1, 1, 1], "x has the wrong sign"),
    (lambda x: x * [1, -1, 1], "y has the wrong sign"),
    (lambda x: x * [1, 1, -1], "z has the wrong sign"),
    (lambda x: x[:, [1, 2, 0]], "x, y, z hold y, z, x"),
    (lambda x: x[:, [2, 0, 1]], "x, y, z hold z, x, y"),
]


@pytest.mark.parametrize("arm", JOINTS)
@pytest.mark.parametrize(("change", "says"), COLUMNS)
def test_position_columns(arm: str, change: Callable[[Array], Array], says: str) -> None:
    assert f"it looks as if {says}:" in Lab(arm, "pose").sentence(xyz(change))
    positions = Lab(arm)
    known = {"base": "fixed", "base_pose": positions.true.base}
    assert f"it looks as if {says}:" in positions.sentence(xyz(change), **known)
    if "hold" in says:
        assert signatures(positions.model(), [positions.measure(xyz(change))]) == ()  # a free base absorbs it
    else:
        assert "x, y, z are left-handed" in positions.sentence(xyz(change))


@pytest.mark.parametrize("arm", JOINTS)
@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (wxyz(lambda q: q[:, [1, 2, 3, 0]]), "qw, qx, qy, qz hold x, y, z, w"),
        (wxyz(lambda q: q[:, [3, 0, 1, 2]]), "qw, qx, qy, qz hold z, w, x, y"),
        (wxyz(lambda q: q * [1.0, -1.0, -1.0, -1.0]), "the rotations are inverse"),
        (reversed_frames, "the poses are inverse"),
        (other_euler("XYZ", "xyz"), "made as Rz Ry Rx (extrinsic x, y, z) of angles that mean Rx Ry Rz"),
        (other_euler("xyz", "XYZ"), "made as Rx Ry Rz (intrinsic x, y, z) of angles that mean Rz Ry Rx"),
    ],
)
def test_orientations(arm: str, spoil: Spoil, says: str) -> None:
    assert says in Lab(arm, "pose").sentence(spoil)


# ---- the sentences


def test_what_is_said() -> None:
    assert Lab("ur10").sentence(joint("elbow_joint", np.negative)) == (
        "arrays: it looks as if 'elbow_joint' is read with the wrong sign: the nominal robot misses the measurements "
        "by 729 mm rms, and by 2.6 mm with this corrected."
    )
    assert Lab("ur10").sentence(joint("wrist_3_joint", np.negative)) == (
        "arrays: it looks as if 'wrist_3_joint' is read with the wrong sign: the nominal robot misses the measurements "
        "by 51 mm rms, and by 2.6 mm with this corrected; it could also be that 'wrist_2_joint' is read from another "
        "zero and needs 180 deg."
    )
    assert Lab("panda", "pose").sentence(wxyz(lambda q: q[:, [1, 2, 3, 0]])) == (
        "arrays: it looks as if qw, qx, qy, qz hold x, y, z, w: the nominal robot misses the measurements by 2489 mm "
        "rms (1 rad counted as 1.42 m), and by 7 mm with this corrected."
    )


# ---- no mistake


@pytest.mark.parametrize("observes", ["position", "pose"])
@pytest.mark.parametrize("arm", ARMS)
@pytest.mark.parametrize("seed", range(10))
def test_badly_made_machines_are_left_alone(arm: str, observes: str, seed: int) -> None:
    lab = Lab(arm, observes, seed)
    half = np.repeat((10e-3, 5e-3), 3)
    origins = lab.rng.uniform(-half, half, (len(lab.arm.joints), 6))
    zeros = {
        j.driver: lab.rng.uniform(-1.0, 1.0) * (10e-3 if j.type == "prismatic" else np.radians(5.0))
        for j in lab.arm.joints
        if j.type != "fixed"
    }
    lab.true = replace(lab.true, arm=lab.arm.with_errors(origins, zeros))
    assert signatures(lab.model(), [lab.measure(rows=30 + 2 * seed)]) == ()
    known = {"base": "fixed", "base_pose": lab.true.base, "tool": "fixed", "tool_poses": lab.true.tools}
    assert signatures(lab.model(**known), [lab.measure(rows=30 + 2 * seed)]) == ()


def test_of_set_ups_that_are_missed_ten_are_looked_into(monkeypatch: pytest.MonkeyPatch) -> None:
    """A hundred set-ups of noise, 0.7 MB, took 25 s before they were refused for their number."""
    rng = np.random.default_rng(3)
    robot = calib.load_robot("example:ur_description/urdf/ur5_robot.urdf", "tool0")
    n = 25 * 20
    columns = {f"{reading.name} [rad]": rng.uniform(-1.5, 1.5, n) for reading in robot.readings}
    columns |= {f"{axis} [m]": rng.normal(0.0, 0.5, n) for axis in "xyz"}
    columns["setup"] = np.array([f"s{k % 25}" for k in range(n)])
    data = calib.read_measurements(columns, robot, sigma=1e-4)
    tried = []
    trials = sanity._trials
    monkeypatch.setattr(sanity, "_trials", lambda *given: tried.append(None) or trials(*given))
    found = signatures(calib.error_model(robot, offsets="all"), [data])
    assert len(tried) == 10
    assert 0 < len(found) <= 10


def test_tables_of_other_set_ups_are_not_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every table was taken apart for every set-up: 80 set-ups with a hundred tables took 15 s."""
    lab = Lab("ur10")
    tables = [replace(lab.measure(), setups=(f"s{k}",)) for k in range(6)]
    asked: list[str] = []
    real = calib.Measurements.at
    monkeypatch.setattr(calib.Measurements, "at", lambda data, setup: (asked.append(setup), real(data, setup))[1])
    signatures(lab.model(), tables)
    assert asked == [f"s{k}" for k in range(6)]


def test_a_sound_table_costs_no_trial(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(sanity, "_trials")
    lab = Lab("panda")
    assert signatures(lab.model(), [lab.measure(rows=500)]) == ()


def test_few_rows_say_nothing() -> None:
    lab = Lab("ur10")
    data = lab.measure(joint("elbow_joint", np.negative))
    assert signatures(lab.model(), []) == ()
    assert all(signatures(lab.model(), [data.subset(range(n))]) == () for n in (0, 1, 5, 9))
    assert all(signatures(lab.model(), [data.subset(range(n))])[0].code == "flipped-sign" for n in (10, 12, 20))


def test_another_robot_is_refused() -> None:
    with pytest.raises(MeasurementError, match="are not those of the robot"):
        signatures(Lab("panda").model(), [Lab("ur10").measure()])


# ---- other set-ups


@pytest.mark.parametrize("observes", ["position", "pose"])
def test_known_frames_show_the_zeros_of_the_first_and_the_last_joint(observes: str) -> None:
    lab = Lab("ur10", observes)
    base = {"base": "fixed", "base_pose": lab.true.base}
    half_a_turn = joint("shoulder_pan_joint", lambda q: q + np.pi)
    assert "'shoulder_pan_joint' is read from another zero and needs 180 deg" in lab.sentence(half_a_turn, **base)
    tool = {"tool": "fixed", "tool_poses": lab.true.tools}
    quarter = joint("wrist_3_joint", lambda q: q - np.pi / 2)
    assert "'wrist_3_joint' is read from another zero and needs +90 deg" in lab.sentence(quarter, **tool)
    assert "'elbow_joint' is read with the wrong sign" in lab.sentence(
        joint("elbow_joint", np.negative), **base, **tool
    )


def test_one_of_two_tables() -> None:
    lab = Lab("panda")
    sound = replace(lab.measure(), where="a.csv")
    spoiled = replace(lab.measure(xyz(lambda x: 1e3 * x)), where="b.csv")
    (finding,) = signatures(lab.model(), [sound, sound.subset([]), spoiled])
    assert finding.code == "position-unit"
    assert finding.sentence.startswith("b.csv: it looks as if millimetres stand under [m]")


def test_several_tools() -> None:
    lab = Lab("ur10")
    lab.true = replace(lab.true, tools={"a": TOOL, "b": pose((-0.1, 0.05, 0.1))})
    readings = lab.arm.draw(lab.rng, 60)
    points = ["a", "b"] * 30
    data = lab.true.measure(lab.robot, readings, points=points)
    assert signatures(lab.model(), [data]) == ()
    signs = np.where(np.arange(6) == 4, -1.0, 1.0)
    (finding,) = signatures(lab.model(), [replace(data, readings=data.readings * signs)])
    assert "'wrist_2_joint' is read with the wrong sign" in finding.sentence


# ---- what is no single mistake


def test_another_size_of_the_family() -> None:
    lab = Lab("ur10")
    small = machines.load(*UR5)
    (finding,) = signatures(calib.error_model(small), [lab.measure()])
    assert (finding.severity, finding.code) == ("error", "another-size")
    assert "the machine is 1.4" in finding.sentence


@pytest.mark.parametrize("observes", ["position", "pose"])
def test_what_nothing_explains(observes: str) -> None:
    lab = Lab("ur10", observes)
    data = lab.measure()
    shuffled = replace(data, readings=data.readings[lab.rng.permutation(len(data))])
    (finding,) = signatures(lab.model(), [shuffled])
    assert (finding.severity, finding.code) == ("warning", "unexplained")


@pytest.mark.parametrize("tables", [1, 2])
def test_poses_of_a_tool_that_is_turned_on_its_link_ask_for_its_pose(tables: int) -> None:
    """A camera on the wrist, say: two tables were said to have a tool each, whose pose was then free as well."""
    lab = Lab("panda", "pose")
    (finding,) = signatures(lab.model(tool="position"), [lab.measure() for _ in range(tables)])
    assert (finding.severity, finding.code) == ("error", "turned-tool")
    assert 'it looks as if the tool is turned on its link, which tool = "pose" finds: ' in finding.sentence


def test_an_instrument_that_stopped_is_not_taken_for_degrees() -> None:
    lab = Lab("ur10")
    data = lab.measure()
    assert data.position is not None
    stopped = replace(data, position=np.broadcast_to(data.position[0], data.position.shape))
    (finding,) = signatures(lab.model(), [stopped])
    assert (finding.severity, finding.code) == ("warning", "unexplained")


def test_of_loops_it_is_asked_how_they_close() -> None:
    """A four-bar that was assembled the other way round misses by decimetres, and nothing said where to look."""
    inputs = load(Path(__file__).resolve().parents[2] / "robots/irb2400/calibration.toml")
    data = inputs.identify[2]
    assert data.position is not None
    (finding,) = signatures(inputs.model, [replace(data, position=data.position[::-1])])
    assert (finding.severity, finding.code) == ("warning", "unexplained")
    assert ", does a loop close another way than the URDF draws it, do readings" in finding.sentence


def test_two_mistakes_are_not_taken_for_one() -> None:
    lab = Lab("panda")
    swapped = joints(["panda_joint4", "panda_joint6"], lambda q: q[:, ::-1])
    data = lab.measure(lambda columns: joint("panda_joint2", np.negative)(swapped(columns)))
    (finding,) = signatures(lab.model(), [data])
    assert (finding.severity, finding.code) == ("warning", "unexplained")
    assert "rms, and no typical mistake explains it" in finding.sentence
    assert finding.sentence.endswith("or are there two mistakes?")


@pytest.mark.parametrize("seed", range(5))
def test_a_wrong_base_is_asked_for(seed: int) -> None:
    lab = Lab("panda", seed=seed)
    (finding,) = signatures(lab.model(base="fixed", base_pose=anywhere(lab.rng)), [lab.measure()])
    assert finding.code == "unexplained"
    assert "is the given base right" in finding.sentence


# ---- a real robot


@pytest.mark.skipif("CALIB_DATASETS" not in os.environ, reason="CALIB_DATASETS names no folder of real measurements")
@pytest.mark.parametrize("observes", ["position", "pose"])
def test_a_real_ur10(observes: str) -> None:
    columns = job.table_columns(job.read(Path(os.environ["CALIB_DATASETS"]) / "ur10_leica"), observes)
    robot = machines.load(*UR10)
    data = calib.read_measurements(columns, robot, observes)
    model = calib.error_model(robot, tool="pose" if observes == "pose" else "position")
    assert signatures(model, [data]) == ()
    for k, name in enumerate(JOINTS["ur10"][:-1]):
        flipped = replace(data, readings=data.readings * np.where(np.arange(6) == k, -1.0, 1.0))
        (finding,) = signatures(model, [flipped])
        assert f"it looks as if {name!r} is read with the wrong sign" in finding.sentence


@pytest.mark.parametrize("observes", ["position", "pose"])
@pytest.mark.parametrize(
    ("what", "code"),
    [
        (("tool",), "own-tools"),
        (("setup",), "own-set-ups"),
        (("tool", "setup"), "own-tools-and-set-ups"),
        ((), None),
    ],
)
def test_what_each_table_has_of_its_own_is_named(observes: str, what: tuple[str, ...], code: str | None) -> None:
    lab = Lab("ur10", observes)
    one = replace(lab.measure(), where="one.csv")
    if "tool" in what:
        lab.true = replace(lab.true, tools={"tool": pose((-0.12, 0.09, 0.02), (1.0, 0.4, -0.7))})
    if "setup" in what:
        lab.true = replace(lab.true, base=anywhere(lab.rng))
    two = replace(lab.measure(), where="two.csv")
    found = signatures(lab.model(), [one, two])
    assert [finding.code for finding in found] == ([code] if code else [])
    named = sanity.apart(lab.model(), [one, two])
    assert (() if named is None else named.what) == what
    if what:
        assert " and ".join(f'{name} = "..."' for name in what) + " name" in found[0].sentence
        # Named, nothing is missed.
        own = [data.named(**dict.fromkeys(what, str(k))) for k, data in enumerate((one, two))]
        assert signatures(lab.model(), own) == ()
        assert sanity.apart(lab.model(), own) is None


@pytest.mark.parametrize(
    "spoil",
    [
        joint("elbow_joint", lambda v: -v),
        joint("wrist_2_joint", lambda v: v + np.pi / 2),
        joints(["shoulder_lift_joint", "elbow_joint"], lambda v: v[:, ::-1]),
    ],
    ids=["sign", "zero", "swapped"],
)
def test_a_mistake_in_one_table_is_no_tool_and_no_set_up_of_its_own(spoil: Spoil) -> None:
    lab = Lab("ur10")
    tables = [replace(lab.measure(), where="one.csv"), replace(lab.measure(spoil), where="two.csv")]
    (finding,) = signatures(lab.model(), tables)
    assert finding.code in ("flipped-sign", "shifted-zero", "swapped-joints")
    assert finding.sentence.startswith("two.csv: ")
    assert sanity.apart(lab.model(), tables) is None


@pytest.mark.parametrize("wrong", [5])
def test_a_mistake_in_one_of_many_tables_is_sought_in_few(wrong: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Forty tables of a wrong robot took over a minute, as every mistake was tried in every table by itself."""
    robot = calib.load_robot("example:ur_description/urdf/ur10_robot.urdf", tip="tool0")
    rng = np.random.default_rng(4)
    model = calib.error_model(robot, offsets="all")

    def tables(flipped: Sequence[int]) -> list[calib.Measurements]:
        found = []
        for k in range(6):
            q = rng.uniform(-1.5, 1.5, (10, 6))
            xyz = robot.tips(q)[:, :3, 3]
            q[:, 2] *= -1.0 if k in flipped else 1.0
            found.append(calib.positions(robot, q, xyz, sigma=1e-4))
        return found

    tried: list[tuple[int, ...]] = []
    real = sanity._trials
    monkeypatch.setattr(
        sanity, "_trials", lambda model, sets, scope, on: (tried.append(scope), real(model, sets, scope, on))[1]
    )
    (found,) = signatures(model, tables([wrong]))
    assert found.severity == "error"
    assert (wrong,) in tried
    assert "'elbow_joint' is read with the wrong sign" in found.sentence
    tried.clear()
    signatures(model, tables(range(0, 6, 2)))
    assert [len(scope) for scope in tried] == [6, 1, 1, 1]


def test_touches_of_an_arm_of_many_joints_have_no_mistake_that_is_tried() -> None:
    """Nothing was tried, and the best of it was asked for: a traceback."""
    axes, n = ("0 0 1", "0 1 0", "1 0 0"), 18
    joints = "".join(
        f'<link name="l{k + 1}"/><joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/>'
        f'<origin xyz="0.1 0 0.1"/><axis xyz="{axes[k % 3]}"/><limit lower="-3" upper="3"/></joint>'
        for k in range(n)
    )
    robot = calib.load_robot(parse_urdf(f'<robot name="r"><link name="l0"/>{joints}</robot>'.encode(), "long.urdf"))
    rng = np.random.default_rng(0)
    columns = {f"j{k} [rad]": rng.uniform(-2.0, 2.0, 300) for k in range(n)}
    touched = calib.read_measurements(
        columns | {"target": [f"s{k % 6}" for k in range(300)]}, robot, "socket", sigma=1e-4
    )
    (finding,) = signatures(calib.error_model(robot, base="fixed"), [touched])
    assert finding.code == "unexplained" and "the nearest" not in finding.sentence
