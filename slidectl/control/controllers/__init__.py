"""The shipped controllers, one module for each family.

The registry imports every module of this folder, so a new family is a new file here and nothing else.
"""
