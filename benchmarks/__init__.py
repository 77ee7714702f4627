"""Measurements of slidectl, run by `make bench`. Nothing here asserts a time: machines are shared and noisy."""
