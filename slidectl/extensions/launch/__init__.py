"""Launch files: reads roslaunch XML into a plan, and carries out the plan through the client.

`load` reads files and starts nothing. This package uses the simulation only through `slidectl.client`.
"""
