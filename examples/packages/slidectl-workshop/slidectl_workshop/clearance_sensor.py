"""The sensor `<sensor type="clearance">`: the distance to what is below it."""

from slidectl.simulation import SensorKind


class Clearance(SensorKind):
    """A range finder that looks down its z axis. Its tag <range> has <min> and <max>, m (0.02 and 10)."""

    message_type = "sensor_msgs/Range"

    def __init__(self, tags):
        self.nearest = tags.number("range/min", 0.02)
        self.farthest = tags.number("range/max", 10.0)

    def measure(self, view):
        [distance] = view.distances([(0.0, 0.0, -1.0)], self.nearest, self.farthest)
        return {
            "header": view.header,
            "radiation_type": 1,
            "min_range": self.nearest,
            "max_range": self.farthest,
            "range": distance + view.noise(),
        }
