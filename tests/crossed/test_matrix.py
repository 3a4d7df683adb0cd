"""Every two features of a job together, through every command: what one of them carries, nothing may lose.

A row ends as the simulated machine has it, or with a sentence that is expected of it: never with a traceback, a warning
or another sentence. All rows through all commands: ``python scripts/development/cross_features.py``.
"""

import functools
import re
from itertools import combinations
from pathlib import Path
from typing import get_args

import pytest
from pydantic import BaseModel

import calib
from calib.assessment import choice
from calib.cli.whole import app
from calib.foundations.errors import CalibError
from calib.job.inputs import load
from calib.job.run import run as run_job
from calib.job.schema import Job
from tests.crossed import walk
from tests.crossed.features import AXES, EXEMPT, FEATURES, REFUSALS, of_axis
from tests.crossed.pairwise import covering, pairs_of
from tests.crossed.rows import BESIDE, beside, matches, refused, refused_pairs, rows, told, with_usual
from tests.crossed.simulate import build

# In the suite every row predicts, verifies and commands; of the other steps each takes its turn.
ALWAYS = (walk.predicts, walk.verifies, walk.is_commanded)
RARELY = (walk.has_others,)
IN_TURNS = tuple(step for step in walk.STEPS if step not in (*ALWAYS, *RARELY))


@pytest.fixture(autouse=True)
def few_candidates(monkeypatch: pytest.MonkeyPatch) -> None:
    """Joint terms are chosen among a few: forty orders of harmonics take their time."""
    monkeypatch.setattr(choice, "candidates", functools.partial(choice.candidates, options={"harmonic_orders": (1,)}))


@pytest.mark.parametrize("number", range(len(rows())), ids=lambda k: f"{k}: {told(rows()[k])}")
def test_a_row_goes_through(number: int, tmp_path: Path) -> None:
    case = build(rows()[number], tmp_path / "job", seed=number)
    steps = [*ALWAYS, IN_TURNS[number % len(IN_TURNS)]]
    walk.walk(case, [*steps, *(RARELY if number % 48 == 3 else ())])


@pytest.mark.parametrize("number", range(len(BESIDE)), ids=lambda k: ", ".join(BESIDE[k]))
def test_what_is_beside_the_matrix_goes_through(number: int, tmp_path: Path) -> None:
    case = build(beside()[number], tmp_path / "job", seed=1)
    walk.walk(case, [*ALWAYS, IN_TURNS[number % len(IN_TURNS)]])


PAIRS = refused_pairs()


@pytest.mark.parametrize("number", range(len(PAIRS)), ids=lambda k: " + ".join(f.label for f in PAIRS[k][:2]))
def test_a_pair_that_does_not_go_together_is_refused_by_its_sentence(number: int, tmp_path: Path) -> None:
    a, b, sentence = PAIRS[number]
    with pytest.raises(CalibError) as caught:
        run_job(load(build(with_usual(a, b), tmp_path).path))
    assert matches(sentence, str(caught.value)), caught.value
    assert "\n" not in str(caught.value)


def test_every_pair_is_met_or_refused() -> None:
    met = {frozenset((a.label, b.label)) for row in rows(twins=True) for a, b in combinations(row, 2)}
    usual = {feature.label for axis in AXES for feature in of_axis(axis)[:1]}
    for a, b in combinations(FEATURES, 2):
        if a.axis == b.axis or {a.label, b.label} <= usual:
            continue
        # A third axis may have no level that goes with both: then one of the two meets its sentence anyway.
        apart = any(all(refused(a, c) or refused(b, c) for c in of_axis(axis)) for axis in AXES)
        assert frozenset((a.label, b.label)) in met or refused(a, b) or apart, (a.label, b.label)


def test_a_covering_design_holds_every_pair() -> None:
    sizes = (3, 4, 2, 5)
    found = covering(sizes, lambda i, a, j, b: (i, a, j, b) != (0, 1, 3, 2))
    met = set().union(*map(pairs_of, found))
    wanted = {(i, a, j, b) for i, j in combinations(range(4), 2) for a in range(sizes[i]) for b in range(sizes[j])}
    assert wanted - met == {(0, 1, 3, 2)}
    assert len(found) < 30  # 120 in full


# ---- nothing is left out


def keys_of(model: type[BaseModel], prefix: str = "") -> set[str]:
    """Every key of a job, dotted; of sections that are lists or have names, without number and name."""
    found: set[str] = set()
    for name, info in model.model_fields.items():
        key = f"{prefix}{info.alias or name}"
        inner = [part for part in _parts(info.annotation) if isinstance(part, type) and issubclass(part, BaseModel)]
        if inner:
            found |= set().union(*(keys_of(part, f"{key}.") for part in inner))
        else:
            found.add(key)
    return found


def _parts(annotation: object) -> list[object]:
    return [annotation, *(part for argument in get_args(annotation) for part in _parts(argument))]


def test_every_key_of_a_job_is_a_feature_or_exempt() -> None:
    registered = {key for feature in FEATURES for key in feature.keys}
    keys = keys_of(Job)
    # A feature may stand for a whole section.
    covered = {key for key in keys if any(key == own or key.startswith(f"{own}.") for own in registered)}
    assert not keys - covered - set(EXEMPT), "join tests/crossed/features.py"
    assert set(EXEMPT) <= keys - covered
    assert all(any(key == own or key.startswith(f"{own}.") for key in keys) for own in registered)
    assert all(EXEMPT.values())


def test_every_command_and_public_function_is_walked() -> None:
    commands = {command.name or command.callback.__name__ for command in app.registered_commands if command.callback}
    functions = {name for name in calib.__all__ if not isinstance(getattr(calib, name), type)}
    assert (commands | functions) - walk.WALKED - set(walk.ELSEWHERE) == set(), "join tests/crossed/walk.py"
    # Of the named submodules some are walked as well.
    below = {name for module in (calib.judging, calib.measuring) for name in module.__all__}
    assert (walk.WALKED | set(walk.ELSEWHERE)) <= commands | functions | below


def test_what_is_said_to_be_walked_is_called_and_what_is_not_has_its_tests() -> None:
    source = Path(walk.__file__).read_text(encoding="utf-8")
    steps = source[source.index("class Walked") :]
    uncalled = {name for name in walk.WALKED if not re.search(rf'run\("{name}"|\b{name}[(.]', steps)}
    # A job reads its robot, makes model and fit, and seeks outliers; what the live view serves, ``live.answer`` says.
    assert uncalled <= {"error_model", "identify", "load_robot", "outliers", "view"}, uncalled
    named = {path for reason in walk.ELSEWHERE.values() for path in re.findall(r"tests/[\w/.]+", reason)}
    root = Path(__file__).parents[2]
    assert not [path for path in named if not (root / path).exists()]
    # Beside the matrix each feature is met at least once.
    met = {feature.label for row in beside() for feature in row}
    assert {feature.label for feature in FEATURES if feature.beside} <= met


def test_what_is_read_by_name_is_there() -> None:
    labels = {feature.label for feature in FEATURES}
    assert len(labels) == len(FEATURES)
    assert {label for refusal in REFUSALS for label in (*refusal.a, *refusal.b)} <= labels
