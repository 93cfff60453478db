"""The forward model in UFL: body, laws, effects, equilibrium, and what the fiducials would show."""
