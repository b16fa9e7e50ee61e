"""Synthetic training images (Section III-A): cables over photographs, and what is mistaken for them."""
