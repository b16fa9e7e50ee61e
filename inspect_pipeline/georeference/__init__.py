"""Position, attitude and ground resolution of frames."""
