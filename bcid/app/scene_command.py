"""`bcid scene check`: is a scene right, before anything is solved?"""

from __future__ import annotations

import argparse
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bcid.app.console import tell
from bcid.base.collective import Comm, on_root
from bcid.base.errors import InputError, MachineError

if TYPE_CHECKING:
    from bcid.forms.scene_check import SceneCheck


def check(arguments: argparse.Namespace, comm: Comm) -> None:
    """`bcid scene check`. Collective: rank 0 works, all fail together."""
    target: Path | None = arguments.output
    if target is not None and target.suffix.lower() != ".png":
        raise InputError(f"--output '{target}': the picture is a PNG file; name it {target.with_suffix('.png').name}")
    # PETSc begins, with collective calls, when this is imported: on all ranks or none.
    import_module("bcid.search.answer.identification_job")
    on_root(comm, lambda: _checked(arguments.scene, target))


def _checked(path: Path, target: Path | None) -> None:
    from bcid.forms.model import check_physics
    from bcid.forms.scene_check import check_scene
    from bcid.forms.scene_table import table
    from bcid.scene import Scene

    found = check_scene(Scene.read(path, physics=check_physics))
    tell(table(found))
    if target is not None:
        _draw(found, target)
        tell(f"\npicture: {target}")


def _draw(found: SceneCheck, target: Path) -> None:
    """The picture; what draws may be missing, or have no display to draw on."""
    from bcid.search.answer.identification_job import body_parts

    scene, mesh = found.scene, found.mesh
    try:
        from bcid.report.scene_picture import draw_scene

        nothing = np.zeros((0, len(mesh.points)))
        body = body_parts(scene, mesh, np.zeros((0, len(mesh.points), 3)), nothing)
        markers = {marker.name: marker.position for marker in found.markers}
        draw_scene(target, body, markers, scene.name, *_words(found))
    except ImportError as error:
        raise MachineError(f"no picture: {error.name} is not installed: pip install 'bcid[report]'") from None


def _words(found: SceneCheck) -> tuple[dict[str, str], list[str]]:
    """What the picture says of places, and of the body."""
    from bcid.forms.mesh import level_name
    from bcid.forms.mesh.check import shown

    scene, mesh = found.scene, found.mesh
    places = {f"{one.kind} {one.name}": shown(one.area, 2) for one in found.places if one.area > 0}
    size = " x ".join(f"{span:.4g}" for span in np.ptp(mesh.points, axis=0) * 1e3)
    level = level_name(scene, scene.levels[found.level])
    places |= {f"region {one.name}": f"{100 * one.part:.3g} % of the volume" for one in found.body_regions}
    places = {name: text.replace("^2", "²") for name, text in places.items()}
    return places, [
        f"{size} mm",
        f"volume {shown(mesh.volume, 3)}".replace("^3", "³"),
        f"{level}: {len(mesh.cells):,} tetrahedra",
    ]


def add_scene(commands: Any) -> None:
    """Declare the command and its sub-command."""
    raw = argparse.RawDescriptionHelpFormatter
    help_text = "tell whether a scene is right, before anything is solved"
    parser = commands.add_parser("scene", help=help_text, description=_DESCRIPTION, formatter_class=raw)
    actions = parser.add_subparsers(dest="action", required=True, metavar="check")
    checking = actions.add_parser("check", help=help_text, description=_DESCRIPTION, formatter_class=raw)
    checking.add_argument("scene", type=Path, help="scene file (TOML)")
    checking.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="PICTURE.png",
        help="also draw the body with its patches, grasps and fiducials",
    )
    checking.set_defaults(run=check)


_DESCRIPTION = """bcid scene check SCENE [-o PICTURE.png] reads a scene and meshes it.

Prints the mesh ladder with nodes, cells and unknowns, the volume of the body, the facets and areas of patches, grasps and
places, how far each fiducial is from the surface, what was mended in a scanned surface, and what looks odd. Nothing is
solved. Exit code 2 if the scene is wrong, with every problem. See docs/bodies.md."""
