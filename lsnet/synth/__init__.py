"""Synthetic training images (Section III-A): cables and similar objects over photographs."""
