"""The Foxglove gateway: its WebSocket protocol, for any number of apps."""
