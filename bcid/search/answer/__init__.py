"""What is reported of a search: anchors, verdict, adequacy, sensitivity to the scene, what to do next, and the runs of commands."""
