"""Finding the anchored patches: hill climbing over single toggles, stages over the ladder, and the evaluator over MPI ranks."""
