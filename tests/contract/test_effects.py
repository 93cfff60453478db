"""Every effect of the catalogue keeps the contract and its formula, and effects that do not are found out."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from mpi4py import MPI
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.spatial.transform import Rotation
from verify.problems import Prescribed, box, forces, move, scene_of, straight

from bcid.app import cli
from bcid.base.errors import InputError
from bcid.base.units import parse_unit
from bcid.forms import check_effect, effects, materials
from bcid.forms.effect_trial import EffectTrial
from bcid.forms.effects.effect import BodyEffect, Effect, Frame, ObservationEffect
from bcid.forms.forward import Forward
from bcid.forms.model import Anchors, Held, Model, Term
from bcid.forms.parameter import Amount, Parameter
from bcid.forms.solver.equilibrium import Equilibrium, Settings
from bcid.forms.solver.status import Status
from bcid.forms.solver.supports import Pose, nodal_weights
from bcid.forms.solver.trajectory import follow
from bcid.measurement import Action, Measurement
from bcid.scene import Level, Scene
from bcid.scene.parts import BodyRegion, Sphere

Array = NDArray[np.float64]

YOUNG, MU = 15e3, 15e3 / 2.7
BAR, AREA = (0.1, 0.02, 0.02), 4e-4
EXACT = Settings(rtol=1e-11)
EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "effects" / "magnetic_force.py"
CORE = {"core": BodyRegion(sphere=Sphere((0.05, 0.005, 0.05), 0.03))}


# ---------------------------------------------------------------- the contract

PLACES = [(name, None) for name in effects.names()] + [("soft_anchor", "left"), ("foundation", "sheared")]


@pytest.fixture(scope="module")
def trials() -> Iterator[Callable[..., EffectTrial]]:
    made: dict[Any, EffectTrial] = {}

    def trial(name: str, place: str | None) -> EffectTrial:
        if (name, place) not in made:
            made[name, place] = EffectTrial(effects.effect(name), place)
        return made[name, place]

    yield trial
    for one in made.values():
        one.destroy()


@pytest.fixture(scope="module")
def two_ranks() -> Mapping[str, Array]:
    return check_effect.on_two_ranks(effects.names())


@pytest.mark.parametrize("name", effects.names())
def test_definition(name: str) -> None:
    effect = effects.effect(name)
    assert check_effect.definition(effect, name) == ""
    for p in effect.parameters:
        parse_unit(p.unit)
        assert p.neutral is not None or p.default is not None or name in ("inclusion", "obstacle"), p.name
        if p.harmonics is not None:
            assert p.period is not None
            assert len(p.scan) == 2 * p.harmonics + 1, "as many as a trigonometric polynomial has coefficients"


@pytest.mark.parametrize("check", check_effect.CHECKS)
@pytest.mark.parametrize(("name", "place"), PLACES)
def test_contract(trials: Callable[..., EffectTrial], name: str, place: str | None, check: str) -> None:
    finding = check_effect.run(check, trials(name, place))
    assert finding.ok, finding


@pytest.mark.parametrize("name", effects.names())
def test_the_same_on_two_ranks(two_ranks: Mapping[str, Array], name: str) -> None:
    finding = check_effect.ranks(effects.effect(name), name, MPI.COMM_SELF, two_ranks[name])
    assert finding.ok, finding


# ---------------------------------------------------------------- effects that break it


def weight(**changes: Any) -> Effect:
    """Gravity under another name, with something else about it."""
    known: dict[str, Any] = {
        "name": "broken",
        "parameters": (Amount("weight", "N/m^3", "weight", neutral=0.0, scale=5000.0),),
        "about": "broken",
        "energy": lambda point, c: -c["weight"] * ufl.inner(point.down, point.u),
    }
    if "observe" in changes:
        return ObservationEffect(**{key: value for key, value in (known | changes).items() if key != "energy"})
    return BodyEffect(**(known | changes))


def amount(unit: str, scale: float = 100.0, **more: Any) -> tuple[Parameter, ...]:
    return (Amount("amount", unit, "how much", neutral=0.0, scale=scale, **more),)


def follower(point: Any, c: Any) -> Any:
    area = point.kin.J * ufl.inv(point.kin.F).T * point.N
    return c["amount"] * ufl.inner(area, point.v) * point.surface(point.support)


def jumping(point: Any, c: Any) -> Any:
    push = ufl.conditional(ufl.gt(point.u[0], 0), 1.0, 0.0)
    return c["amount"] * push * point.v[0] * point.surface(point.support)


CALLS: list[int] = []


def forgetful(point: Any, c: Any) -> Any:
    CALLS.append(1)
    return -c["weight"] * len(CALLS) * point.u[1]


BROKEN = {
    "vanishes": weight(energy=lambda point, c: -(c["weight"] + 100) * point.u[0]),
    "vanishes, seen by the camera": weight(
        observe=lambda positions, values, _frame, _place: positions + 1e-6 * (values["weight"] + 1)
    ),
    "acts": weight(parameters=amount("N/m^3", 1e-9), energy=lambda point, c: -c["amount"] * point.u[0]),
    "numbers": weight(energy=forgetful),
    "numbers, frozen": weight(energy=lambda point, c: -float(c["weight"].value) * point.u[0]),
    "tangent": weight(parameters=amount("Pa"), energy=None, work=jumping, symmetric=False),
    "differences": weight(
        parameters=amount("N^2/m^6", 1e4, lower=0.0),
        energy=lambda point, c: -ufl.sqrt(c["amount"] + 1e-300) * point.u[0],
    ),
    "symmetry": weight(parameters=amount("Pa"), energy=None, work=follower),
    "units": weight(parameters=(Amount("weight", "Pa", "weight", neutral=0.0, scale=5000.0),)),
    "units, a hidden length": weight(energy=lambda point, c: -c["weight"] * ufl.exp(point.X[0] / 0.05) * point.u[0]),
    "vanishes, an error inside": weight(energy=lambda point, c: c["wieght"] * point.u[0]),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_effect_is_found_out(case: str) -> None:
    with EffectTrial(BROKEN[case]) as trial:
        finding = check_effect.run(case.split(",")[0], trial)
    assert finding.ok is False, finding
    assert str(finding).startswith("WRONG")


def test_a_follower_load_that_says_so_passes() -> None:
    honest = weight(parameters=amount("Pa", 20.0), energy=None, work=follower, symmetric=False)
    assert [f.text for f in check_effect.findings(honest) if not f.ok] == []


@pytest.mark.parametrize(
    ("broken", "said"),
    [
        (weight(name="two words"), "use letters, digits and _"),
        (weight(acts_on="magic"), "acts_on = 'magic': allowed are body force"),
        (weight(energy=None), "it does nothing: give one of energy, potential"),
        (weight(parameters=(Parameter("speed", "m/s", "speed", default=1.0),)), "no parameter has a neutral value"),
        (weight(parameters=amount("kPa")), "amount: unit 'kPa' is not SI"),
        (weight(parameters=amount("stone")), "unit 'stone' is not known"),
        (weight(parameters=amount("Pa", 0.0)), "amount: scale = 0.0: give a positive size"),
        (weight(parameters=amount("Pa", 5.0, lower=-1, upper=1)), "outside the bounds on both sides"),
        (weight(parameters=amount("Pa") * 2), "parameter 'amount' is declared twice"),
        (weight(symmetric=False), "what has an energy has a symmetric tangent"),
        (weight(memory={"Q": (3, 3)}), "a memory that nothing advances"),
        (weight(places=lambda _scene, _anchors: []), "places gives none"),
    ],
)
def test_a_broken_definition_is_found_out(broken: Effect, said: str) -> None:
    first, *others = list(check_effect.findings(broken))
    assert first.ok is False
    assert said in first.text
    assert others == [], "what is not defined cannot be tried"


SOURCE = """
import ufl
from mpi4py import MPI
from bcid.forms.effects.effect import BodyEffect
from bcid.forms.parameter import Amount

effect = BodyEffect(
    name="{name}",
    parameters=(Amount("weight", "N/m^3", "weight", neutral=0.0, scale=5000.0),),
    about="weight",
    energy=lambda point, c: -c["weight"] * {more} * ufl.inner(point.down, point.u),
)
"""


def test_what_depends_on_the_ranks_is_found_out(tmp_path: Path) -> None:
    path = tmp_path / "shared.py"
    path.write_text(SOURCE.format(name="shared", more="MPI.COMM_WORLD.size"))
    finding = check_effect.ranks(effects.load(path), str(path), MPI.COMM_SELF)
    assert finding.ok is False
    assert "positions on 2 ranks differ" in finding.text


def test_without_mpirun_ranks_are_not_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    finding = check_effect.ranks(weight(), "weight", MPI.COMM_SELF)
    assert finding.ok is None
    assert "no mpirun" in str(finding)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("import ufl\neffect = (\n", r"mine.py:2: '\(' was never closed"),
        ("import ufl\n\nx = 1 / 0\n", "mine.py:3: ZeroDivisionError"),
        ("from bcid.forms.parameter import Parameter\nParameter('x', '1', '', lower=2, upper=1)\n", "mine.py:2: Value"),
        ("raise SystemExit(1)\n", "mine.py:1: SystemExit"),
        ("x = 1\n", "mine.py: defines no effect"),
        ("effect = 'gravity'\n", "mine.py: defines no effect"),
        (SOURCE.format(name="gravity", more="1"), "catalogue has an effect 'gravity' already"),
    ],
)
def test_files_that_cannot_be_used(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "mine.py"
    path.write_text(text)
    with pytest.raises(InputError, match=said):
        effects.load(path)


def test_a_file_that_is_not_there_or_not_python(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        effects.load(tmp_path / "none.py")
    (tmp_path / "effect.txt").write_text("")
    with pytest.raises(InputError, match=r"must end in \.py"):
        effects.load(tmp_path / "effect.txt")
    with pytest.raises(InputError, match="did you mean 'gravity'"):
        effects.effect("gravty")


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["check-effect", str(EXAMPLE)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2 + len(check_effect.CHECKS)
    assert all(line.startswith(("ok ", "-- ")) for line in lines)
    wrong = tmp_path / "wrong.py"
    wrong.write_text(SOURCE.format(name="other", more="1"))
    assert cli.main(["check-effect", str(wrong)]) == 2
    out, err = capsys.readouterr()
    assert "WRONG  definition: its name is 'other' but that of its file 'wrong'" in out
    assert "effect other: 1 of 1 checks failed; the other checks were not made" in err
    assert cli.main(["check-effect", "gravty"]) == 2
    assert "did you mean 'gravity'" in capsys.readouterr().err


# ---------------------------------------------------------------- formulas: energies


def model(law: str = "neo_hooke", **values: float) -> Model:
    known = materials.law(law)
    return Model(known, {"young": YOUNG, "poisson": 0.35} | values, down=(0.0, 0.0, -1.0))


def stretched(parts: Model, F: Array) -> Prescribed:
    """A cube of edge 1 m under a homogeneous deformation."""
    equilibrium = Prescribed.on(box((1.0, 1.0, 1.0), (2, 2, 2)), parts + Held("all"), rtol=1e-12)
    equilibrium.field = lambda points: points @ (F - np.eye(3)).T  # type: ignore[method-assign]
    assert equilibrium.solve(Pose()) is Status.CONVERGED
    return equilibrium


F = np.array([[1.1, 0.05, -0.02], [0.0, 0.95, 0.08], [0.1, 0.03, 1.05]])
C = F.T @ F
I1BAR = np.linalg.det(F) ** (-2 / 3) * np.trace(C)
A = np.array([math.cos(math.radians(30)), 0.0, math.sin(math.radians(30))])


@pytest.mark.parametrize(
    ("term", "energy"),
    [
        (Term("strain_stiffening", {"c2": 700.0}), 700 * (I1BAR - 3) ** 2),
        (Term("fibres", {"k1": 900.0, "angle": 30.0}), 450 * (A @ C @ A - 1) ** 2),
        (Term("active_stress", {"amplitude": -80.0, "angle": 30.0}), -40 * (A @ C @ A - 1)),
    ],
)
def test_energy(term: Term, energy: float) -> None:
    with_it, without = (stretched(m, F).energy() for m in (model() + term, model()))
    assert with_it - without == pytest.approx(energy, rel=1e-9)


def test_compressibility_is_another_poisson() -> None:
    expected = stretched(model(poisson=0.2), F).energy()
    assert stretched(model() + Term("compressibility", {"poisson": 0.2}), F).energy() == pytest.approx(expected)


@pytest.mark.parametrize(("form", "unit"), [("quadratic", "J - 1"), ("simo_taylor", "")])
def test_volumetric_form_is_that_of_the_law_with_it(form: str, unit: str) -> None:
    """All of it is the law with that form, whose energy per volume is bulk/2 (J - 1)^2 instead of bulk/2 (ln J)^2."""
    term = Term(f"volumetric_{form}", {"part": 1.0})
    whole = stretched(model() + term, F).energy()
    assert whole == pytest.approx(stretched(replace(model(), volumetric=form), F).energy(), rel=1e-12)
    if unit:
        bulk = YOUNG * 0.35 / (1.35 * 0.3)
        volume = np.linalg.det(F)
        expected = bulk / 2 * ((volume - 1) ** 2 - math.log(volume) ** 2)
        assert whole - stretched(model(), F).energy() == pytest.approx(expected, rel=1e-9)
    softer = model() + Term("compressibility", {"poisson": 0.2}) + term
    other = replace(model(poisson=0.2), volumetric=form)
    assert stretched(softer, F).energy() == pytest.approx(stretched(other, F).energy(), rel=1e-12)


def test_inclusion_has_the_volume_of_its_ball() -> None:
    values = {"ratio": 3.0, "cx": 0.4, "cy": 0.5, "cz": 0.6, "radius": 0.35}
    energies = []
    for parts in (model() + Term("inclusion", values), model()):
        # The whole boundary and the inside are held at the homogeneous state: only the factor counts.
        equilibrium = Prescribed.on(box((1.0, 1.0, 1.0), (6, 6, 6)), parts)
        equilibrium.u.x.array[:] = (equilibrium.body.nodes @ (F - np.eye(3)).T).ravel()
        energies.append(equilibrium.energy())
    # The ball's volume, and what its soft edge adds: 1 + (pi 0.1)^2.
    volume = 4 / 3 * math.pi * 0.35**3 * (1 + (0.1 * math.pi) ** 2)
    assert energies[0] / energies[1] - 1 == pytest.approx(2 * volume, rel=0.02)


# ---------------------------------------------------------------- formulas: bodies


def bar(parts: Model, **scene_changes: Any) -> Equilibrium:
    """A bar along x, 100 x 20 x 20 mm, that may be gripped at x1."""
    scene = replace(scene_of(("x0",), "x1", (0.1, 0.01, 0.01), down=(0.0, 0.0, -1.0)), **scene_changes)
    divisions = (10, 2, 2)
    return Forward(scene, model=parts, settings=EXACT, mesh=box(BAR, divisions)).equilibrium


def rollers(parts: Model) -> Model:
    return replace(parts, rollers=(("x0", 0), ("y0", 1), ("z0", 2)))


def pulled(equilibrium: Equilibrium, distance: float) -> float:
    """Force of the gripper after a small pull along x, N."""
    pose = Pose(np.array([distance, 0.0, 0.0]))
    assert equilibrium.solve(pose) is Status.CONVERGED
    return float(equilibrium.wrench(pose)[0])


def test_a_free_prestrained_block_shrinks_to_its_natural_shape() -> None:
    equilibrium = bar(rollers(model() + Term("prestrain", {"sx": 1.2, "sy": 0.9, "sz": 1.1})))
    assert equilibrium.solve(Pose()) is Status.CONVERGED
    expected = equilibrium.body.nodes * (1 / np.array([1.2, 0.9, 1.1]) - 1)
    np.testing.assert_allclose(equilibrium.displacement(), expected, atol=1e-9)
    assert equilibrium.energy() == pytest.approx(0.0, abs=1e-12)


def test_active_stress_shortens_a_free_block() -> None:
    equilibrium = bar(rollers(model() + Term("active_stress", {"amplitude": 1.5})))
    assert equilibrium.solve(Pose()) is Status.CONVERGED
    shortened = -equilibrium.displacement()[:, 0].min() / BAR[0]
    assert shortened == pytest.approx(1.5 / YOUNG, rel=1e-3)


def test_active_stress_comes_and_goes() -> None:
    parts = model() + Term("active_stress", {"amplitude": 100.0, "period": 4.0})
    at = [parts.acting(1.0, time)["active_stress.amplitude"] for time in (0.0, 1.0, 2.0, 3.0, 4.0)]
    assert at == pytest.approx([0.0, 50.0, 100.0, 50.0, 0.0])


def test_a_softly_anchored_bar_is_two_springs_in_series() -> None:
    parts = model(poisson=0.0) + Term("soft_anchor", {"stiffness": 2e5}) + Anchors({"x0"}) + Held("x1")
    series = 1 / (1 / (2e5 * AREA) + BAR[0] / (YOUNG * AREA))
    assert pulled(bar(parts), 1e-6) == pytest.approx(series * 1e-6, rel=1e-4)
    # Held by name is the same as held with all, and a patch that is not its place stays rigid.
    named = replace(parts, terms=(Term("soft_anchor", {"stiffness": 2e5}, place="x0"),))
    other = replace(parts, terms=(Term("soft_anchor", {"stiffness": 2e5}, place="y0"),))
    patches = {name: scene_of((name,)).patches[name] for name in ("x0", "y0")}
    assert pulled(bar(named), 1e-6) == pytest.approx(series * 1e-6, rel=1e-4)
    assert pulled(bar(other, patches=patches), 1e-6) == pytest.approx(YOUNG * AREA / BAR[0] * 1e-6, rel=1e-4)


def test_a_stiffness_gradient_is_springs_in_series() -> None:
    parts = model(poisson=0.0) + Term("stiffness_gradient", {"gx": 1.0, "gy": 0.0, "gz": 0.0})
    size = math.hypot(*BAR)
    flexibility, _ = quad(lambda x: 1 / (YOUNG * AREA * (1 + (x - BAR[0] / 2) / size)), 0, BAR[0])
    force = pulled(bar(parts + Anchors({"x0"}) + Held("x1")), 1e-6)
    assert force == pytest.approx(1e-6 / flexibility, rel=2e-3)


def test_a_block_sinks_into_its_foundation_by_weight_over_stiffness() -> None:
    parts = model() + Term("gravity", {"weight": 2000.0}) + Term("foundation", {"stiffness": 1e5})
    sides = replace(parts, rollers=(("x0", 0), ("y0", 1)))
    equilibrium = bar(sides, support="z0")
    assert equilibrium.solve(Pose()) is Status.CONVERGED
    share = nodal_weights(equilibrium.body, equilibrium.places["z0"], "place z0")
    assert share @ equilibrium.displacement()[:, 2] == pytest.approx(-2000 * BAR[2] / 1e5, rel=1e-6)


def test_support_contact_stops_sinking_but_not_lifting() -> None:
    heavy = model() + Term("gravity", {"weight": 3000.0}) + Anchors({"x0"})
    hard = heavy + Term("support_contact", {"stiffness": 1e6})
    free, held = (bar(parts, support="z0") for parts in (heavy, hard))
    for equilibrium in (free, held):
        assert follow(equilibrium, move(np.zeros((1, 3)), ""), lambda _k, _pose: None).status is Status.CONVERGED
    deepest = [-e.displacement()[e.body.nodes[:, 2] < 1e-9, 2].min() for e in (free, held)]
    assert deepest[0] > 3e-3
    assert deepest[1] < 3000 * BAR[2] / 1e6 + 1e-3 * math.hypot(*BAR)
    lifted = replace(heavy, down=(0.0, 0.0, 1.0)), replace(hard, down=(0.0, 0.0, 1.0))
    up = [bar(parts, support="z0") for parts in lifted]
    for equilibrium in up:
        assert follow(equilibrium, move(np.zeros((1, 3)), ""), lambda _k, _pose: None).status is Status.CONVERGED
    # Only where the bar's lower edge turns at its anchor does the body press down at all.
    assert up[1].displacement()[:, 2].max() == pytest.approx(up[0].displacement()[:, 2].max(), rel=0.02)


def test_friction_opposes_the_motion_and_leaves_a_loop() -> None:
    stress, bottom = 4.0, BAR[0] * BAR[1]
    equilibrium = bar(
        model(poisson=0.0) + Term("support_friction", {"shear_stress": stress}) + Held("x1"), support="z0"
    )
    path = 2e-3 * np.array([0, 1, 2, 3, 2, 1, 0])[:, None] * np.array([1.0, 0.0, 0.0])
    pull: list[float] = []
    result = follow(equilibrium, move(path, "x1"), lambda _k, pose: pull.append(float(equilibrium.wrench(pose)[0])))
    assert result.status is Status.CONVERGED
    assert pull[0] == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(pull[1:], stress * bottom * np.array([1, 1, 1, -1, -1, -1]), rtol=0.01)


def test_friction_does_not_depend_on_how_long_the_steps_are() -> None:
    """A bar that is drawn on by less than it gives sticks, with part of the stress, and does not creep when it is held."""
    # So small that the bar hardly stretches.
    stress, bottom, limit = 0.04, BAR[0] * BAR[1], 1e-3 * math.hypot(*BAR)
    parts = model(poisson=0.0) + Term("support_friction", {"shear_stress": stress}) + Held("x1")
    ends = []
    for steps in (1, 4):
        equilibrium = bar(parts, support="z0")
        pull = list[float]()
        # Out by four times what sticks, back by half of that, and out again by a quarter of it.
        far = limit * np.array([0.0, 4.0, 3.5, 3.75, 3.75])
        ways = np.interp(np.arange(4 * steps + 1) / steps, np.arange(5), far)
        path = ways[:, None] * np.array([1.0, 0.0, 0.0])

        def seen(_: int, pose: Pose, equilibrium: Equilibrium = equilibrium, pull: list[float] = pull) -> None:
            pull.append(float(equilibrium.wrench(pose)[0]))

        assert follow(equilibrium, move(path, "x1"), seen).status is Status.CONVERGED
        ends.append(pull[::steps])
    # From full stress the springs give way by half and by a quarter of what they stick by.
    for end in ends:
        np.testing.assert_allclose(end, stress * bottom * np.array([0, 1, 0.5, 0.75, 0.75]), rtol=0.03, atol=1e-9)


def test_a_viscous_body_relaxes_after_a_step_of_strain() -> None:
    """Isochoric stretch in 1 ms, then held: the overstress is that of the branch, falling as exp(-t/tau)."""
    tau, fraction, stretch = 3.0, 0.4, 1.2
    state = np.diag([stretch, stretch**-0.5, stretch**-0.5])
    equilibrium = Prescribed.on(
        box((1.0, 1.0, 1.0), (2, 2, 2)),
        model() + Term("viscosity", {"fraction": fraction, "relaxation_time": tau}) + Held("all"),
    )
    equilibrium.field = lambda points: points @ (state - np.eye(3)).T  # type: ignore[method-assign]
    end = equilibrium.body.nodes[:, 0] > 1 - 1e-9
    branch = MU * fraction / (1 - fraction)
    invariant = stretch**2 + 2 / stretch
    at_once = branch * stretch * (1 - invariant / 3 / stretch**2)
    long_time = MU * (stretch - 1 / stretch)
    for part, time in ((0.0, 0.0), (1.0, 1e-3), (1.0, 1.0), (1.0, 3.5), (1.0, 4.0), (1.0, 60.0)):
        pose = Pose(load_factor=part, time=time)
        assert equilibrium.solve(pose) is Status.CONVERGED
        stress = float(forces(equilibrium).reshape(-1, 3)[end, 0].sum())
        equilibrium.accept(pose)
        over = at_once * math.exp(-(time - 1e-3) / tau) if part else 0.0
        assert stress == pytest.approx(part * long_time + over, rel=2e-4, abs=1e-6 * MU)
    # A body that has long been as it is keeps no overstress, whatever was before.
    equilibrium.reset()
    assert equilibrium.solve(Pose()) is Status.CONVERGED
    assert float(forces(equilibrium).reshape(-1, 3)[end, 0].sum()) == pytest.approx(long_time, rel=1e-6)


@pytest.mark.parametrize(
    ("name", "value"), [("viscosity", {"fraction": 0.5}), ("support_friction", {"shear_stress": 4.0})]
)
def test_the_wrench_is_found_again_from_the_states(name: str, value: dict[str, float]) -> None:
    """What an effect remembers is part of the force, also when states are looked at afterwards."""
    parts = model() + Term(name, value)
    scene = replace(scene_of(("x0",), "x1", (0.1, 0.01, 0.01), fiducials={"a": (0.05, 0.01, 0.02)}), support="z0")
    forward = Forward(scene, model=parts, settings=EXACT, mesh=box(BAR, (5, 1, 1)))
    there_and_back = [move(np.array([0, 2, 4, 2, 0])[:, None] * np.array([1e-3, 0.0, 5e-4]), "x1")]
    states = forward.predict(["x0"], there_and_back, keep=True)
    wrench = forward.detail(["x0"], there_and_back, states).wrench
    assert wrench is not None
    assert abs(wrench[4, 0]) > 1e-3, "on the way back it pushes"
    seen: list[Array] = []
    forward.equilibrium.hold(["x0"], "x1")
    follow(forward.equilibrium, there_and_back[0], lambda _k, pose: seen.append(forward.equilibrium.wrench(pose)))
    np.testing.assert_allclose(wrench, seen, atol=1e-9)


# ---------------------------------------------------------------- formulas: grip and camera


def drive(name: str, action: Action, **values: float) -> Action:
    effect = effects.effect(name)
    assert effect.drive is not None
    return effect.drive(action, {p.name: values.get(p.name, p.neutral or 0.0) for p in effect.parameters})


def turning(steps: int, grasp: str = "x1") -> Action:
    """Straight, while turning by 10 degrees per step about (1, 2, 2)/3."""
    turns = [
        Rotation.from_rotvec(np.radians(10 * k) * np.array([1, 2, 2]) / 3).as_quat()[[3, 0, 1, 2]] for k in range(steps)
    ]
    path = np.arange(steps)[:, None] * np.array([2e-3, 1e-3, 0.0])
    return move(path, grasp, {"x1": np.arange(steps)[:, None] * np.array([0.1, 0.0, 0.0])}, turns)


def rotation(quaternion: Array) -> Rotation:
    return Rotation.from_quat(quaternion[[1, 2, 3, 0]])


def test_time_lag_shows_the_state_of_a_while_ago() -> None:
    late = drive("time_lag", turning(5), seconds=0.3)
    np.testing.assert_allclose(late.translation[:, 0], 2e-3 * np.array([0, 0.7, 1.7, 2.7, 3.7]), atol=1e-12)
    np.testing.assert_allclose(late.loads["x1"][:, 0], 0.1 * np.array([0, 0.7, 1.7, 2.7, 3.7]), atol=1e-12)
    angles = [rotation(q).magnitude() for q in late.rotation]
    np.testing.assert_allclose(np.degrees(angles), [0, 7, 17, 27, 37], atol=1e-6)
    early = drive("time_lag", turning(5), seconds=-0.5)
    np.testing.assert_allclose(early.translation[:, 0], 2e-3 * np.array([0.5, 1.5, 2.5, 3.5, 4.0]), atol=1e-12)
    unequal = replace(turning(3), times=np.array([0.0, 4.0, 5.0]))
    np.testing.assert_allclose(drive("time_lag", unequal, seconds=1.0).translation[:, 0], [0, 1.5e-3, 2e-3], atol=1e-12)
    one = drive("time_lag", turning(1), seconds=1.0)
    np.testing.assert_array_equal(one.translation, np.zeros((1, 3)))


def test_grasp_slip_is_less_of_the_motion() -> None:
    slipped = drive("grasp_slip", turning(4), lag=0.25)
    np.testing.assert_allclose(slipped.translation, 0.75 * turning(4).translation)
    for q, whole in zip(slipped.rotation, turning(4).rotation, strict=True):
        np.testing.assert_allclose(rotation(q).as_rotvec(), 0.75 * rotation(whole).as_rotvec(), atol=1e-12)
    free = replace(turning(3), grasp="")
    assert drive("grasp_slip", free, lag=0.5) is free


def test_grasp_slip_predicts_what_a_shorter_pull_does() -> None:
    fiducials = {"a": (0.05, 0.01, 0.02)}
    seen = []
    for parts, distance in ((model() + Term("grasp_slip", {"lag": 0.25}), 8e-3), (model(), 6e-3)):
        scene = scene_of(("x0",), "x1", (0.1, 0.01, 0.01), fiducials=fiducials)
        forward = Forward(scene, model=parts, settings=EXACT, mesh=box(BAR, (5, 1, 1)))
        seen.append(forward.predict(["x0"], [straight((distance, distance / 2, 0), 3, "x1")]).positions)
    np.testing.assert_allclose(seen[0], seen[1], atol=1e-10)


def test_grasp_offset_turns_about_another_centre_and_along_other_axes() -> None:
    commanded = turning(4)
    d, vector = np.array([3e-3, -2e-3, 1e-3]), np.array([4.0, -3.0, 6.0])
    values = dict(zip(("x", "y", "z", "rx", "ry", "rz"), [*d, *vector], strict=True))
    real = drive("grasp_offset", commanded, **values)
    axes = Rotation.from_rotvec(np.radians(vector))
    held = np.random.default_rng(0).normal(size=(5, 3)) * 0.01
    for k in range(4):
        turn = axes * rotation(commanded.rotation[k]) * axes.inv()
        expected = axes.apply(commanded.translation[k]) + turn.apply(held - d) - (held - d)
        found = real.translation[k] + rotation(real.rotation[k]).apply(held) - held
        np.testing.assert_allclose(found, expected, atol=1e-15)


def observe(name: str, positions: Array, frame: Frame, place: str = "", **values: float) -> Array:
    effect = effects.effect(name)
    assert effect.observe is not None
    given = {p.name: values.get(p.name, p.default if p.neutral is None else p.neutral) for p in effect.parameters}
    return effect.observe(positions, given, frame, place)  # type: ignore[arg-type]


def test_camera_offset_can_be_undone_by_hand() -> None:
    rest = np.random.default_rng(0).normal(size=(4, 3)) * 0.05
    frame = Frame(0, "1", 0, 0.0, ("a", "b", "c", "d"), rest)
    positions = rest + 0.01 * np.random.default_rng(1).normal(size=(4, 3))
    vector, shift = np.array([5.0, -7.0, 11.0]), np.array([1e-3, 2e-3, -3e-3])
    values = dict(zip(("rx", "ry", "rz", "tx", "ty", "tz"), [*vector, *shift], strict=True))
    seen = observe("camera_offset", positions, frame, scale=1.03, **values)
    middle = rest.mean(axis=0)
    back = middle + Rotation.from_rotvec(np.radians(vector)).inv().apply(seen - middle - shift) / 1.03
    np.testing.assert_allclose(back, positions, atol=1e-16)
    np.testing.assert_array_equal(observe("camera_offset", positions, frame), middle + (positions - middle))


def test_marker_fault_moves_one_fiducial_from_a_frame_on() -> None:
    rest = np.zeros((3, 3))
    for index, expected in ((2, 0.0), (3, 2e-3), (7, 2e-3)):
        seen = observe("marker_fault", rest, Frame(index, "1", 0, 0.0, ("a", "b", "c"), rest), "b", y=2e-3, onset=3.0)
        np.testing.assert_array_equal(seen, [[0, 0, 0], [0, expected, 0], [0, 0, 0]])
    assert not rest.any(), "what it is handed stays as it is"


# ---------------------------------------------------------------- scenes and needs


def slab(text: str, tmp_path: Path, project: Path) -> Scene:
    from bcid.forms.model import check_physics

    source = (project / "examples/scenes/slab.toml").read_text(encoding="utf-8")
    path = tmp_path / "scene.toml"
    path.write_text(source.replace("../../meshes", str(project / "meshes")) + text, encoding="utf-8")
    return Scene.read(path, physics=check_physics)


def test_places_are_checked_in_the_scene(tmp_path: Path, project: Path) -> None:
    good = '[effects.soft_anchor]\nplace = "3"\nstiffness = "1e6 Pa/m"\n'
    assert Model.of(slab(good, tmp_path, project)).terms[0].label == "soft_anchor(3)"
    with pytest.raises(InputError, match=r"soft_anchor: place = '9'; .*known: 1, 2"):
        slab(good.replace('"3"', '"9"'), tmp_path, project)
    fault = '[effects.marker_fault]\nx = "1 mm"\ny = "0 mm"\nz = "0 mm"\n'
    with pytest.raises(InputError, match="marker_fault: place is missing; known: 1, 2"):
        slab(fault, tmp_path, project)
    assert Model.of(slab(fault + 'place = "16"\n', tmp_path, project)).terms[0].place == "16"


def test_what_effects_need(project: Path) -> None:
    whole = replace(Scene.read(project / "examples/scenes/slab.toml"), regions=CORE)
    measurement = Measurement.read(project / "examples/measurements/slab-34-complex")
    for name in effects.names():
        needs = effects.effect(name).needs
        # The law's own form is log.
        other = name == "volumetric_log"
        fit = replace(whole, material=replace(whole.material, volumetric="quadratic")) if other else whole
        assert needs is None or needs(fit, measurement) == ""
    assert "the form log already" in effects.effect("volumetric_log").needs(whole, measurement)  # type: ignore[misc]
    still = replace(measurement, data=measurement.data.copy(deep=True))
    still.data["translation"][:] = 0.0
    still.data["rotation"][:] = [1.0, 0.0, 0.0, 0.0]
    bare = replace(whole, support="", regions={})
    for name in ("region_stiffness", "region_compressibility"):
        assert "no part of the body in [regions]" in effects.effect(name).needs(bare, measurement)  # type: ignore[misc]
    stated = replace(whole, regions={"core": replace(CORE["core"], constants={"poisson": 0.2})})
    assert "states the poisson" in effects.effect("region_compressibility").needs(stated, measurement)  # type: ignore[misc]
    lacking = {name: effects.effect(name).needs for name in effects.names()}
    for name in ("foundation", "support_contact", "support_friction"):
        assert "names no support surface" in lacking[name](bare, measurement)  # type: ignore[misc]
    for name in ("viscosity", "time_lag", "support_friction"):
        assert "nothing depends on time" in lacking[name](whole, still)  # type: ignore[misc]
    for name in ("grasp_slip", "grasp_offset"):
        assert "no gripper moves" in lacking[name](whole, still)  # type: ignore[misc]
    ogden = replace(whole, material=replace(whole.material, law="ogdn"))
    assert "unknown material law 'ogdn'" in lacking["compressibility"](ogden, measurement)  # type: ignore[misc]
    svk = replace(whole, material=replace(whole.material, law="saint_venant_kirchhoff"))
    assert "no separate volumetric energy" in lacking["volumetric_quadratic"](svk, measurement)  # type: ignore[misc]
    mixed = replace(whole, material=replace(whole.material, formulation="mixed"))
    assert "mixed formulation" in lacking["volumetric_quadratic"](mixed, measurement)  # type: ignore[misc]
    with pytest.raises(InputError, match="names no support surface"):
        bar(model() + Term("foundation", {"stiffness": 1e4}))


@pytest.mark.parametrize("name", effects.names())
def test_the_slab_can_be_solved_with_a_notable_dose(name: str, project: Path) -> None:
    scene = Scene.read(project / "examples/scenes/slab.toml")
    scene = replace(scene, levels=(Level(1, 0.05),), regions=CORE)
    effect, mm = effects.effect(name), 1e-3
    values = {p.name: 0.30 if p.law else p.scale + (0 if p.reciprocal else p.neutral) for p in effect.amounts}  # type: ignore[operator]
    values |= {"cx": 0.05, "cy": 0.005, "cz": 0.05, "radius": 0.03} if name == "inclusion" else {}
    values |= {"cx": 0.05, "cy": 0.045, "cz": 0.05, "radius": 0.03} if name == "obstacle" else {}
    places = {"marker_fault": "6", "tether": "6", "roller": "bottom"}
    places |= dict.fromkeys(("region_stiffness", "region_compressibility"), "core")
    term = Term(effect, values, place=places.get(name, ""))
    forward = Forward(scene, model=Model.of(scene) + term)
    pulls = [straight((x * mm, y * mm, z * mm), 3, "II") for x, y, z in ((16, 0, 0), (0, 8, 0), (8, 0, 8), (-4, 0, -8))]
    pulls = [replace(pull, name=str(k), frames=pull.frames + 4 * k) for k, pull in enumerate(pulls)]
    prediction = forward.predict(["3", "4"], pulls)
    assert prediction.failure is None, prediction.failure
    assert prediction.complete
