"""Geometry of cameras and the ground: attitudes, rays, local frames, terrain."""
