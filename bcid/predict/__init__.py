"""Predictions of a measurement by any hypothesis, at several fidelities, spread over ranks and kept on disk."""
