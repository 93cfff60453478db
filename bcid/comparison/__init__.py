"""Comparing model and measurement: adequate? where does it fail? which effect is missing? add it, and compare again."""
