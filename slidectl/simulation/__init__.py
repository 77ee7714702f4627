"""The simulation: clock, robots, and the graph of topics, services and parameters with the built-in services.

It knows simulated time only: no sockets, no wall time, no threads.
"""

from slidectl.simulation.feature import Feature
from slidectl.simulation.graph import Graph
from slidectl.simulation.pending import Pending
from slidectl.simulation.simulation import Simulation
from slidectl.simulation.spawned_robots import SpawnedRobot

__all__ = ["Feature", "Graph", "Pending", "Simulation", "SpawnedRobot"]
