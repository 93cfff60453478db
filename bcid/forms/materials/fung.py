"""Fung solid in Guccione's form: exponential stiffening with one fibre direction, for heart muscle and the like.

Parameters:
    c: scale of the energy, Pa.
    bf: stiffening along the fibres.
    bt: stiffening across the fibres.
    bfs: stiffening in shear between the fibres and their cross-section.
    angle: fibre direction in the plane of fibres, degrees.
    poisson: ratio that sets the volumetric stiffness; it is Poisson's ratio at small strain if bf = bt = bfs.

Equation:
    psi = c/2 (exp Q - 1) + U(J), U = bulk/2 (ln J)^2 unless another U is chosen
    Q = bf Eff^2 + bt (Ecc^2 + Err^2 + 2 Ecr^2) + 2 bfs (Efc^2 + Efr^2)
    with the Green-Lagrange strain E of the whole deformation along the fibres (f) and two directions across them (c, r)

Relation to known quantities:
    At small strain the shear modulus is c bfs/2 in planes that hold the fibre and c bt/2 across it; `shear` is the
    mean over the three planes, mu = c (2 bfs + bt)/6. bulk = 2 mu nu / (1 - 2 nu), which makes bf = bt = bfs = b
    Hooke's solid with mu = c b/2 and that nu; the mixed form needs nu > 0. Benchmark of Land et al. (2015), problem
    1: c = 2 kPa, bf = 8, bt = 2, bfs = 4, fibres along the beam, incompressible (poisson = 0.5 in the mixed form).

Source:
    Guccione, McCulloch & Waldman, J. Biomech. Eng. 113 (1991) 42; Land et al., Proc. R. Soc. A 471 (2015) 20150641.

Example:
    >>> from bcid.forms import materials
    >>> land = {"c": 2e3, "bf": 8.0, "bt": 2.0, "bfs": 4.0, "poisson": 0.5}
    >>> materials.law("fung").check(land, mixed=True)
    []
"""

from __future__ import annotations

import ufl
from ufl.core.expr import Expr

from bcid.forms.kinematics import Kinematics, expm1
from bcid.forms.materials._moduli import POISSON, first_lame, first_lame_compliance
from bcid.forms.materials.law import Constants, Law, Scalar
from bcid.forms.parameter import Parameter


def shear(c: Constants) -> Scalar:
    """Mean of the three initial shear moduli, c (2 bfs + bt)/6 (Pa)."""
    return c["c"] * (2 * c["bfs"] + c["bt"]) / 6


def energy(kin: Kinematics, c: Constants) -> Expr:
    """c/2 (exp Q - 1); the strains across the fibres enter through E:E, which needs no cross directions."""
    f = kin.direction(c["angle"])
    Ef = kin.E * f
    along = ufl.inner(f, Ef) ** 2
    sliding = ufl.inner(Ef, Ef) - along
    across = ufl.inner(kin.E, kin.E) - along - 2 * sliding
    return c["c"] / 2 * expm1(c["bf"] * along + c["bt"] * across + 2 * c["bfs"] * sliding)


law = Law(
    name="fung",
    title="Fung (Guccione)",
    parameters=(
        Parameter("c", "Pa", "scale of the energy", lower=0, open_lower=True),
        Parameter("bf", "1", "stiffening along the fibres", lower=0),
        Parameter("bt", "1", "stiffening across the fibres", lower=0),
        Parameter("bfs", "1", "stiffening in shear along the fibres", lower=0),
        Parameter("angle", "deg", "fibre direction in the plane of fibres", default=0, lower=-180, upper=180, scale=10),
        POISSON,
    ),
    energy=energy,
    shear=shear,
    bulk=lambda c: first_lame(shear(c), c["poisson"]),
    compliance=lambda c: first_lame_compliance(shear(c), c["poisson"]),
    isotropic=False,
    about="Exponential, transversely isotropic solid for heart muscle and fibrous tissue.",
)
