"""Images that two cameras would take of a body with beads on it, with known truth."""
