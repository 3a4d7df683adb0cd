"""Which model a real UR10 needs: nested models, judged by rows held out; the table of docs/assessment.md.

    python scripts/studies/model_comparison.py <ur10_leica folder> [--folds 10] [--markdown FILE]

Data: as scripts/examples/ur10_leica_job.py reads them, all rows, positions. --markdown writes the table into FILE,
between the comments that name this script.
"""

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import calib
from calib.assessment.comparison import TERMS, ModelComparison, compare_models, nested_models
from calib.foundations.files import write_atomically
from scripts.examples.ur10_leica_job import NotTheDatasetError, read, table_columns

ROBOT = "example:ur_description/urdf/ur10_robot.urdf"
BEGIN, END = "<!-- scripts/studies/model_comparison.py -->", "<!-- end -->"


def compared(dataset: Path, folds: int) -> ModelComparison:
    robot = calib.load_robot(ROBOT, tip="tool0")
    data = calib.read_measurements(table_columns(read(dataset), "position"), robot)
    model = calib.error_model(robot, offsets="all", placements="all")
    return compare_models(nested_models(model, [data]), data, scheme=folds, choose=[TERMS])


def table(found: ModelComparison) -> list[str]:
    lines = [
        "| model | free | seen | held out [mm] | standard error | worse than the best [mm] | standard error | |",
        "|---|--:|--:|--:|--:|--:|--:|---|",
    ]
    for m in found.models:
        figures = m.held_out.rms, m.held_out.standard_error, m.difference, m.standard_error
        shown = " | ".join(f"{1e3 * value:.3f}" for value in figures)
        said = "recommended" if m is found.recommended else ""
        lines.append(f"| {m.name} | {m.parameters} | {m.rank} | {shown} | {said} |")
    said = (
        f"{found.rows} rows, {found.groups} groups of them that stay together, {found.folds} folds; rms of positions."
    )
    return [*lines, "", said]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path, help="folder of the UR10's measurements")
    parser.add_argument("--folds", type=int, default=10, help="folds (default: 10)")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="also write the table into this page")
    arguments = parser.parse_args()
    try:
        lines = table(compared(arguments.dataset, arguments.folds))
    except NotTheDatasetError as problem:
        print(problem, file=sys.stderr)
        return 1
    print("\n".join(lines))
    if arguments.markdown is not None:
        page = arguments.markdown.read_text(encoding="utf-8")
        before, _, rest = page.partition(BEGIN)
        _, end, after = rest.partition(END)
        if not end:
            print(f"{arguments.markdown} has no {BEGIN} and {END} around a table.", file=sys.stderr)
            return 1
        write_atomically(arguments.markdown, "\n".join([f"{before}{BEGIN}", "", *lines, "", f"{END}{after}"]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
