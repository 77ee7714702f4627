"""For Foxglove: its WebSocket protocol, spoken to any number of apps."""
