"""Pixels: decoding of images and video, and how usable a picture is."""
