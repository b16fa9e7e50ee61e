"""Coverage of a flight: how much of the frames, the time, the spans and the corridor was covered."""
