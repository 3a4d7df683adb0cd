"""The case robots/arm_cmm: its URDF is the published arm, its data is what the script makes and the truth file says."""

import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yourdfpy
from numpy.typing import NDArray

Array = NDArray[np.float64]

ROOT = Path(__file__).resolve().parents[2]
CASE = ROOT / "robots" / "arm_cmm"
SCRIPT = ROOT / "scripts/simulate/arm_cmm.py"
TRACKED = ("identification.csv", "validation.csv", "identification_realistic.csv")
TOUCHED = ("probe.csv", "cone.csv", "lengths.csv", "sphere.csv", "articulations.csv")

# Standard DH rows in metres and degrees; row 7 is the probe.
D = (0.100, 0.150, 0.450, 0.100, 0.350, 0.100, 0.150)
ALPHA = (-90.0, 90.0, 90.0, -90.0, -90.0, 90.0, 0.0)

# Angles [deg] and nominal probe position [mm] as printed, with four misprints mended: row 9 lacks theta_1 = 0, row 10
# prints x = 112.002, row 11 cuts z to 177.21, row 13 prints the actual position in place of the nominal one.
PUBLISHED = (
    ((0, 0, 0, 0, 0, 0), (0, 150, 1050)),
    ((-90, 10, 10, 90, 10, 10), (66.530, 403.646, 636.530)),
    ((-90, 0, 0, 90, 0, 0), (150, 500, 550)),
    ((90, 90, 90, 90, 90, 90), (200, 350, 150)),
    ((10, 80, 30, 150, 30, 140), (211.979, 145.894, 287.833)),
    ((90, 70, 90, 130, 40, 30), (213.240, 119.589, 169.933)),
    ((0, 90, 0, 0, 0, 0), (950, 150, 100)),
    ((-90, -90, 0, 90, 0, 90), (150, 600, -250)),
    ((0, 90, 0, -90, 0, 90), (300, 150, -250)),
    ((30, 150, 60, 130, 80, 160), (102.002, 110.994, -102.182)),
    ((40, 30, 60, 150, 0, 0), (-33.671, -115.071, 177.211)),
    ((90, 0, 0, 90, 0, 0), (-150, -500, 550)),
    ((50, -80, 50, 40, -60, 40), (-502.183, -731.686, 231.949)),
    ((60, 40, 60, 150, 10, 10), (18.218, -108.910, 201.660)),
    ((120, 90, 120, -20, 70, 50), (-631.721, 660.874, 187.184)),
    ((0, -90, 0, 0, 0, 0), (-950, 150, 100)),
    ((-90, -90, -90, -90, -90, -90), (-200, 350, 150)),
    ((40, 150, 50, 160, 90, 130), (-33.663, 187.312, -50.344)),
    ((90, 90, 0, 0, 0, 0), (-150, 950, 100)),
    ((-120, 140, 20, 60, 10, 150), (-164.490, -495.465, -265.903)),
)


def dh(theta: float, d: float, alpha: float) -> Array:
    """One standard DH row with a = 0, written out."""
    ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array([[ct, -st * ca, st * sa, 0], [st, ct * ca, -ct * sa, 0], [0, sa, ca, d], [0, 0, 0, 1]])


def moved(entry: dict[str, Any]) -> Array:
    """Trans(translation) Rx Ry Rz of a truth file's section, written out; metres."""
    (a, b, c) = np.radians(entry["rotation_deg"])
    ca, sa, cb, sb, cc, sc = np.cos(a), np.sin(a), np.cos(b), np.sin(b), np.cos(c), np.sin(c)
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [cb * cc, -cb * sc, sb],
        [ca * sc + sa * sb * cc, ca * cc - sa * sb * sc, -sa * cb],
        [sa * sc - ca * sb * cc, sa * cc + ca * sb * sc, ca * cb],
    ]
    matrix[:3, 3] = np.array(entry["translation_mm"]) * 1e-3
    return matrix


def nominal_probe(q: Array) -> Array:
    matrix = np.eye(4)
    for theta, d, alpha in zip((*q, 0.0), D, np.radians(ALPHA), strict=True):
        matrix = matrix @ dh(theta, d, alpha)
    return matrix


def true_point(truth: dict[str, Any], readings_deg: Array, base: Array, tip_mm: list[float]) -> Array:
    """Position [mm] of a point in the probe's frame that the truth file predicts."""
    matrix = base
    for i, reading in enumerate(readings_deg):
        joint = truth[f"joint_{i + 1}"]
        theta = np.radians(reading + joint["offset_deg"])
        matrix = matrix @ moved(joint) @ dh(theta, D[i], np.radians(ALPHA[i]))
    matrix = matrix @ moved(truth["handle_mount"]) @ dh(0.0, D[6], np.radians(ALPHA[6]))
    return (matrix[:3, :3] @ (np.array(tip_mm) * 1e-3) + matrix[:3, 3]) * 1e3


def true_reflector(truth: dict[str, Any], readings_deg: Array) -> Array:
    """Position [mm] in the tracker's frame."""
    return true_point(truth, readings_deg, moved(truth["base_in_tracker"]), truth["tip_in_probe_mm"])


def centred(realistic: dict[str, Any], readings_deg: Array) -> Array:
    """Readings of the realistic arm with the eccentricity of its encoders taken out."""
    u = np.radians(readings_deg)
    return readings_deg + realistic["cosine_deg"] * np.cos(u) + realistic["sine_deg"] * np.sin(u)


def read_table(name: str) -> tuple[list[str], Array, list[list[str]]]:
    """Header, readings and tracked positions as numbers, and the words and sizes of touches."""
    lines = [line for line in (CASE / name).read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    header = lines[0].split(", ")
    numbers = sum(title[0] in "jxyz" for title in header)
    cells = [line.split(", ") for line in lines[1:]]
    return (
        header,
        np.array([[float(cell) for cell in row[:numbers]] for row in cells]),
        [row[numbers:] for row in cells],
    )


def columns(name: str) -> tuple[Array, dict[str, list[str]]]:
    """Readings of touches, and their other columns by name without the unit."""
    header, readings, rest = read_table(name)
    return readings, {title.split(" ")[0]: [row[i] for row in rest] for i, title in enumerate(header[6:])}


@pytest.fixture(scope="module")
def robot() -> yourdfpy.URDF:
    return yourdfpy.URDF.load(str(CASE / "arm_cmm.urdf"))


@pytest.fixture(scope="module")
def truth() -> dict[str, Any]:
    return tomllib.loads((CASE / "truth.toml").read_text(encoding="utf-8"))


def urdf_probe(robot: yourdfpy.URDF, q: Array) -> Array:
    robot.update_cfg({f"joint_{i + 1}": angle for i, angle in enumerate(q)})
    return robot.get_transform("probe", "base_link")


def test_urdf_is_the_dh_product(robot: yourdfpy.URDF) -> None:
    for q in np.random.default_rng(0).uniform(-np.pi, np.pi, (50, 6)):
        assert np.abs(urdf_probe(robot, q) - nominal_probe(q)).max() < 1e-12


def test_every_link_frame_is_the_dh_frame_before_its_row(robot: yourdfpy.URDF) -> None:
    q = np.random.default_rng(1).uniform(-np.pi, np.pi, 6)
    robot.update_cfg({f"joint_{i + 1}": angle for i, angle in enumerate(q)})
    matrix = np.eye(4)
    for i, theta in enumerate(q):
        turned = matrix @ dh(theta, 0.0, 0.0)
        assert np.abs(robot.get_transform(f"link_{i + 1}", "base_link") - turned).max() < 1e-12
        matrix = matrix @ dh(theta, D[i], np.radians(ALPHA[i]))
    assert np.abs(robot.get_transform("handle", "base_link") - matrix).max() < 1e-12


@pytest.mark.parametrize(("angles", "position"), PUBLISHED, ids=[f"row {i + 1}" for i in range(len(PUBLISHED))])
def test_published_positions(robot: yourdfpy.URDF, angles: tuple[float, ...], position: tuple[float, ...]) -> None:
    q = np.radians(angles)
    for probe in (urdf_probe(robot, q), nominal_probe(q)):
        assert np.abs(probe[:3, 3] * 1e3 - position).max() <= 0.0005


def test_names_and_limits_a_job_relies_on(robot: yourdfpy.URDF) -> None:
    assert robot.actuated_joint_names == [f"joint_{i}" for i in range(1, 7)]
    readings = np.vstack([read_table(name)[1][:, :6] for name in (*TRACKED, *TOUCHED)])
    for name, column in zip(robot.actuated_joint_names, np.radians(readings).T, strict=True):
        limit = robot.joint_map[name].limit
        assert limit.lower < column.min()
        assert column.max() < limit.upper


def test_script_reproduces_the_committed_files(tmp_path: Path) -> None:
    subprocess.run([sys.executable, str(SCRIPT), str(tmp_path)], check=True, capture_output=True)
    made = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert sorted(made) == sorted(["truth.toml", "truth_realistic.toml", *TRACKED, *TOUCHED])
    assert made == {name: (CASE / name).read_bytes() for name in made}


def test_another_seed_is_another_arm(tmp_path: Path) -> None:
    subprocess.run([sys.executable, str(SCRIPT), str(tmp_path), "--seed", "2"], check=True, capture_output=True)
    assert (tmp_path / "truth.toml").read_bytes() != (CASE / "truth.toml").read_bytes()


@pytest.fixture(scope="module")
def realistic() -> dict[str, Any]:
    return tomllib.loads((CASE / "truth_realistic.toml").read_text(encoding="utf-8"))


def balls(truth: dict[str, Any], realistic: dict[str, Any], readings: Array) -> Array:
    """Where the ball was [mm] in the arm's base, up to half a count of every encoder."""
    ball = realistic["ball_in_probe_mm"]
    return np.array([true_point(truth, row, np.eye(4), ball) for row in centred(realistic, readings)])


def assert_scatter(errors: Array, realistic: dict[str, Any]) -> None:
    """The operator's scatter, and what counting adds: 7 urad of every joint, with levers of up to 0.9 m."""
    relative = errors / realistic["operator_sigma_mm"]
    # 20 numbers or more: the root mean square of the operator's part is 1 +- 0.16 and better.
    assert 0.7 < np.sqrt(np.mean(relative**2)) < 1.4
    assert abs(relative.mean()) < 0.5
    assert np.abs(relative).max() < 4.5


@pytest.mark.parametrize("name", TRACKED + TOUCHED)
def test_every_table_says_that_it_is_simulated(name: str) -> None:
    assert (CASE / name).read_text(encoding="utf-8").startswith("# Simulated, not measured on a real machine: scripts/")


def test_realistic_encoders_are_off_centre_and_count(truth: dict[str, Any], realistic: dict[str, Any]) -> None:
    amplitude = np.radians(np.hypot(realistic["cosine_deg"], realistic["sine_deg"]))
    assert amplitude.min() > 24e-6
    assert amplitude.max() < 76e-6
    readings = np.vstack([read_table(name)[1][:, :6] for name in ("identification_realistic.csv", *TOUCHED)])
    counts = readings * realistic["counts_per_turn"] / 360.0
    assert np.abs(counts - np.round(counts)).max() < 1e-3
    _, table, _ = read_table("identification_realistic.csv")
    residuals = np.array([row[6:] - true_reflector(truth, centred(realistic, row[:6])) for row in table])
    assert np.sqrt(np.mean(residuals**2)) == pytest.approx(truth["sigma_mm"], rel=0.15)


@pytest.mark.parametrize(("name", "places"), [("probe.csv", "probe_cone_mm"), ("cone.csv", "cones_mm")])
def test_cones_are_touched_where_they_stand(
    truth: dict[str, Any], realistic: dict[str, Any], name: str, places: str
) -> None:
    readings, words = columns(name)
    assert {words["target"].count(place) for place in realistic[places]} == {20 if name == "probe.csv" else 10}
    centres = np.array([realistic[places][place] for place in words["target"]])
    assert_scatter(balls(truth, realistic, readings) - centres, realistic)


def test_lengths_are_those_of_the_gauges(truth: dict[str, Any], realistic: dict[str, Any]) -> None:
    readings, words = columns("lengths.csv")
    assert words["target"] == ["A", "B"] * 20
    assert words["pair"] == [str(n // 2 + 1) for n in range(40)]
    points = balls(truth, realistic, readings)
    measured = np.linalg.norm(points[1::2] - points[::2], axis=1)
    assert_scatter((measured - np.array([float(x) for x in words["length"][::2]])) / np.sqrt(2.0), realistic)


@pytest.mark.parametrize("name", ["sphere.csv", "articulations.csv"])
def test_spheres_are_touched_from_outside(truth: dict[str, Any], realistic: dict[str, Any], name: str) -> None:
    readings, words = columns(name)
    assert {words["target"].count(place) for place in realistic["spheres_mm"]} == {25}
    if name == "articulations.csv":
        assert words["group"] == [str(n // 5 % 5 + 1) for n in range(50)]
    assert set(map(float, words["diameter"])) == {realistic["sphere_diameter_mm"]}
    assert set(map(float, words["ball"])) == {realistic["ball_diameter_mm"]}
    radius = 0.5 * (realistic["sphere_diameter_mm"] + realistic["ball_diameter_mm"])
    centres = np.array([realistic["spheres_mm"][place] for place in words["target"]])
    assert_scatter(np.linalg.norm(balls(truth, realistic, readings) - centres, axis=1) - radius, realistic)


@pytest.mark.parametrize(("name", "rows"), [("identification.csv", 60), ("validation.csv", 30)])
def test_truth_predicts_the_measurements_to_the_noise(truth: dict[str, Any], name: str, rows: int) -> None:
    header, table, _ = read_table(name)
    assert header == [*(f"joint_{i} [deg]" for i in range(1, 7)), "x [mm]", "y [mm]", "z [mm]"]
    assert table.shape == (rows, 9)
    residuals = np.array([row[6:] - true_reflector(truth, row[:6]) for row in table]) / truth["sigma_mm"]
    # 90 and 180 unit normal deviates: the root mean square is 1 +- 0.075 and better, the mean 0 +- 0.1 and better.
    assert np.sqrt(np.mean(residuals**2)) == pytest.approx(1.0, abs=0.2)
    assert abs(residuals.mean()) < 0.3
    assert np.abs(residuals).max() < 4.0
