"""Geometry of cameras and the ground: attitudes, pixel rays, the local frame, terrain."""
