"""Tracking of lines over the frames of a camera."""
