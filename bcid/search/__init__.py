"""Finding the anchored patches: misfit, hill climbing over single toggles, stages over the ladder, belief, and the MPI farm."""
