"""What the other commands do, once their arguments are parsed."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from bcid.app.console import beside_the_result, complain, extra, finish, progress_of, tell
from bcid.app.flags import names_in, size_in
from bcid.app.shared_flags import direction_in
from bcid.base.collective import Comm, first
from bcid.base.errors import InputError
from bcid.base.options import check_level
from bcid.base.shipped import copy_examples

if TYPE_CHECKING:
    from bcid.measurement.inspection import Inspected

EXAMPLE = "examples/scenes/slab.toml examples/measurements/slab-34-complex"


def report(arguments: argparse.Namespace) -> None:
    """`bcid report`."""
    with extra("report"):
        from bcid.report.page import write_report

        made = write_report(arguments.run_folders, arguments.output)
    for folder, troubles in made.troubles.items():
        for text in troubles:
            complain(text if str(folder) in text else f"{folder}: {text}")
    if not arguments.quiet:
        runs = f"{len(made.shown)} run{'s' if len(made.shown) != 1 else ''}"
        tell(f"{made.path}: {runs}, {made.path.stat().st_size / 1e6:.1f} MB")


def import_recording(arguments: argparse.Namespace) -> None:
    """`bcid import`."""
    if not first():
        return
    from bcid.measurement.inspection import import_file
    from bcid.scene import Scene

    scene = None if arguments.scene is None else Scene.read(arguments.scene)
    made = import_file(arguments.file, arguments.output, scene)
    tell(made.text)
    if not arguments.no_picture:
        _draw_tracks(made)


def _draw_tracks(made: Inspected) -> None:
    """The paths beside a mapping."""
    target = made.mapping.with_suffix(".png")
    if target.exists():
        complain(f"no picture: {target} exists already")
        return
    with beside_the_result("picture"):
        from bcid.report.tracks_picture import draw_tracks

        seen = made.seen
        title = f"{made.mapping.stem}: {len(seen.points)} markers, {seen.frames} frames"
        tell(f"wrote {draw_tracks(seen.points, seen.times, made.unit, title, target)}")


def figure(arguments: argparse.Namespace) -> None:
    """`bcid figure`."""
    formats = names_in(arguments.format)
    if not formats:
        raise InputError(f"--format '{arguments.format}': names no format; give some, as --format png,pdf")
    progress = progress_of(arguments, 0)
    with extra("report"):
        from bcid.report.export import write_figures

        files = write_figures(arguments.run_folder, arguments.output, formats, arguments.overwrite, progress.say)
    if not arguments.quiet:
        tell(f"{arguments.output}: {len(files)} files")


def calibrate(arguments: argparse.Namespace) -> None:
    """`bcid calibrate`."""
    from bcid.vision.calibrate_run import run_calibration

    progress = progress_of(arguments, 0)
    folder = run_calibration(
        arguments.left,
        arguments.right,
        arguments.board,
        arguments.output,
        arguments.distortion,
        progress,
        arguments.overwrite,
        picked=arguments.picked,
        image_size=arguments.image_size,
        first_pixel=arguments.first_pixel,
    )
    finish(folder, arguments, None, progress)


def track(arguments: argparse.Namespace) -> None:
    """`bcid track`."""
    from bcid.measurement import Measurement
    from bcid.scene import Scene
    from bcid.vision.track_run import run_tracking

    scene = Scene.read(arguments.scene)
    expected = None if arguments.expected is None else Measurement.read(arguments.expected)
    progress = progress_of(arguments, 0)
    folder = run_tracking(
        arguments.recording,
        scene.fiducials,
        arguments.output,
        progress,
        arguments.overwrite,
        expected,
        not arguments.no_video,
    )
    finish(folder, arguments, None, progress)


def simulate(arguments: argparse.Namespace, comm: Comm) -> None:
    """`bcid simulate`."""
    from bcid.base.collective import on_root
    from bcid.forms.model import check_physics
    from bcid.forms.simulate import simulate as make
    from bcid.forms.written_effects import with_effects
    from bcid.measurement import Measurement
    from bcid.scene import Scene
    from bcid.scene.motions import motion

    if arguments.output.exists():
        raise InputError(f"{arguments.output}: exists already; choose another folder or remove it")
    scene = on_root(comm, lambda: Scene.read(arguments.scene, physics=check_physics))
    anchors = names_in(arguments.anchors)
    if arguments.surface < 0:
        raise InputError(f"--surface {arguments.surface}: must be at least 0")
    noise = None if arguments.noise is None else size_in(arguments.noise, "--noise", "m")
    check_level(arguments.level, scene, "--level")
    if arguments.like and arguments.grasp:
        raise InputError("--grasp: a measurement given with --like names its grasps itself; leave one of the two out")
    scene = with_effects(scene, arguments.true_effect)
    shaped = (arguments.amplitude, arguments.steps, arguments.direction)
    if arguments.like and any(one is not None for one in shaped):
        raise InputError("--like: repeats the motions as they are; leave --amplitude, --steps and --direction out")
    times = None
    if arguments.like:
        like = on_root(comm, lambda: Measurement.read(arguments.like))
        like.check(scene)
        actions, times = like.actions, like.data["time"].values
    else:
        grasps = list(scene.grasps)
        if not grasps:
            raise InputError(f"scene {scene.source} has no grasp: use --like with a measurement without one")
        grasp = arguments.grasp or grasps[len(grasps) // 2]
        amplitude = None if arguments.amplitude is None else size_in(arguments.amplitude, "--amplitude", "m")
        shape = amplitude, arguments.steps, direction_in(arguments.direction)
        actions = motion(arguments.motion, grasp, 1, *shape)
    progress = progress_of(arguments, comm.rank)
    progress.say(f"simulating {len(actions)} action(s), {sum(len(a) for a in actions)} steps")
    felt = None if arguments.wrench_noise is None else size_in(arguments.wrench_noise, "--wrench-noise", "N")
    wrench = arguments.wrench or felt is not None
    chosen = arguments.level, noise, arguments.seed, comm, None, wrench, times, felt or 0.0, arguments.surface
    made = make(scene, anchors, actions, *chosen)
    on_root(comm, lambda: made.write(arguments.output))
    if comm.rank == 0:
        points = f" and {arguments.surface} points of the surface" if arguments.surface else ""
        tell(f"{arguments.output}: {len(made.positions)} frames of {len(made.fiducial_names)} fiducials{points}")


def examples(arguments: argparse.Namespace) -> None:
    """`bcid examples`."""
    names = copy_examples(arguments.folder)
    tell(f"{arguments.folder}: {', '.join(names)}\ntry: cd {arguments.folder}; bcid identify {EXAMPLE} -o run")


def check_effect(arguments: argparse.Namespace, comm: Comm) -> None:
    """`bcid check-effect`."""
    from bcid.forms.check_effect import check_effect as check

    check(arguments.effect, comm, lambda text: tell(text) if comm.rank == 0 else None)
