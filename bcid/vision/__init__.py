"""From two cameras that watch beads on a body to a measurement."""
