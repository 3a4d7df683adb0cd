"""Cross-validation: rows that belong together stay together, figures are what they are called, and folds never move."""

from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.assessment.validation import (
    HeldOut,
    cross_validate,
    folds,
    held_out,
    largest_unharmed,
    neighbourhoods,
    one_standard_error,
    parts_apart,
    poses_between,
    row_groups,
    smallest_unharmed,
    some_rows,
)
from calib.foundations.errors import JobError, MeasurementError
from tests.support import machines, streams
from tests.support.touching import lab

UR10 = ("example:ur_description/urdf/ur10_robot.urdf", "tool0")


def measured(n: int, seed: int = 0, sigma: float = 5e-5) -> tuple[calib.ErrorModel, calib.Measurements]:
    rng = np.random.default_rng(seed)
    robot, arm = machines.load(*UR10), machines.arm(*UR10)
    true = machines.Machine(arm.moved(rng), machines.anywhere(rng), {"tool": machines.pose((0.05, 0.02, 0.15))})
    data = true.measure(robot, arm.draw(rng, n), rng=rng, sigma=sigma)
    return calib.error_model(robot, offsets="all", placements="all"), data


def visited_again(data: calib.Measurements, rows: int, by: float = 2e-4) -> calib.Measurements:
    """The measurements, and their first rows once more at nearly the same readings."""
    again = data.subset([*range(len(data)), *range(rows)])
    shift = np.zeros_like(again.readings)
    shift[len(data) :] = np.random.default_rng(0).uniform(-by, by, (rows, shift.shape[1]))
    return replace(again, readings=again.readings + shift)


def test_sigmas_of_more_or_fewer_components_than_there_are_is_a_sentence() -> None:
    """Three were given for x, y and z, and the first was taken for all."""
    model, data = measured(40)
    for sigmas in ([], [1e-4, 2e-4, 3e-4]):
        with pytest.raises(JobError, match=f"{len(sigmas)} model sigmas are given for 1 component of the data"):
            cross_validate(model, data, count=3, model_sigmas=sigmas)


def test_poses_that_were_visited_twice_are_one_group() -> None:
    _, data = measured(40)
    group = row_groups([visited_again(data, 15)])
    assert group.max() + 1 == 40
    np.testing.assert_array_equal(group[40:], group[:15])


def test_words_keep_rows_together() -> None:
    _, data = measured(20)
    named = replace(data, group=tuple("abcd"[n % 4] for n in range(20)))
    group = row_groups([named])
    assert group.max() + 1 == 4
    np.testing.assert_array_equal(group, np.tile(group[:4], 5))


def test_a_word_and_a_second_visit_join_what_they_touch() -> None:
    _, data = measured(6)
    first = replace(data, group=("a", "a", "b", "c", "d", "e"))
    again = data.subset([1, 2])  # without words: rows of poses 1 and 2
    group = row_groups([first, again])
    assert group.max() + 1 == 5
    assert group[0] == group[1] == group[6]
    assert group[2] == group[7]


def test_neither_the_order_of_rows_nor_of_sets_moves_a_fold() -> None:
    _, data = measured(60)
    whole = visited_again(data, 20)
    order = np.random.default_rng(1).permutation(len(whole))
    fold = folds(row_groups([whole]), 5)
    np.testing.assert_array_equal(folds(row_groups([whole.subset(order)]), 5), fold[order])
    parts = whole.subset(range(30, 80)), whole.subset(range(30))
    np.testing.assert_array_equal(folds(row_groups(parts), 5), np.concatenate([fold[30:], fold[:30]]))


def ends_turned(data: calib.Measurements, rows: np.ndarray) -> calib.Measurements:
    """The same lengths, of some rows with the other end first, as a table in another order tells them."""
    own, other = data.ends
    one = np.where(rows[:, None], other.readings, own.readings)
    two = np.where(rows[:, None], own.readings, other.readings)
    return replace(data, readings=one, other=replace(other, readings=two))


def test_which_end_of_a_gauge_a_table_tells_first_moves_no_fold() -> None:
    data = lab().pairs(40)
    turned = ends_turned(data, np.random.default_rng(0).random(40) < 0.5)
    np.testing.assert_array_equal(row_groups([turned]), row_groups([data]))
    np.testing.assert_array_equal(calib.hold_out(turned)[1].value, calib.hold_out(data)[1].value)
    # Touched once more from the other end, it is the same gauge at the same place.
    both = row_groups([data, ends_turned(data, np.ones(40, dtype=np.bool_))])
    np.testing.assert_array_equal(both[40:], both[:40])


def test_stretches_of_an_even_stream_are_the_same_at_any_time_of_the_day() -> None:
    """Its rows stand where stretches end, and the rounding of their times told on which side they were."""
    data = streams.read(streams.streams(3, seconds=45.0), clock="given")
    assert data.stream is not None
    data = data.subset(range(1001))

    def at(start: float) -> np.ndarray:
        times = start + np.arange(1001) / 25.0
        since = times - 0.5 * (times[0] + times[-1])
        return row_groups([replace(data, stream=replace(data.stream, since=since))])

    for start in (0.1, 1.3, 1001.7, 86400.03, 1.7e9 + 0.04):
        np.testing.assert_array_equal(at(start), at(0.0))


def test_folds_are_of_nearly_the_same_number_of_groups() -> None:
    _, data = measured(53)
    group = row_groups([visited_again(data, 20)])
    fold = folds(group, 10)
    sizes = [len(np.unique(group[fold == k])) for k in range(10)]
    assert sorted(set(sizes)) == [5, 6]
    assert all(len(np.unique(fold[group == g])) == 1 for g in range(53))
    assert len(np.unique(folds(row_groups([data.subset([0, 1, 2])]), 10))) == 3


def test_what_cannot_be_split_is_refused() -> None:
    _, data = measured(5)
    with pytest.raises(MeasurementError, match="one pose or one group"):
        folds(row_groups([data.subset([0, 0, 0])]))
    with pytest.raises(JobError, match="folds: 1 is not a number from 2"):
        folds(row_groups([data]), 1)


def test_the_standard_error_is_that_of_repetitions() -> None:
    """Pairs of rows share their error: the standard error knows; one that takes them for single is too small."""
    rng = np.random.default_rng(2)
    group = np.repeat(np.arange(200), 2)
    found = [held_out(np.repeat(rng.standard_normal(200) ** 2, 2), group) for _ in range(300)]
    scatter = np.std([figure.rms for figure in found])
    assert np.mean([figure.rms for figure in found]) == pytest.approx(1.0, abs=0.01)
    assert np.mean([figure.standard_error for figure in found]) == pytest.approx(scatter, rel=0.1)
    single = held_out(np.repeat(rng.standard_normal(200) ** 2, 2), np.arange(400))
    assert single.standard_error < 0.8 * scatter


def test_the_rule_takes_the_smallest_within_one_standard_error() -> None:
    rms = [1.0, 0.8, 0.74, 0.7, 0.72]
    assert one_standard_error([HeldOut(value, 0.05) for value in rms]) == 2
    assert one_standard_error([HeldOut(value, 0.0) for value in rms]) == 3
    assert one_standard_error([HeldOut(value, 0.5) for value in rms]) == 0


def test_where_geometry_alone_foretells_nothing_no_terms_are_chosen() -> None:
    nothing = HeldOut(np.inf, np.nan, np.nan, np.nan)
    for figures in ([nothing], [nothing, nothing], [nothing, HeldOut(0.5, 0.05, 1.0, 3.9)]):
        assert smallest_unharmed(figures) == 0
        assert largest_unharmed(figures, apart=False) == 0


def test_a_model_that_harms_somewhere_is_not_taken() -> None:
    first = HeldOut(1.0, 0.05, 2.0, 3.0)
    assert smallest_unharmed([first, HeldOut(0.5, 0.05, 2.1, 3.0)]) == 0
    assert smallest_unharmed([first, HeldOut(0.5, 0.05, 1.0, 4.1)]) == 0
    # A row that lies off has what the model changes on top.
    assert smallest_unharmed([first, HeldOut(0.5, 0.05, 1.0, 3.9)]) == 1
    assert smallest_unharmed([first, HeldOut(0.52, 0.05, 1.0, 3.0), HeldOut(0.5, 0.05, 1.0, 3.0)]) == 1
    assert largest_unharmed([first, HeldOut(0.52, 0.05, 1.0, 3.0), HeldOut(0.5, 0.05, 1.0, 3.0)], apart=False) == 2
    assert largest_unharmed([first, HeldOut(0.52, 0.05, 1.0, 3.0), HeldOut(0.5, 0.05, 1.0, 3.0)], apart=True) == 1
    assert largest_unharmed([first, HeldOut(0.4, 0.05, 1.0, 3.0), HeldOut(0.5, 0.05, 1.0, 3.0)], apart=False) == 1
    # Of few neighbourhoods chance says as much.
    assert largest_unharmed([first, HeldOut(0.8, 0.11, 1.0, 3.0)], apart=False) == 0
    assert largest_unharmed([first, HeldOut(0.8, 0.09, 1.0, 3.0)], apart=False) == 1
    assert largest_unharmed([first, HeldOut(0.95, 0.01, 1.0, 3.0)], apart=False) == 1
    assert largest_unharmed([first, HeldOut(0.95, 0.01, 1.0, 3.0)], apart=True) == 0


def in_cubes(places: int, rows: int, width: float) -> tuple[calib.Measurements, np.ndarray]:
    """Rows in cubes of joint space, and which cube they are in."""
    rng = np.random.default_rng(4)
    _, data = measured(places * rows)
    cube = np.repeat(np.arange(places), rows)
    readings = rng.uniform(-2.5, 2.5, (places, 6))[cube] + rng.uniform(-width, width, (places * rows, 6))
    return replace(data, readings=readings), cube


@pytest.mark.parametrize("places", [3, 5, 8])
def test_places_that_lie_apart_are_not_divided(places: int) -> None:
    data, cube = in_cubes(places, 30, 0.2)
    found, apart = neighbourhoods([data], row_groups([data]))
    assert apart
    pairs = {(int(a), int(b)) for a, b in zip(cube, found, strict=True)}
    assert len(pairs) == places  # one for one
    order = np.random.default_rng(0).permutation(len(data))
    moved = data.subset(order)
    np.testing.assert_array_equal(neighbourhoods([moved], row_groups([moved])).number, found[order])


def test_between_angles_on_either_side_of_half_a_turn_there_is_nothing() -> None:
    _, data = measured(200)
    readings = np.random.default_rng(2).uniform(-0.5, 0.5, (200, 6))
    # Two joints swing about half a turn, and are told within a turn.
    readings[:, 4:] -= np.pi * np.sign(readings[:, 4:])
    data = replace(data, readings=readings)
    group, turning = row_groups([data]), [True] * 6
    assert neighbourhoods([data], group).apart
    assert not neighbourhoods([data], group, turning=turning).apart
    # One that slides does not come back.
    assert neighbourhoods([data], group, turning=[*turning[:4], False, False]).apart
    cubes, _ = in_cubes(4, 30, 0.2)
    assert neighbourhoods([cubes], row_groups([cubes]), turning=turning).apart


def test_poses_between_places_are_on_the_way_from_one_to_another() -> None:
    data, cube = in_cubes(4, 30, 0.2)
    everything = np.ones(len(data), dtype=bool)
    poses = poses_between([data], everything, cube)
    middles = np.array([data.readings[cube == k].mean(axis=0) for k in range(4)])
    ends = [(a, b) for a in range(4) for b in range(a)]
    share = np.linspace(0.0, 1.0, 101)[:, None]
    ways = np.concatenate([share * middles[a] + (1.0 - share) * middles[b] for a, b in ends])
    off = np.abs(poses[:, None] - ways).max(axis=2)
    assert np.all(off.min(axis=1) < 0.25)
    # All ways are gone, none of them by a row and another one of its own place.
    found = off.argmin(axis=1) // 101
    assert set(found) == set(range(len(ends)))
    assert np.mean(np.abs(poses[:, None] - middles).max(axis=2).min(axis=1) > 0.25) > 0.5
    order = np.random.default_rng(0).permutation(len(data))
    np.testing.assert_array_equal(poses_between([data.subset(order)], everything, cube[order]), poses)
    some = cube > 0
    few = poses_between([data], some, cube[some] - 1)
    np.testing.assert_array_equal(few, poses_between([data.subset(some)], everything[some], cube[some] - 1))


def test_poses_all_over_are_divided_into_neighbourhoods() -> None:
    _, data = measured(300)
    found, apart = neighbourhoods([data], row_groups([data]), 10)
    assert not apart
    assert len(np.unique(found)) == 10
    # Rows are nearer to their own middle than to any other one's.
    middles = np.array([data.readings[found == k].mean(axis=0) for k in range(10)])
    nearest = np.argmin(np.linalg.norm(data.readings[:, None] - middles, axis=2), axis=1)
    assert np.mean(nearest == found) > 0.95
    assert len(np.unique(neighbourhoods([data.subset(range(7))], row_groups([data.subset(range(7))]), 10).number)) == 7


def test_which_rows_are_looked_at_does_not_depend_on_their_order() -> None:
    _, data = measured(60)
    data = visited_again(data, 40)
    order = np.random.default_rng(3).permutation(len(data))
    chosen = some_rows([data], row_groups([data]), 50)
    again = data.subset(order)
    np.testing.assert_array_equal(some_rows([again], row_groups([again]), 50), chosen[order])
    # Other poses rather than other visits.
    assert len(np.unique(row_groups([data])[chosen])) == 50
    assert some_rows([data], row_groups([data]), 500).all()


def test_held_out_errors_are_those_of_poses_never_seen() -> None:
    """Noise and what the parameters lose by it: rms^2 = 3 sigma^2 (1 + 27 / (3 0.9 n)), to a scatter of 3 n numbers."""
    n, sigma = 240, 5e-5
    model, data = measured(n, sigma=sigma)
    found = cross_validate(model, data)
    expected = np.sqrt(3.0) * sigma * np.sqrt(1.0 + 27.0 / (3 * 0.9 * n))
    assert abs(found.figure().rms - expected) < 3.0 * found.figure().standard_error < 0.15 * expected
    fit = calib.identify(model, data)
    own = np.sqrt(np.mean(np.sum(fit.residuals[0] ** 2, axis=1)))
    assert own < found.figure().rms


def test_the_order_of_rows_does_not_matter_to_the_figure() -> None:
    model, data = measured(80)
    order = np.random.default_rng(1).permutation(80)
    one, other = cross_validate(model, data, count=4), cross_validate(model, [data.subset(order)], count=4)
    np.testing.assert_allclose(other.residuals[0], one.residuals[0][order], rtol=0, atol=1e-11)
    assert other.figure().rms == pytest.approx(one.figure().rms, rel=1e-9)


def test_no_set_up_is_held_out_whose_other_rows_hardly_show_it() -> None:
    """It was chance whether the only row of a place was held out, and then nothing could be judged."""
    _, data = measured(60)
    few = replace(data, setups=tuple("abcdef"), setup=np.array([0] * 50 + [1, 2, 2, 3, 3, 3, 4, 4, 4, 5]))
    some, rest = calib.hold_out(few, 0.5)
    assert len(rest) > 15
    kept = {name: int(np.sum(some.setup == k)) for k, name in enumerate(some.setups)}
    assert set(kept) == set("abcdef")
    assert all(kept[name] >= 2 for name in rest.setups)
    assert kept["b"] == kept["f"] == 1
    alone = replace(data, setups=tuple(map(str, range(60))), setup=np.arange(60))
    with pytest.raises(MeasurementError, match="no rows can be held out, as too few of their tools and set-ups"):
        calib.hold_out(alone)


def test_another_group_is_held_out_where_the_one_by_chance_is_the_last_of_its_tool() -> None:
    """Of two stretches of one tool and one of another none was held out, as chance took that of the other."""
    _, data = measured(60)
    group = np.repeat(["a", "b", "c"], 20)
    for alone in "abc":
        two = replace(data, group=tuple(group), tools=("one", "two"), tool=(group == alone).astype(np.intp))
        some, rest = calib.hold_out(two)
        assert (len(some), len(rest)) == (40, 20)
        assert rest.tools == ("one",)


def test_a_target_that_a_known_length_needs_is_not_held_out() -> None:
    """Which socket was held out was chance, and a known distance of it to another one then said nothing."""
    made = lab(noise=5e-5)
    names = ("a", "b", "c")
    data = made.sockets(6, names)
    for out in names:
        some, rest = calib.hold_out(data, keep=[name for name in names if name != out])
        assert (set(some.targets), rest.targets) == (set(names) - {out}, (out,))
    with pytest.raises(MeasurementError, match="or of targets to keep, would be left"):
        calib.hold_out(data, keep=names)


def test_by_chance_no_tool_that_has_several_groups_is_in_one_fold_alone() -> None:
    """Whether the two poses of a tool came into one fold was chance, and then nothing could be judged."""
    model, data = measured(24)
    group = row_groups([data])
    fold = folds(group, 4)
    together = [int(np.flatnonzero(group == g)[0]) for g in range(24) if fold[np.flatnonzero(group == g)[0]] == 2]
    rare = np.isin(np.arange(24), together[:2]).astype(np.intp)
    two = replace(data, tools=("tool", "rare"), tool=rare)
    found = parts_apart(fold, group, [two])
    assert sorted(found[rare == 1]) == [2, 3]
    assert np.count_nonzero(found != fold) == 1
    cross_validate(model, two, count=4)
    # Of each table, as one may hold what another lacks.
    assert np.count_nonzero(parts_apart(fold, group, [two.subset(rare == 0), two.subset(rare == 1)]) != fold) <= 1
    np.testing.assert_array_equal(parts_apart(fold, group, [data]), fold)
