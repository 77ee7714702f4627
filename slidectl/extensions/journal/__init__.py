"""The journal of a world, and its replay."""
