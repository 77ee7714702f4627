"""The ROS commands with their own words: `slidectl ros rostopic ...`, and shell functions of their names.

One module for each tool, imported when it runs. Names, options and output are those of the tools; they use the code of
slidectl's own commands.
"""
