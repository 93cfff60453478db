"""Measurements by an independent finite element code of worlds that are outside the family of models."""
