"""The rows of the matrix: sets of features, one of every axis, in which every pair that goes together is met."""

import re
from functools import cache
from itertools import combinations

from tests.crossed.features import AXES, FEATURES, REFUSALS, Feature, of_axis
from tests.crossed.pairwise import covering

LABELS = {feature.label: feature for feature in FEATURES}


def refused(a: Feature, b: Feature) -> str | None:
    """The pattern of the sentence by which two features of different axes are refused together."""
    for refusal in REFUSALS:
        if (a.label in refusal.a and b.label in refusal.b) or (b.label in refusal.a and a.label in refusal.b):
            return refusal.sentence
    return None


@cache
def rows(*, twins: bool = False) -> tuple[tuple[Feature, ...], ...]:
    """The rows, always the same ones; features with a twin, and those ``beside``, are crossed where ``twins``."""
    met = [tuple(one for one in of_axis(axis) if twins or not (one.twin or one.beside)) for axis in AXES]
    levels = [own for own in met if len(own) > 1]

    @cache
    def allowed(i: int, a: int, j: int, b: int) -> bool:
        return refused(levels[i][a], levels[j][b]) is None

    found = covering([len(own) for own in levels], allowed)
    return tuple(with_usual(*(levels[i][level] for i, level in enumerate(row))) for row in found)


# Rows of what the suite does not cross with all.
BESIDE: tuple[tuple[str, ...], ...] = (
    ("place: two",),
    ("place: about known",),
    ("tips: two",),
    ("point: of each row",),
    ("motion: stream",),
    ("motion: late",),
    ("noise: an arm",),
    ("terms: bearings",),
    ("terms: torque offsets",),
    ("observes: board", "tools: turned"),
    ("observes: socket", "known: on a link"),
    ("observes: plane", "known: on a link"),
    ("terms: of masses", "motion: stream"),
    ("solver: total differential", "geometry: offsets", "motion: late"),
    ("solver: total differential", "geometry: offsets", "tips: two"),
    ("terms: of masses", "place: loaded"),
    ("geometry: dh", "tips: two"),
    ("geometry: dh", "observes: socket", "known: on a link"),
    ("levels: grid", "observes: plane", "known: on a link"),
)


def beside() -> list[tuple[Feature, ...]]:
    """The rows of ``BESIDE``."""
    return [with_usual(*(LABELS[label] for label in row)) for row in BESIDE]


def refused_pairs() -> list[tuple[Feature, Feature, str]]:
    """Every pair that is refused, once, with the pattern of its sentence."""
    found = []
    for a, b in combinations(FEATURES, 2):
        if a.axis != b.axis and (sentence := refused(a, b)):
            found.append((a, b, sentence))
    return found


def with_usual(*features: Feature) -> tuple[Feature, ...]:
    """A row of the usual features but for these, and for those that these cannot stand beside."""
    chosen = {feature.axis: feature for feature in features}
    for axis in AXES:
        if axis not in chosen:
            fitting = [one for one in of_axis(axis) if not any(refused(one, other) for other in chosen.values())]
            chosen[axis] = (fitting or list(of_axis(axis)))[0]
    return tuple(chosen[axis] for axis in AXES)


def told(features: tuple[Feature, ...]) -> str:
    """A row as a person reads it: what is not usual."""
    return ", ".join(feature.label for feature in features if feature is not of_axis(feature.axis)[0]) or "usual"


def matches(pattern: str, sentence: str) -> bool:
    return re.search(pattern, sentence) is not None
