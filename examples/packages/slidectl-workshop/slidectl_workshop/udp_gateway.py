"""The gateway `slidectl gateway udp`: numbers in datagrams become messages."""

import asyncio
from dataclasses import dataclass, field

from slidectl.effects import Effect
from slidectl.extensions.gateways import DaemonConnection, Gateway, GatewayOptions


class UdpGateway(Gateway):
    """Accept numbers over UDP.

    Each number becomes a std_msgs/Float64 on the topic; the answer is ok, or what is wrong.
    """

    @dataclass(frozen=True)
    class Options(GatewayOptions):
        port: int = field(default=9870, metadata={"help": "Port; 0: a free one."})
        topic: str = field(default="/udp", metadata={"help": "Where the numbers are published."})

    def __init__(self, options):
        super().__init__()
        self.options = options
        self.received = 0
        self.connection = None

    async def open(self):
        loop = asyncio.get_running_loop()
        address = ("127.0.0.1", self.options.port)
        self.socket, _ = await loop.create_datagram_endpoint(lambda: Datagrams(self), local_addr=address)
        return f"udp://127.0.0.1:{self.socket.get_extra_info('sockname')[1]}"

    async def attach(self, paths):
        permitted = (Effect.READS, Effect.WRITES)  # clients get neither files nor code
        self.connection = await DaemonConnection.open(paths, permitted, on_lost=self.lost.set)
        self.connection.advertise(self.options.topic, "std_msgs/Float64")

    def receive(self, datagram):
        self.received += 1
        if self.connection is None:
            return "error: the daemon is gone"
        try:
            self.connection.publish(self.options.topic, {"data": float(datagram)})
        except ValueError as error:
            return f"error: {error}"
        return "ok"

    async def detach(self):
        if self.connection is not None:
            self.connection.close()
        self.connection = None

    async def close(self):
        self.socket.close()

    def status(self):
        return {"connections": 0, "dropped": 0, "received": self.received}


class Datagrams(asyncio.DatagramProtocol):
    """Passes each datagram to the gateway, and its answer back."""

    def __init__(self, gateway):
        self.gateway = gateway

    def connection_made(self, transport):
        self.transport = transport

    def datagram_received(self, data, sender):
        self.transport.sendto(self.gateway.receive(data).encode(), sender)
