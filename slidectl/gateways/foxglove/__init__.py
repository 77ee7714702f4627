"""The door for Foxglove: its WebSocket protocol, spoken to any number of apps."""
