"""Other programs on the same problems, each written as its own documentation writes it."""

from bcid.base.solver_wheel import prepare

# Peers import DOLFINx themselves, in processes of their own.
prepare()
