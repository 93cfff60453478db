"""What the hypotheses of an explanation say of the anchors, as an identification tells it."""

from __future__ import annotations

from collections.abc import Sequence

from bcid.comparison.fitted_hypothesis import FittedHypothesis
from bcid.forms.forward import Prediction
from bcid.inference.hypotheses import HypothesisOdds, patches
from bcid.search.identification import Alternative, Identification

# So many other sets are told.
_TOLD = 8


def anchor_marginals(
    rivals: Sequence[FittedHypothesis], odds: HypothesisOdds, best: FittedHypothesis, seconds: float
) -> Identification:
    """The anchors of the best hypothesis, with probabilities over all effects.

    Args:
        rivals: all hypotheses that were weighed, the likeliest first.
        odds: what is believed of them.
        best: whose anchors are reported.
        seconds: time spent.
    """
    state, predictor = best.fitted.state, best.fitted.state.predictor
    names = list(predictor.whole.patches)

    def ordered(anchors: frozenset[str]) -> tuple[str, ...]:
        return tuple(name for name in names if name in anchors)

    likeliest: dict[frozenset[str], FittedHypothesis] = {}
    for rival in rivals:
        likeliest.setdefault(rival.anchors, rival)
    others = [rival for anchors, rival in likeliest.items() if anchors != state.anchors]
    others.sort(key=lambda r: (-odds.held_by(r.anchors), len(r.anchors), sorted(r.anchors)))
    every = 2 ** len(names)
    return Identification(
        anchored=ordered(state.anchors),
        probability=odds.held_by(state.anchors),
        patches=patches(odds.probabilities, names),
        rms=state.rms,
        noise=state.noise if predictor.data.stated else None,
        discretisation=state.errors.mesh_rms if state.errors.mesh.known else None,
        certified=False,
        evaluations=dict(enumerate(predictor.trajectories.values())),
        looked_at={"in full": len(likeliest), "stopped": 0, "failed": 0, "not": every - len(likeliest)},
        alternatives=tuple(
            Alternative(
                ordered(r.anchors),
                odds.held_by(r.anchors),
                r.fitted.state.rms,
                predictor.level,
                False,
                state.rms,
                len(r.fitted.state.predictor.data.mask),
            )
            for r in others[:_TOLD]
        ),
        classes=((ordered(state.anchors),),),
        levels=(predictor.level,),
        stages=(),
        prediction=Prediction(state.prediction.positions, ()),
        failures={},
        seconds=seconds,
        remarks=predictor.measurement.remarks,
        missing=odds.verdicts["unknown"],
        nuisances=tuple(state.told),
        stiffness=best.fitted.stiffness,
    )
