"""Which is to blame? Jobs with one planted cause, and what the tool names: the confusion matrix of docs/cameras.md.

    python scripts/studies/blame.py --store blame.jsonl [--jobs 40] [--first 8] [--rendered]
        [--markdown docs/cameras.md]

Every job is one line of the store; what is there already is not simulated again, so that the script may be stopped at
any time. Thresholds were set on other seeds, below 8 and from 1000 on.

By the mathematics of scripts/simulate/photographs.py: a UR5 with errors of 0.1 mm and 0.1 mrad, 24 photographs, a lens
that is given and free, and one thing wrong: the lens that is given (1.5 % of its focal length, no distortion), the
print 1.5 % too large, the print bent by millimetres, a joint's zero by 5 mrad, or corners that are found badly. A
quarter of the photographs is held out. Corners are simulated, found to 0.05 px, or badly to 0.7 px; or, with
``--rendered``, photographs are rendered and corners are found in them. What blur and noise do to corners that are
found at all is a tenth of a pixel, less than an arm that is off by 0.1 mm does, or a print by 0.1 %: where corners are
planted in rendered photographs, all else is as it was given.
"""

import argparse
import json
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import calib
from calib.assessment.blame import blame
from calib.assessment.judged import JudgedSet, Use
from calib.foundations.linear import one_thread
from calib.identification.identify import residuals_of
from calib.identification.parameters import Priors
from calib.measurement.boards import Board
from calib.measurement.lens import NAMES
from scripts.simulate import photographs as simulation

CAUSES = ("lens", "scale", "shape", "arm", "corners")
ANSWERS = (*CAUSES, "cannot tell")
SIGMA = {"corners": 0.7}
BLURRED = simulation.Look(blur=1.8, noise=15.0)
BEGIN, END = "<!-- blame: by scripts/studies/blame.py -->", "<!-- blame: end -->"
RENDERED = "<!-- blame of rendered photographs: by scripts/studies/blame.py -->"
RENDERED_END = "<!-- blame of rendered photographs: end -->"


def job(seed: int, cause: str, *, rendered: bool = False) -> str:
    """What is named for one planted cause."""
    rng = np.random.default_rng([seed, CAUSES.index(cause)])
    some = simulation.session(seed, 24)
    small = 0.0 if rendered and cause == "corners" else 1.0
    arm = simulation.Arm(rng, 0.1e-3 * small, 0.1e-3 * small, 0.1e-3 * small)
    sheet = replace(some.sheet, scale=rng.normal(scale=1e-3) * small, aspect=0.0, shear=0.0, bend=(0.0, 0.0, 0.0))
    given = {"fx": some.lens.fx, "fy": some.lens.fy, "cx": some.lens.cx, "cy": some.lens.cy}
    given |= dict(zip(("k1", "k2", "p1", "p2", "k3"), some.lens.k, strict=True))
    sign = rng.choice((-1.0, 1.0))
    if cause == "lens":
        given |= {"fx": given["fx"] * (1 + 0.015 * sign), "fy": given["fy"] * (1 + 0.015 * sign), "k1": 0.0, "k2": 0.0}
    elif cause == "scale":
        sheet = replace(sheet, scale=0.015 * sign)
    elif cause == "shape":
        sheet = replace(sheet, bend=tuple(rng.uniform(0.2, 0.4, 3) * rng.choice((-1.0, 1.0), 3)))
    elif cause == "arm":
        arm.zeros[arm.names[int(rng.integers(1, 5))]] += 5e-3 * sign
    sigma, board = SIGMA.get(cause, 0.05), np.column_stack([sheet.corners(), np.zeros(len(sheet.corners()))])
    some = replace(some, arm=arm, sheet=sheet)
    if rendered:
        look = BLURRED if cause == "corners" else some.look
        columns = simulation.corners_found(replace(some, look=look), rng)
    else:
        columns = simulation.corners_seen(some, sigma, rng)
    robot = calib.load_robot(simulation.UR5, simulation.TIP)
    camera = calib.measuring.Camera("tip", **given, free=NAMES[:9], size=some.lens.size)
    data = calib.read_measurements(columns, robot, "pixels", instrument=camera)
    data = calib.measuring.seen_by(data, camera, Board(marks=board, shape="quadratic"))
    kept, held_out = calib.hold_out(data, 0.25)
    model = calib.error_model(
        robot,
        offsets="all",
        placements="all",
        base="fixed",
        tool="pose",
        priors=Priors("learned", "learned"),
    )
    fit = calib.identify(model, kept)
    found = blame(fit, _judged(fit, kept, held_out))
    return (found and found.named) or "cannot tell"


def _judged(fit: calib.Fit, kept: calib.Measurements, held_out: calib.Measurements) -> list[JudgedSet]:
    uses: list[tuple[Use, calib.Measurements]] = [("identification", kept), ("validation", held_out)]
    return [
        JudgedSet(use, use, data, *(residuals_of(fit, [data], machine)[0] for machine in (fit.nominal, fit.machine)))
        for use, data in uses
    ]


def table(answers: Mapping[tuple[str, int], str]) -> str:
    """Return the confusion matrix, and what it comes to."""
    head = ["| planted | " + " | ".join(ANSWERS) + " |", "|---|" + "--:|" * len(ANSWERS)]
    of = {cause: [answer for (planted, _), answer in answers.items() if planted == cause] for cause in CAUSES}
    rows = [
        f"| {cause} | " + " | ".join(str(own.count(answer)) for answer in ANSWERS) + " |" for cause, own in of.items()
    ]
    right = sum(own.count(cause) for cause, own in of.items())
    open_ = sum(own.count("cannot tell") for own in of.values())
    wrong = len(answers) - right - open_
    said = (
        f"Of {len(answers)} jobs {right} are named rightly, of {open_} it cannot be told, and {wrong} are blamed "
        f"wrongly ({100.0 * wrong / max(len(answers), 1):.1f} %)."
    )
    return "\n".join([*head, *rows, "", said])


def write(page: Path, found: str, begin: str = BEGIN, end: str = END) -> None:
    """Put a table into a page, between its marks."""
    before, rest = page.read_text().split(begin)
    page.write_text(f"{before}{begin}\n{found}\n{end}{rest.split(end)[1]}")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--store", type=Path, required=True)
    parser.add_argument("--jobs", type=int, default=40, help="of every cause")
    parser.add_argument("--first", type=int, default=8, help="the first seed")
    parser.add_argument("--rendered", action="store_true", help="corners are found in rendered photographs")
    parser.add_argument("--markdown", type=Path, help="the page of the table")
    given = parser.parse_args()
    given.store.touch()
    lines = [json.loads(line) for line in given.store.read_text().splitlines()]
    lines = [one for one in lines if one.get("rendered", False) == given.rendered]
    answers = {(one["planted"], one["seed"]): one["named"] for one in lines}
    seeds = range(given.first, given.first + given.jobs)
    with one_thread():
        for seed in seeds:
            for planted in CAUSES:
                if (planted, seed) not in answers:
                    answers[planted, seed] = job(seed, planted, rendered=given.rendered)
                    line = {"planted": planted, "seed": seed, "rendered": given.rendered}
                    with given.store.open("a") as out:
                        out.write(json.dumps({**line, "named": answers[planted, seed]}) + "\n")
    found = table({(planted, seed): named for (planted, seed), named in answers.items() if seed in seeds})
    print(found)
    if given.markdown is not None:
        write(given.markdown, found, *((RENDERED, RENDERED_END) if given.rendered else (BEGIN, END)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
