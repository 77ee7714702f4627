"""A feature: counts the robots that were spawned since the last reset."""

from slidectl.simulation import Feature


class SpawnCounter(Feature):
    def attach(self, simulation):
        self.count = 0
        self.published = self.node.advertise("count", "std_msgs/Int32", latch=True)
        self.node.advertise_service("forget", "std_srvs/Trigger", self.forget)

    def set(self, count):
        self.count = count
        self.published.publish({"data": count})

    def on_spawn(self, robot):
        self.set(self.count + 1)

    def forget(self, request):
        text = f"{self.count} spawns forgotten"
        self.set(0)
        return {"success": True, "message": text}

    def reset(self):
        self.set(0)

    def save_state(self):
        return {"count": self.count}

    def load_state(self, state):
        self.set(state["count"])
