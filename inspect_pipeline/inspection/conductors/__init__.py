"""Conductors of spans in three dimensions: frames aligned, places found, votes on where each is present."""
