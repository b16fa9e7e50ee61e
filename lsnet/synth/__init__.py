"""Synthetic training images (Section III-A): cables drawn over photographs, with what is mistaken for them."""
