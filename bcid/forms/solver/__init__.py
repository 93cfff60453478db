"""Solving: equilibria, their tangents and factors, trajectories through them, and what tells a stable state."""
