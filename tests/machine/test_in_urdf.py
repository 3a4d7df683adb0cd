"""The best machine that a URDF holds: fitted without what it has no place for, judged, written and used as that."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.compensation.controllers import exported
from calib.foundations.errors import OutputError
from calib.identification.error_model import corrected_dh, with_terms
from calib.identification.fit import Fit
from calib.machine.in_urdf import fit_in_urdf
from calib.results.calibration import Calibration
from calib.robot.load import robot_in_urdf
from tests.support import machines
from tests.support.gears import UR10, geared, wavy

Array = np.ndarray
TERMS = {"gain": "all", "harmonics": "all", "harmonic_orders": (1, 2, 3)}


class Lab:
    """A badly made UR10 with uneven gears, of which a few tens of degrees are used: there terms look like geometry."""

    def __init__(self, seed: int, n: int = 120) -> None:
        self.rng = rng = np.random.default_rng([seed, 71])
        self.robot, plain = machines.load(*UR10), machines.arm(*UR10)
        waves = [{k: rng.normal(scale=3e-4, size=6) for k in (1, 2, 3)} for _ in range(2)]
        self.arm = geared(plain.moved(rng), wavy(np.zeros(6), *waves))
        self.true = machines.Machine(self.arm, machines.anywhere(rng), {"tool": machines.pose((0.05, 0.02, 0.15))})
        self.data, self.rest = (self._measure(n, name) for name in ("some.csv", "rest.csv"))

    def _measure(self, n: int, name: str) -> calib.Measurements:
        found = self.true.measure(self.robot, 0.2 * self.arm.draw(self.rng, n), rng=self.rng, sigma=3e-5)
        return replace(found, where=name)

    def model(self, **options: object) -> calib.ErrorModel:
        return machines.model(self.robot, **({"offsets": "all", "placements": "all"} | TERMS | options))


@pytest.fixture(scope="module")
def lab() -> Lab:
    return Lab(0)


@pytest.fixture(scope="module")
def fit(lab: Lab) -> Fit:
    return calib.identify(lab.model(), lab.data)


@pytest.fixture(scope="module")
def found(fit: Fit, lab: Lab) -> Calibration:
    return calib.assess(fit, lab.rest)


@pytest.fixture(scope="module")
def out(found: Calibration, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return calib.save(found, tmp_path_factory.mktemp("in_urdf") / "out")


def rms(r: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(r[:, :3] ** 2, axis=1))))


def alone(urdf: Path, data: calib.Measurements, judged: calib.Measurements, tip: str = "tool0") -> float:
    """Rms of rows held out by a URDF, read as any other, base and tool fitted to the rest."""
    robot = calib.load_robot(urdf, tip)
    fit = calib.identify(calib.error_model(robot), data)
    return rms(calib.machine_of(fit).residuals(judged))


def test_it_is_the_geometry_that_is_fitted_alone(fit: Fit, lab: Lab) -> None:
    again, plain = fit_in_urdf(fit), calib.identify(lab.model(gain="none", harmonics="none"), lab.data)
    assert again is not None
    assert again.robot.terms == ()
    np.testing.assert_array_equal(again.values, plain.values)


def test_nothing_is_fitted_again_where_the_urdf_holds_all(lab: Lab) -> None:
    plain = calib.identify(lab.model(gain="none", harmonics="none"), lab.data)
    assert fit_in_urdf(plain) is None
    found = calib.assess(plain, lab.rest)
    assert (found.in_urdf, found.machine.in_urdf) == (None, None)


def test_on_rows_held_out_it_is_better_than_geometry_without_its_terms(
    fit: Fit, found: Calibration, lab: Lab, out: Path
) -> None:
    new, old = (alone(out / name, lab.data, lab.rest) for name in ("calibrated.urdf", "model.urdf"))
    assert found.in_urdf is not None
    assert new == pytest.approx(found.in_urdf.metrics["validation"]["position"].rms, rel=1e-4)
    assert new < 0.95 * old
    assert found.judged_by["after"]["position"].rms < new < found.judged_by["before"]["position"].rms


def test_files_are_what_they_say(found: Calibration, fit: Fit, out: Path) -> None:
    readings = np.random.default_rng(1).uniform(-2.0, 2.0, (30, 6))
    calibrated, geometry = (machines.arm((out / n).read_text(), "tool0") for n in ("calibrated.urdf", "model.urdf"))
    best = found.machine.in_urdf
    assert best is not None
    assert np.abs(calibrated.tips(readings) - best.tips(readings)).max() < 1e-9
    plain = replace(fit.deviations, terms=np.zeros_like(fit.deviations.terms))
    assert np.abs(geometry.tips(readings) - fit.robot.tips(readings, plain)).max() < 1e-9
    again = calib.load_machine(out)
    assert again.in_urdf is not None
    assert np.abs(again.in_urdf.predict(readings) - best.predict(readings)).max() < 1e-12
    assert np.abs(again.predict(readings) - found.machine.predict(readings)).max() < 1e-12


def test_all_is_told(found: Calibration, out: Path) -> None:
    assert found.in_urdf is not None
    position = found.in_urdf.metrics["validation"]["position"]
    contents = json.loads((out / "result.json").read_text())["in_urdf"]
    assert contents["converged"] is True
    assert contents["metrics"]["validation"]["position"]["rms"] == position.rms
    report = (out / "report.md").read_text()
    for value in (position, found.judged_by["after"]["position"]):
        assert f"{value.rms * 1e3:.4f} mm" in report
    assert "calibrated.urdf is the best geometry without them. On held-out rows, base and tool fitted anew" in report


def test_write_urdf_writes_the_same(fit: Fit, out: Path, tmp_path: Path) -> None:
    calib.write_urdf(fit, tmp_path / "arm.urdf")
    assert (tmp_path / "arm.urdf").read_bytes() == (out / "calibrated.urdf").read_bytes()


@pytest.mark.parametrize("to", ["dh", "ur", "xacro"])
def test_controllers_that_take_geometry_are_given_the_best(to: str, found: Calibration, lab: Lab) -> None:
    """What a file loses is what remains between the best geometry and the whole, and less than without a fit."""
    whole = found.machine
    new, old = exported(whole, to), exported(replace(whole, in_urdf=None), to)  # type: ignore[arg-type]
    assert [part.part for part in new.left_out] == ["joint terms"]
    assert new.lost == pytest.approx(new.left_out[0].cost, rel=1e-6)
    assert new.lost < 0.9 * old.lost


def test_ros_is_told_which_geometry_its_terms_go_with(found: Calibration) -> None:
    assert "model.urdf has the offsets" in exported(found.machine, "ros").text
    assert "model.urdf" not in exported(replace(found.machine, in_urdf=None), "ros").text


def test_what_was_held_is_held_again(lab: Lab) -> None:
    """Levels and globs of free parameters: what the fit never moved stays nominal in the URDF as well."""
    model = lab.model()
    first = calib.identify(model, lab.data, free=["*elbow_joint.*", "base.*", "tool.*"])
    second = calib.identify(model, lab.data, free=["*.cos_*", "*.sin_*"], start=first)
    again = fit_in_urdf(second)
    assert again is not None
    moved = {p.name for p in again.parameters if p.of_robot}
    assert moved == {p.name for p in first.parameters if p.kind in ("offset", "placement")}
    plain = calib.identify(with_terms(model, ()), lab.data, free=["*elbow_joint.*", "base.*", "tool.*"])
    np.testing.assert_allclose(again.values, plain.values, atol=1e-12)


def test_conditions_of_rows_are_no_hindrance(lab: Lab) -> None:
    """Terms that need a column: the URDF has neither."""
    rng = np.random.default_rng(3)
    readings = lab.arm.draw(rng, 60)
    columns = machines.table(lab.arm, readings, lab.true.see(readings), "position")
    columns |= {"temperature [degC]": rng.uniform(15.0, 35.0, 60), "direction": rng.choice(["+", "-"], 60).tolist()}
    data = calib.read_measurements(columns, lab.robot, sigma=(3e-5, None))
    model = machines.model(lab.robot, offsets="all", placements="all", backlash="all", expansion="arm")
    found = calib.assess(calib.identify(model, data))
    assert found.in_urdf is not None
    plain = calib.identify(with_terms(model, ()), data)
    assert found.in_urdf.metrics["identification"]["position"].rms == pytest.approx(rms(plain.residuals[0]))


def test_of_dh_numbers_the_table_is_the_best_as_well(tmp_path: Path) -> None:
    lab = Lab(2)
    fit = calib.identify(machines.model(lab.robot, dh="all", **TERMS), lab.data)
    out = calib.save(calib.assess(fit, lab.rest), tmp_path / "out")
    plain = calib.identify(machines.model(lab.robot, dh="all"), lab.data)
    table = calib.dh.read_dh(out / "calibrated_dh.csv")
    expected = corrected_dh(plain.model, plain.machine.deviations)
    for row, other in zip(table.rows, expected.rows, strict=True):
        assert (row.a, row.d, row.alpha, row.theta) == pytest.approx((other.a, other.d, other.alpha, other.theta))


@pytest.mark.parametrize("mimics", [True, False], ids=["followed by mimic", "takes other readings"])
def test_couplings_are_left_to_mimic_joints_or_said_to_be_lost(mimics: bool, tmp_path: Path) -> None:
    """A joint that follows two others: with a mimic element the URDF is fitted alone; without, it reads one more."""
    text = machines.INLINE["mimic"]
    if not mimics:
        text = text.replace('<mimic joint="lift" multiplier="-1" offset="0.1"/>', "")
    coupling = (calib.Coupling("level", {"lift": -1.0, "swing": 0.002}, 0.1),)
    path = tmp_path / "arm.urdf"
    path.write_text(text)
    robot = calib.load_robot(path, "tip", couplings=coupling)
    assert (robot_in_urdf(robot) is not None) is mimics
    rng = np.random.default_rng(5)
    readings = rng.uniform(-1.5, 1.5, (80, len(robot.readings)))
    d = calib.Deviations(rng.normal(scale=1e-3, size=(len(robot.chain), 6)), np.zeros(len(robot.moving)))
    columns: dict[str, object] = {f"{r.name} [rad]": readings[:, k] for k, r in enumerate(robot.readings)}
    columns |= {f"{axis} [m]": robot.tips(readings, d)[:, k, 3] for k, axis in enumerate("xyz")}
    data = calib.read_measurements(columns, robot, sigma=(1e-5, None))
    fit = calib.identify(machines.model(robot, offsets="all", placements="all", gain=["reach"]), data)
    out = calib.save(calib.assess(fit), tmp_path / "out")
    contents = json.loads((out / "result.json").read_text())["in_urdf"]
    assert bool(contents["metrics"]) is mimics
    again = calib.load_machine(out).in_urdf
    assert again is not None
    assert (again.robot.couplings == ()) is mimics
    report = (out / "report.md").read_text()
    assert ("needs other joint readings" in report) is not mimics
    if mimics:
        told = contents["metrics"]["identification"]["position"]["rms"]
        assert alone(out / "calibrated.urdf", data, data, "tip") == pytest.approx(told, rel=1e-4)


def test_a_model_file_with_a_geometry_of_other_joints_is_refused(out: Path, tmp_path: Path) -> None:
    for file in out.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    contents = json.loads((out / "model.json").read_text())
    contents["in_urdf"]["joints"].pop()
    (tmp_path / "model.json").write_text(json.dumps(contents))
    with pytest.raises(OutputError, match=r"model\.json: its joints are not those of nominal\.urdf"):
        calib.load_machine(tmp_path)


PENDULUM = """<robot name="two"><link name="l0"/><link name="l1"/><link name="l2"/>
<joint name="one" type="continuous"><parent link="l0"/><child link="l1"/><axis xyz="0 0 1"/></joint>
<joint name="two" type="continuous"><parent link="l1"/><child link="l2"/><origin xyz="0.5 0 0"/>
<axis xyz="0 0 1"/></joint></robot>"""
WAVES = """schema = 1
[robot]
urdf = "two.urdf"
[error_model]
harmonics = "all"
base = "fixed"
tool = "fixed"
[tools.tool]
position = ["0.3 m", "0 m", "0 m"]
[[measurements]]
file = "rows.csv"
sigma = "0.01 mm"
[[measurements]]
file = "rest.csv"
sigma = "0.01 mm"
use = "validate"
"""


@pytest.mark.parametrize("policy", ["nearest", "minimal"])
def test_of_joint_terms_alone_the_urdf_stays_the_nominal_one(tmp_path: Path, policy: str) -> None:
    """Of an arm whose base and tool are known: nothing of what is found has a place in a URDF."""
    rng = np.random.default_rng(4)
    for name in ("rows.csv", "rest.csv"):
        q = rng.uniform(-2.0, 2.0, size=(30, 2))
        first = q[:, 0] + 1e-3 * np.cos(q[:, 0])
        both = first + q[:, 1] - 5e-4 * np.sin(q[:, 1])
        x, y = (0.5 * f(first) + 0.3 * f(both) + rng.normal(scale=1e-5, size=30) for f in (np.cos, np.sin))
        table = np.column_stack([q, x, y, rng.normal(scale=1e-5, size=30)])
        np.savetxt(tmp_path / name, table, delimiter=",", header="one [rad],two [rad],x [m],y [m],z [m]", comments="")
    (tmp_path / "two.urdf").write_text(PENDULUM, encoding="utf-8")
    text = WAVES.replace('tool = "fixed"', f'tool = "fixed"\nnull_space = "{policy}"')
    (tmp_path / "job.toml").write_text(text, encoding="utf-8")
    found = calib.calibrate(tmp_path / "job.toml", tmp_path / "out")
    assert found.trusted
    assert (tmp_path / "out" / "calibrated.urdf").read_text(encoding="utf-8") == PENDULUM
    machine = calib.load_machine(tmp_path / "out")
    assert machine.in_urdf is not None
    assert not machine.in_urdf.robot.terms
    own, alone = found.metrics["validation"], found.in_urdf
    assert alone is not None
    assert alone.metrics["validation"]["position"].rms == pytest.approx(own["before"]["position"].rms)
    assert own["after"]["position"].rms < 0.1 * own["before"]["position"].rms
