"""Simulated flights along a drawn power line, with their truth."""
