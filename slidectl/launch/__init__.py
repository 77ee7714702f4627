"""Launch files: roslaunch XML into a plan, and a plan carried out through the client.

`load` reads files and starts nothing. It works on the simulation only through `slidectl.client`.
"""
