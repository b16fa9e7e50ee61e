"""Drawn clutter: objects that are mistaken for cables."""
