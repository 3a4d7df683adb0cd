"""Candidates that can be measured, plans with their forecasts, and ``calib plan``."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.assessment.candidates import PlannedMeasurement, Sight, possible, random_candidates
from calib.assessment.planning import Plan, plan
from calib.foundations import rigid
from calib.foundations.errors import JobError
from calib.identification.machine import Frames
from calib.robot.sampling import joint_limits
from calib.robot.urdf import parse_urdf
from tests.support import machines
from tests.support.cases import CASE, copy_case, run
from tests.support.collisions import ARM, BALLS, ball, with_shapes
from tests.support.machines import anywhere, pose

NAME = (machines.INLINE["negative"], "tip")
FRAMES = Frames(anywhere(np.random.default_rng(3))[None], pose((0.05, 0.0, 0.1))[None])


def test_sight_is_an_angle_and_a_distance() -> None:
    sight = Sight((1.0, 0.0, 0.0), (0.0, 0.0, 2.0), np.deg2rad(30.0), 0.5, 1.5)
    turned = [pose(rotvec=(0.0, np.deg2rad(angle), 0.0)) for angle in (90, 61, 59, 119, 121, -90)]
    facing, within = sight.sees(np.stack(turned), np.zeros((6, 3)))
    assert facing.tolist() == [True, True, False, True, False, False]
    assert within.all()
    points = np.array([[0.6, 0, 0], [0.4, 0, 0], [-0.4, 0, 0], [-0.6, 0, 0]])
    assert sight.sees(np.stack(turned[:1] * 4), points)[1].tolist() == [False, True, True, False]
    assert Sight().sees(np.stack(turned), np.zeros((6, 3)))[0].all()


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"facing": (0.0, 0.0, 0.0)}, "has no direction"),
        ({"acceptance": 4.0}, "is not between 0 and 180 deg"),
        ({"nearest": 2.0, "farthest": 1.0}, "holds no distance"),
    ],
)
def test_what_no_reflector_can_do_is_refused(options: dict[str, object], why: str) -> None:
    with pytest.raises(JobError, match=why):
        Sight(**options)  # type: ignore[arg-type]


def test_random_candidates_can_be_measured() -> None:
    robot = machines.load(*NAME)
    sight = Sight((1.0, 2.0, 0.5), (0.0, 0.0, 1.0), np.deg2rad(50.0), 0.5, 5.0)
    found = random_candidates(robot, FRAMES, 60, sight)
    assert found.readings.shape == (60, 6)
    assert found.tried > 60
    assert set(found.rejected) <= {"reflector turned away", "out of the tracker's range"}
    limits = joint_limits(robot)
    assert np.all((found.readings >= limits[:, 0]) & (found.readings <= limits[:, 1]))
    T = FRAMES.base @ machines.arm(*NAME).tips(found.readings)
    point = (T @ FRAMES.tools[0])[:, :3, 3]
    to_tracker = np.array([1.0, 2.0, 0.5]) - point
    distance = np.linalg.norm(to_tracker, axis=1)
    assert np.all((distance > 0.5) & (distance < 5.0))
    assert np.all(np.sum(T[:, :3, 2] * to_tracker, axis=1) / distance > np.cos(np.deg2rad(50.0)))
    np.testing.assert_array_equal(found.readings, random_candidates(robot, FRAMES, 60, sight).readings)


def test_what_is_in_the_way_of_candidates_is_said() -> None:
    robot = machines.load(*NAME)
    with pytest.raises(JobError, match=r"only 0 of 200 random poses can be measured, and 20 are asked for: 200 out of"):
        random_candidates(robot, FRAMES, 20, Sight(nearest=500.0), most_tries=10)
    beyond = np.array([[0.0] * 6, [9.0] + [0.0] * 5])
    found = possible(robot, FRAMES, beyond)
    assert (len(found.readings), found.rejected) == (1, {"outside the joints' limits": 1})


def planned(count: int = 12, **options: object) -> Plan:
    robot = machines.load(*NAME)
    model = calib.error_model(robot, offsets="all", placements="all")
    measurement = PlannedMeasurement(FRAMES, misfit=0.2e-3)
    candidates = random_candidates(robot, FRAMES, 150).readings
    return plan(model, count, candidates=candidates, measurement=measurement, **options)  # type: ignore[arg-type]


def test_a_plan_is_of_candidates_and_forecasts_less_error_for_more_poses() -> None:
    found = planned(20, target=0.3e-3)
    candidates = random_candidates(machines.load(*NAME), FRAMES, 150).readings
    np.testing.assert_array_equal(found.readings, candidates[list(found.chosen)])
    assert len(set(found.chosen)) == 20
    assert [f.poses for f in found.forecasts] == [10, 15, 20, 30, 40]
    chosen, random = (np.array([getattr(f, who) for f in found.forecasts]) for who in ("chosen", "random"))
    assert np.all(np.diff(chosen) < 0.0)
    assert np.all(chosen < random)
    assert set(found.indices) == set(found.random_indices) == {"O1", "O2", "O3", "O4", "O5"}
    assert found.enough is not None
    assert planned(20, target=1e-9).enough is None


def test_progress_is_told_for_every_design_that_is_made() -> None:
    told: list[tuple[int, int]] = []
    found = planned(20, progress=lambda done, of: told.append((done, of)))
    assert told == [(k, len(found.forecasts) + 1) for k in range(len(found.forecasts) + 2)]


def test_enough_poses_are_enough_and_one_fewer_is_not() -> None:
    target = 0.25e-3
    found = planned(20, target=target)
    assert found.enough is not None
    assert 9 <= found.enough < 40
    # The best design of as many poses is no worse than the best sequence.
    assert planned(found.enough).forecasts[-3].chosen <= target * 1.001


def test_measured_poses_are_completed() -> None:
    first = planned(20, target=0.25e-3)
    more = planned(20, target=0.25e-3, measured=first.readings)
    assert more.enough is not None
    assert first.enough is not None
    assert more.enough < first.enough
    at_20 = {f.poses: f.chosen for f in first.forecasts}
    assert {f.poses: f.chosen for f in more.forecasts}[20] < at_20[20]


@pytest.mark.parametrize("count", [0, -3, 1001, 10**12])
def test_how_many_poses_a_plan_may_have(tmp_path: Path, count: int) -> None:
    said = rf"^{count} poses cannot be chosen; allowed are 1 to 1000\.$"
    with pytest.raises(JobError, match=said):
        planned(count)
    out = tmp_path / "poses.csv"
    found = run("plan", CASE / "calibration.toml", "-n", count, "--candidates", "100000", "-o", out)
    assert (found.code, out.exists()) == (1, False)
    assert re.search(said, found.err.removeprefix("Error: "), re.MULTILINE)


def test_too_few_candidates() -> None:
    with pytest.raises(JobError, match="151 poses cannot be chosen from 150 candidates"):
        planned(151)
    with pytest.raises(JobError, match="20 poses cannot be chosen from 0 candidates"):
        plan(calib.error_model(machines.load(*NAME), offsets="all"), 20, candidates=np.zeros((0, 6)))


def test_candidates_of_zeros_and_ones_may_be_of_any_kind() -> None:
    model = calib.error_model(machines.load(*NAME), offsets="all")
    rng = np.random.default_rng(5)
    corners = rng.uniform(size=(60, len(model.robot.readings))) > 0.5
    found = plan(model, 10, candidates=corners)  # type: ignore[arg-type]
    assert found.readings.tolist() == plan(model, 10, candidates=corners.astype(np.float64)).readings.tolist()


# ---- the command


def test_plan_of_a_urdf_with_sight_and_collisions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("arm.urdf").write_text(with_shapes(ARM, {link: ball(at) for link, at in BALLS.items()}), encoding="utf-8")
    said = run(
        *("plan", "arm.urdf", "-n", "15", "-o", "poses.csv", "--candidates", "100", "--target", "1 mm"),
        *("--tracker", "2000 0 500 mm", "--facing", "1 0 0", "--acceptance", "80 deg"),
    )
    assert (said.code, said.err) == (0, "")
    text = said.out.replace("\n", " ")
    assert "turned away" in text
    assert "touching itself" in text
    assert "of the best poses keep the error that more poses would remove below 1 mm." in " ".join(text.split())
    assert text.endswith("15 poses are in poses.csv. ")
    robot = calib.load_robot("arm.urdf")
    lines = Path("poses.csv").read_text().splitlines()
    assert lines[0] == "a [deg],b [deg],c [deg],d [deg]"
    q = np.deg2rad(np.array([line.split(",") for line in lines[1:]], dtype=float))
    T = robot.tips(q)
    to_tracker = np.array([2.0, 0.0, 0.5]) - (T @ rigid.translation(np.array([0.05, 0, 0.05])))[:, :3, 3]
    cosine = np.sum(T[:, :3, 0] * to_tracker, axis=1) / np.linalg.norm(to_tracker, axis=1)
    assert np.all(cosine > np.cos(np.deg2rad(80.01)))
    again = run("plan", "arm.urdf", "-n", "15", "-o", "poses.csv")
    assert (again.code, again.err) == (1, "Error: poses.csv: already exists; choose another name.\n")


@pytest.mark.parametrize(("limit", "beyond"), [('lower="-0.5" upper="0.5"', True), ('lower="-9" upper="9"', False)])
def test_plan_tells_which_joints_that_follow_others_it_takes_beyond_their_limits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: str, *, beyond: bool
) -> None:
    """Compensation remarks on the same limits; the poses of a plan are where an arm is told to go, too."""
    monkeypatch.chdir(tmp_path)
    sized = 'effort="1" velocity="1"'
    joints = [
        f'<joint name="{name}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/><origin xyz="0.3 0 0.1"/>'
        f'<axis xyz="{axis}"/><limit {own} {sized}/>{mimic}</joint>'
        for k, (name, axis, own, mimic) in enumerate(
            [
                ("a", "0 0 1", 'lower="-1" upper="1"', ""),
                ("b", "0 1 0", 'lower="-1" upper="1"', ""),
                ("c", "0 1 0", limit, '<mimic joint="b" multiplier="-2" offset="0.1"/>'),
                ("d", "1 0 0", 'lower="-1" upper="1"', ""),
            ]
        )
    ]
    links = [f'<link name="l{k}"/>' for k in range(5)]
    Path("arm.urdf").write_text(f'<robot name="r">{"".join(links + joints)}</robot>', encoding="utf-8")
    said = run("plan", "arm.urdf", "-n", "15", "-o", "poses.csv", "--candidates", "100")
    text = " ".join((said.out + said.err).split())
    assert said.code == 0
    rows = np.deg2rad(np.loadtxt("poses.csv", delimiter=",", skiprows=1))
    over = int(np.count_nonzero(np.abs(0.1 - 2.0 * rows[:, 1]) > 0.5))
    assert (f"'c': beyond the limits in the URDF in {over} of 15 poses" in text) is beyond


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("a 0 1", "facing: 'a 0 1' is not three numbers, like '0 0 1'."),
        ("0 nan 1", "facing: '0 nan 1' is not three numbers, like '0 0 1'."),
        ("1e7 0 0", "facing is 1e+07; allowed is -1e+06 to 1e+06."),
        ("1e999 0 0", "facing is inf; allowed is -1e+06 to 1e+06."),
        ("0 0 0", "facing: (0.0, 0.0, 0.0) has no direction."),
    ],
)
def test_a_direction_has_no_unit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, typed: str, said: str) -> None:
    monkeypatch.chdir(tmp_path)
    Path("arm.urdf").write_text(ARM, encoding="utf-8")
    found = run("plan", "arm.urdf", "-o", "poses.csv", "--tracker", "2 0 0 m", "--facing", typed)
    assert (found.code, found.err) == (1, f"Error: {said}\n")


def test_plan_of_a_job_completes_what_was_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    copy_case(tmp_path)
    monkeypatch.chdir(tmp_path)
    common = ("plan", "calibration.toml", "-n", "10", "--candidates", "100", "--json")
    alone = json.loads(run(*common, "-o", "a.csv").out)
    more = json.loads(run(*common, "-o", "b.csv", "--measured", "identification.csv").out)
    assert (alone["rank"], alone["parameters"]) == (27, 45)
    assert [f["poses"] for f in alone["forecasts"]] == [10, 15, 20]
    assert more["forecasts"][-1]["chosen"] < alone["forecasts"][-1]["chosen"]
    assert run(*common[:4], "-o", "c.csv", "--candidates", "b.csv", "-q") == (0, "", "")
    assert sorted(Path("c.csv").read_text().splitlines()) == sorted(Path("b.csv").read_text().splitlines())


def test_poses_are_read_as_the_job_reads_its_tables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Columns that a job passes over, or calls otherwise, need no mention; a table that lacks them is read as well."""
    job = copy_case(tmp_path)
    monkeypatch.chdir(tmp_path)
    common = ("plan", "calibration.toml", "-n", "10", "--candidates", "100", "--json", "-o")
    alike = json.loads(run(*common, "a.csv", "--measured", "identification.csv").out)
    for table in ("identification.csv", "validation.csv"):
        head, *rows = [line for line in Path(table).read_text().splitlines() if not line.startswith("#")]
        text = "\n".join([head.replace("x [mm]", "X2") + ",who", *(f"{row},me" for row in rows)])
        Path(table).write_text(text)
    said = run(*common, "b.csv", "--measured", "identification.csv")
    assert (said.code, said.out) == (1, "")
    add = 'columns = { "x [mm]" = "X2" }\nignore = ["who"]\n'
    job.write_text(job.read_text().replace("[[measurements]]\n", f"[[measurements]]\n{add}"))
    again = json.loads(run(*common, "b.csv", "--measured", "identification.csv").out)
    assert again == alike
    assert run(*common, "c.csv", "--measured", "b.csv").code == 0


def test_poses_that_the_arm_cannot_have_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    copy_case(tmp_path)
    monkeypatch.chdir(tmp_path)
    Path("rad.csv").write_text(Path("validation.csv").read_text().replace("[deg]", "[rad]"))
    common = ("plan", "calibration.toml", "-n", "10", "-o", "poses.csv", "--candidates")
    assert run(*common, "rad.csv") == (
        *(1, ""),
        "Error: rad.csv: 10 poses cannot be chosen from 0 of its 30 poses: 30 outside the joints' limits.\n",
    )
    twice = Path("validation.csv").read_text().splitlines()
    Path("twice.csv").write_text("\n".join([*twice, *twice[-30:]]))
    few = run(*common, "twice.csv", "-n", "31").err
    assert few == "Error: twice.csv: 31 poses cannot be chosen from 30 candidates.\n"
    said = run(*common, "40", "--measured", "rad.csv").out.replace("\n", " ")
    assert "rad.csv: of 30 rows 30 outside the joints' limits: are its columns and units right?" in said


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (("--tool", "1 2 mm"), "tool: '1 2 mm' is not three numbers, like '50 0 50 mm'."),
        (("--misfit", "3 deg"), "misfit: unit 'deg' is not a unit of length; allowed are m, cm, mm, um, inch."),
        (("--candidates", "none.csv"), "none.csv: there is no such file."),
        (("--sigma", "0 mm"), "sigma: '0 mm' is out of range; allowed is 1e-06 to 1000 mm."),
        (("--tip", "nobody"), "arm_cmm.urdf: tip 'nobody' is not a link of the URDF; its links are "),
    ],
)
def test_wrong_wishes_are_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: tuple[str, ...], why: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("arm_cmm.urdf").write_bytes((CASE / "arm_cmm.urdf").read_bytes())
    said = run("plan", "arm_cmm.urdf", "-o", "poses.csv", *options)
    assert (said.code, said.out) == (1, "")
    assert said.err.startswith(f"Error: {why}")
    assert not Path("poses.csv").exists()


def test_results_are_no_arm_to_plan_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("out").mkdir()
    why = "is a folder; poses are planned for a URDF or a job, of results for calibrated.urdf in it."
    assert run("plan", "out", "-o", "poses.csv") == (1, "", f"Error: out: {why}\n")


@pytest.mark.parametrize("count", ["0", "-3", "100001", "9" * 5000])
def test_candidates_that_are_no_number_of_poses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, count: str) -> None:
    monkeypatch.chdir(tmp_path)
    Path("arm.urdf").write_text(ARM, encoding="utf-8")
    code, out, said = run("plan", "arm.urdf", "-o", "poses.csv", f"--candidates={count}")
    assert (code, out) == (1, "")
    assert re.fullmatch(r"Error: candidates: '.*' is not a number from 1 to 100000, nor a file\.\n", said)
    assert run("plan", "arm.urdf", "-o", "poses.csv", "--candidates", "\u00b2")[::2] == (
        1,
        "Error: \u00b2: there is no such file.\n",
    )
    assert run("plan", "job.toml", "-o", "poses.csv", "--observes", "pixels", "--candidates", "marks.csv") == (
        *(1, ""),
        "Error: candidates: 'marks.csv' is not a number from 1 to 100000; views to photograph are drawn at random.\n",
    )
    assert run("plan", "arm.urdf", "-o", "poses.csv", "--seed=-1").code == 2


def test_no_random_candidates() -> None:
    robot = calib.load_robot(parse_urdf(ARM.encode(), "arm.urdf"), "tip")
    with pytest.raises(JobError, match=r"^0 random poses are asked for; it takes one at least\.$"):
        random_candidates(robot, Frames(np.eye(4)[None], np.eye(4)[None]), 0)


def test_joints_that_their_limits_hold_in_one_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Some are told; where no joint has any room, all poses would be one."""
    monkeypatch.chdir(tmp_path)
    whole = (CASE / "arm_cmm.urdf").read_text(encoding="utf-8")
    held = re.sub(r'lower="[^"]*" upper="[^"]*"', "", whole)
    some = held.replace("<limit ", '<limit lower="-1" upper="1" ', 5)
    Path("some.urdf").write_text(some, encoding="utf-8")
    Path("held.urdf").write_text(held, encoding="utf-8")
    common = ("-o", "poses.csv", "-n", "12", "--candidates", "30")
    said = run("plan", "some.urdf", *common)
    assert said.code == 0
    assert "some.urdf: limits leave no room to 'joint_6': no pose moves them" in said.out.replace("\n", " ")
    Path("poses.csv").unlink()
    assert run("plan", "held.urdf", *common) == (
        *(1, ""),
        "Error: held.urdf: the limits of its joints leave no room to move, so that there is one pose; a <limit> "
        "without lower and upper is from 0 to 0.\n",
    )
    assert not Path("poses.csv").exists()
