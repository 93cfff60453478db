"""What bcid is measured against, and how: `bcid bench` (see docs/bench.md)."""
