"""The control cycle as machine code: the same laws on rows of tables instead of objects, and copying to and from them.

Optional: it needs numba (`pip install '.[fast]'`). Without it, and until it is ready, the interpreter runs
the cycles, with the same results to the bit.
"""
