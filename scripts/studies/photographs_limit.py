"""What photographs can tell at best: pixels held out as the best estimate would foretell them, beside those found.

    python scripts/studies/photographs_limit.py --store rehearsal.jsonl [--markdown docs/cameras.md]

Of the first seed of two cases of photographs_rehearsal.py, whose store is read. The best estimate is a linear Bayes by
the mathematics of the simulation, by differences at the truth: it knows how large errors of arm, print and corners are
and how well the arm comes back, which no user knows. What it expects of pixels held out is what the arm's coming back
leaves, and what so few photographs do not tell of arm, camera, board and lens.
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from calib.foundations.linear import one_thread
from scripts.simulate import photographs as simulation
from scripts.studies.blame import write
from scripts.studies.photographs_rehearsal import CASES, SIGMA, SPLITS, held_out, scene

NAMES = ("ordinary", "8 photographs to identify")
BEGIN, END = "<!-- limit: by scripts/studies/photographs_limit.py -->", "<!-- limit: end -->"
Array = simulation.Array


def expected(name: str) -> list[tuple[float, float]]:
    """Return of every split what coming back leaves of pixels held out, and what all is expected to, in px."""
    case = CASES[name]
    some = scene(case, 0).some
    J, prior = simulation.by_unknowns(some), np.zeros(63)
    prior[:36], prior[57] = case.arm**-2, 5e-3**-2
    # A flange that is off moves the camera that it carries.
    lever = np.eye(6)
    R, t = some.camera[:3, :3], some.camera[:3, 3]
    lever[:3, :3] = lever[3:, 3:] = R.T
    lever[:3, 3:] = R.T @ np.cross(np.eye(3), t).T
    U = J[:, :, 36:42] @ lever
    noise = [SIGMA**2 * np.eye(len(u)) + (u * np.repeat(case.repeats, 3) ** 2) @ u.T for u in U]
    found = []
    for number in range(SPLITS):
        held = sorted(held_out(list(range(len(J))), case, number))
        H = np.diag(prior) + sum(J[k].T @ np.linalg.solve(noise[k], J[k]) for k in range(len(J)) if k not in held)
        unit = 1.0 / np.sqrt(np.diag(H))
        covariance = np.linalg.inv(H * unit * unit[:, None]) * unit * unit[:, None]
        left = np.mean([np.trace(noise[k]) / len(noise[k]) for k in held])
        own = np.mean([np.einsum("ij,jk,ik->i", J[k], covariance, J[k]).mean() for k in held])
        found.append((float(np.sqrt(2.0 * left)), float(np.sqrt(2.0 * (left + own)))))
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--store", type=Path, required=True, help="of photographs_rehearsal.py")
    parser.add_argument("--markdown", type=Path, help="the page of the table")
    given = parser.parse_args()
    lines = [json.loads(line) for line in given.store.read_text().splitlines()]
    rows = ["| case | the arm's coming back [px] | best expected [px] | found [px] |", "|---|--:|--:|--:|"]
    with one_thread():
        for name in NAMES:
            (one,) = [x for x in lines if (x["case"], x["seed"], x["rendered"]) == (name, 0, False)]
            told = expected(name)
            columns = [[a for a, _ in told], [b for _, b in told], [split["px"] for split in one["splits"]]]
            rows.append(f"| {name} | " + " | ".join(", ".join(f"{x:.2f}" for x in own) for own in columns) + " |")
    found = "\n".join(rows)
    print(found)
    if given.markdown is not None:
        write(given.markdown, found, BEGIN, END)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
