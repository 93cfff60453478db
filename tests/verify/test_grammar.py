"""Terms of the grammar: their scores against the tangent of the same terms in UFL, their files, and what is found with them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from bcid.base.errors import InputError
from bcid.forms import check_effect
from bcid.forms import effect_trial as trial
from bcid.forms.forward import Forward
from bcid.forms.gripper_force import ForceScale
from bcid.forms.model import Model, Term
from bcid.forms.probes import Probe, SensitivityRequest
from bcid.forms.quadrature import QuadraturePoints
from bcid.forms.sensitivity import Sensitivity
from bcid.forms.solver.equilibrium import Settings
from bcid.grammar.effect_file import check_name, made, source
from bcid.grammar.energies import energies
from bcid.grammar.family import SURFACE
from bcid.grammar.grammar import Grammar
from bcid.grammar.holds import Holds, held_by
from bcid.grammar.pulled import pulled_families
from bcid.grammar.replaced_law import ReplacedLaw
from bcid.grammar.term_scores import GRIPS
from bcid.scene import Level, Material

ANCHORS = frozenset({"left"})


@pytest.fixture(scope="module")
def forward():
    scene, mesh = trial.scene(), trial.box()
    model, settings = Model.of(scene), Settings(rtol=1e-12)
    found = Forward(scene, 0, MPI.COMM_SELF, model, settings, mesh, ForceScale(400.0, 0.05))
    yield found
    found.destroy()


@pytest.fixture(scope="module")
def grammar(forward: Forward) -> Grammar:
    return Grammar(forward)


def test_energies_with_a_direction_are_looked_for_apart(forward: Forward, grammar: Grammar) -> None:
    even, fibres = (Grammar(forward, (kind,)).families for kind in ("energy", "fibres"))
    assert {f.name for f in (*even, *fibres)} == {f.name for f in grammar.families if f.kind == "energy"}
    assert not {f.name for f in even} & {f.name for f in fibres}
    assert {"longest_stretch", "second_squared"} <= {f.name for f in even}
    assert {"fibre_in_tension", "transverse", "crossed_fibres"} <= {f.name for f in fibres}


def test_points_integrate_volume_area_and_what_is_linear_in_place(forward: Forward) -> None:
    inside, outside = QuadraturePoints.volume(forward.body, 2), QuadraturePoints.boundary(forward.body, 2)
    size = np.array([0.06, 0.02, 0.04])
    assert inside.weights.sum() == pytest.approx(size.prod())
    assert inside.weights @ inside.places == pytest.approx(size.prod() * size / 2)
    assert outside.weights.sum() == pytest.approx(2 * (size.prod() / size).sum())
    # Gauss: the normals of a closed surface, and the volume below it.
    assert outside.weights @ outside.normals == pytest.approx(np.zeros(3), abs=1e-12)
    flux = np.einsum("q,qi,qi->", outside.weights, outside.places, outside.normals)
    assert flux == pytest.approx(3 * size.prod())
    linear = forward.body.nodes @ np.array([[1.0, 2.0, 0.0], [0.0, -1.0, 3.0], [0.5, 0.0, 1.0]]).T
    for points in (inside, outside):
        assert points.values(linear)[0] == pytest.approx(
            points.places[0] @ np.array([[1.0, 2.0, 0.0], [0.0, -1.0, 3.0], [0.5, 0.0, 1.0]]).T
        )
        assert points.gradients(linear)[-1] == pytest.approx(
            np.array([[1.0, 2.0, 0.0], [0.0, -1.0, 3.0], [0.5, 0.0, 1.0]])
        )


def test_a_law_made_up_of_terms_moves_the_body_as_the_law_does() -> None:
    """Of the scene's law nothing is left: neither its coupling of shape and volume, nor what quadrature makes of it."""
    scene, shear = replace(trial.scene(), levels=(Level(2, element_size=0.02),)), 15e3 / 2.7
    scene = replace(scene, material=Material("neo_hooke", {"young": "15 kPa", "poisson": 0.35}))
    other = Material("mooney_rivlin", {"c10": "0 Pa", "c01": f"{shear / 2} Pa", "poisson": 0.35})
    family = next(f for f in energies(shear, ReplacedLaw.of(Model.of(scene))) if f.name == "second_for_first")
    term = Term(made(source(family, "other", {}, "", ())), {"c": shear / 2})
    found = []
    for model in (Model.of(replace(scene, material=other)), Model.of(scene) + term):
        forward = Forward(scene, 0, MPI.COMM_SELF, model, Settings(rtol=1e-10), trial.box())
        found.append(forward.predict(ANCHORS, trial.actions()[:1]).positions - scene.rest)
        forward.destroy()
    assert np.abs(found[0] - found[1]).max() < 1e-6 * np.abs(found[0]).max()


def test_scores_are_the_sensitivities_of_the_same_terms_in_ufl(forward: Forward, grammar: Grammar) -> None:
    """Of every family, force and torque of the gripper included; of those at spots to the quadrature that scores have."""
    action = trial.actions()
    prediction = forward.predict(ANCHORS, action, keep=True)
    chosen: dict[str, int] = {}
    for k, variant in enumerate(grammar.variants):
        # Where nothing moves a spring does nothing, and small spots are less than an element of the box.
        if variant.place != "left" and variant.shapes.get("radius", 1.0) > 0.1 * grammar.size:
            chosen.setdefault(variant.family.name, k)
    assert len(chosen) == len(grammar.families)
    probes = []
    for k in chosen.values():
        term = grammar.term(grammar.variants[k])
        probes.append(Probe(term, tuple(p.name for p in grammar.variants[k].family.amounts)))
    sensitivity = Sensitivity(forward)
    found = sensitivity.of(ANCHORS, action, prediction, SensitivityRequest(tuple(probes), terms=grammar))
    assert found.terms is not None
    for (name, k), probe, arrays in zip(chosen.items(), probes, found.probes, strict=True):
        expected = np.stack([arrays[one] for one in probe.wanted], axis=-1)
        scored = found.terms[..., grammar.ends[k] - len(probe.wanted) : grammar.ends[k]]
        family = grammar.variants[k].family
        # Which way a point slides is no polynomial.
        tolerance = 0.2 if family.local else 1e-2 if family.remembers else 1e-5
        for rows in (slice(len(trial.scene().fiducials)), slice(-2, None)):
            most = np.abs(expected[:, rows]).max()
            assert scored[:, rows] == pytest.approx(expected[:, rows], abs=tolerance * most + 1e-15), name
    sensitivity.destroy()


@pytest.mark.parametrize(
    ("name", "stiffness"),
    [
        ("spring", 1e4),
        ("spring", 1e7),
        ("normal_spring", 1e7),
        ("outer_stop", 1e7),
        ("inner_stop", 1e7),
    ],
)
def test_springs_hold_a_spot_however_stiff_they_are(
    forward: Forward, grammar: Grammar, name: str, stiffness: float
) -> None:
    """Against the same springs solved, in a motion so small that everything else is linear."""
    number = next(k for k, s in enumerate(grammar.held_spots) if s["cy"] > 0.015 and 0.02 < s["cx"] < 0.05)
    spot = grammar.held_spots[number] | {"radius": 0.006}
    near = Holds(
        forward.body, grammar.outside, [grammar.outside.spot(np.array([spot[f"c{axis}"] for axis in "xyz"]), 0.006)]
    )
    # The spot moves inwards when it is pulled, and outwards when it is pushed.
    way = -1e-4 if name == "outer_stop" else 1e-4
    action = [
        replace(a, translation=way * a.translation, rotation=np.tile([1.0, 0.0, 0.0, 0.0], (len(a), 1)), loads={})
        for a in trial.actions()
    ]
    free = forward.predict(ANCHORS, action, keep=True)
    family = next(f for f in grammar.families if f.name == f"{name}_at_a_spot")
    term = Term(made(source(family, "held", spot, "", ())), {"stiffness": stiffness, **spot})
    held = Forward(
        forward.scene,
        0,
        MPI.COMM_SELF,
        forward.model + term,
        Settings(rtol=1e-12),
        forward.mesh,
        ForceScale(400.0, 0.05),
    )
    expected = held.predict(ANCHORS, action).positions - free.positions
    held.destroy()
    push = made(source(next(f for f in grammar.families if f.name == "traction_at_a_spot"), "push", spot, "", ()))
    pushed = Term(push, {"tx": 0.0, "ty": 0.0, "tz": 0.0, **spot})
    sensitivity = Sensitivity(forward)
    found = sensitivity.of(
        ANCHORS, action, free, SensitivityRequest((Probe(pushed, ("tx", "ty", "tz")),), terms=_Only(near))
    )
    sensitivity.destroy()
    assert found.held is not None
    forces = held_by(stiffness, float(near.areas[0]), found.held[:, 0], near.normals[0], GRIPS[f"{name}_at_a_spot"])
    per_force = np.stack([found.probes[0][name] for name in ("tx", "ty", "tz")], axis=-1) / near.areas[0]
    moved = np.einsum("fpaj,fj->fpa", per_force, forces)
    count = len(forward.scene.fiducials)
    most = np.abs(expected[:, :count]).max()
    assert most > 1e-10
    # The springs act on more than the mean of the movement.
    assert moved[:, :count] == pytest.approx(expected[:, :count], abs=0.35 * most)


class _Only:
    """No terms but places that springs may hold."""

    def __init__(self, holds: Holds) -> None:
        self.places = holds
        self.count, self.holds = 1, len(holds.areas)

    def works(self, unknowns: np.ndarray, fields: np.ndarray, before: np.ndarray) -> np.ndarray:
        return np.zeros((fields.shape[1], 1))

    def held(self, unknowns: np.ndarray, solve) -> np.ndarray:
        return self.places.at(unknowns, solve)


def test_every_family_makes_an_effect_that_keeps_its_word_about_itself(grammar: Grammar) -> None:
    for family in (*grammar.families, *pulled_families(grammar.families)):
        place = "top" if family.where == SURFACE else ""
        shapes = next(v for v in grammar.variants if v.family.name in (family.name, family.steady)).shapes
        text = source(family, "found", shapes, place, ["What was found."])
        effect = made(text)
        assert check_effect.definition(effect, "found") == "", family.name
        assert "What was found." in text
        assert all(p.default == pytest.approx(shapes[p.name], rel=1e-5) for p in effect.shapes if p.name in shapes)
        # Ruff's line length of the project does not bind a user's file, but a docstring should be readable.
        assert max(len(line) for line in text.split('"""')[1].splitlines()[1:]) <= 120


def test_what_grows_with_the_pull_does_what_is_steady_in_proportion(forward: Forward, grammar: Grammar) -> None:
    action = [replace(a, rotation=np.tile([1.0, 0.0, 0.0, 0.0], (len(a), 1))) for a in trial.actions()]
    prediction = forward.predict(ANCHORS, action, keep=True)
    ways = np.concatenate([np.linalg.norm(a.translation, axis=1) for a in action]) / grammar.size
    sensitivity = Sensitivity(forward)
    some = ("pressure_at_a_spot", "body_force", "fibre_stress")
    for family in pulled_families(f for f in grammar.families if f.name in some):
        steady = grammar.term(
            next(v for v in grammar.variants if v.family.name == family.steady and v.place in ("", "top"))
        )
        probes = tuple(
            Probe(term, tuple(p.name for p in term.effect.amounts)) for term in (steady, grammar.like(family)(steady))
        )
        found = sensitivity.of(ANCHORS, action, prediction, SensitivityRequest(probes))
        for name, of_steady in found.probes[0].items():
            grown = found.probes[1][name]
            assert np.abs(grown).max() > 0, family.name
            expected = ways.reshape(-1, 1, 1) * of_steady
            assert grown == pytest.approx(expected, abs=1e-6 * np.abs(expected).max() + 1e-15), family.name
    sensitivity.destroy()


def test_a_variant_is_a_term_that_does_nothing(grammar: Grammar) -> None:
    variant = next(v for v in grammar.variants if v.family.name == "spring" and v.place == "top")
    term = grammar.term(variant)
    assert term.place == "top"
    assert term.values["stiffness"] == 0.0


def test_a_spot_about_a_surface_has_its_middle_and_its_area(grammar: Grammar) -> None:
    found = grammar.about("left")
    assert [found[f"c{axis}"] for axis in "xyz"] == pytest.approx([0.0, 0.01, 0.02], abs=1e-12)
    # The integral of the spot's weight over a plane.
    assert 2 * np.pi * found["radius"] ** 2 == pytest.approx(0.02 * 0.04)


@pytest.mark.parametrize("name", ["soft-spot", "3spots", "class", ""])
def test_names_that_no_effect_can_have_are_refused(name: str) -> None:
    with pytest.raises(InputError, match="cannot be the name of an effect"):
        check_name(name)
