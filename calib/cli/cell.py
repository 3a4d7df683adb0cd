"""``calib cell``: an arm and what it touched, in one URDF."""

from pathlib import Path
from typing import Annotated

import typer

from calib.cli.application import IN_WORDS, MORE, Telling, command
from calib.cli.options import MeshRoots, SetupName, argument, mesh_folders, option, refuse_idle, written
from calib.foundations.choices import PlacedIn
from calib_start import loading


@command("cell", MORE, "calib cell arm_out/ positioner_out/ -o cell.urdf")
def cell(
    arm: Annotated[Path, argument("ARM", "Results of the arm, or its URDF.")],
    positioner: Annotated[Path, argument("POSITIONER", "Results of the positioner.")],
    out: Annotated[Path, written("FILE", "The cell's URDF, to be written.")],
    scene: Annotated[Path | None, option("--scene", "FILE", "Also draw it (HTML).")] = None,
    placed_in: Annotated[
        PlacedIn, typer.Option("--placed-in", help="In whose frame the positioner's base was found.")
    ] = "arm",
    setup: SetupName = None,
    prefix: Annotated[str | None, option("--prefix", "NAME", "Put before names that both use, as NAME_.")] = None,
    mesh_root: MeshRoots = None,
    telling: Telling = IN_WORDS,
) -> None:
    """Put an arm and the positioner it touched into one URDF.

    The positioner is fixed to the arm's base link, at its calibrated pose. Names that both use are changed in the
    positioner. It may also be another arm, a turntable or a track.
    """
    with loading():
        from calib.compensation.cell import calibrated_cell
        from calib.foundations.errors import JobError
        from calib.foundations.files import refuse_taken, write_together
        from calib.presentation.machine_scene import cell_scene
        from calib.presentation.scene import render_scene
    if scene is None:
        refuse_idle("meshes are read for --scene alone.", {"--mesh-root": mesh_root})
    if scene == out:
        raise JobError(f"{out}: cannot be the cell and its scene; choose another name for one of them.")
    refuse_taken(out, scene)
    found = calibrated_cell(arm, positioner, placed_in, prefix, setup=setup)
    # As in a job: the URDF's own folder, and what is named.
    roots = (arm.parent, *mesh_folders(mesh_root))
    files: dict[Path, bytes | str] = {out: found.cell.document}
    if scene is not None:
        files[scene] = render_scene(cell_scene(found, f"{out.name}: calibrated cell", roots))
    write_together(files)
    renamed = found.cell.renamed
    changed = f" Renamed, as both use the name: {', '.join(renamed)}." if renamed else ""
    telling.tell(
        lambda: {"file": str(out), "scene": None if scene is None else str(scene), **found.contents()},
        lambda: [f"The cell is in {out}.{changed}"],
    )
