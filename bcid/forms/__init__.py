"""The forward model in UFL: body, laws, effects, equilibrium, and what the fiducials would show."""

from bcid.base.solver_wheel import prepare

prepare()
