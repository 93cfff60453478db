"""Studies of identification, written as study files, and those of the paper."""
