"""What public functions are given, held against their annotations: of another kind, it is one sentence."""

import inspect
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

import calib
from calib.foundations.arguments import checked, own_fields
from calib.foundations.arrays import Array, BoolArray, IntArray
from calib.foundations.errors import JobError
from calib.identification.relations import Relation
from tests.support.cases import CASE, TABLE


def _nested(depth: int) -> list[Any]:
    found: list[Any] = []
    for _ in range(depth):
        found = [found]
    return found


@checked
def takes(
    number: float = 1.0,
    count: int = 1,
    flag: bool = False,
    text: str | Path = "",
    names: Literal["all"] | Sequence[str] = "all",
    amounts: Mapping[str, float | None] | None = None,
    point: tuple[float, float] = (0.0, 0.0),
    array: Array | None = None,
    rows: IntArray | BoolArray | None = None,
    numbers: npt.ArrayLike | None = None,
    progress: Callable[[int], None] = lambda _: None,
    some: Collection[str] = (),
    anything: Any = None,
) -> None:
    """Take one of every kind."""


@pytest.mark.parametrize(
    "given",
    [
        {"number": 1},
        {"number": np.float32(1.0)},
        {"number": float("nan")},  # for the function to judge
        {"count": np.int64(3)},
        {"flag": np.bool_(True)},
        {"text": Path("x")},
        {"names": "all"},
        {"names": "other"},  # likewise
        {"names": ["a", "b"]},
        {"names": ("a",)},
        {"names": np.array(["a", "b"])},
        {"names": pd.Series(["a"])},
        {"names": {"a": 1}.keys()},  # in the order of the mapping
        {"some": {"a", "b"}},
        {"amounts": {"a": 1.0, "b": None}},
        {"point": [1, 2.0]},
        {"point": np.zeros(2)},
        {"array": np.zeros((2, 3), dtype=int)},
        {"rows": np.array([True])},
        {"numbers": [[1, 2], [3, 4]]},
        {"numbers": pd.DataFrame([[1.0, 2.0]])},
        {"numbers": pd.DataFrame({"a": [1.0]})["a"]},
        {"progress": print},
        {"anything": object()},
    ],
)
def test_what_fits_is_taken(given: dict[str, Any]) -> None:
    takes(**given)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"number": "0.02 mm"}, "number is '0.02 mm'; needs a number."),
        ({"number": True}, "number is True; needs a number."),
        ({"number": 10**400}, "number is a whole number of 1329 bits, too large; needs a number."),
        ({"count": -(10**5000)}, "count is a whole number of 16610 bits, too large; needs a whole number."),
        ({"number": 1j}, "number is a complex; needs a number."),
        ({"number": np.zeros(3)}, "number is an array of float64; needs a number."),
        ({"count": 1.5}, "count is 1.5; needs a whole number."),
        ({"count": True}, "count is True; needs a whole number."),
        ({"flag": None}, "flag is None; needs a bool."),
        ({"text": 5}, "text is 5; needs a text or a Path."),
        ({"text": b"x"}, "text is b'x'; needs a text or a Path."),
        ({"names": None}, 'names is None; needs "all" or a list of texts.'),
        ({"names": ["a", None]}, "names is ['a', None]; needs \"all\" or a list of texts."),
        ({"names": memoryview(np.zeros((2, 2)))}, 'names is a memoryview; needs "all" or a list of texts.'),
        ({"names": {"a"}}, 'names is a set; needs "all" or a list of texts.'),
        ({"names": frozenset({"a"})}, 'names is a frozenset; needs "all" or a list of texts.'),
        ({"point": {1.0, 2.0}}, "point is a set; needs 2 numbers."),
        ({"names": {"a": 1}}, 'names is a dict; needs "all" or a list of texts.'),
        ({"amounts": {"a": "x"}}, "amounts is a dict; needs a mapping of texts to numbers or None, or None."),
        ({"amounts": {1: 1.0}}, "amounts is a dict; needs a mapping of texts to numbers or None, or None."),
        ({"point": (1.0,)}, "point is (1.0,); needs 2 numbers."),
        ({"point": "12"}, "point is '12'; needs 2 numbers."),
        ({"array": [1.0]}, "array is [1.0]; needs an array of numbers or None."),
        ({"array": np.zeros(2, dtype=complex)}, "array is an array of complex128; needs an array of numbers or None."),
        ({"array": np.ma.masked_all(2)}, "array is a masked array of float64; needs an array of numbers or None."),
        (
            {"rows": np.zeros(2)},
            "rows is an array of float64; needs an array of whole numbers, an array of bools or None.",
        ),
        ({"numbers": [[1.0], [1.0, 2.0]]}, "numbers is a list of list; needs an array of numbers or None."),
        (  # what is behind the mask would be taken
            {"numbers": list(np.ma.masked_array([[1.0, 9e9]], [[False, True]]))},
            "numbers is a list of masked numbers; needs an array of numbers or None.",
        ),
        (
            {"numbers": [[1.0, np.ma.masked]]},
            "numbers is a list of masked numbers; needs an array of numbers or None.",
        ),
        (
            {"numbers": (pd.DataFrame({"a": [1.0]}),)},
            "numbers is a tuple of DataFrame; needs an array of numbers or None.",
        ),
        ({"numbers": _nested(5000)}, "numbers is a list of list; needs an array of numbers or None."),
        ({"numbers": [None]}, "numbers is [None]; needs an array of numbers or None."),
        ({"numbers": "abc"}, "numbers is 'abc'; needs an array of numbers or None."),
        (  # an array has no names: columns in another order, or in degrees, would be wrong in silence
            {"numbers": pd.DataFrame({"a": [1.0]})},
            "numbers is a DataFrame, whose columns have names; needs an array of numbers or None.",
        ),
        ({"progress": 5}, "progress is 5; needs a function."),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused_in_a_sentence(given: dict[str, Any], said: str) -> None:
    with pytest.raises(JobError) as caught:
        takes(**given)
    assert str(caught.value) == f"takes: {said}"


def test_an_array_serves_as_a_list_of_numbers() -> None:
    robot = calib.load_robot(CASE / "arm_cmm.urdf", tip="probe")
    data, held_out = calib.hold_out(calib.read_measurements(CASE / TABLE, robot, sigma=2e-5))
    model, sigmas = calib.error_model(robot, offsets="all"), [1e-5, 2e-5]
    by_list, by_array = (
        calib.identify(model, [data, held_out], model_sigmas=given) for given in (sigmas, np.array(sigmas))
    )
    np.testing.assert_array_equal(by_list.values, by_array.values)


def test_long_texts_are_cut() -> None:
    with pytest.raises(JobError) as caught:
        takes(number="x" * 10_000)  # type: ignore[arg-type]
    assert len(str(caught.value)) < 150


def test_fields_are_held_against_their_annotations() -> None:
    @dataclass(frozen=True)
    class Thing:
        size: float
        name: str = ""

        def __post_init__(self) -> None:
            own_fields(self)

    Thing(1.0, "a")
    with pytest.raises(JobError, match=r"^Thing: name is None; needs a text\.$"):
        Thing(1.0, None)  # type: ignore[arg-type]


# ---- what is public


def test_every_public_function_looks_at_what_it_is_given() -> None:
    rooms = (calib, calib.commands, calib.dh, calib.judging, calib.measuring, calib.planning, calib.positioner)
    for room in rooms:
        names = getattr(room, "__all__", None) or [name for name in vars(room) if name.startswith("for_")]
        for name in names:
            value = getattr(room, name)
            if inspect.isfunction(value):
                assert hasattr(value, "__wrapped__"), name


def test_slips_of_python_users_are_sentences() -> None:
    robot = calib.load_robot(CASE / "arm_cmm.urdf", tip="probe")
    data = calib.read_measurements(CASE / TABLE, robot, sigma=2e-5)
    model = calib.error_model(robot, offsets="all")
    fit = calib.identify(model, data)
    for slip, said in (
        (lambda: calib.load_robot(None), "load_robot: urdf is None; needs a text, a Path or an Urdf."),  # type: ignore[arg-type]
        (lambda: calib.error_model(robot, offsets=5), 'offsets is 5; needs "all", "none" or a list of texts.'),  # type: ignore[arg-type]
        (lambda: calib.error_model(robot, offsets=None), "offsets is None"),  # type: ignore[arg-type]
        (lambda: calib.identify(model, fit), "identify: measurements is a Fit; needs a Measurements"),  # type: ignore[arg-type]
        (lambda: calib.identify(model, [data, None]), "measurements is a list of Measurements, NoneType"),  # type: ignore[list-item]
        (lambda: calib.identify(model, data, free="base.x"), "free is 'base.x'; needs a list of texts or None."),
        (lambda: calib.verify(fit, data), "verify: machine is a Fit; needs a CalibratedMachine."),  # type: ignore[arg-type]
        (lambda: calib.read_measurements(CASE / TABLE, robot, "postion"), "observes: 'postion' is not one of position"),  # type: ignore[arg-type]
        (lambda: robot.tips([[0.0] * 6]), "tips: readings is a list of list; needs an array of numbers."),  # type: ignore[arg-type]
        (lambda: calib.measuring.Payload("5 kg"), "Payload: mass is '5 kg'; needs a number."),  # type: ignore[arg-type]
        (lambda: calib.Deviations(None, np.zeros(6)), "Deviations: placements is None; needs an array of numbers."),  # type: ignore[arg-type]
        (lambda: data.subset([99]), "there are no such rows among 60"),
        (lambda: data.subset(np.array(3)), "rows are a list of numbers, or a mask, and no 0-d array."),
        (lambda: data.link_of(7), "there is no such target among 0 (tuple index out of range)."),
        (lambda: data.link_of("a"), "link_of: target is 'a'; needs a whole number."),  # type: ignore[arg-type]
        (lambda: fit.told_covariance(np.array([999])), "told_covariance: parameters is no array of numbers from 0 to"),
        (lambda: fit.told_covariance(np.array(0)), "told_covariance: parameters is no array of numbers from 0 to"),
        (lambda: fit.value("tool.y.z"), "the fit has no parameter 'tool.y.z'; there are 'tool.z', 'tool.y', 'tool.x'."),
        (lambda: fit.value("q"), "the fit has no parameter 'q'; there are 'joint_1.offset', 'joint_2.offset',"),
        (lambda: fit.bases_of(None), "bases_of: data is None; needs a Measurements."),  # type: ignore[arg-type]
        (lambda: data.placed_by(np.eye(4)), "tools has the shape (4, 4); needed is (1, 4, 4)."),
        (lambda: data.loaded(fit), "loaded: robot is a Fit; needs a Robot."),  # type: ignore[arg-type]
        (lambda: robot.own(["a"]), "own: readings is ['a']; needs an array of numbers."),
        (lambda: model.at(["base"]), "at: setup is ['base']; needs a text."),  # type: ignore[arg-type]
        (lambda: calib.judging.cross_validate(model, data, count=2).figure("turn"), "quantity: 'turn' is not one of"),
        (lambda: fit.told_covariance([0]), "told_covariance: parameters is [0]; needs an array of whole numbers."),  # type: ignore[arg-type]
        (lambda: calib.positions(robot, data.readings, data.position, tool="\ud800"), "holds half a character"),  # type: ignore[arg-type]
        (
            lambda: calib.read_measurements({"group": [10**5000]}, robot),
            "column 'group': a whole number of 16610 bits, too large is not a word.",
        ),
        (
            lambda: calib.read_measurements({"x [m]": [10**5000]}, robot),
            "column 'x': 'a whole number of 16610 bits, too large' is not a number",
        ),
        (lambda: calib.judging.cross_validate(model, data, losses=[]), "0 losses are given for 1 set"),
        (
            lambda: calib.judging.compare_models({"a": model, "b": calib.error_model(robot)}, data, losses=[]),
            "0 losses are given for 1 set",
        ),
        (lambda: calib.judging.observability(model, np.array([])), "there are no measurements to identify from."),  # type: ignore[arg-type]
        (lambda: calib.plan(model, 10, candidates=30, measured=np.array(0.5)), "readings of shape (): needs"),
        (lambda: calib.positioner.five_point(np.eye(3), *np.eye(4, 3)), "P1: an array of float64 is not a point"),
        (lambda: calib.dh.dh_to_urdf(calib.dh.dh_of(robot), "\ud800"), "is not well-formed XML"),
        (lambda: calib.assess(fit, data=[]), "data: there are no tables to judge the fit by."),
        (lambda: calib.planning.Views(data), "Views: fit is a Measurements; needs a Fit."),  # type: ignore[arg-type]
        (lambda: calib.planning.roughly([0.1]), "tool: needs three lengths x, y, z in m."),
        (lambda: calib.planning.self_collision(robot, (), np.array(5.0)), "readings has the shape (); needed is"),
        (lambda: calib.data_frame(fit, "values"), "what: 'values' is not one of parameters, residuals, correlations."),  # type: ignore[arg-type]
        (lambda: calib.plot(fit, "values"), "what: 'values' is not one of errors, parameters, correlations."),  # type: ignore[arg-type]
        (lambda: calib.judging.cross_validate(model, []), "there are no measurements to identify from."),
        (lambda: calib.judging.compare_models({"a": model}, []), "there are no measurements to identify from."),
        (lambda: calib.assess(fit, data.subset([])), "has no rows to judge by."),
        (lambda: calib.judging.bootstrap(fit, np.zeros(6)), "readings of shape (6,): needs (N, 6), a column for each"),
        (lambda: calib.judging.bootstrap(fit, np.zeros((1, 6)), seed=-1), "seed is -1; allowed is 0 or more."),
        (lambda: calib.planning.random_candidates(robot, calib.planning.roughly(), 5, seed=-1), "seed is -1;"),
        (lambda: calib.planning.possible(robot, calib.planning.roughly(), np.zeros((3, 5))), "of shape (3, 5): needs"),
        (lambda: calib.plan(model, 10, candidates=30, measured=np.zeros((3, 5))), "readings of shape (3, 5): needs"),
        (
            lambda: calib.plan(
                model, 10, candidates=30, measurement=calib.planning.PlannedMeasurement(working=np.zeros((3, 2)))
            ),
            "readings of shape (3, 2): needs",
        ),
        (lambda: calib.positions(robot, data.readings[1:], data.position), "xyz: 60 rows for 59 rows of readings."),  # type: ignore[arg-type]
        (lambda: calib.measuring.sockets(robot, data.readings, ["a"]), "names: 1 row for 60 rows of readings."),
        (
            lambda: calib.positioner.relative_base(np.eye(3), np.eye(3)).sigma_at(np.zeros(3)),
            "the points to carry must be finite numbers (N, 3), in m.",
        ),
    ):  # fmt: skip
        with pytest.raises(calib.CalibError) as caught:
            slip()
        assert said in str(caught.value)
        assert "\n" not in str(caught.value)


def test_numbers_out_of_range_are_sentences() -> None:
    """Where a number would be taken as it is, and answered with confidence."""
    robot = calib.load_robot(CASE / "arm_cmm.urdf", tip="probe")
    data = calib.read_measurements(CASE / TABLE, robot, sigma=2e-5)
    model = calib.error_model(robot, offsets="all")
    machine = calib.machine_of(calib.identify(model, data))
    q, T = data.readings, robot.tips(data.readings)
    with_nan, wild = (np.where(np.arange(len(q))[:, None] == 2, value, q) for value in (np.nan, 1e300))
    for slip, said in (
        (lambda: robot.tips(with_nan), "readings: row 3 of 'joint_1' is nan; allowed is -1e+08 to 1e+08 rad."),
        (lambda: machine.predict(wild), "readings: row 3 of 'joint_1' is 1e+300; allowed is"),
        (lambda: machine.tool_jacobian(q[:, :5]), "readings of shape (60, 5): needs (N, 6)"),
        (lambda: machine.tool_jacobian(with_nan), "row 3 of 'joint_1' is nan"),
        (lambda: calib.poses(robot, q, T.swapaxes(1, 2)), "placements: row 1 is not a placement; needed are a"),
        (lambda: calib.poses(robot, q, np.where(np.eye(4) > 0, 1e200, T)), "placements: row 1 is not a placement"),
        (lambda: calib.poses(robot, q, np.full_like(T, np.nan)), "placements: row 1 is not a placement"),
        (lambda: calib.verify(machine, data, limit=np.nan), "limit is nan m; allowed is 1e-06 to 1000 mm."),
        (lambda: calib.plan(model, 10, candidates=10**12), "1000000000000 random poses are asked for; allowed are"),
        (lambda: calib.plan(model, 10, candidates=100, target=-1e-3), "target is -0.001 m; allowed is"),
        (lambda: calib.plan(model, 2, candidates=with_nan), "row 3 of 'joint_1' is nan"),
        (lambda: calib.error_model(robot, placements="all", priors=calib.Priors(length=1e300)), "1e+300 m"),
        (lambda: Relation("nope", ("a", "b"), 1.0, 1.0), "relation: 'nope' is not one of distance, angle, offset."),  # type: ignore[arg-type]
        (lambda: Relation("angle", ("a", "b"), 4.7, 1e-4), "the angle is 4.7 rad; allowed is 0 to 180 deg."),
        (lambda: Relation("distance", ("a",), 1.0, 1.0), "Relation: targets is ('a',); needs 2 texts."),  # type: ignore[arg-type]
    ):  # fmt: skip
        with pytest.raises(calib.CalibError) as caught:
            slip()
        assert said in str(caught.value)
        assert "\n" not in str(caught.value)


def test_deviations_of_another_arm_are_refused() -> None:
    robot = calib.load_robot(CASE / "arm_cmm.urdf", tip="probe")
    none, q = robot.no_deviations(), np.zeros((1, 6))
    for d, said in (
        (calib.Deviations(np.zeros((3, 6)), none.offsets), r"placements has the shape \(3, 6\); of this arm"),
        (calib.Deviations(none.placements, np.zeros(5)), r"offsets has the shape \(5,\); of this arm it is \(6,\)"),
        (calib.Deviations(none.placements, none.offsets, np.zeros(1)), r"terms has the shape \(1,\)"),
    ):  # fmt: skip
        with pytest.raises(calib.RobotError, match=said):
            robot.tips(q, d)


def test_numbers_out_of_range_are_refused_where_they_come_in() -> None:
    robot = calib.load_robot(CASE / "arm_cmm.urdf", tip="probe")
    data = calib.read_measurements(CASE / TABLE, robot, sigma=2e-5)
    u = calib.machine_of(calib.identify(calib.error_model(robot, offsets="all"), data))
    t = np.linspace(0.0, 3.0, 8)
    circle, line = np.c_[np.cos(t), np.sin(t), 0.0 * t], np.c_[t, 0.0 * t, 0.0 * t]
    at = calib.positioner
    for slip, said in (
        (lambda: calib.judging.uncertainty_map(u, 0), "0 random poses, seed 0: allowed are 1 to 1000000"),
        (lambda: calib.judging.uncertainty_map(u, 10**9), "1000000000 random poses"),
        (lambda: calib.judging.uncertainty_map(u, 5, seed=-1), "no negative seed"),
        (
            lambda: calib.judging.uncertainty_map(u, 5, closure_determinant=float("nan")),
            "closure_determinant is nan; needs a finite number.",
        ),
        (lambda: at.expected_circle_error(-1.0, t, 1e-4), "radius is -1 m; allowed is 0 to 10000 m."),
        (lambda: calib.judging.uncertainty_map(u, 5, limits=np.zeros((2, 6))), "limits: needs finite numbers (6, 2)"),
        (
            lambda: calib.judging.uncertainty_map(u, 5, limits=np.full((6, 2), np.nan)),
            "limits: needs finite numbers (6, 2)",
        ),
        (
            lambda: calib.judging.uncertainty_map(u, 5, limits=np.full((6, 2), [-1e308, 1e308])),
            "limits: needs finite numbers (6, 2)",
        ),
        (lambda: calib.judging.compare(u, u, seed=-1), "no negative seed"),
        (lambda: calib.judging.outside_identified(u, np.zeros(6)), "readings of shape (6,)"),
        (lambda: calib.judging.outside_identified(u, np.full((1, 6), 1e308)), "readings of shape (1, 6)"),
        (lambda: calib.commands.for_joint_targets(u, np.full((1, 6), 1e308)), "the readings must be finite numbers"),
        (lambda: calib.Deviations(np.full((6, 6), 1e308), np.zeros(6)), "not finite, or above 1e+100"),
        (lambda: calib.measuring.Camera("floor", size=(10**400, 9)), "size is a tuple of int"),
        (lambda: at.circle_axis(1e308 * circle), "the points of a sweep must be finite numbers"),
        (lambda: at.pivot(np.full((3, 4, 4), 1e308)), "the placements of a pivot must be finite"),
        (lambda: at.pivot(np.eye(4)[None], guess=[1e308, 0.0, 0.0]), "the guess of a tool point must be three finite"),
        (lambda: at.five_point(*(1e308 * np.eye(3)), [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]), "is not a point of three"),
        (lambda: calib.dh.dh_of(robot, parallel=5.0), "parallel: 5.0 is not an angle between 0 and 0.5 rad"),
        (lambda: calib.dh.dh_of(robot, parallel=float("nan")), "parallel: nan"),
        (lambda: at.circle_axis(circle, sigma=1e300), "sigma is 1e+300 m; allowed is 0, or 1e-06 to 1000 mm"),
        (lambda: at.line_axis(line, sigma=float("inf")), "sigma is inf m"),
        (lambda: at.expected_circle_error(float("nan"), t, 1e-4), "radius is nan m"),
        (lambda: at.expected_circle_error(1.0, 5.0, 1e-4), "must be finite numbers (N,)"),
        (lambda: at.expected_line_error([], 1e-4), "must be finite numbers (N,)"),
        (lambda: at.relative_base(circle, circle, sigma_a=-1.0, sigma_b=1e-4), "sigma_a is -1 m"),
        (lambda: at.pivot(np.eye(4)[None], guess=[0.0]), "the guess of a tool point must be three finite numbers"),
        (lambda: at.pivot(np.eye(4)[None], sigma=float("nan")), "sigma is nan m"),
    ):  # fmt: skip
        with pytest.raises(calib.CalibError) as caught:
            slip()
        assert said in str(caught.value)


def test_what_was_given_is_kept_whatever_its_owner_does_later() -> None:
    robot = calib.load_robot("example:ur_description/urdf/ur10_robot.urdf", tip="tool0")
    placements, base, tools = np.zeros((len(robot.chain), 6)), np.eye(4), {"tool": np.eye(4)}
    machine = calib.CalibratedMachine(robot, calib.Deviations(placements, np.zeros(6)), base, tools)
    readings = np.zeros((1, 6))
    before = machine.predict(readings)
    placements += 0.1
    base[0, 3] = tools["tool"][0, 3] = 1.0
    tools.clear()
    np.testing.assert_array_equal(machine.predict(readings), before)
    with pytest.raises(ValueError, match="read-only"):
        machine.base[0, 3] = 1.0


def test_views_of_what_others_may_write_to_are_copied() -> None:
    robot = calib.load_robot("example:ur_description/urdf/ur10_robot.urdf", tip="tool0")
    deviations = calib.Deviations(np.zeros((len(robot.chain), 6)), np.zeros(6))
    base, tools = np.eye(4), {"tool": np.eye(4)}
    view = base[:]
    view.flags.writeable = False
    machine = calib.CalibratedMachine(robot, deviations, np.broadcast_to(view, (4, 4)), MappingProxyType(tools))
    base[0, 3] = tools["tool"][0, 3] = 1.0
    tools.clear()
    np.testing.assert_array_equal(machine.base, np.eye(4))
    np.testing.assert_array_equal(machine.tools["tool"], np.eye(4))
    again = calib.CalibratedMachine(robot, deviations, machine.base, machine.tools)
    assert again.base is machine.base


def test_a_matrix_is_refused_in_a_sentence() -> None:
    robot = calib.load_robot("example:ur_description/urdf/ur10_robot.urdf", tip="tool0")
    deviations = calib.Deviations(np.zeros((len(robot.chain), 6)), np.zeros(6))
    matrix = np.eye(4).view(np.matrix)
    with pytest.raises(calib.CalibError, match="base is a matrix of float64; needs an array of numbers"):
        calib.CalibratedMachine(robot, deviations, matrix, {"tool": np.eye(4)})


def test_numbers_of_numpy_become_those_of_python() -> None:
    @checked
    def told(count: int, least: float) -> tuple[type, type]:
        return type(count), type(least)

    assert told(np.int8(3), least=np.float32(0.5)) == (int, float)  # type: ignore[arg-type]
    term = calib.JointTerm("joint_2", "cos", np.int64(2))  # type: ignore[arg-type]
    assert type(term.order) is int
    payload = calib.measuring.Payload(np.float32(2.0), np.array([0.0, 0.0, 0.1]))  # type: ignore[arg-type]
    assert payload == calib.measuring.Payload(2.0, (0.0, 0.0, 0.1))


_HALF, _LONG = np.float16, np.longdouble


@pytest.mark.parametrize(
    ("make", "plain"),
    [
        (lambda given: calib.Priors(length=given), Fraction(1, 4)),
        (lambda given: calib.measuring.Payload(given, [given, 0, given]), Fraction(1, 4)),
        (lambda given: calib.dh.DhRow("j", "revolute", given, 0, 0, 0), Fraction(1, 4)),
        (lambda given: calib.dh.DhRow("j", "revolute", given, 0, 0, 0), 4),
        (lambda given: calib.planning.Sight(facing=[given, given, given]), Fraction(1, 4)),
        (lambda given: calib.Coupling("a", {"b": given}), _LONG(0.25)),
        (lambda given: calib.measuring.LaserTracker(given, 0, [given, 0, 0]), _HALF(0.25)),
    ],
)
def test_numbers_of_every_kind_become_those_of_python(make: Callable[[Any], object], plain: Any) -> None:
    made, meant = make(plain), make(float(plain))
    assert (made, repr(made)) == (meant, repr(meant))


def test_numbers_that_are_none_are_sentences() -> None:
    for given, said in (
        (np.timedelta64(3, "s"), "needs a number"),
        (_LONG("1e4000"), "inf"),
        (Fraction(1, 10**400), "0.0 is not a positive number"),
    ):
        with pytest.raises(JobError, match=said):
            calib.Priors(length=given)  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", [np.float16, np.float32, np.longdouble])
def test_arrays_of_every_kind_of_numbers_become_those_of_float64(kind: Any) -> None:
    robot = calib.load_robot(CASE / "arm_cmm.urdf", tip="probe")
    readings = np.array([[0.5, -0.25, 0.125, 0.0, 0.5, 1.0]])
    given, plain = (
        calib.CalibratedMachine(
            robot,
            calib.Deviations(np.zeros((len(robot.chain), 6), kind), np.full(6, 0.125, kind)),
            np.eye(4, dtype=kind),
            {"tool": np.eye(4, dtype=kind)},
        ).predict(readings.astype(kind))
        for kind in (kind, np.float64)
    )
    np.testing.assert_array_equal(given, plain)
    calib.measuring.Target(np.eye(4, dtype=kind))
    calib.measuring.SetUp(np.eye(4, dtype=kind))
    calib.dh.DhTable("standard", (calib.dh.DhRow("j", "revolute", 0.1, 0.2, 0.0, 0.0),), np.eye(4, dtype=kind))
    beyond = readings.astype(_LONG)
    beyond[0, 0] = _LONG("1e4000")
    with pytest.raises(calib.CalibError):
        calib.positions(robot, beyond, np.zeros((1, 3)))


def test_placements_of_huge_numbers_are_sentences() -> None:
    huge = np.eye(4)
    huge[0, 1] = 1e308
    with pytest.raises(calib.CalibError, match="needs a point"):
        calib.Known(base=huge)
    with pytest.raises(calib.CalibError, match="not a rigid placement"):
        calib.dh.DhTable("standard", (calib.dh.DhRow("j", "revolute", 0.1, 0.2, 0.0, 0.0),), huge)


def test_columns_that_are_none_are_sentences() -> None:
    robot = calib.load_robot(CASE / "arm_cmm.urdf", tip="probe")
    columns = {f"{name} [rad]": [0.1, 0.2] for name in (r.name for r in robot.readings)} | {
        "y [m]": [1, 2],
        "z [m]": [1, 2],
    }
    for x, said in (
        ([[1.0, 2.0], [3.0]], r"column 'x \[m\]' is a list of list; needs one value for each row"),
        (np.ma.masked_array([1.0, 9e9], [False, True]), "is a masked array of float64; leave its rows out"),
        (list(np.ma.masked_array([1.0, 9e9], [False, True])), "is a list of masked numbers; leave its rows out"),
        (np.array([_LONG("1e4000"), 1.0]), "column 'x'"),
    ):
        with pytest.raises(calib.CalibError, match=said):
            calib.read_measurements({**columns, "x [m]": x}, robot)


def test_keys_of_terms_that_are_no_lists_are_sentences_of_one_line() -> None:
    robot = calib.load_robot(CASE / "arm_cmm.urdf", tip="probe")
    for key in ("gain", "harmonic_orders"):
        for value, told in ((np.array(0.5), "an array of float64"), (pd.Series([1.0, 2.0]), "a Series")):
            with pytest.raises(JobError, match=f"{key}: {told} is not .* list of [^\n]*$"):
                calib.error_model(robot, terms={key: value})


def test_orders_of_an_array_are_saved(tmp_path: Path) -> None:
    robot = calib.load_robot(CASE / "arm_cmm.urdf", tip="probe")
    data = calib.read_measurements(CASE / TABLE, robot, sigma=2e-5)
    terms = [calib.JointTerm("joint_2", "cos", order) for order in np.arange(1, 3)]
    fit = calib.identify(calib.error_model(robot, offsets="all", terms=terms), data)
    assert [term.order for term in calib.load_machine(calib.save(fit, tmp_path / "out")).robot.terms] == [1, 2]


@pytest.mark.parametrize(
    ("make", "given"),
    [
        (lambda given: calib.measuring.Payload(1.0, given), [0.0, 0.0, 0.1]),
        (calib.measuring.Load, [0.0, 0.0, -9.8]),
        (lambda given: calib.measuring.LaserTracker(1e-5, 1e-6, given), [1.0, 0.0, 0.0]),
        (lambda given: Relation("distance", given, 1.0, 1e-5), ["a", "b"]),
        (lambda given: calib.ClosedLoop("loop", ("a", "b"), ("x",), given), ["j"]),
        (lambda given: calib.measuring.Columns({}, given), ["noise"]),
        (lambda given: calib.Known(relations=given), [Relation("distance", ("a", "b"), 1.0, 1e-5)]),
        (lambda given: calib.dh.DhTable("standard", given), [calib.dh.DhRow("j", "revolute", 0.1, 0.2, 0.0, 0.0)]),
    ],
)
def test_lists_that_change_later_change_nothing(make: Callable[[list[Any]], object], given: list[Any]) -> None:
    made = make(given)
    before = repr(made)
    given.clear()
    assert repr(made) == before


def test_methods_that_take_numbers_or_names_hold_them_against_their_hints() -> None:
    """What is behind a mask was taken for points, a text for a list of its letters."""
    robot = calib.load_robot(CASE / "arm_cmm.urdf", tip="probe")
    machine = calib.CalibratedMachine(robot, robot.no_deviations(), np.eye(4), {"tool": np.eye(4)})
    data = calib.read_measurements(CASE / TABLE, robot, sigma=2e-5)
    model = calib.error_model(robot)
    masked = np.ma.masked_array(np.ones((4, 3)), np.eye(4, 3))
    readings = np.ma.masked_array(np.zeros((2, len(robot.readings))), True)
    planning, measuring = calib.planning, calib.measuring
    tracker, board = measuring.LaserTracker(1e-5, 1e-6), measuring.Board("b", np.eye(3))
    bodies = planning.self_collision(calib.load_robot("example:ur_description/urdf/ur5_robot.urdf", tip="tool0"))
    assert bodies is not None
    asked: list[Callable[[], object]] = [
        lambda: tracker.sigma_at(masked),
        lambda: tracker.sigma_at(np.zeros((4, 6))),
        lambda: calib.positioner.relative_base(np.eye(3), np.eye(3)).sigma_at(masked),
        lambda: planning.Sight().sees(np.stack([np.eye(4)] * 4), masked),
        lambda: planning.Sight().sees(np.array(1.0), np.array(1.0)),
        lambda: planning.Sight().sees(np.stack([np.eye(4)] * 2), np.ones((4, 3))),
        lambda: board.numbers(masked),
        lambda: board.numbers(np.zeros((4, 6))),
        lambda: bodies.colliding(np.ma.masked_all((2, 6))),
        lambda: bodies.without_lasting(np.ma.masked_all((2, 6))),
        lambda: bodies.without_lasting(np.array(1.0)),
        lambda: bodies.colliding(np.array(1.0)),
        lambda: bodies.colliding(np.zeros((2, 6)), 5),  # type: ignore[arg-type]
        lambda: board.same_as(5),  # type: ignore[arg-type]
        lambda: measuring.TouchingArm(machine, np.zeros(3), 1e-5).points(readings),
        lambda: model.parameters("tool"),
        lambda: data.at(["base"]),  # type: ignore[arg-type]
        lambda: robot.carrier(5),  # type: ignore[arg-type]
        lambda: robot.driving("probe"),
        lambda: machine.tool_named(np.zeros(3)),  # type: ignore[arg-type]
    ]
    for ask in asked:
        with pytest.raises(calib.CalibError, match=r"^[^\n]+$"):
            ask()


def test_rows_of_one_set_up_are_read_only() -> None:
    robot = calib.load_robot(CASE / "arm_cmm.urdf", tip="probe")
    data = calib.read_measurements(CASE / TABLE, robot, sigma=2e-5).at("base")
    assert not any(value.flags.writeable for value in vars_of(data).values() if isinstance(value, np.ndarray))


def vars_of(made: object) -> dict[str, Any]:
    return {name: getattr(made, name) for name in type(made).__slots__}  # type: ignore[attr-defined]


def test_every_method_of_a_public_class_looks_at_what_it_is_given() -> None:
    """But for two that rooms use among themselves: of what is known to be right, and of functions as arguments."""
    rooms = (calib, calib.commands, calib.dh, calib.judging, calib.measuring, calib.planning, calib.positioner)
    classes = {thing for room in rooms for name in room.__all__ if inspect.isclass(thing := getattr(room, name))}
    bare = [
        f"{cls.__name__}.{name}"
        for cls in classes
        for name, method in vars(cls).items()
        if not name.startswith("_")
        and inspect.isfunction(own := getattr(method, "__func__", method))
        and len(inspect.signature(own).parameters) > 1
        and not hasattr(own, "__wrapped__")
    ]
    assert sorted(bare) == ["Deviations.trusted", "Finding.warning"]


def test_a_hint_that_names_its_own_class_is_held_against_too() -> None:
    class Thing:
        @checked
        def like(self, other: "Later | None") -> bool:
            return other is None

    with pytest.raises(JobError, match=r"^like: other is 5; needs a Later or None\.$"):
        Thing().like(5)  # type: ignore[arg-type]


class Later:
    """A class that is known when it is asked for."""


def test_things_that_fail_to_become_arrays_are_sentences() -> None:
    class Tensor:
        def __array__(self) -> npt.NDArray[Any]:
            raise RuntimeError("detach it first")

    with pytest.raises(JobError, match=r"^takes: numbers is a Tensor; needs an array of numbers or None\.$"):
        takes(numbers=Tensor())


def test_what_is_equal_has_one_hash() -> None:
    def made() -> list[object]:
        camera = calib.measuring.Camera("tip", 900.0, 900.0, 640.0, 360.0, free=("fx",), lens_sigma={"fx": 2.0})
        return [calib.Coupling("a", {"b": 1.0}), camera, calib.measuring.Columns({"x": "east"})]

    for one, other in zip(made(), made(), strict=True):
        assert (one, hash(one), {one, other}) == (other, hash(other), {one})
