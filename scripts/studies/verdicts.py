"""Does the verdict say no where it must, and yes where it may? Sound and bad sessions, judged in one process.

    python scripts/studies/verdicts.py [--sound 500] [--poor 60] [--moving 60] [--seeds 2]
        [--only sound|poor|moving|bad|later|last|next|again] [--minutes 9] [--log verdicts.json]
        [--out docs/verdicts.md]

With --log what was judged is kept, and what is there already is not judged again; --minutes ends a part of it.
What is called next is kept as it came out at first, from the page that is there; again is the same after repair.
"""

import argparse
import json
import sys
import time
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np

from calib.assessment.checks.of_rows import SEEN_IN_TIME, SURE
from scripts.studies.verdict_moving import NEXT, moving
from scripts.studies.verdict_sessions import BAD, LAST, LATER, POOR, Judged, bad, judge, poor, sound

ROBOTS = ("ur5", "ur10", "panda")
LATER_ROBOT, LAST_ROBOT, NEXT_ROBOT = "xarm7", "z1", "baxter"
SOUND = {"sound": sound, "poor": poor, "moving": moving}
# A session that is trusted is right where so many of 200 new tool points are inside their stated 95 % regions.
INSIDE = 0.9
# Checks of which less is worse.
LEAST = ("improvement", "regions", "held-out poses", "redundancy", "places", "joints")
HEAD = """# Does the verdict say no?

Every calibration ends with a list of checks (see [assessment](assessment.md)); it is trusted when all of them pass.
This page judges sessions of simulated robots, which are made without any of the toolkit's mathematics. By the sound
sessions the thresholds were set; in the bad ones something is wrong. The page is made by
`python scripts/studies/verdicts.py`; the sessions are described in `scripts/studies/verdict_sessions.py` and
`verdict_moving.py`.

How the thresholds were chosen: what counts as sound was written down before it was judged, except for dense paths.
Some of the first dense paths stayed in so narrow a region that the calibration improved little on held-out rows, and
the verdict said that no improvement was shown. Paths now go several times through 0.7 rad in every joint.

Three thresholds were changed after bad sessions had been judged:

* "redundancy", to less than half of the worst of the sound sessions;
* "explained", to what poor arms need, a twentieth of what random numbers leave;
* "lengths", from 4 to 1.5 %, because an instrument whose scale was off by 2 % was trusted.

Checks were made for sessions that had been trusted:

* "one machine", after the first ten later situations;
* its search for three and four machines, "axes" and "resolution", after the ten that followed;
* "timing", after those of streams;
* "at rest", after [a real arm](irb120.md) that was read while it braked;
* "drift" of joints, of the tool and of the arm's length, after an arm that warmed up was trusted;
* "jump" of photographs, by what each has in common, after a board that had moved was trusted.

The limits of size of "axes", of "resolution" and of the search for more machines were chosen by judgement; no sound
session and no poor arm reaches them.

A session may be trusted although something is wrong with it, if what is stated of it is right all the same. For every
such session 200 new poses are drawn, and their true tool points are compared with the predicted ones. The session
counts as right if at least nine of ten are inside their stated 95 % regions. The truth is that of the arm as it is
used: with what leans or falls, warm, and in the first of two set-ups.
"""

TAIL = """## What it cannot find

An error that is the same in all rows, also in the held-out ones, shows in no row. Errors that vary from row to row in
many ways, or that are in few rows, look like a worse instrument or a worse arm; so does a base that leans. They leave
residuals, and the stated regions and the errors of held-out rows are then as large as they really are. Without a
stated sigma the verdict cannot tell the difference: state the instrument's sigma. About forty positions are needed to
split rows between machines. An arm that grows while it is measured is found if that moves the tool by more than the
residuals scatter, and if the rows are in the order in which they were measured.
"""


def record(kind: str, seed: int, label: dict[str, Any], found: Judged) -> dict[str, Any]:
    """One line of the log."""
    told = {"word": found.word, "failed": list(found.failed), "said": found.said, "checks": dict(found.checks)}
    told |= {"inside": found.inside, "errors": found.errors, "claimed": found.stated, "late": list(found.late)}
    return {"set": kind, "seed": seed, **label, **told}


def sessions(args: argparse.Namespace) -> Iterator[tuple[str, int, str, str]]:
    """Everything that is to be judged: set, seed, situation, robot."""
    if args.only in ("", "sound"):
        yield from (("sound", seed, "", "") for seed in range(args.sound))
    if args.only in ("", "poor"):
        yield from (("poor", seed, "", "") for seed in range(args.poor))
    if args.only in ("", "moving"):
        yield from (("moving", seed, "", "") for seed in range(args.moving))
    for name, table, robots in (
        ("bad", BAD, ROBOTS),
        ("later", LATER, (LATER_ROBOT,)),
        ("last", LAST, (LAST_ROBOT,)),
        ("next", NEXT, (NEXT_ROBOT,)),
        ("again", NEXT, (NEXT_ROBOT,)),
    ):
        # What came out at first cannot come out again.
        if args.only == name or (args.only == "" and name != "next"):
            yield from ((name, seed, what, which) for what in table for which in robots for seed in range(args.seeds))


def page(lines: Sequence[dict[str, Any]], before: str) -> str:
    """The page; of what came out at first, ``before`` has it where it was not judged now."""
    parts = [HEAD]
    good = [line for line in lines if line["set"] == "sound"]
    doubted = [line for line in good if line["word"] != "trusted"]
    parts.append(f"## Sound sessions\n\n{len(good)} were judged, and {len(doubted)} of them doubted or refused.\n")
    rows = ["| session | judged | not trusted |", "|---|--:|--:|"]
    count = Counter(line["layout"] for line in good)
    bad_count = Counter(line["layout"] for line in doubted)
    rows += [f"| {WORDS[name]} | {number} | {bad_count[name]} |" for name, number in sorted(count.items())]
    parts.append("\n".join(rows) + "\n")
    if doubted:
        parts.append("Those that were not trusted, by the checks that did not pass:\n")
        parts += [f"- {WORDS[line['layout']]} ({line['robot']}): {', '.join(line['failed'])}" for line in doubted]
        parts.append("")
    said = "What the checks found in sound sessions, and what they allow. To fail, a value must also be significant."
    parts.append(said + "\n")
    rows = ["| check | median | 99 of 100 | worst | allowed |", "|---|--:|--:|--:|--:|"]
    for name in dict.fromkeys(name for line in good for name in line["checks"]):
        found = np.array([line["checks"][name] for line in good if name in line["checks"]], dtype=np.float64)
        x = found[np.isfinite(found[:, 0]), 0]
        if not len(x) or name in ("convergence", "lens"):
            continue
        least = name in LEAST
        cells = [np.quantile(x, q) for q in ((0.5, 0.01, 0.0) if least else (0.5, 0.99, 1.0))]
        limits = found[np.isfinite(found[:, 1]), 1]
        low, high = (f"{limit:.2g}" for limit in (limits.min(), limits.max()))
        told = low if low == high else f"{low} to {high}"
        shown = " | ".join(f"{cell:.2g}" for cell in cells)
        rows.append(f"| {name} | {shown} | {'at least' if least else 'at most'} {told} |")
    parts.append("\n".join(rows) + "\n")
    parts += poor_arms([line for line in lines if line["set"] == "poor"])
    parts += in_motion([line for line in lines if line["set"] == "moving"])
    for name, title, said in (
        ("bad", "Bad sessions", "Each on three robots."),
        (
            "later",
            "Ten more",
            f"Written down before any was judged, on another robot ({LATER_ROBOT}). Four of the twenty sessions were "
            'trusted before the check "one machine" was made to find what these were.',
        ),
        (
            "last",
            "And ten after that",
            "Written down before any was judged, with that check in place and on one more robot "
            f"({LAST_ROBOT}). Six of the twenty sessions were trusted before "
            "checks were made for what these were.",
        ),
        (
            "next",
            "Streams, photographs, two tools, two set-ups",
            f"Ten more, written down before any was judged, with all checks in place and on one more robot "
            f"({NEXT_ROBOT}, its left arm); shown as they came out, before anything was changed.",
        ),
        (
            "again",
            "The same once more",
            'After the check "timing" was made for streams, whose threshold comes from the sound sessions in motion, '
            'and "drift" for arms that warm up.',
        ),
    ):
        own = [line for line in lines if line["set"] == name]
        if own:
            parts += situations(title, said, own)
        elif name == "next" and f"## {title}\n" in before:
            parts.append(f"## {title}\n" + before.split(f"## {title}\n")[1].split("\n## ", maxsplit=1)[0])
    parts.append(TAIL)
    return "\n".join(parts)


def right(line: dict[str, Any]) -> bool:
    """Whether what is stated of a session holds the truth."""
    return bool(line.get("inside", float("nan")) >= INSIDE)


def situations(title: str, said: str, own: Sequence[dict[str, Any]]) -> list[str]:
    """A section of bad situations."""
    trusted = [line for line in own if line["word"] == "trusted"]
    whats = list(dict.fromkeys(line["what"] for line in own))
    stated = sum(bool(line["stated"]) for line in own)
    told = f"{len(whats)} situations, {len(own)} sessions ({stated} state a sigma), {len(trusted)} of them trusted"
    told += f", {sum(map(right, trusted))} of these right within what is stated." if trusted else "."
    rows = ["| situation | trusted | of these right | doubted | refused | by |", "|---|--:|--:|--:|--:|---|"]
    for what in whats:
        these = [line for line in own if line["what"] == what]
        words = Counter(line["word"] for line in these)
        why = Counter(check for line in these for check in line["failed"])
        by = ", ".join(check for check, _ in why.most_common(4))
        well = sum(right(line) for line in these if line["word"] == "trusted")
        cells = (words["trusted"], well if words["trusted"] else "", words["doubted"], words["refused"], by)
        rows.append(f"| {what} | {' | '.join(map(str, cells))} |")
    parts = [f"## {title}\n\n{said} {told}\n", "\n".join(rows) + "\n"]
    if trusted:
        parts.append("Sessions that were trusted, at 200 new poses:\n")
        rows = [
            "| situation | sigma stated | inside their 95 % regions | errors, rms | stated, rms |",
            "|---|---|--:|--:|--:|",
        ]
        for line in trusted:
            cells = (
                f"{1e2 * line['inside']:.0f} %",
                f"{1e3 * line['errors']:.2g} mm",
                f"{1e3 * line['claimed']:.2g} mm",
            )
            rows.append(f"| {line['what']} | {'yes' if line['stated'] else 'no'} | {' | '.join(cells)} |")
        parts.append("\n".join(rows) + "\n")
    return parts


def in_motion(lines: Sequence[dict[str, Any]]) -> list[str]:
    """What is said of sound sessions in motion, and through a lens."""
    if not lines:
        return []
    doubted = [line for line in lines if line["word"] != "trusted"]
    late = np.array([line["late"] for line in lines if np.isfinite(line["late"]).all()]).reshape(-1, 2)
    sharp = [
        line["checks"].get("stated sigma", (np.nan, np.nan)) for line in lines if line["layout"].startswith("lens")
    ]
    px = np.array([one for one in sharp if np.isfinite(one[0])]).reshape(-1, 2)
    count = Counter(line["layout"] for line in lines)
    said = ", ".join(f"{number} {WORDS[name]}" for name, number in sorted(count.items()))
    return [
        f"## In motion, and through a lens\n\n{len(lines)} more sound sessions: {said}. Doubted or refused: "
        f"{len(doubted)}.\n",
        *(f"- {WORDS[line['layout']]} ({line['robot']}): {', '.join(line['failed'])}" for line in doubted),
        *([""] if doubted else []),
        f"From these two thresholds come. A delay in rows with times counts from {SURE:g} standard errors and from "
        f"{SEEN_IN_TIME:g} of the scatter of a row; the largest of {len(late)} were {late[:, 0].max():.2g} and "
        f"{late[:, 1].max():.2g}. Pixels may scatter by {px[:, 1].min():.2g} times the stated sigma or more, by the "
        f"focal length; in {len(px)} sessions, with gears that wobble by up to 0.15 mrad, it was up to "
        f"{px[:, 0].max():.2g} times, and {np.max(px[:, 0] / px[:, 1]):.2g} of what was allowed.\n",
    ]


def poor_arms(lines: Sequence[dict[str, Any]]) -> list[str]:
    """What is said of poor arms: how much they leave unexplained."""
    if not lines:
        return []
    left = np.array([line["checks"]["explained"][0] for line in lines if "explained" in line["checks"]])
    doubted = [line for line in lines if line["word"] != "trusted"]
    low, high = (1e3 * wobble for wobble in POOR)
    said = (
        f"## Poor arms\n\n{len(lines)} sessions of arms whose gears wobble by {low:.0f} to {high:.0f} mrad, as those "
        f"for hobbyists do. They leave {left.min():.2g} to {left.max():.2g} of the spread, half of them more than "
        f"{np.median(left):.2g}, and as much in rows held out as was predicted for these. Doubted or refused: "
        f"{len(doubted)}.\n"
    )
    return [said, *(f"- {line['robot']}: {', '.join(line['failed'])}" for line in doubted), *([""] if doubted else [])]


WORDS = {
    "random": "random poses",
    "few": "few poses",
    "many": "many poses",
    "path": "dense paths",
    "lines": "lines at one orientation",
    "planes": "planes, row by row, at one orientation",
    "narrow": "poses in a narrow volume",
    "levels": "two levels",
    "sockets": "sockets",
    "pixels": "pixels of a board",
    "drift": "an instrument that drifts by one to three sigma",
    "outliers": "2 or 5 % outliers, robust loss",
    "offsets": "offsets alone",
    "clock free": "streams with a free clock",
    "clock given": "streams with a given clock",
    "times": "tables with times",
    "lens free": "photographs with a free lens",
    "lens given": "photographs with a given lens",
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sound", type=int, default=500)
    parser.add_argument("--poor", type=int, default=60)
    parser.add_argument("--moving", type=int, default=60)
    parser.add_argument("--minutes", type=float, default=float("inf"))
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--only", default="", choices=("", *SOUND, "bad", "later", "last", "next", "again"))
    parser.add_argument("--log", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs/verdicts.md"))
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    lines = json.loads(args.log.read_text()) if args.log is not None and args.log.exists() else []
    done = {
        (line["set"], line["seed"], line.get("what", ""), line["robot"] if line["set"] not in SOUND else "")
        for line in lines
    }
    until = time.monotonic() + 60.0 * args.minutes
    for k, (kind, seed, what, which) in enumerate(one for one in sessions(args) if one not in done):
        if time.monotonic() > until:
            break
        session = SOUND[kind](seed) if kind in SOUND else bad(what, which, seed, NEXT)
        lines.append(record(kind, seed, dict(session.label), judge(session)))
        line = lines[-1]
        if (line["word"] == "trusted") == (kind not in SOUND):
            print(kind, seed, what, line["robot"], line["word"], line["failed"], line["said"][:300], flush=True)
        if args.log is not None and k % 20 == 19:
            args.log.write_text(json.dumps(lines))
    if args.log is not None:
        args.log.write_text(json.dumps(lines))
    before = args.out.read_text(encoding="utf-8") if args.out.exists() else ""
    args.out.write_text(page(lines, before), encoding="utf-8", newline="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
