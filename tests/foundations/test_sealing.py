"""Frozen data whose arrays nobody can write to: when made, replaced, copied, or read from a pickle."""

import copy
import importlib
import inspect
import pickle
import pkgutil
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pytest

import calib
from calib.foundations.arguments import takes_arrays
from calib.foundations.arrays import Array
from calib.foundations.sealing import sealed
from tests.support.cases import CASE, TABLE


class Pair(NamedTuple):
    a: Array
    name: str


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Slotted:
    one: Array
    several: tuple[Array, ...]
    named: Mapping[str, Array]
    pair: Pair
    text: str = ""


@dataclass(frozen=True, eq=False)
@sealed
class Unslotted:
    one: Array

    @cached_property
    def twice(self) -> Array:
        return 2.0 * self.one


def slotted() -> Slotted:
    return Slotted(np.ones(2), (np.ones(3), np.ones(1)), {"a": np.ones(4)}, Pair(np.ones(5), "b"), "c")


def by_pickle(thing: Any) -> Any:
    return pickle.loads(pickle.dumps(thing))


WAYS: list[Callable[[Any], Any]] = [lambda one: one, by_pickle, copy.deepcopy, copy.copy, replace]


@pytest.mark.parametrize("way", WAYS)
def test_arrays_are_read_only_whatever_way_they_came(way: Callable[[Any], Any]) -> None:
    made = way(slotted())
    arrays = [made.one, *made.several, *made.named.values(), made.pair.a]
    assert [array.flags.writeable for array in arrays] == [False] * 5
    assert [len(array) for array in arrays] == [2, 3, 1, 4, 5]
    assert (type(made.pair), made.pair.name, made.text) == (Pair, "b", "c")
    with pytest.raises(ValueError, match="read-only"):
        made.one[0] = 5.0


def test_without_slots_what_was_found_is_kept() -> None:
    made = Unslotted(np.ones(2))
    assert made.twice.tolist() == [2.0, 2.0]
    again = by_pickle(made)
    assert not again.one.flags.writeable
    assert "twice" in vars(again)


def test_whoever_made_an_array_may_go_on_with_it() -> None:
    mine = np.ones(2)
    Slotted(mine, (), {}, Pair(mine, ""))
    mine[0] = 2.0


def _dataclasses() -> Iterator[type]:
    for module in pkgutil.walk_packages(calib.__path__, "calib."):
        if not module.name.endswith("__main__"):
            for _, found in inspect.getmembers(importlib.import_module(module.name), inspect.isclass):
                if is_dataclass(found) and found.__module__ == module.name:
                    yield found


def test_all_frozen_data_with_arrays_is_sealed() -> None:
    """But for what a module keeps to itself."""
    own = [c for c in set(_dataclasses()) if not c.__name__.startswith("_") and c.__dataclass_params__.frozen]  # type: ignore[attr-defined]
    with_arrays = [c for c in own if any(takes_arrays(field.type) for field in fields(c))]
    assert len(with_arrays) > 60
    assert not [c for c in with_arrays if getattr(c, "__setstate__", None).__module__ != sealed.__module__]


def _writable(thing: Any, path: str, seen: set[int]) -> Iterator[str]:
    """What can be written to of a result, through names that are for users."""
    if id(thing) in seen:
        return
    seen.add(id(thing))
    if isinstance(thing, np.ndarray):
        if thing.flags.writeable:
            yield path
    elif is_dataclass(thing):
        for field in fields(thing):
            yield from _writable(getattr(thing, field.name), f"{path}.{field.name}", seen)
    elif isinstance(thing, Mapping):
        for key, item in thing.items():
            yield from _writable(item, f"{path}[{key}]", seen)
    elif isinstance(thing, tuple | list):
        for number, item in enumerate(thing):
            yield from _writable(item, f"{path}[{number}]", seen)


def test_nothing_of_results_can_be_written_to_nor_of_their_copies() -> None:
    robot = calib.load_robot(CASE / "arm_cmm.urdf", tip="probe")
    data, held_out = calib.hold_out(calib.read_measurements(CASE / TABLE, robot, sigma=2e-5))
    model = calib.error_model(robot, offsets="all", terms={"harmonics": ["joint_2"]})
    found = calib.assess(calib.identify(model, data), held_out)
    machine, some = found.machine, data.readings[:3]
    results: list[Any] = [
        *(found, calib.verify(machine, held_out, refit=True), calib.judging.tool_uncertainty(machine, some)),
        *(calib.judging.sensitivity(model, some), calib.judging.cross_validate(model, data, count=2)),
        *(calib.plan(model, 8, candidates=30), calib.commands.for_joint_targets(machine, some)),
        *(calib.positioner.pivot(machine.predict(some)), calib.dh.dh_of(robot)),
    ]
    for result in results:
        for way in WAYS:
            assert not list(_writable(way(result), type(result).__name__, set()))
