"""The shipped controllers, one module for each family.

The registry imports every module of this folder, so a new family needs only a new file here.
"""
