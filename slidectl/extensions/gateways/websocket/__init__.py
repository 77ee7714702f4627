"""rosbridge over WebSocket, for roslib in browsers and roslibpy. A frame is a line of the daemon's protocol."""
