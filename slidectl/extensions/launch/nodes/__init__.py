"""Tasks for nodes that have a counterpart here, one file per family, and for the user's programs.

node_kinds.py chooses the task for a node.
"""
