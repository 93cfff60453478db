"""What the commands of `bcid.app.cli` do, once their arguments are parsed."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bcid.base.collective import Comm, first
from bcid.base.errors import InputError, MachineError
from bcid.base.progress import Progress, Silent, clear, progress_on
from bcid.base.shipped import copy_examples, shipped
from bcid.base.text_file import read_json

if TYPE_CHECKING:
    from bcid.measurement.inspection import Inspected
    from bcid.studies.engine.work import Workers

DEMO_SCENE = "examples/scenes/slab_explain.toml"
DEMO_MEASUREMENT = "examples/measurements/slab-34-heavy"
EXAMPLE = "examples/scenes/slab.toml examples/measurements/slab-34-complex"
# The module of `bcid.report` that draws what a command found.
_PICTURES = dict.fromkeys(("compare", "diagnose", "fit", "explain", "propose"), "diagnosis_picture") | {
    "identify": "identification_picture",
    "explore": "exploration_picture",
    "calibrate": "calibration_picture",
    "track": "tracking_picture",
}


def complain(text: object) -> None:
    """Say on standard error what went wrong."""
    clear()
    print(f"bcid: {text}", file=sys.stderr, flush=True)


def demo(arguments: argparse.Namespace, comm: Comm) -> None:
    """`bcid demo`."""
    scene, measurement = shipped(DEMO_SCENE), shipped(DEMO_MEASUREMENT)
    progress = _progress(arguments, comm.rank)
    progress.say("a soft slab was pulled five times; which patches hold it, and what does the plain model lack?")
    progress.say("searching the anchors with the plain model first")
    folder = _explained(scene, measurement, arguments, comm, progress)
    if comm.rank > 0:
        return
    if not arguments.no_picture:
        _draw(folder, progress)
    from bcid.report.text import falling

    clear()
    found = read_json(folder / "diagnosis.json")
    print("\n" + (folder / "summary.txt").read_text(encoding="utf-8").split("\n\n")[0])
    print(f"{falling(found)}\n\nrun folder: {folder} (summary.txt tells more)", flush=True)
    if not arguments.no_picture:
        _demo_report(folder)


def _demo_report(folder: Path) -> None:
    """The page that the demo ends with."""
    with _beside_the_result("report"):
        from bcid.report.page import write_report

        made = write_report([folder], folder / "report.html")
        print(f"report: {made.path} (open it in a browser)", flush=True)


@contextmanager
def _beside_the_result(what: str) -> Iterator[None]:
    """Pages and pictures are a view: what stops them must not take the result along."""
    try:
        yield
    except ImportError as error:
        complain(f"no {what}: {error.name} is not installed (the extra 'report')")
    except Exception as error:
        complain(f"no {what}: {error}")


def _progress(arguments: argparse.Namespace, rank: int) -> Progress:
    """What a command speaks through. One for each command: its lines count the seconds since it was made."""
    return Silent() if arguments.quiet or rank > 0 else progress_on()


def identify(arguments: argparse.Namespace, comm: Comm) -> None:
    """`bcid identify`."""
    from bcid.search.identify import IdentifyOptions
    from bcid.search.identify_run import run_identification
    from bcid.search.termination import Stop, Termination

    options = IdentifyOptions(
        certify=arguments.certify,
        seeds=arguments.seeds,
        random_state=arguments.random_state,
        coarsest=arguments.coarsest,
        finest=arguments.finest,
        climbed=arguments.climbed,
        start=arguments.start,
        threshold=arguments.threshold,
        toggles=arguments.toggles,
        stop=Stop.parse(arguments.stop),
        termination=Termination(arguments.fit, arguments.patience, arguments.budget),
    )
    scene, measurement, output = arguments.scene, arguments.measurement, arguments.output
    progress = _progress(arguments, comm.rank)
    folder = run_identification(
        scene, measurement, output, options, comm, progress, arguments.overwrite, arguments.refine
    )
    _finish(folder, arguments, comm, progress)


def _finish(folder: Path, arguments: argparse.Namespace, comm: Comm | None, progress: Progress) -> None:
    """Print the result and draw it; `comm` is None for commands without MPI."""
    if comm is not None and comm.rank > 0:
        return
    _print_result(folder, "summary.txt")
    if not arguments.no_picture:
        _draw(folder, progress)
    progress.say(f"a page of it: bcid report {folder} -o report.html")


def _print_result(folder: Path, file: str) -> None:
    clear()
    print((folder / file).read_text(encoding="utf-8").rstrip())
    print(f"\nrun folder: {folder}", flush=True)


def _draw(folder: Path, progress: Progress) -> None:
    """Pictures of a run."""
    with _beside_the_result("picture"):
        from bcid.base.run_folder import RunFolder

        kind = _PICTURES[RunFolder.open(folder).record["command"]]
        for file in import_module(f"bcid.report.{kind}").draw(folder):
            progress.say(f"wrote {file}")


def compare(arguments: argparse.Namespace, comm: Comm) -> None:
    """`bcid compare`."""
    from bcid.comparison.compare_runs import run_compare

    progress = _progress(arguments, comm.rank)
    common = _common(arguments, comm, progress)
    folder = run_compare(arguments.run_folder, _beside(arguments, "compare"), **common)
    _finish(folder, arguments, comm, progress)


def diagnose(arguments: argparse.Namespace, comm: Comm) -> None:
    """`bcid diagnose`."""
    from bcid.comparison.compare_runs import run_diagnose

    progress = _progress(arguments, comm.rank)
    common = _common(arguments, comm, progress) | {"only": _listed(arguments.only)}
    folder = run_diagnose(arguments.run_folder, _beside(arguments, "diagnose"), **common)
    _finish(folder, arguments, comm, progress)


def fit(arguments: argparse.Namespace, comm: Comm) -> None:
    """`bcid fit`."""
    from bcid.comparison.compare_runs import run_fit

    if not (arguments.add or arguments.free):
        raise InputError("fit: nothing to do; name an effect with --add (as --add gravity) or a number with --free")
    chosen = {name: getattr(arguments, name) for name in ("add", "free", "fixed")}
    progress = _progress(arguments, comm.rank)
    common = _common(arguments, comm, progress)
    folder = run_fit(arguments.run_folder, arguments.output, **common, **chosen)
    _finish(folder, arguments, comm, progress)


def explain(arguments: argparse.Namespace, comm: Comm) -> None:
    """`bcid explain`."""
    if arguments.most < 1:
        raise InputError(f"--most {arguments.most}: must be at least 1")
    progress = _progress(arguments, comm.rank)
    folder = _explained(arguments.scene, arguments.measurement, arguments, comm, progress)
    _finish(folder, arguments, comm, progress)
    if arguments.no_propose or _verdict(folder, comm) != "unknown":
        return
    progress.say("no known effect explains it: looking for a term that does (--no-propose leaves that out)")
    _proposed(folder, None, folder / "propose", arguments, comm, progress)


def _verdict(folder: Path, comm: Comm) -> str:
    """Of a run, the same on every rank."""
    from bcid.base.collective import on_root

    return str(on_root(comm, lambda: read_json(folder / "diagnosis.json")["verdict"]))


def propose(arguments: argparse.Namespace, comm: Comm) -> None:
    """`bcid propose`."""
    folder = arguments.folder or arguments.run_folder.with_name(f"{arguments.run_folder.resolve().name}-propose")
    progress = _progress(arguments, comm.rank)
    _proposed(arguments.run_folder, arguments.output, folder, arguments, comm, progress)


def _proposed(
    run: Path, output: Path | None, folder: Path, arguments: argparse.Namespace, comm: Comm, progress: Progress
) -> None:
    """Search the grammar beside the model of a run, and tell what came out."""
    from bcid.proposal.propose import ProposeOptions
    from bcid.proposal.propose_run import run_propose

    options = ProposeOptions(level=arguments.level)
    if arguments.command == "propose":
        kinds = options.kinds if arguments.kinds is None else _names(arguments.kinds)
        options = replace(options, terms=arguments.most, kinds=kinds)
    files = run_propose(run, output, folder, comm, options, progress, arguments.overwrite, arguments.effects)
    _finish(folder, arguments, comm, progress)
    for file in files if comm.rank == 0 else ():
        print(f"effect: {file} (use it with --effects {file})", flush=True)


def _explained(scene: Path, measurement: Path, arguments: argparse.Namespace, comm: Comm, progress: Progress) -> Path:
    """Run the whole loop; returns the run folder."""
    from bcid.comparison.compare_runs import run_explain
    from bcid.comparison.explain import ExplainOptions

    only = _listed(getattr(arguments, "only", None))
    options = ExplainOptions(
        getattr(arguments, "level", None), getattr(arguments, "most", ExplainOptions.effects), only=only
    )
    files = getattr(arguments, "effects", [])
    return run_explain(scene, measurement, arguments.output, options, comm, progress, arguments.overwrite, files)


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _listed(text: str | None) -> tuple[str, ...] | None:
    """Names of effects separated by commas; None where the option is not given."""
    if text is None:
        return None
    names = _names(text)
    if not names:
        raise InputError(f"--only '{text}': names no effect; give some, as --only gravity,soft_anchor")
    return names


def _beside(arguments: argparse.Namespace, command: str) -> Path:
    run: Path = arguments.run_folder
    output: Path = arguments.output or run.with_name(f"{run.resolve().name}-{command}")
    return output


def _common(arguments: argparse.Namespace, comm: Comm, progress: Progress) -> dict[str, Any]:
    """What all jobs on a run take."""
    common = {"comm": comm, "progress": progress, "overwrite": arguments.overwrite}
    return common | {"level": arguments.level, "files": arguments.effects}


def explore(arguments: argparse.Namespace, comm: Comm) -> None:
    """`bcid explore`."""
    from bcid.exploration.explore_run import run_exploration
    from bcid.exploration.loop import ExploreOptions

    if not arguments.wait > 0:
        raise InputError(f"--wait {arguments.wait:g}: must be a positive number of seconds")
    options = ExploreOptions(
        confidence=arguments.confidence,
        budget=arguments.budget,
        criterion=arguments.criterion,
        look_ahead=not arguments.no_look_ahead,
        grasps=None if arguments.grasps is None else _names(arguments.grasps),
        level=arguments.level,
        noise=_noise(arguments.noise),
        samples=arguments.samples,
        random_state=_random_state(arguments.random_state),
        effects=_names(arguments.effects or ""),
        wrench_noise=_noise(arguments.wrench_noise, "--wrench-noise", "N"),
    )
    progress = _progress(arguments, comm.rank)
    folder = run_exploration(
        arguments.scene,
        arguments.robot,
        arguments.output,
        options,
        comm,
        progress,
        arguments.overwrite,
        arguments.store,
        arguments.wait,
        arguments.hide,
    )
    _finish(folder, arguments, comm, progress)


def _noise(text: str | None, option: str = "--noise", unit: str = "m") -> float | None:
    """A standard deviation in a unit; None where the option is not given."""
    noise = _quantity(text, option, unit)
    if noise is not None and noise < 0:
        raise InputError(f"{option} '{text}': must not be negative")
    return noise


def _length(text: str | None, option: str) -> float | None:
    """A length, m; None where the option is not given."""
    return _quantity(text, option, "m")


def _quantity(text: str | None, option: str, unit: str) -> float | None:
    """A number in a unit; None where the option is not given."""
    from bcid.base.units import quantity

    try:
        return None if text is None else quantity(text, unit)
    except InputError as error:
        raise InputError(f"{option}: {error}") from None


def _direction(text: str | None) -> tuple[float, ...] | None:
    """Three numbers separated by commas or blanks; None where the option is not given."""
    if text is None:
        return None
    try:
        return tuple(float(number) for number in text.replace(",", " ").split())
    except ValueError:
        raise InputError(f"--direction '{text}': expected three numbers, as 0,0,1") from None


def _random_state(number: int) -> int:
    if number < 0:
        raise InputError(f"--random-state {number}: must be at least 0")
    return number


def report(arguments: argparse.Namespace) -> None:
    """`bcid report`."""
    from bcid.report.page import write_report

    made = write_report(arguments.run_folders, arguments.output)
    for folder, troubles in made.troubles.items():
        for text in troubles:
            complain(text if str(folder) in text else f"{folder}: {text}")
    if not arguments.quiet:
        runs = f"{len(made.shown)} run{'s' if len(made.shown) != 1 else ''}"
        print(f"{made.path}: {runs}, {made.path.stat().st_size / 1e6:.1f} MB")


def import_recording(arguments: argparse.Namespace) -> None:
    """`bcid import`."""
    if not first():
        return
    from bcid.measurement.inspection import import_file
    from bcid.scene import Scene

    scene = None if arguments.scene is None else Scene.read(arguments.scene)
    made = import_file(arguments.file, arguments.output, scene)
    print(made.text)
    if not arguments.no_picture:
        _draw_tracks(made)


def _draw_tracks(made: Inspected) -> None:
    """The paths beside a mapping."""
    target = made.mapping.with_suffix(".png")
    if target.exists():
        complain(f"no picture: {target} exists already")
        return
    with _beside_the_result("picture"):
        from bcid.report.tracks_picture import draw_tracks

        seen = made.seen
        title = f"{made.mapping.stem}: {len(seen.points)} markers, {seen.frames} frames"
        print(f"wrote {draw_tracks(seen.points, seen.times, made.unit, title, target)}", flush=True)


def figure(arguments: argparse.Namespace) -> None:
    """`bcid figure`."""
    from bcid.report.export import write_figures

    formats = _names(arguments.format)
    if not formats:
        raise InputError(f"--format '{arguments.format}': names no format; give some, as --format png,pdf")
    progress = _progress(arguments, 0)
    try:
        files = write_figures(arguments.run_folder, arguments.output, formats, arguments.overwrite, progress.say)
    except ImportError as error:
        raise MachineError(f"{error.name} is not installed: pip install 'bcid[report]'") from None
    if not arguments.quiet:
        print(f"{arguments.output}: {len(files)} files")


def calibrate(arguments: argparse.Namespace) -> None:
    """`bcid calibrate`."""
    from bcid.vision.calibrate_run import run_calibration

    progress = _progress(arguments, 0)
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
    _finish(folder, arguments, None, progress)


def track(arguments: argparse.Namespace) -> None:
    """`bcid track`."""
    from bcid.measurement import Measurement
    from bcid.scene import Scene
    from bcid.vision.track_run import run_tracking

    scene = Scene.read(arguments.scene)
    expected = None if arguments.expected is None else Measurement.read(arguments.expected)
    progress = _progress(arguments, 0)
    folder = run_tracking(
        arguments.recording,
        scene.fiducials,
        arguments.output,
        progress,
        arguments.overwrite,
        expected,
        not arguments.no_film,
    )
    _finish(folder, arguments, None, progress)


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
    anchors = _names(arguments.anchors)
    if arguments.surface < 0:
        raise InputError(f"--surface {arguments.surface}: must be at least 0")
    noise, random_state = _noise(arguments.noise), _random_state(arguments.random_state)
    if arguments.level is not None and not 0 <= arguments.level < len(scene.levels):
        raise InputError(f"--level {arguments.level}: the scene has levels 0 to {len(scene.levels) - 1}")
    if arguments.like and arguments.grasp:
        raise InputError("--grasp: a measurement given with --like names its grasps itself; leave one of the two out")
    scene = with_effects(scene, arguments.hide)
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
        shape = _length(arguments.amplitude, "--amplitude"), arguments.steps, _direction(arguments.direction)
        actions = motion(arguments.motion, grasp, 1, *shape)
    progress = _progress(arguments, comm.rank)
    progress.say(f"simulating {len(actions)} action(s), {sum(len(a) for a in actions)} steps")
    felt = _noise(arguments.wrench_noise, "--wrench-noise", "N")
    wrench = arguments.wrench or felt is not None
    chosen = arguments.level, noise, random_state, comm, None, wrench, times, felt or 0.0, arguments.surface
    made = make(scene, anchors, actions, *chosen)
    on_root(comm, lambda: made.write(arguments.output))
    if comm.rank == 0:
        points = f" and {arguments.surface} points of the surface" if arguments.surface else ""
        print(f"{arguments.output}: {len(made.positions)} frames of {len(made.fiducial_names)} fiducials{points}")


def examples(arguments: argparse.Namespace) -> None:
    """`bcid examples`."""
    names = copy_examples(arguments.folder)
    print(f"{arguments.folder}: {', '.join(names)}\ntry: cd {arguments.folder}; bcid identify {EXAMPLE} -o run")


def check_effect(arguments: argparse.Namespace, comm: Comm) -> None:
    """`bcid check-effect`."""
    from bcid.forms.check_effect import check_effect as check

    check(arguments.effect, comm, lambda text: print(text, flush=True) if comm.rank == 0 else None)


def bench(arguments: argparse.Namespace) -> None:
    """`bcid bench`."""
    from bcid.bench.bench_run import run

    run(arguments.parts, arguments.output, arguments.quick)


def study(arguments: argparse.Namespace, comm: Comm | None = None) -> None:
    """`bcid study`."""
    from bcid.studies.engine.work import Workers

    if arguments.jobs < 1:
        raise InputError(f"--jobs {arguments.jobs}: must be at least 1")
    if not arguments.limit > 0:
        raise InputError(f"--limit {arguments.limit:g}: must be a positive number of seconds")
    rank = comm.rank if comm else 0
    folder = _studies(arguments)(arguments, Workers(comm, arguments.jobs, arguments.limit), _progress(arguments, rank))
    if rank == 0 and (folder / "table.txt").is_file():
        _print_result(folder, "table.txt")


def _studies(arguments: argparse.Namespace) -> Callable[..., Path]:
    """The function that runs the study that is asked for."""
    named = {"paper": _study_paper, "hidden": _study_hidden, "beyond": _study_beyond, "exploration": _study_exploration}
    if arguments.study in named:
        return named[arguments.study]
    if not Path(arguments.study).is_file():
        raise InputError(f"study '{arguments.study}': neither a file nor one of {', '.join(named)}")
    return _study_file


def _study_hidden(arguments: argparse.Namespace, how: Workers, progress: Progress) -> Path:
    from bcid.studies.hidden.hidden_study import HiddenOptions, run_hidden

    options = HiddenOptions(
        arguments.cases, arguments.seed, how.jobs, how.limit, arguments.least, conditions=arguments.conditions
    )
    if arguments.bodies is not None:
        options = replace(options, bodies=tuple(name.strip() for name in arguments.bodies.split(",")))
    return run_hidden(arguments.output, options, progress=progress, overwrite=arguments.overwrite, comm=how.comm)


def _study_beyond(arguments: argparse.Namespace, how: Workers, progress: Progress) -> Path:
    from bcid.studies.beyond.beyond_study import BeyondOptions, run_beyond

    options = BeyondOptions(arguments.cases, arguments.seed)
    if arguments.bodies is not None:
        options = replace(options, bodies=_names(arguments.bodies))
    return run_beyond(arguments.output, options, how, progress, arguments.overwrite, how.comm)


def _study_exploration(arguments: argparse.Namespace, how: Workers, progress: Progress) -> Path:
    from bcid.studies.exploration.exploration_study import run_study
    from bcid.studies.exploration.exploration_trials import ExplorationExtent

    count, part = arguments.trials, arguments.only
    extent = ExplorationExtent(count) if part is None else ExplorationExtent.only(count, part)
    return run_study(arguments.output, extent, arguments.seed, how, progress, arguments.overwrite)


def _study_file(arguments: argparse.Namespace, how: Workers, progress: Progress) -> Path:
    from bcid.studies.paper.study import Extent, run_study

    extent = Extent(arguments.quick, _part(arguments.part), arguments.predict_only, arguments.seed)
    folder = run_study(Path(arguments.study), arguments.output, extent, how, progress, arguments.overwrite)
    if extent.part or extent.only_predict:
        progress.say("this part is done; the command without --part and --predict-only makes the tables")
    return folder


def _study_paper(arguments: argparse.Namespace, how: Workers, progress: Progress) -> Path:
    from bcid.studies.paper.paper_study import run_paper

    return run_paper(arguments.output, arguments.quick, arguments.seed, how, progress, arguments.overwrite)


def _part(text: str | None) -> tuple[int, int] | None:
    """(i, n) of "i/n"."""
    if text is None:
        return None
    numbers = text.split("/")
    if len(numbers) == 2 and all(n.isdecimal() for n in numbers) and 1 <= int(numbers[0]) <= int(numbers[1]):
        return int(numbers[0]), int(numbers[1])
    raise InputError(f"--part '{text}': expected I/N with I from 1 to N, as 3/16")
