"""What a person does with a job: every command and every public function, and what must come of each.

A command ends well, with what the simulated machine shows, or with one sentence that is in ``SENTENCES``. A new command
or public function joins by its name in ``WALKED``, or in ``ELSEWHERE`` with the reason.
"""

import csv
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import calib
from calib.compensation.commands import for_poses
from calib.job.calibrate import calibrate
from calib.presentation import display, live
from calib.presentation.console import drawn, short_report
from calib.presentation.tables import plain
from calib.results.calibration import Calibration
from calib.results.report import report_of
from calib.results.result_file import read_result
from tests.crossed.simulate import ELBOW, SIGMA, Case, write
from tests.support.cases import Said, run

Array = NDArray[np.float64]

# Errors of predictions in m, rad and px: a few times the simulated noise; where a field is simulated, what is left of
# it, as a few rows do not show it all.
BOUNDS = {"orientation": 6e-5, "pixels": 0.06}
BOUND, BOUND_OF_FIELD = 3e-5, 4e-4

# By which sentences commands may refuse a sound calibration, and when.
SENTENCES: Mapping[str, tuple[tuple[str, Callable[[Case], bool]], ...]] = {
    "export ur": ((r"the kinematics file of Universal Robots is for their arms alone", lambda case: True),),
    "export dh": (
        (
            r"joint '\w+' has no reading; a DH table has no joints that follow others",
            lambda case: case.follows,
        ),
        (r"DH table", lambda case: case.follows),
    ),
    "verify": (
        (
            r"the calibration was made without any position; judge it in its job",
            lambda case: case.draft.kind == "pixels",
        ),
    ),
}

# Where commands and public names are crossed: here by name; or not, and why.
WALKED = {
    *("calibrate", "check", "verify", "compare", "uncertainty", "compensate", "view", "sensitivity", "performance"),
    *("cell", "export", "plan", "models"),
    *(
        "identify",
        "error_model",
        "load_robot",
        "load_machine",
        "read_measurements",
        "advice",
        "data_frame",
    ),
    *("outliers", "not_placed", "outside_identified"),
    *("plot", "table", "tool_uncertainty", "uncertainty_map", "machine_of"),
    *("write_urdf", "commands", "judging"),
    *("assess", "check", "hold_out", "report", "save", "scene"),
}
ELSEWHERE = {
    "demo": "runs check, calibrate and compensate on the shipped case; tests/test_cli.py",
    "fleet": "calls calibrate as it is, byte for byte; tests/job/test_fleet.py",
    "iso9283": "reads a table of its own and no calibration; tests/assessment/test_iso9283.py",
    "dh": "turns a table into a URDF and back, without a job; tests/robot/test_dh.py",
    "five-point": "reads a table of its own; tests/positioner/test_five_point_command.py",
    "positioner": "its own table in, its own job out; tests/positioner/test_positioner.py",
    "planning": "plan walks it",
    "init": "makes a job of tables before there is one; tests/proposal/test_init.py",
    "import": "makes tables of files of others; tests/proposal/test_import.py",
    "app": "check and calibrate behind a page; tests/app",
    "board": "draws what is to be printed; tests/job/test_photographs.py",
    "propose": "init in other words; tests/proposal/test_init.py",
    "measuring": "what features of measurements are made of",
    "poses": "read_measurements in other words; tests/test_api.py",
    "positions": "read_measurements in other words; tests/test_api.py",
}


@dataclass(frozen=True)
class Walked:
    """A finished calibration and its case."""

    case: Case
    outcome: Calibration
    out: Path
    model: calib.CalibratedMachine

    def bound(self, quantity: str) -> float:
        """How far predictions may be off."""
        field = self.case.draft.levels in ("grid", "gaussian") and self.case.draft.kind in ("position", "pose")
        # A minimal set holds more than the data ask for, where the nominal machine is far off the measurements.
        field = field or self.case.draft.error_model["null_space"] == "minimal"
        if field and quantity == "orientation":
            return 4.0 * BOUNDS[quantity]
        return BOUNDS.get(quantity, BOUND_OF_FIELD if field else BOUND)


Step = Callable[[Walked, Path], None]


def allowed(case: Case, what: str, said: Said) -> bool:
    """Whether a command ended with a sentence that this case may meet; one line, and nothing on stdout."""
    assert said.code == 1, f"{what}: exit code {said.code}: {said.err}"
    assert said.out == "" and said.err.startswith("Error: ") and said.err.count("\n") == 1, f"{what}: {said.err}"
    met = [when(case) for pattern, when in SENTENCES.get(what, ()) if re.search(pattern, said.err)]
    assert any(met), f"{what}: {said.err}"
    return True


def walk(case: Case, steps: Sequence[Step] | None = None) -> None:
    """Take a case through some steps after calibration, all of them when None."""
    folder = case.path.parent.parent
    walked = _calibrated(case, folder / "out")
    for step in STEPS if steps is None else steps:
        step(walked, folder)


def _calibrated(case: Case, out: Path) -> Walked:
    said = run("check", case.path)
    assert (said.code, said.err) == (0, ""), said.err
    outcome = calibrate(case.path, out)
    assert all(plain(drawn(one)) for one in short_report(report_of(outcome)))
    walked = Walked(case, outcome, out, calib.load_machine(out))
    for judged in outcome.sets:
        for quantity, m in outcome.metrics[judged.use]["after"].items():
            assert m.rms < walked.bound(quantity), (judged.use, quantity, m.rms)
    return walked


def predicts(walked: Walked, folder: Path) -> None:
    """The model read back says where the true machine's tools are, at readings and conditions that it never saw."""
    case = walked.case
    if not case.placed:
        return
    rows = case.rows(case.draw(32))
    for tools in (rows.tools, [ELBOW] * 32) if case.draft.elbow else (rows.tools,):
        own = rows._replace(tools=tools, points=np.zeros((32, 3)))
        there = case.see(own)[:, :3, 3]
        off, within = np.empty((32, 3)), np.zeros(32, dtype=bool)
        for setup, tool in dict.fromkeys(zip(own.setups, tools, strict=True)):
            k = np.flatnonzero([(s, t) == (setup, tool) for s, t in zip(own.setups, tools, strict=True)])
            machine, q, told = walked.model.at(setup), own.readings[k], own.told.subset(k)
            off[k] = machine.predict(q, tool=tool, conditions=told)[:, :3, 3] - there[k]
            within[k] = calib.judging.tool_uncertainty(machine, q, tool, conditions=told).inside(off[k])
        rms = float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
        # Farther out than the rows, errors of the parameters are larger than at them.
        assert rms < 4.0 * walked.bound("position"), rms
        assert np.mean(within) >= 0.7 or case.modelled_badly, np.mean(within)


def verifies(walked: Walked, folder: Path) -> None:
    """The machine passes by its own measurements, in the frame that it knows, and fails when a joint has slipped."""
    case = walked.case
    columns = case.positions(case.draw(14))
    write(folder / "new.csv", columns)
    options = ["--sigma", f"{SIGMA!r} m", "--json", *(["--in-order"] if case.draft.said == "order" else [])]
    options += [] if case.placed else ["--refit-base"]
    said = run("verify", walked.out, folder / "new.csv", *options)
    if said.code == 1:
        assert allowed(case, "verify", said)
        return
    found = json.loads(said.out)
    _same_from_python(walked, folder / "new.csv", found)
    if case.placed:  # else the arm's size may be unknown too
        assert said.code == 0 or case.modelled_badly, found
        assert found["as_calibrated"]["metrics"]["position"]["rms"] < 4.0 * walked.bound("position"), found
    joint = next(name for name in columns if name.endswith("[deg]"))
    write(folder / "slipped.csv", columns | {joint: columns[joint] + 1.0 * np.sin(np.arange(14.0))})
    assert run("verify", walked.out, folder / "slipped.csv", *options).code == 3


def _same_from_python(walked: Walked, path: Path, found: Mapping[str, Any]) -> None:
    """What Python says of the same rows is what the command says."""
    case = walked.case
    data = calib.read_measurements(path, walked.model.robot, sigma=SIGMA, in_order=case.draft.said == "order")
    again = calib.verify(walked.model, data, refit=not case.placed).contents()
    assert again["as_calibrated"]["test"] == found["as_calibrated"]["test"]


def compares(walked: Walked, folder: Path) -> None:
    """A calibration has not moved from itself."""
    said = run("compare", walked.out, walked.out, "-o", folder / "both.html", "--json")
    assert (said.code, said.err) == (0, ""), said.err
    assert (folder / "both.html").stat().st_size > 1000
    found = json.loads(said.out)
    assert not found["moved"]
    assert found["tip"]["max"] < 1e-6, found["tip"]


def is_uncertain(walked: Walked, folder: Path) -> None:
    """How sure it is, over the workspace and at rows with their conditions."""
    case = walked.case
    tool = case.draft.tools[0]
    for setup in case.setups[-1:]:
        of = ("--setup", setup) if len(case.setups) > 1 else ()
        for more in (("-o", folder / "map.csv"), ("--whole",)):
            said = run("uncertainty", walked.out, "--samples", "20", "--tool", tool, *of, *more, "--json")
            assert (said.code, said.err) == (0, ""), said.err
    u = walked.model
    assert u.uncertainty is not None
    q = case.draw(5)
    found = calib.judging.tool_uncertainty(u, q, tool, conditions=case.conditions(q))
    assert np.isfinite(found.position).all() and (found.position > 0.0).all()
    calib.judging.uncertainty_map(calib.machine_of(walked.outcome.fit), 5, tool=tool)
    calib.judging.outside_identified(u, 5.0 * q)
    calib.judging.not_placed(u, tool)


def is_commanded(walked: Walked, folder: Path) -> None:
    """Corrected commands take the calibrated machine where the nominal one would go, terms and residuals included."""
    case, model = walked.case, walked.model
    q = 0.6 * case.draw(6)  # within a grid
    setup = case.setups[-1]
    model = walked.model.at(setup)
    targets = case.rows(q)._replace(setups=[setup] * 6, points=np.zeros((6, 3)))
    tools, told = targets.tools, targets.told
    columns = case.as_targets(targets)
    told = replace(told, approach=np.where(np.asarray(told.approach) > 0, 1.0, -1.0))
    write(folder / "targets.csv", columns)
    of = ("--setup", setup) if len(case.setups) > 1 else ()
    said = run("compensate", walked.out, folder / "targets.csv", "-o", folder / "sent.csv", "--what", "position", *of)
    assert (said.code, said.err) == (0, ""), said.err
    with (folder / "sent.csv").open(encoding="utf-8") as file:
        sent = list(csv.DictReader(file))
    found = calib.commands.for_joint_targets(model, q, tools, what="position", conditions=told)
    rows = np.flatnonzero(found.reached)
    assert len(rows) >= 3, found.reasons
    T = np.stack([model.tools[tools[n]] for n in rows])
    wanted = (model.robot.tips(q[rows]) @ T)[:, :3, 3]
    there = (model.tips(found.readings[rows], told.subset(rows)) @ T)[:, :3, 3]
    assert np.abs(there - wanted).max() < 3e-6
    # The same from the command, and the true machine goes there.
    titles = list(case.joints(q))
    factors = np.array([1e-3 if title.endswith("[mm]") else np.pi / 180.0 for title in titles])
    by_command = np.array([[float(sent[n][title]) for title in titles] for n in rows]) * factors
    assert np.abs(by_command - found.readings[rows]).max() < 1e-9
    true = case.see(targets._replace(readings=found.readings, told=told).subset(rows))
    if case.placed:
        meant = walked.model.at(setup).base @ model.robot.tips(q[rows]) @ T
        error = np.linalg.norm((true - meant)[:, :3, 3], axis=1)
        assert np.sqrt(np.mean(error**2)) < 4.0 * walked.bound("position"), error
    back = for_poses(model, there, q[rows], [tools[n] for n in rows], conditions=told.subset(rows))
    assert back.reached.all(), back.reasons


def is_exported(walked: Walked, folder: Path) -> None:
    """Every controller's file, or a sentence that it has no place for this machine."""
    for to in ("ur", "offsets", "dh", "ros", "xacro"):
        said = run("export", walked.out, "--to", to, "-o", folder / f"export.{to}", "--json")
        if said.code:
            assert allowed(walked.case, f"export {to}", said)
        else:
            assert said.err == ""
            found = json.loads(said.out)
            assert np.isfinite(found["lost"]) and np.isfinite(found["before"])
    calib.write_urdf(walked.outcome.fit, folder / "calibrated.urdf")
    scene = ("--scene", folder / "cell.html")
    of = ("--setup", walked.case.setups[-1]) if len(walked.case.setups) > 1 else ()
    doubted = 0 if read_result(walked.out).trusted else 3
    said = run("cell", walked.out, walked.out, "-o", folder / "cell.urdf", *scene, "--prefix", "b_", "--quiet", *of)
    assert said == (doubted, "", ""), said.err
    # Its base is in the frame of what measured it, or, where rows do not say so, it may be taken as if it were.
    within = "instrument" if walked.model.placed is None else walked.model.placed.within
    placed = ("--placed-in", within, "--quiet", *of)
    said = run("cell", walked.out, walked.out, "-o", folder / "placed.urdf", *placed)
    assert said == (doubted, "", ""), said.err


def performs(walked: Walked, folder: Path) -> None:
    """A cone touched in several articulations: the calibrated arm finds it in one place."""
    case = walked.case
    tools = [case.draft.tools[0]] * 8
    if case.draft.points:  # of a scanner, which touches nothing
        return
    rows, kept = case.reach(np.repeat(case.places_of_touch[:1], 8, axis=0), tools)
    if len(kept) < 4:
        return
    columns = case.as_targets(rows) | {"target": np.array(["cone"] * len(kept))}
    if len(case.setups) > 1:
        columns["setup"] = np.array(rows.setups)
    write(folder / "cone.csv", columns)
    said = run("performance", walked.out, folder / "cone.csv", "--json")
    assert (said.code, said.err) == (0, ""), said.err
    after = json.loads(said.out)["after"][0]["value"]
    assert not case.placed or abs(after) < 8.0 * walked.bound("position"), after


def is_studied(walked: Walked, folder: Path) -> None:
    """What parameters do, and which poses would tell them."""
    drawn = ("--plot", folder / "sensitivity.svg")
    said = run("sensitivity", walked.case.path, "--errors", walked.out, *drawn, "--json")
    assert (said.code, said.err) == (0, ""), said.err
    write(folder / "done.csv", walked.case.joints(walked.case.draw(8)))
    tables = ("--measured", folder / "done.csv", "--working", folder / "done.csv", "--target", "0.1 mm")
    for more in ((), ("--criterion", "D"), ("--criterion", "A", "--observes", "pose"), tables):
        out = folder / f"poses_{len(more)}.csv"
        said = run("plan", walked.case.path, "-n", "6", "--candidates", "25", "-o", out, *more, "--json")
        assert (said.code, said.err) == (0, ""), said.err
        assert len(out.read_text(encoding="utf-8").splitlines()) == 7


def is_seen(walked: Walked, folder: Path) -> None:
    """What the live view answers, and how a fit shows itself."""
    model, fit = walked.model, walked.outcome.fit
    values = [slider["value"] for slider in live.sliders(model)]
    answer = live.answer(model, json.dumps({"readings": values, "apart": 5.0}))
    assert "positions" in answer or "does not close" in str(answer) or "cannot close" in str(answer), answer
    calib.table(fit)
    calib.plot(fit)
    display.html(fit)
    assert len(calib.data_frame(fit)) == len(fit.parameters)


def is_doubted(walked: Walked, folder: Path) -> None:
    """Advice, outliers and repeated fits of the same rows."""
    fit = walked.outcome.fit
    calib.advice(fit)
    q, tool = walked.case.draw(3), walked.case.draft.tools[0]
    # Of the few stretches of a stream some draws hold no row of a tool or of a place.
    repetitions = 10 if walked.case.draft.motion else 2
    found = calib.judging.bootstrap(fit, q, repetitions, kind="poses", tool=tool)
    assert len(found.values) >= 2 and found.values.shape[1] == len(fit.parameters)
    if all(data.position is not None for data in fit.measurements):
        assert calib.judging.bootstrap(fit, q, 2, kind="residuals", tool=tool).failed == 0


def is_made_from_python(walked: Walked, folder: Path) -> None:
    """What Python makes of the fit, without a job: judged by rows held out, and kept as the command keeps it."""
    fit = walked.outcome.fit
    data = fit.measurements[0]
    some, rest = calib.hold_out(data)
    assert len(some) + len(rest) == len(data)
    assert not [finding for finding in calib.check(fit.model, list(fit.measurements)) if finding.severity == "error"]
    found = calib.assess(fit, [data])
    assert found.machine.residual_model is None
    assert len(repr(found)) < 1000
    out = calib.save(found, folder / "by_python")
    assert (out / "scene.html").read_text(encoding="utf-8") == calib.scene(found)
    assert "Made from Python" in calib.report(found)
    again = calib.load_machine(out)
    q = walked.case.draw(3)
    told = walked.case.conditions(q)
    assert np.abs(again.tips(q, told) - found.machine.tips(q, told)).max() < 1e-9


def has_others(walked: Walked, folder: Path) -> None:
    """Which model the machine needs: at rows held out the simulated one is no worse than any that the data allow."""
    said = run("models", walked.case.path, "--folds", "2", "--json")
    assert (said.code, said.err) == (0, ""), said.err
    assert json.loads(said.out)["models"]


STEPS: tuple[Step, ...] = (
    predicts,
    verifies,
    compares,
    is_uncertain,
    is_commanded,
    is_exported,
    performs,
    is_studied,
    is_seen,
    is_doubted,
    is_made_from_python,
    has_others,
)
