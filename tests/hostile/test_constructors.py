"""Frozen data of the front modules, made by hand: nonsense is refused in one sentence, whatever field it is in.

A new public dataclass joins by itself: it is among what functions make, or has an example here of what is good.
"""

import functools
import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
import pytest

import calib
from calib.foundations.errors import CalibError

# What functions make, and nobody writes down, or what is of a fit: it is as good as their arguments.
MADE = (
    *("Bootstrap", "CalibratedCell", "Calibration", "Choice", "Corrections", "CrossValidation", "DhFrames"),
    *("ErrorModel", "Export", "Finding", "Fit", "FivePoint", "Forecast", "GroupStudy", "HeldOut", "JudgedModel"),
    *("Measurements", "ModelComparison", "Observability", "Performance", "Pivot", "Plan", "PrismaticAxis", "Proposal"),
    *("ProposedTable", "Question", "RelativeBase", "RevoluteAxis", "Robot", "SelfCollision", "Sensitivity"),
    *("TableError", "Targets", "Touches", "Trace", "Views"),
)
# Conditions say nothing where they are NaN, and are held against the rows that they are of; sight may have no end.
LATER = {
    "Conditions": ("payload", "gravity", "temperature", "torque", "approach", "lagged", "torque_sigma", "motion"),
    "Sight": ("nearest", "farthest"),
}
FRONT = (calib, calib.commands, calib.dh, calib.judging, calib.measuring, calib.planning, calib.positioner)


def public() -> dict[str, type]:
    """The dataclasses that the front modules name."""
    named = ((name, getattr(module, name)) for module in FRONT for name in module.__all__)
    return {name: found for name, found in named if inspect.isclass(found) and is_dataclass(found)}


CLASSES = {name: found for name, found in public().items() if name not in MADE}


@functools.cache
def machine() -> calib.CalibratedMachine:
    robot = calib.load_robot("example:ur_description/urdf/ur5_robot.urdf", tip="tool0")
    return calib.CalibratedMachine(robot, robot.no_deviations(), np.eye(4), {"tool": np.eye(4)})


ROW = {"joint": "j", "type": "revolute", "a": 0.1, "d": 0.2, "alpha": 0.0, "theta": 0.0, "beta": 0.0}
GOOD: Mapping[str, Callable[[], dict[str, Any]]] = {
    "Board": lambda: {"marks": np.zeros((4, 3))},
    "CalibratedMachine": lambda: {
        name: getattr(machine(), name) for name in ("robot", "deviations", "base", "tools", "others", "tool_tips")
    },
    "Camera": lambda: {"camera_on": "tip", "fx": 900.0, "fy": 900.0, "cx": 640.0, "cy": 360.0},
    "Candidates": lambda: {"readings": np.zeros((3, 6)), "tried": 3},
    "ClosedLoop": lambda: {"name": "l", "frames": ("a", "b"), "closes": ("x",), "passive": ("j",)},
    "Clock": dict,
    "Columns": dict,
    "Conditions": dict,
    "Coupling": lambda: {"joint": "j", "drivers": {"k": 1.0}},
    "Deviations": lambda: {"placements": np.zeros((2, 6)), "offsets": np.zeros(2), "terms": np.zeros(1)},
    "DhRow": lambda: dict(ROW),
    "DhTable": lambda: {"convention": "standard", "rows": (calib.dh.DhRow(**ROW),)},
    "Free": dict,
    "JointTerm": lambda: {"reading": "j", "kind": "cos", "order": 2},
    "Known": lambda: {"base": np.eye(4), "tools": {"tool": np.zeros(3)}},
    "LaserTracker": lambda: {"sigma": 1e-5, "sigma_per_metre": 1e-6},
    "Load": dict,
    "Payload": lambda: {"mass": 1.0, "position": (0.0, 0.0, 0.1)},
    "Priors": lambda: {"length": 1e-3, "angle": 1e-3, "harmonics": 1e-4, "elastic": 1e-5, "elastic_sliding": 1e-7},
    "Relation": lambda: {"kind": "distance", "targets": ("a", "b"), "value": 1.0, "sigma": 1e-5},
    "SetUp": lambda: {"pose": np.eye(4), "length": 1e-3, "angle": 1e-3},
    "PlannedMeasurement": dict,
    "Sight": dict,
    "Target": lambda: {"pose": np.eye(4)},
    "TouchingArm": lambda: {"machine": machine(), "point": np.zeros(3), "sigma": 1e-5},
}
# Beside what no field can be, what a field of this name cannot be.
NEGATIVE = (
    "mass",
    "sigma",
    "sigma_per_metre",
    "length",
    "angle",
    "harmonics",
    "elastic",
    "scale_sigma",
    "gap",
    "order",
)
POSES = ("pose", "base", "tool")


def test_every_public_dataclass_has_an_example_or_is_made_by_a_function() -> None:
    assert set(GOOD) == set(CLASSES)
    assert set(MADE) <= set(public())


@pytest.mark.parametrize("name", GOOD)
def test_what_is_good_is_taken(name: str) -> None:
    assert CLASSES[name](**GOOD[name]()) is not None


def nonsense(name: str) -> Iterator[tuple[str, Any]]:
    """Every field of a class with what it cannot be."""
    cls = CLASSES[name]
    hints = get_type_hints(cls)
    for field in fields(cls):
        if field.init:
            for value in _wrong(hints[field.name], field.name):
                yield field.name, value


def _wrong(hint: Any, field: str) -> Iterator[Any]:
    yield object()
    kinds = [hint, *get_args(hint)]
    if type(None) not in kinds and hint is not object:
        yield None
    if float in kinds:
        yield from (float("nan"), "1 mm", [1.0], 1e300, float("-inf"), 1j)
        if field in NEGATIVE:
            yield -1.0
    if int in kinds:
        yield from (1.5, "1", 10**9 if field == "order" else float("nan"))
    if hint is str or (str in kinds and type(None) in kinds):
        yield from (5, ["a"])
    if bool in kinds:
        yield "yes"
    if any(get_origin(kind) is np.ndarray for kind in kinds):
        yield from (np.zeros((2, 2, 2)), np.array([["a"]]), np.array(1.0), np.full((3, 3), 1j))
        for shape in ((4, 4), (3,), (6,), (2, 6), (3, 3), (4, 3)):
            yield from (np.full(shape, np.nan), np.full(shape, np.inf))
        if field in POSES:
            yield from (np.ones((4, 4)), 2.0 * np.eye(4), np.eye(3), 1e9 * np.eye(4))
    if any(get_origin(kind) is tuple and float in get_args(kind) for kind in kinds):
        yield from ((1.0,), (float("nan"), 0.0, 0.0), (float("inf"), 0.0, 0.0), ("a", "b", "c"), (1e300, 0.0, 0.0))
    for kind in kinds:
        if inspect.isclass(get_origin(kind)) and issubclass(get_origin(kind), Mapping):
            value = get_args(kind)[1]
            yield from ({5: 1.0}, {"a": object()}, ["a"])
            if value is float:
                yield from ({"a": float("nan")}, {"a": 1e300})
            if field in ("tools", "others"):
                yield from ({"a": np.eye(3)}, {"a": np.ones((4, 4))}, {"a": np.full((4, 4), np.nan)})


@pytest.mark.parametrize("name", GOOD)
def test_nonsense_is_refused_when_it_is_said(name: str) -> None:
    cls, taken = CLASSES[name], []
    for field, value in nonsense(name):
        try:
            cls(**GOOD[name]() | {field: value})
        except CalibError as e:
            said = str(e)
            assert said.endswith("."), said
            assert "\n" not in said
            assert len(said) < 1000
        else:
            taken.append((field, value))
    taken = [(field, value) for field, value in taken if field not in LATER.get(name, ())]
    assert not taken


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: calib.measuring.Payload(-1.0), "payload: mass is -1 kg; allowed is 0, or 1e-06 to 100000 kg."),
        (
            lambda: calib.JointTerm("joint_2", "cos", 10**9),
            "joint term of 'joint_2': order is 1000000000; allowed are 0 to 1000000.",
        ),
        (lambda: calib.Priors(length=-1.0), "prior length: -1.0 is not a positive number; leave it out for no prior."),
        (
            lambda: calib.Priors(harmonics="learnd"),  # type: ignore[arg-type]
            "prior harmonics: 'learnd' is neither a positive number nor \"learned\".",
        ),
        (
            lambda: calib.CalibratedMachine(machine().robot, machine().deviations, np.eye(3), {"tool": np.eye(4)}),
            "machine: the base 'base': needs a rigid placement (4, 4): a rotation, a position in m, and the last row "
            "0 0 0 1.",
        ),
        (
            lambda: calib.Deviations(np.zeros((2, 5)), np.zeros(2)),
            "deviations: placements has the shape (2, 5); needed is (any, 6).",
        ),
    ],
)
def test_what_is_said(make: Callable[[], object], said: str) -> None:
    with pytest.raises(CalibError) as caught:
        make()
    assert str(caught.value) == said
