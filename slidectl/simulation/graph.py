"""The graph: topics, services, parameters, the log, timers and the clock that they share.

No physics and no control here; the simulation hangs those on it.
"""

from __future__ import annotations

from slidectl.simulation.clock import Clock, ClockTopic
from slidectl.simulation.node import GraphNode
from slidectl.simulation.parameters import Parameters
from slidectl.simulation.rosout import Rosout
from slidectl.simulation.services import Services
from slidectl.simulation.timers import Timers
from slidectl.simulation.topics import NodePublisher, Topics

WORLD_NODE = "/gazebo"
CLOCK_FREQUENCY = "/gazebo/pub_clock_frequency"


class Graph:
    """Everything that a client can see or do. `clock_topic` publishes /clock."""

    def __init__(self) -> None:
        self.clock = Clock()
        self.timers = Timers(self.clock.now_ns)
        self.topics = Topics()
        self.services = Services()
        self.parameters = Parameters()
        self.caller = 0
        """The session id of the process whose request is being carried out, 0 when nobody knows or none is."""
        self.log = Rosout(self.topics, self.clock.now_ns, WORLD_NODE)
        clock = self.topics.advertise("/clock", "rosgraph_msgs/Clock", WORLD_NODE, kind=NodePublisher)
        self.clock_topic = ClockTopic(clock)
        self.parameters.watch(CLOCK_FREQUENCY, self._take_clock_frequency)

    def node(self, namespace: str = "/", name: str = WORLD_NODE) -> GraphNode:
        """A node handle in `namespace` of the node `name`."""
        return GraphNode(self, namespace, name)

    def nodes(self) -> list[str]:
        """Names of all nodes that publish, subscribe or serve, sorted."""
        return sorted(self.topics.nodes() | self.services.nodes())

    def close_node(self, name: str) -> None:
        """A node has gone (a client hung up): take back all that it had."""
        self.topics.close_node(name)
        self.services.close_node(name)

    def _take_clock_frequency(self) -> None:
        self.clock_topic.set_frequency(self.parameters.get(CLOCK_FREQUENCY, 0))
