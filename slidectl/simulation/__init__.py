"""The simulation: clock, robots, and the graph of topics, services and parameters with the services that are built in.

Knows simulated time only: no sockets, no wall time, no threads.
"""

from slidectl.simulation.graph import Graph
from slidectl.simulation.pending import Pending
from slidectl.simulation.robots import SpawnedRobot
from slidectl.simulation.simulation import Simulation

__all__ = ["Graph", "Pending", "Simulation", "SpawnedRobot"]
