"""What everything else stands on: errors, units, progress, ranks, files of others, run folders."""
