"""The features of a simulation, each in a file of its own. Only the table in simulation/feature.py names them."""
