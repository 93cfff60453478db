"""Choosing the next pull: belief over anchor sets, expected information of the pulls a robot may make, the loop, robots."""
