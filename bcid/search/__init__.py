"""Finding the anchored patches: misfit, hill climbing over single toggles, stages over the mesh ladder, belief, and the MPI farm."""
