"""Any bytes give a value or one of our errors: what the fuzzer found, and a fixed number of seeded mutations.

scripts/development/fuzz.py searches longer, and stores what it finds where this replays it.
"""

import random
from pathlib import Path

import pytest

from scripts.development.fuzz import minimised
from scripts.development.fuzz_readers import READERS, judge, mutated, packed, unpacked

CORPUS = Path(__file__).resolve().parents[1] / "corpus"
FOUND = sorted(path.relative_to(CORPUS).as_posix() for path in CORPUS.glob("*/*"))
MUTATIONS = {
    "board": 15,
    "case": 50,
    "command": 8,
    "gaussian": 100,
    "importing": 30,
    "mesh": 100,
    "proposal": 60,
    "recording": 25,
}
MUTATIONS |= {"session": 30, "stream": 40, "uncertainty": 60}


@pytest.mark.parametrize("found", FOUND)
def test_what_was_found_once_is_read_well(found: str) -> None:
    judge(READERS[found.partition("/")[0]].read, (CORPUS / found).read_bytes())


@pytest.mark.parametrize("name", READERS)
def test_seeds_are_read(name: str) -> None:
    """A reader that refuses its seeds would be fuzzed in vain."""
    refused = []
    for seed in READERS[name].seeds():
        try:
            READERS[name].read(seed)
        except ValueError as e:
            refused.append(str(e))
    assert all("UTF-16" in why for why in refused)


@pytest.mark.parametrize("name", READERS)
def test_damaged_files_give_a_value_or_a_sentence(name: str) -> None:
    reader, chance = READERS[name], random.Random(name)
    seeds = reader.seeds()
    for _ in range(MUTATIONS.get(name, 200)):
        data = mutated(chance.choice(seeds), reader.words, chance)
        try:
            judge(reader.read, data)
        except Exception as e:
            e.add_note(f"input: {data!r}")
            raise


def test_a_fault_is_seen() -> None:
    def crash(_: bytes) -> None:
        raise KeyError("a bug")

    def babble(_: bytes) -> None:
        raise ReferenceError

    with pytest.raises(KeyError):
        judge(crash, b"")
    with pytest.raises(ReferenceError):
        judge(babble, b"")


def test_several_files_survive_one_text() -> None:
    files = {"a.toml": b"x\n", "b.csv": b"", "c": b"\n%%%\n\xff"}
    assert unpacked(packed(files)) == files


def test_a_found_input_is_made_as_small_as_it_gets() -> None:
    assert minimised(b"a lot of text, (((, and more of it" * 20, lambda data: data.count(b"(") >= 2) == b"(("
