"""rosbridge over WebSocket: roslib in browsers, roslibpy. A frame is a line of the daemon's socket."""
