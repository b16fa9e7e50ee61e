"""Recordings made from photographs, videos and split parts."""
