"""The ROS commands word for word: `slidectl ros rostopic ...`, and shell functions of their names.

One module for each tool, imported when it runs. Names, options and output are those of the tools; what they do is
done by the code of slidectl's own commands.
"""
