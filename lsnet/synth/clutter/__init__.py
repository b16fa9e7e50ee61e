"""Drawn clutter: what is mistaken for cables and is none."""
