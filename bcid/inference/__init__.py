"""Inference: what measured positions say about hypotheses, once noise and the error of the mesh are counted."""
