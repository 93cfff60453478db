"""The study beyond the catalogue: is the term that is proposed the one that was hidden, and does it explain the measurement?

RUN/cases/0007/scene.toml, measurement/, truth.json     what is proposed from, and the truth
RUN/results/0007.json                                   what was proposed
RUN/beyond.json  table.txt
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bcid.base.collective import Comm, on_root
from bcid.base.errors import InputError
from bcid.base.progress import Progress, Silent
from bcid.base.run_folder import RunFolder, running
from validation.beyond.beyond_case import KINDS, NOISE
from validation.beyond.true_laws import LAWS
from validation.beyond.true_terms import TERMS
from validation.engine.dispatch import dispatch
from validation.engine.work import Work, Workers, read_result
from validation.synthetic.bodies import check_bodies
from validation.synthetic.wilson import rate
from validation.text_table import TextTable

Json = Mapping[str, Any]
_MAKES = ("cases/", "results/", "logs/", "beyond.json", "table.txt")
# A held-out error is at the noise up to this many times it: of laws, and of terms on the boundary.
HELD_OUT = {"law": 1.2, "term": 1.5}
# An energy is right within this part of it; a place within the radius of the patch, or this, m.
ENERGY, PLACE = 0.05, 0.01


@dataclass(frozen=True)
class BeyondOptions:
    """What a study does.

    Attributes:
        cases: how many; kinds of truth take turns, then bodies.
        seed: of what is random.
        bodies: names of those that take turns.
    """

    cases: int = 40
    seed: int = 0
    bodies: tuple[str, ...] = ("slab", "gallbladder")

    def check(self) -> None:
        """Refuse numbers that make no sense."""
        if self.cases < 1:
            raise InputError(f"--cases {self.cases}: must be at least 1")
        check_bodies(self.bodies)


def run_beyond(
    folder: Path,
    options: BeyondOptions,
    how: Workers,
    progress: Progress | None = None,
    overwrite: bool = False,
    comm: Comm | None = None,
) -> Path:
    """Run the study into a run folder; one that was interrupted goes on. Collective on `comm`."""
    options.check()
    inputs = {"cases": options.cases, "seed": options.seed, "bodies": list(options.bodies), "limit": how.limit}
    with running(comm, folder, "study beyond", inputs, _MAKES, overwrite) as run:
        path = on_root(comm, folder.resolve)
        job = {"cases": str(path / "cases"), "seed": options.seed, "bodies": list(options.bodies)}
        work = Work("validation.beyond.beyond_case:maker", job, path / "results")
        tasks = {f"{index:04d}": {"index": index} for index in range(options.cases)}
        dispatch(work, tasks, how, progress or Silent())
        on_root(comm, lambda: _conclude(run, options))
    return folder


def _conclude(run: RunFolder | None, options: BeyondOptions) -> None:
    assert run is not None
    read = [read_result(run.path / "results" / f"{index:04d}.json") for index in range(options.cases)]
    judged = [judge(one["result"]) | {"index": k} for k, one in enumerate(read) if one["result"] is not None]
    lost = {f"{k:04d}": one["reason"] for k, one in enumerate(read) if one["result"] is None}
    found = {"cases": options.cases, "lost": lost, "judged": judged, "rates": rates(judged)}
    run.write_json("beyond.json", found)
    run.write_text("table.txt", table(found))
    run.finish({"cases": len(judged), "lost": len(lost)})


def judge(result: Json) -> dict[str, Any]:
    """Whether a case is right, question by question; what does not apply is left out."""
    truth, found = result["truth"], result["found"]
    kind, terms = truth["kind"], found["terms"]
    told: dict[str, Any] = {
        "kind": kind,
        "body": truth["body"],
        "size": truth["size"],
        "floor_noises": None if truth["floor"] is None else truth["floor"] / NOISE,
        "refused": len(truth["refused"]),
        "cpu_seconds": result["cpu_seconds"],
    }
    told["anchors"] = not (set(truth["anchored"]) ^ set(found["anchored"])) - set(truth["not_asked"])
    told["proposed"] = " + ".join(term["family"] for term in terms) or found["verdict"]
    if kind == "none":
        return told | {"nothing": not terms}
    of = "law" if kind in LAWS else "term"
    held_out = found["held_out"]
    told["held out"] = held_out is not None and held_out <= HELD_OUT[of] * NOISE
    told["held_out_noises"] = None if held_out is None else held_out / NOISE
    if of == "law":
        told["energy_apart"] = found["energy_apart"]
        told["energy"] = found["energy_apart"] <= ENERGY
        return told
    right = TERMS[kind].families
    told["kind right"] = bool(terms) and terms[0]["family"] in right
    told["among likely"] = any(p > 0.05 and set(name.split("+")) & right for name, p in found["verdicts"].items())
    apart = terms[0]["apart"] if terms else None
    told["place"] = apart is not None and apart <= max(truth["term"]["radius"], PLACE)
    return told


# Question, cases that it is asked of, goal.
_QUESTIONS = (
    ("laws: held out", LAWS, "held out", 0.90),
    ("laws: anchors", LAWS, "anchors", 0.95),
    ("laws: energy", LAWS, "energy", None),
    ("boundary: place", tuple(TERMS), "place", 0.80),
    ("boundary: kind", tuple(TERMS), "kind right", 0.80),
    ("boundary: kind among the likely", tuple(TERMS), "among likely", None),
    ("boundary: held out", tuple(TERMS), "held out", 0.80),
    ("boundary: anchors", tuple(TERMS), "anchors", None),
    ("nothing hidden: nothing proposed", ("none",), "nothing", 0.95),
    ("nothing hidden: anchors", ("none",), "anchors", None),
)


def rates(judged: Sequence[Json]) -> dict[str, dict[str, Any]]:
    """How often each question is answered rightly."""
    found = {}
    for name, kinds, question, goal in _QUESTIONS:
        met = [bool(one[question]) for one in judged if one["kind"] in kinds and question in one]
        found[name] = rate(met) | {"goal": goal}
    return found


def table(found: Json) -> str:
    """Rates, and what was proposed for each kind of truth."""
    rows = []
    for name, one in found["rates"].items():
        goal = "" if one["goal"] is None else f"{100 * one['goal']:.0f} %"
        told = "-" if one["rate"] is None else f"{100 * one['rate']:.0f} %"
        rows.append(
            (
                name,
                goal,
                told,
                f"{one['met']} of {one['count']}",
                f"{100 * one['low']:.0f} to {100 * one['high']:.0f} %",
            )
        )
    title = f"Beyond the catalogue: {found['cases']} cases, five pulls each, noise {NOISE * 1e3:g} mm, truth of cubic elements"
    first = TextTable(title, ("question", "goal", "rate", "cases", "95 % interval"), tuple(rows))
    kinds = [(kind, *_of_kind([one for one in found["judged"] if one["kind"] == kind])) for kind in KINDS]
    head = (
        "truth",
        "cases",
        "size (noises)",
        "held out (noises)",
        "truth's own",
        "energy off",
        "CPU s",
        "drawn again",
        "proposed",
    )
    second = TextTable("By what was hidden (medians)", head, tuple(kinds))
    cases = [(f"{one['index']:04d}", one["body"], one["kind"], *_of_case(one)) for one in found["judged"]]
    head = ("case", "body", "truth", "size", "held out", "truth's own", "energy off", "anchors", "proposed")
    third = TextTable("Case by case (sizes and errors in noises)", head, tuple(cases))
    lost = [f"{name}: {why}" for name, why in found["lost"].items()]
    return (
        "\n".join(
            [first.text(), "", second.text(), "", third.text(), *(["", "Without a result:", *lost] if lost else [])]
        )
        + "\n"
    )


def _of_kind(judged: Sequence[Json]) -> tuple[str, ...]:
    def median(name: str, digits: str = ".2g") -> str:
        values = [one[name] for one in judged if one.get(name) is not None]
        return f"{np.median(values):{digits}}" if values else ""

    names = [one["proposed"] for one in judged]
    most = ", ".join(f"{name} {names.count(name)}" for name in sorted(set(names), key=lambda n: (-names.count(n), n)))
    seconds, refused = median("cpu_seconds", ".0f"), str(sum(one["refused"] for one in judged))
    errors = median("held_out_noises", ".3g"), median("floor_noises", ".3g"), median("energy_apart")
    return str(len(judged)), median("size"), *errors, seconds, refused, most


def _of_case(one: Json) -> tuple[str, ...]:
    def told(name: str, digits: str = ".2f") -> str:
        return "" if one.get(name) is None else f"{one[name]:{digits}}"

    held = "right" if one["anchors"] else "wrong"
    energy = told("energy_apart", ".1%").replace("%", " %")
    return told("size", ".1f"), told("held_out_noises"), told("floor_noises"), energy, held, one["proposed"]
