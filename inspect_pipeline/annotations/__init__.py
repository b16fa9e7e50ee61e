"""Detections as messages that viewers draw and programs read."""
