"""`identification.json`: the anchored patches and how certain they are."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

from bcid.results.common_rows import ComparedRow, InputUncertaintyRow, LeftOutRow, StiffnessRecord
from bcid.results.record import FileRecord, Record, length


@dataclass(frozen=True, kw_only=True)
class AnchorSet(Record):
    """A set of anchored patches.

    Attributes:
        anchored: names of the patches.
        probability: posterior probability of the set; an upper bound where it did not converge to the end.
        rms: RMS residual per coordinate, in the frames in which it and the reported set are known.
        reported_rms: of the reported set, in the same frames.
        frames: how many these are.
        level: of the mesh hierarchy, that it was evaluated on last.
        stopped: whether its evaluation ended when it was improbable enough.
        failure: why it did not converge any further; "" where it did.
    """

    anchored: tuple[str, ...]
    probability: float
    rms: float = length()
    reported_rms: float = length()
    frames: int
    level: int
    stopped: bool
    failure: str = ""


@dataclass(frozen=True, kw_only=True)
class IdentificationRecord(FileRecord):
    """The content of `identification.json`.

    Attributes:
        anchored: names of the anchored patches of the reported set, in the scene's order.
        probability: posterior probability of this set among all that were evaluated.
        patches: of each candidate patch the probability that it is anchored.
        rms: RMS residual per coordinate, discretisation error taken out.
        noise_rms: the stated noise per coordinate, or None.
        discretisation_rms: RMS of what may be left of the discretisation error; None where it is not known.
        certified: whether every set was evaluated, and the model converged for each.
        evaluations: forward trajectories per level of the mesh hierarchy, in whole-trajectory equivalents.
        evaluated: how many sets were evaluated "in full", "stopped", "failed" and "not" evaluated.
        alternatives: the next best sets, best first.
        classes: likely sets in classes that these data cannot separate; the first holds the reported set.
        levels: of the mesh hierarchy, that were used.
        stages: what happened on each level, in words.
        failures: sets without an acceptable equilibrium, with the reason.
        not_converged: sets that did not converge to the end and are not improbable.
        remarks: what is unusual about the measurement.
        discrepancy_probability: posterior probability of an unmodelled discrepancy; None where it was not computed.
        outliers: markers that were left out.
        adequate: whether the model with the reported set explains the measurement.
        input_uncertainties: inputs of the scene that may be slightly wrong.
        stiffness: by known forces, or None.
        refined: patches that were halved, with their halves.
        rounds: what each round of halving did, in words.
        left_out: frames that were not compared, or None.
        scene: name of the body.
        compared: what was compared; None in files of format/1, and of explain.
        partly_held: of patches that hold along some axes only, which, in words.
        body: sizes of the body and its places, in words.
    """

    file: ClassVar[str] = "identification.json"

    anchored: tuple[str, ...]
    probability: float
    patches: dict[str, float]
    rms: float = length()
    noise_rms: float | None = length(default=None)
    discretisation_rms: float | None = length(default=None)
    certified: bool
    evaluations: dict[int, float]
    evaluated: dict[str, int]
    alternatives: tuple[AnchorSet, ...]
    classes: tuple[tuple[tuple[str, ...], ...], ...]
    levels: tuple[int, ...]
    stages: tuple[str, ...]
    failures: dict[str, str]
    not_converged: tuple[tuple[str, ...], ...]
    remarks: tuple[str, ...]
    discrepancy_probability: float | None = None
    outliers: tuple[str, ...]
    adequate: bool
    input_uncertainties: tuple[InputUncertaintyRow, ...]
    stiffness: StiffnessRecord | None = None
    refined: dict[str, tuple[str, ...]] = field(default_factory=dict)
    rounds: tuple[str, ...] = ()
    left_out: LeftOutRow | None = None
    scene: str = ""
    compared: ComparedRow | None = None
    partly_held: dict[str, str] = field(default_factory=dict)
    body: tuple[str, ...] = ()
