"""Several tips of one tree, from a job file through the command line: export, compensation, the scene, bad frames."""

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.assessment.choice import candidates
from calib.job.arm import read_arm
from calib.job.inputs import load
from calib.job.schema import InstrumentSection
from calib.robot.links import arm_of, link_placements
from calib.robot.terms import kind_of
from calib.robot.urdf import parse_urdf
from tests.support.cases import run, write_table
from tests.support.machines import anywhere, pose
from tests.support.trees import TIPS, TOOLS, Tree, gap, touching, tree, urdf

SIGMA = 3e-5
JOB = """
schema = 1
[robot]
urdf = "tree.urdf"
tip = "right_hand"
[error_model]
offsets = "all"
placements = "all"
"""
RIGHT = '[[measurements]]\nfile = "right.csv"\nsigma = "0.03 mm"\n'
LEFT = '[[measurements]]\nfile = "left.csv"\ntip = "left_hand"\nsigma = "0.03 mm"\n'
TOUCH = '[[measurements]]\nfile = "touch.csv"\nobserves = "socket"\ntip = "left_hand"\nsigma = "0.03 mm"\n'
ON = '[targets.a]\non = "right_hand"\n[targets.b]\non = "right_hand"\nposition = ["-60 mm", "30 mm", "120 mm"]\n'


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Tree]:
    """Both hands tracked, the right one without a column of the left arm and the other way round; and they touch."""
    folder, rng = tmp_path_factory.mktemp("tree"), np.random.default_rng(4)
    made, base = tree(rng), anywhere(rng)
    (folder / "tree.urdf").write_text(urdf(), encoding="utf-8")
    for name, tip, n in (("right", "right_hand", 120), ("left", "left_hand", 120), ("judge", "left_hand", 40)):
        q = made.draw(rng, n)
        seen = (base @ made.link(tip, q) @ TOOLS[tip])[:, :3, 3] + rng.normal(scale=SIGMA, size=(n, 3))
        write_table(
            folder / f"{name}.csv", made.columns(q, (tip,)) | {f"{k} [m]": seen[:, i] for i, k in enumerate("xyz")}
        )
    places = np.repeat([(0.05, 0.02, 0.15), (-0.06, 0.03, 0.12)], 30, axis=0)
    q = touching(made, rng, places + rng.normal(scale=SIGMA, size=places.shape))
    # The head moves as well, and matters to nothing.
    write_table(folder / "touch.csv", made.columns(q) | {"target": ["a"] * 30 + ["b"] * 30})
    return folder, made


def test_two_arms_that_touch_each_other(cell: tuple[Path, Tree]) -> None:
    folder, made = cell
    job, out = folder / "job.toml", folder / "out"
    judge = LEFT.replace("left.csv", "judge.csv") + 'use = "validate"\n'
    job.write_text(JOB + ON + RIGHT + LEFT + TOUCH + judge, encoding="utf-8")
    said = run("calibrate", job, "-o", out)
    assert said.code == 0, said
    assert "joints that move nothing that was measured, and are left out: 'neck', 'nod'" in " ".join(said.out.split())
    result = json.loads((out / "result.json").read_text())
    names = {record["name"] for record in result["parameters"]}
    assert {"tool.x", "tool.left_hand.x", "target.a.x", "waist.offset", "left_wrist.rx"} <= names
    assert not {"target.b.x", "neck.offset"} & names
    assert result["metrics"]["validation"]["after"]["position"]["rms"] < 3 * SIGMA

    machine = calib.load_machine(out)
    assert machine.robot.links == TIPS[:2]
    q = made.draw(np.random.default_rng(0), 100)[:, [made.names.index(r.name) for r in machine.robot.readings]]
    # The calibrated URDF holds both arms.
    again = calib.load_robot(out / "calibrated.urdf", TIPS[0], links=[TIPS[1]])
    for tip, tool in zip(TIPS, ("tool", "left_hand"), strict=False):
        np.testing.assert_allclose(again.with_tip(tip).tips(q), machine.of(tool).tips(q), atol=1e-9)
    said = run("verify", out, folder / "judge.csv", "--tool", "left_hand")
    # Nor is the right arm at zero, of which that table has no column, told to be where nothing was measured.
    assert said.code == 0 and "outside the range" not in said.out, said
    assert run("uncertainty", out, "--tool", "left_hand", "--samples", "20", "-q").code == 0
    mapped = calib.judging.uncertainty_map(machine, 5, tool="left_hand")
    places = machine.of("left_hand").tips(mapped.readings) @ machine.tools["left_hand"]
    np.testing.assert_allclose(mapped.positions, places[:, :3, 3], atol=1e-12)

    # As an instrument it touches with the tool that is named, of whichever hand.
    section = InstrumentSection.model_validate(
        {"kind": "arm", "model": "out", "tool": "left_hand", "sigma": "0.03 mm"}, context={"folder": folder}
    )
    touched = read_arm("left", section, folder).arm.points(q)
    np.testing.assert_allclose(
        touched, (machine.of("left_hand").tips(q) @ machine.tools["left_hand"])[:, :3, 3], atol=1e-9
    )

    # Corrected commands of one arm are of its joints alone, and take it where they say.
    wanted = {f"{name} [rad]": q[:5, k] for k, name in enumerate(r.name for r in machine.robot.readings)}
    wanted = {name: values for name, values in wanted.items() if not name.startswith("right_")}
    write_table(folder / "wanted.csv", wanted)
    options = ("--tool", "left_hand", "--what", "position", "-q")
    assert run("compensate", out, folder / "wanted.csv", "-o", folder / "corrected.csv", *options).code == 0
    with (folder / "corrected.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert set(wanted) < set(rows[0]) and not any(name.startswith("right_") for name in rows[0])
    found = q[:5].copy()
    for k, reading in enumerate(machine.robot.readings):
        if f"{reading.name} [rad]" in wanted:
            found[:, k] = [float(row[f"{reading.name} [rad]"]) for row in rows]
    nominal = machine.robot.with_tip("left_hand").tips(q[:5]) @ machine.tools["left_hand"]
    reached = machine.of("left_hand").tips(found) @ machine.tools["left_hand"]
    np.testing.assert_allclose(reached[:, :3, 3], nominal[:, :3, 3], atol=2e-6)


def test_commands_take_an_arm_of_several_by_name(cell: tuple[Path, Tree], tmp_path: Path) -> None:
    """What a controller of the left arm takes, and poses that calibrate it; the picture shows the tools of both."""
    folder, _ = cell
    job, out = folder / "both.toml", folder / "both"
    job.write_text(JOB + ON + RIGHT + LEFT + TOUCH, encoding="utf-8")
    assert run("calibrate", job, "-o", out, "-q").code == 0
    costs = []
    for k, options in enumerate(((), ("--tool", "left_hand"))):
        said = run("export", out, "--to", "ros", "-o", tmp_path / f"{k}.yaml", "--json", *options)
        assert said.code == 0, said
        costs.append(json.loads(said.out)["before"])
        written = (tmp_path / f"{k}.yaml").read_text()
        tip, tool = (("right_hand", "tool"), ("left_hand", "left_hand"))[k]
        assert f'tip_link: "{tip}"' in written
        assert re.findall(r'- name: "(\S+)"\n\s+xyz', written) == [tool]
    assert costs[0] != costs[1]
    said = run("export", out, "--to", "ros", "-o", tmp_path / "none.yaml", "--tool", "tail")
    assert said.code == 1 and "'tail'" in said.err and not (tmp_path / "none.yaml").exists()

    tables = []
    for k, options in enumerate(((), ("--tip", "left_hand"))):
        said = run("plan", job, "-n", "12", "-o", tmp_path / f"{k}.csv", "--candidates", "60", "--json", *options)
        assert said.code == 0, said
        tables.append((json.loads(said.out)["rank"], (tmp_path / f"{k}.csv").read_text()))
    assert tables[0][1] != tables[1][1]
    said = run("plan", job, "-n", "12", "-o", tmp_path / "none.csv", "--tip", "tail")
    assert said.code == 1
    assert said.err.endswith("'tail' is not a tip of the job; allowed is 'right_hand', 'left_hand'.\n")

    options = ("--placed-in", "instrument", "--scene", tmp_path / "cell.html", "-q")
    assert run("cell", out, out, "-o", tmp_path / "cell.urdf", *options).code in (0, 3)
    scene = (tmp_path / "cell.html").read_text(encoding="utf-8")
    assert re.search(r'/tools/tool"', scene)
    assert re.search(r'"robot/[^"/]*left_hand/tools/left_hand"', scene)

    scene = (out / "scene.html").read_text(encoding="utf-8")
    for node in ("frames/tip/tools/tool", "robot/left_hand/tools/left_hand", "robot/right_hand/sockets/a"):
        assert f'"{node}"' in scene


def test_terms_of_one_arm_ask_nothing_of_the_table_of_the_other(tmp_path: Path) -> None:
    """Backlash and measured torques of both arms: each table tells those of its own joints alone."""
    rng = np.random.default_rng(8)
    made, base = tree(rng), anywhere(rng)
    lost, soft = rng.normal(scale=3e-4, size=(2, len(made.names)))
    (tmp_path / "tree.urdf").write_text(urdf(), encoding="utf-8")
    for name, tip, n in (("right", "right_hand", 120), ("left", "left_hand", 120), ("judge", "left_hand", 40)):
        q, own = made.draw(rng, n), {title.split()[0] for title in made.columns(np.zeros((1, len(made.names))), (tip,))}
        side, torque = rng.choice([-1.0, 1.0], q.shape), rng.normal(scale=10.0, size=q.shape)
        moved = q + lost * side - 0.1 * soft * torque
        seen = (base @ made.link(tip, moved) @ TOOLS[tip])[:, :3, 3] + rng.normal(scale=SIGMA, size=(n, 3))
        told = torque + rng.normal(scale=0.1, size=q.shape)
        columns = made.columns(q, (tip,)) | {f"{k} [m]": seen[:, i] for i, k in enumerate("xyz")}
        for k, joint in enumerate(made.names):
            if joint in own:
                columns[f"direction_{joint}"] = ["+" if s > 0 else "-" for s in side[:, k]]
                columns[f"tau_{joint} [Nm]"] = told[:, k]
        columns["sigma_tau [Nm]"] = np.full(n, 0.1)
        columns["tool"] = [{"right_hand": "pin", "left_hand": "ball"}[tip]] * n
        write_table(tmp_path / f"{name}.csv", columns)
        if name == "judge":
            columns = {title: values for title, values in columns.items() if title[:1] not in "xyz"}
            write_table(tmp_path / "wanted.csv", columns)
    job, out = tmp_path / "job.toml", tmp_path / "out"
    judge = LEFT.replace("left.csv", "judge.csv") + 'use = "validate"\n'
    job.write_text(JOB + 'backlash = "all"\ntorque = "all"\n' + RIGHT + LEFT + judge, encoding="utf-8")
    said = run("calibrate", job, "-o", out)
    assert said.code == 0, said
    result = json.loads((out / "result.json").read_text())
    assert result["metrics"]["validation"]["after"]["position"]["rms"] < 3 * SIGMA
    known = {record["name"]: record for record in result["parameters"]}
    for k, joint in enumerate(made.names):
        for name, true in ((f"{joint}.backlash", lost[k]), (f"{joint}.torque", 0.1 * soft[k])):
            if name in known:
                assert abs(known[name]["value"] - true) < 4.0 * known[name]["sigma"]
    # The column says whose rows these are, of the hand that is not the first one.
    said = run("verify", out, tmp_path / "judge.csv")
    assert said.code == 0, said
    options = ("--what", "position", "-q")
    said = run("compensate", out, tmp_path / "wanted.csv", "-o", tmp_path / "corrected.csv", *options)
    assert said.code == 0, said
    # Of the joints that move the targets all is to be told.
    table = (tmp_path / "wanted.csv").read_text().replace("direction_left_wrist", "group")
    (tmp_path / "unsaid.csv").write_text(table)
    said = run("compensate", out, tmp_path / "unsaid.csv", "-o", tmp_path / "none.csv", *options)
    assert said.code == 1 and "there is no column 'direction_left_wrist'" in said.err


def test_hands_alone_leave_the_torso_unseen(cell: tuple[Path, Tree]) -> None:
    folder, made = cell
    job, out = folder / "hands.toml", folder / "hands"
    job.write_text(JOB + ON + TOUCH, encoding="utf-8")
    run("calibrate", job, "-o", out, "-q")
    machine = calib.load_machine(out)
    chosen = [made.names.index(reading.name) for reading in machine.robot.readings]
    q = touching(made, np.random.default_rng(3), np.tile((0.0, -0.03, 0.14), (20, 1)))
    assert np.abs(gap(made, q) - (0.0, -0.03, 0.14)).max() < 1e-9
    off = []
    for d in (machine.deviations, None):
        right, left = (machine.robot.with_tip(tip).tips(q[:, chosen], d) for tip in TIPS[:2])
        x = (np.linalg.inv(right) @ left @ machine.tools["left_hand"])[:, :3, 3]
        off.append(np.linalg.norm(x - (0.0, -0.03, 0.14), axis=1).max())
    assert off[0] < 0.5 * off[1]


EYE = """
[instruments.eye]
kind = "camera"
camera_on = {}
sigma = "0.05 px"
fx = "800 px"
fy = "800 px"
cx = "500 px"
cy = "500 px"
[[measurements]]
file = "pixels.csv"
observes = "pixels"
tip = "left_hand"
instrument = "eye"
"""


def test_a_camera_on_the_head_sees_a_mark_on_the_hand(cell: tuple[Path, Tree]) -> None:
    folder, made = cell
    rng = np.random.default_rng(9)
    q = made.draw(rng, 30_000, 0.9)
    eye = pose((0.02, 0.06, 0.05), (-1.9, 0.1, 0.1))
    x = (np.linalg.inv(made.link("head", q) @ eye) @ made.link("left_hand", q) @ TOOLS["left_hand"])[:, :3, 3]
    good = np.flatnonzero((x[:, 2] > 0.2) & (np.abs(x[:, :2]).max(axis=1) < x[:, 2]))[:150]
    u, v = (800.0 * x[good, :2] / x[good, 2:] + 500.0 + rng.normal(scale=0.05, size=(len(good), 2))).T
    write_table(folder / "pixels.csv", made.columns(q[good], TIPS[1:]) | {"u [px]": u, "v [px]": v})
    job, out = folder / "eye.toml", folder / "eye"
    accepting = JOB.replace("schema = 1", 'schema = 1\naccept = ["lens"]')
    job.write_text(accepting + EYE.replace("{}", '{ link = "head" }') + LEFT, encoding="utf-8")
    said = run("calibrate", job, "-o", out)
    assert said.code == 0, said
    result = json.loads((out / "result.json").read_text())
    assert result["metrics"]["identification"]["after"]["pixels"]["rms"] < 0.1
    found = np.array(result["targets"]["target"]["position"])
    assert np.linalg.norm(found - eye[:3, 3]) < 5e-3
    for place, sentence in (
        ('{ link = "left_hand" }', "the target 'target' is on 'left_hand', which carries the tool as well"),
        ('{ link = "tail" }', "link 'tail' is not a link of the URDF"),
        ('"ceiling"', "instruments.eye.camera_on: 'ceiling' is not"),
        ("{ on = 3 }", "instruments.eye.camera_on: a section with keys is not"),
    ):
        job.write_text(JOB + EYE.replace("{}", place), encoding="utf-8")
        said = run("calibrate", job, "-o", folder / "none")
        assert (said.code, said.out, said.err.count("\n")) == (1, "", 1)
        assert sentence in said.err, said.err


COUPLED = """
[[robot.coupling]]
joint = "chest"
drivers = { waist = -0.5, lean = -1.0 }
"""


def test_a_torso_joint_that_undoes_others(cell: tuple[Path, Tree], tmp_path: Path) -> None:
    """A joint without a reading of its own between base and both arms: in the fit, the URDF and the picture alike."""
    rng, document = np.random.default_rng(6), parse_urdf(urdf("revolute").encode(), "tree.urdf")
    coupling = calib.Coupling("chest", {"waist": -0.5, "lean": -1.0})
    robot = calib.load_robot(document, "right_hand", links=["left_hand"], couplings=[coupling])
    true = calib.Deviations(
        rng.normal(scale=5e-4, size=(len(robot.chain), 6)), rng.normal(scale=5e-3, size=len(robot.moving))
    )
    (tmp_path / "tree.urdf").write_text(urdf("revolute"), encoding="utf-8")
    for name, tip in (("right", "right_hand"), ("left", "left_hand")):
        q, at = rng.uniform(-1.0, 1.0, (150, len(robot.readings))), robot.with_tip(tip)
        seen = (at.tips(q, true) @ TOOLS[tip])[:, :3, 3] + rng.normal(scale=SIGMA, size=(150, 3))
        told = at.driving((tip,))
        columns = {f"{r.name} [rad]": q[:, k] for k, r in enumerate(robot.readings) if r.name in told}
        write_table(tmp_path / f"{name}.csv", columns | {f"{k} [m]": seen[:, i] for i, k in enumerate("xyz")})
    (tmp_path / "job.toml").write_text(JOB + COUPLED + RIGHT + LEFT, encoding="utf-8")
    assert run("calibrate", tmp_path / "job.toml", "-o", tmp_path / "out", "-q").code == 0
    machine = calib.load_machine(tmp_path / "out")
    assert machine.robot.couplings == (coupling,)
    q = rng.uniform(-1.0, 1.0, (50, len(robot.readings)))
    # One forward kinematics of all links: the picture's is the robot's, also behind the coupled joint.
    arm = arm_of(machine.robot, machine.deviations, q, np.eye(4))
    placed = link_placements(machine.robot.urdf, arm)
    for tip, tool in zip(TIPS, ("tool", "left_hand"), strict=False):
        np.testing.assert_allclose(placed[tip], machine.of(tool).tips(q), atol=1e-12)
        found = (machine.base @ machine.of(tool).tips(q) @ machine.tools[tool])[:, :3, 3]
        expected = (robot.with_tip(tip).tips(q, true) @ TOOLS[tip])[:, :3, 3]
        assert np.sqrt(np.mean(np.sum((found - expected) ** 2, axis=1))) < 3 * SIGMA
    again = calib.load_robot(
        tmp_path / "out" / "calibrated.urdf", "right_hand", links=["left_hand"], couplings=[coupling]
    )
    for tip, tool in zip(TIPS, ("tool", "left_hand"), strict=False):
        np.testing.assert_allclose(again.with_tip(tip).tips(q), machine.of(tool).tips(q), atol=1e-9)


WRONG = {
    "tip that is none": (LEFT.replace("left_hand", "tail") + RIGHT, "link 'tail' is not a link of the URDF"),
    "target on itself": (
        ON.replace("right_hand", "left_hand") + TOUCH,
        "touch.csv: the target 'a' is on 'left_hand', which carries the tool as well",
    ),
    "target on no link": (ON.replace("right_hand", "tail") + TOUCH, "link 'tail' is not a link of the URDF"),
    "target of nothing": (ON + RIGHT, "targets: 'a' does not appear in the measurements"),
    "one tool on two tips": (
        RIGHT + 'tool = "ball"\n' + LEFT + 'tool = "ball"\n',
        "left.csv: the tool 'ball' is on 'left_hand' here and on 'right_hand' in another table",
    ),
    "joint that matters": (
        LEFT.replace("left_hand", "right_hand"),
        "left.csv: there is no column 'right_shoulder_pan', ",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_frames_are_one_sentence(cell: tuple[Path, Tree], case: str) -> None:
    folder, _ = cell
    sections, sentence = WRONG[case]
    (folder / "wrong.toml").write_text(JOB + sections, encoding="utf-8")
    said = run("calibrate", folder / "wrong.toml", "-o", folder / "none")
    assert (said.code, said.out, said.err.count("\n")) == (1, "", 1)
    assert sentence in said.err
    assert not (folder / "none").exists()


UNRELATED = {
    "two links of one name": (
        ('<link name="right_hand"/>', '<link name="right_hand"/><link name="right_hand"/>'),
        RIGHT,
        "link 'right_hand' is declared already in line",
    ),
    "a base that nothing shows": (
        ("", ""),
        RIGHT + TOUCH.replace('tip = "left_hand"', 'tip = "left_hand"\nsetup = "other"'),
        "touch.csv: nothing shows where the base is in the set-up 'other'",
    ),
}


@pytest.mark.parametrize("case", UNRELATED)
def test_frames_that_nothing_relates_and_names_that_come_twice(cell: tuple[Path, Tree], case: str) -> None:
    folder, _ = cell
    (old, new), sections, sentence = UNRELATED[case]
    text = (folder / "tree.urdf").read_text(encoding="utf-8")
    (folder / "other.urdf").write_text(text.replace(old, new, 1), encoding="utf-8")
    (folder / "wrong.toml").write_text(JOB.replace("tree.urdf", "other.urdf") + sections, encoding="utf-8")
    said = run("calibrate", folder / "wrong.toml", "-o", folder / "none")
    assert (said.code, said.out, said.err.count("\n")) == (1, "", 1)
    assert sentence in said.err, said.err
    assert not (folder / "none").exists()


def test_points_that_differ_row_by_row_on_a_second_arm(cell: tuple[Path, Tree], tmp_path: Path) -> None:
    """A depth camera on the left hand: each row says where its point is in the tool's frame."""
    folder, made = cell
    rng, base = np.random.default_rng(12), anywhere(np.random.default_rng(5))
    (tmp_path / "tree.urdf").write_text((folder / "tree.urdf").read_text(encoding="utf-8"), encoding="utf-8")
    for name, n in (("left", 150), ("judge", 40)):
        q, points = made.draw(rng, n), rng.uniform(-0.1, 0.1, (n, 3))
        placed = base @ made.link("left_hand", q) @ TOOLS["left_hand"]
        seen = placed[:, :3, 3] + (placed[:, :3, :3] @ points[:, :, None])[:, :, 0]
        seen += rng.normal(scale=SIGMA, size=(n, 3))
        columns = made.columns(q, ("left_hand",)) | {f"{k} [m]": seen[:, i] for i, k in enumerate("xyz")}
        columns |= {f"point_{k} [mm]": 1e3 * points[:, i] for i, k in enumerate("xyz")}
        write_table(tmp_path / f"{name}.csv", columns)
    judge = LEFT.replace("left.csv", "judge.csv") + 'use = "validate"\n'
    job = tmp_path / "job.toml"
    job.write_text(JOB + 'tool = "pose"\n' + LEFT + judge, encoding="utf-8")
    said = run("calibrate", job, "-o", tmp_path / "out")
    assert said.code == 0, said
    found = json.loads((tmp_path / "out" / "result.json").read_text())["metrics"]
    assert found["validation"]["after"]["position"]["rms"] < 2.5 * SIGMA * 1e3


def test_masses_are_not_offered_where_a_table_lacks_the_other_arm(cell: tuple[Path, Tree]) -> None:
    folder, _ = cell
    job = folder / "auto.toml"
    job.write_text(JOB + RIGHT + LEFT, encoding="utf-8")
    inputs = load(job)
    assert any(data.absent for data in inputs.identify)
    kinds = {kind_of(one.terms[0]).masses for one in candidates(inputs.model.urdf_robot, inputs.identify)}
    assert kinds == {"none"}
