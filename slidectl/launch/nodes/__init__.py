"""The nodes that have a counterpart here, one file a family, and programs of the user's own.

`kinds` tells which is which.
"""
