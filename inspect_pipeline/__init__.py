"""Recordings in, annotations and rows out."""
