"""A table that holds out rows of its own: whole groups of them, the same every time, never on both sides."""

import json
from pathlib import Path

import numpy as np
import pytest

from calib.foundations.errors import MeasurementError
from calib.job.inputs import load
from tests.support.cases import JOB, TABLE, copy_case, edit, keep_rows, run, write_table
from tests.support.touching import SOCKETS, between, lab

BEGIN = f'file = "{TABLE}"\n'


def holding_out(folder: Path, share: str = "0.25") -> Path:
    """The shipped case without its validation table, a share of the other one held out."""
    job = copy_case(folder)
    text = job.read_text(encoding="utf-8")
    job.write_text(text[: text.rindex("[[measurements]]")], encoding="utf-8")
    edit(JOB, (BEGIN, f"{BEGIN}hold_out = {share}\n"))(job.parent)
    return job


def test_rows_are_on_one_side_and_judge_the_other(tmp_path: Path) -> None:
    job = holding_out(tmp_path / "job")
    inputs = load(job)
    (seen,), (held_out,) = inputs.identify, inputs.validate
    assert (len(seen), len(held_out)) == (45, 15)
    assert not set(seen.lines.tolist()) & set(held_out.lines.tolist())
    assert load(job).validate[0].lines.tolist() == held_out.lines.tolist()
    assert run("calibrate", job, "-o", tmp_path / "out", "-q") == (0, "", "")
    metrics = json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))["metrics"]
    assert metrics["validation"]["after"]["position"]["n"] == 15
    assert metrics["validation"]["after"]["position"]["rms"] < 1e-2 * metrics["validation"]["before"]["position"]["rms"]


def test_a_pose_that_was_visited_again_stays_with_itself(tmp_path: Path) -> None:
    job = holding_out(tmp_path)
    table = tmp_path / TABLE
    rows = [line for line in table.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    table.write_text("\n".join([rows[0], *rows[1:], *rows[1:]]) + "\n", encoding="utf-8")
    inputs = load(job)
    sides = [{tuple(q) for q in np.round(data.readings, 6)} for data in (*inputs.identify, *inputs.validate)]
    assert not sides[0] & sides[1]
    assert sum(map(len, (*inputs.identify, *inputs.validate))) == 120


def test_rows_before_the_first_motion_are_told_once(tmp_path: Path) -> None:
    """The side of the first row is never known; an arm that rests at its first pose lost twenty rows in silence."""
    job = holding_out(tmp_path)
    edit(JOB, (BEGIN, f"{BEGIN}in_order = true\n"))(tmp_path)
    assert "rows-left-out" not in [finding.code for finding in load(job).findings]
    table = tmp_path / TABLE
    rows = [line for line in table.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    table.write_text("\n".join([rows[0], *([rows[1]] * 19), *rows[1:]]) + "\n", encoding="utf-8")
    inputs = load(job)
    assert sum(map(len, (*inputs.identify, *inputs.validate))) == 59
    assert [finding.sentence for finding in inputs.findings if finding.code == "rows-left-out"] == [
        f"{table}: in_order leaves out 20 rows, before every joint has moved: nothing tells from which side it was "
        "reached; begin with a motion of all joints."
    ]


def test_joints_whose_side_nothing_tells_are_named_where_it_matters(tmp_path: Path) -> None:
    """A joint that first moves late was taken for one whose offset had changed, and one that rests for a moved base."""
    job = holding_out(tmp_path)
    edit(JOB, (BEGIN, f"{BEGIN}in_order = true\n"))(tmp_path)
    table = tmp_path / TABLE
    head, *rows = [line for line in table.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    late = [",".join(["0.1", *row.split(",")[1:]]) for row in rows[:40]]
    table.write_text("\n".join([head, *late, *rows[40:]]) + "\n", encoding="utf-8")
    name = head.split(",")[0].split(" ")[0]

    def told() -> list[str]:
        return [finding.sentence for finding in load(job).findings if finding.code == "side-not-known"]

    assert told() == []
    edit(JOB, ('offsets = "all"', 'offsets = "all"\nbacklash = "all"'))(tmp_path)
    assert told() == [
        f"{table}: in 39 of 59 rows nothing tells from which side '{name}' was reached: it counts as in the middle, "
        "and half of its gap may then look like an offset, a base or a tool that changed; begin with a motion of all "
        "joints."
    ]


def test_what_a_joint_does_is_told_of_the_whole_table(tmp_path: Path) -> None:
    """A joint that moves in the rows to identify from, and stands still in the few that are held out."""
    job = holding_out(tmp_path)
    table = tmp_path / TABLE
    away = set(load(job).validate[0].lines.tolist())
    lines = table.read_text(encoding="utf-8").splitlines()
    for line in away:
        cells = lines[line - 1].split(",")
        lines[line - 1] = ",".join([*cells[:5], "0.1", *cells[6:]])
    table.write_text("\n".join(lines) + "\n", encoding="utf-8")
    inputs = load(job)
    assert np.ptp(inputs.validate[0].readings[:, 5]) == 0.0 < np.ptp(inputs.identify[0].readings[:, 5])
    assert "joint-at-rest" not in [finding.code for finding in inputs.findings]


@pytest.mark.parametrize("share", ["0.0", "1.0", "2", "-0.5", '"0.25"', "true"])
def test_a_share_that_is_none_is_refused(share: str, tmp_path: Path) -> None:
    said = run("check", holding_out(tmp_path, share))
    assert (said.code, said.out) == (1, "")
    assert "measurements[0].hold_out: " in said.err
    assert "is not a share between 0 and 1, like 0.25." in said.err


def test_held_out_tables_hold_nothing_out(tmp_path: Path) -> None:
    job = copy_case(tmp_path)
    edit(JOB, ('use = "validate"', 'use = "validate"\nhold_out = 0.5'))(job.parent)
    assert 'hold_out: has no effect with use = "validate"' in run("check", job).err


def test_one_row_cannot_be_shared_out(tmp_path: Path) -> None:
    job = holding_out(tmp_path)
    keep_rows(TABLE, 1)(tmp_path)
    with pytest.raises(MeasurementError, match="none can be held out"):
        load(job)


RELATED = """
schema = 1
[robot]
urdf = "example:ur_description/urdf/ur10_robot.urdf"
tip = "tool0"
[error_model]
offsets = "all"
base = "fixed"
[[relations]]
targets = ["{0}", "{1}"]
distance = "{2} m"
sigma = "0.01 mm"
[[measurements]]
file = "some.csv"
observes = "socket"
hold_out = 0.34
[[measurements]]
file = "others.csv"
observes = "socket"
use = "validate"
"""


def test_sockets_of_a_known_distance_are_not_held_out(tmp_path: Path) -> None:
    """The distance was left out without a word, and the warning asked for what the job has."""
    made = lab(noise=3e-5)
    for file, names in (("some.csv", ("a", "b", "c")), ("others.csv", ("other",))):
        places = [SOCKETS.get(name, (0.3, 0.6, 0.2)) for name in names]
        q = [made.touching(lambda x, c=place: x - c, made.scatter(6, 3)) for place in places]
        write_table(tmp_path / file, made.columns(np.concatenate(q), target=np.repeat(names, 6).tolist()))
    job = tmp_path / "job.toml"
    for a, b in ("ab", "bc", "ca"):
        job.write_text(RELATED.format(a, b, between("distance", a, b).value), encoding="utf-8")
        inputs = load(job)
        assert [relation.targets for relation in inputs.model.relations] == [(a, b)]
        assert not {"relation-left-out", "size-unseen"} & {finding.code for finding in inputs.findings}
    job.write_text(RELATED.format("a", "other", 0.4), encoding="utf-8")
    said = " ".join(run("check", job).out.split())
    assert "the known distance of 'a' and 'other' is not used, as not both are in a table to identify from" in said


KNOWN = """
schema = 1
[robot]
urdf = "example:ur_description/urdf/ur10_robot.urdf"
tip = "tool0"
[error_model]
offsets = "all"
{0}
[[measurements]]
file = "some.csv"
observes = "socket"
sigma = "0.03 mm"
hold_out = 0.25
"""


def test_of_three_sockets_in_known_places_each_stays_in_the_fit(tmp_path: Path) -> None:
    """Two leave the base free to turn about the line between them: the readings seemed to be of another robot."""
    made = lab(noise=3e-5)
    data = made.sockets(12)
    target = [data.targets[t] for t in data.target]
    write_table(tmp_path / "some.csv", made.columns(data.readings, target=target))
    known = "".join(f"[targets.{name}]\nposition = {[f'{x} m' for x in place]}\n" for name, place in SOCKETS.items())
    job = tmp_path / "job.toml"
    job.write_text(KNOWN.format(known), encoding="utf-8")
    inputs = load(job)
    ((own,), (held_out,)) = inputs.identify, inputs.validate
    assert set(own.targets) == set(held_out.targets) == set(SOCKETS)
    assert (len(own), len(held_out)) == (27, 9)
    # In unknown places one is held out as a whole: else what is left of its rows would be of where they are.
    job.write_text(KNOWN.format('base = "fixed"'), encoding="utf-8")
    inputs = load(job)
    assert [len(data.targets) for data in (*inputs.identify, *inputs.validate)] == [2, 1]
