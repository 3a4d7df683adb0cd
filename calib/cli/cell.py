"""``calib cell``: an arm and what it touched, in one URDF."""

from pathlib import Path
from typing import Annotated

import typer

from calib.cli.application import IN_WORDS, MORE, NOT_TRUSTED, Telling, command
from calib.cli.options import MeshRoots, SetupName, argument, mesh_folders, option, refuse_idle, written
from calib.foundations.choices import PlacedIn
from calib_start import loading


@command("cell", MORE, "calib cell arm_out/ positioner_out/ -o cell.urdf")
def cell(
    arm: Annotated[Path, argument("ARM", "Results of the arm, or its URDF.")],
    positioner: Annotated[Path, argument("POSITIONER", "Results of the positioner.")],
    out: Annotated[Path, written("FILE", "The cell's URDF, to be written.")],
    scene: Annotated[Path | None, written("FILE", "Also draw it (HTML).", "--scene")] = None,
    placed_in: Annotated[
        PlacedIn | None,
        typer.Option("--placed-in", help="In whose frame the positioner's base was found; else as its results say."),
    ] = None,
    setup: SetupName = None,
    prefix: Annotated[str | None, option("--prefix", "NAME", "Put before names that both use, as NAME_.")] = None,
    mesh_root: MeshRoots = None,
    telling: Telling = IN_WORDS,
) -> None:
    """Put an arm and the positioner it touched into one URDF.

    The positioner is fixed to the arm's base link, at its calibrated pose. Names that both use are changed in the
    positioner. It may also be another arm, a turntable or a track. Says how sure its place is. Exit codes: 0 good, 1
    bad input and nothing written, 2 wrong usage, 3 written, but of results that are not to be trusted.
    """
    with loading():
        from calib.compensation.cell import calibrated_cell
        from calib.foundations.errors import JobError
        from calib.foundations.files import refuse_taken, write_together
        from calib.presentation.acceptance_tables import place_lines
        from calib.presentation.console import warning
        from calib.presentation.machine_scene import cell_scene
        from calib.presentation.scene import render_scene
        from calib.results.result_file import doubted, not_trusted
    if scene is None:
        refuse_idle("meshes are read for --scene alone.", {"--mesh-root": mesh_root})
    if scene == out:
        raise JobError(f"{out}: cannot be the cell and its scene; choose another name for one of them.")
    refuse_taken(out, scene)
    found = calibrated_cell(arm, positioner, placed_in, prefix, setup=setup)
    # As in a job: the URDF's own folder, and what is named.
    roots = (arm.parent, *mesh_folders(mesh_root))
    unsure = doubted(arm, positioner)
    files: dict[Path, bytes | str] = {out: found.cell.document}
    if scene is not None:
        files[scene] = render_scene(cell_scene(found, f"{out.name}: calibrated cell", roots))
    write_together(files)
    renamed = found.cell.renamed
    changed = f" Renamed, as both use the name: {', '.join(renamed)}." if renamed else ""
    telling.tell(
        lambda: {
            "file": str(out),
            "scene": None if scene is None else str(scene),
            **found.contents(),
            "notes": list(map(not_trusted, unsure)),
        },
        lambda: [
            *(warning(not_trusted(folder)) for folder in unsure),
            *map(warning, found.remarks),
            *place_lines(found),
            f"The cell is in {out}.{changed}",
        ],
    )
    if unsure:
        raise typer.Exit(NOT_TRUSTED)
